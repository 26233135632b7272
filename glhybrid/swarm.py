"""Poses of nodes and instances, compiled: a frame of one takes microseconds, and one of thousands all cores.

Import it only where something moves, or where there are thousands (MANY). Small scenes begin with the same functions as
plain Python, which gives the same bits and needs no Numba (kernels.py). Each function does what NumPy does elsewhere
for what is looked at once (keys.Tracks.at, pose.Player.at, pose.place, GpuScene); tests hold both against each other.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np

from glhybrid import layout
from glhybrid.kernels import MOTION

TASK = 8192  # elements under which a range is not worth another thread
KINDS = {"STEP": 0, "LINEAR": 1, "SLERP": 2, "CUBICSPLINE": 3, "CUBIC_TURN": 4}
_fields: Any = layout.dtype("Instance").fields
FLAG: int = _fields["flipped"][1] // 4  # column of 32-bit words in rows of layout Instance
assert (_fields["world_from_object"][1], _fields["object_from_world"][1]) == (0, 64)  # as `place` has it


def spread(function: Callable[[int, int], Any], first: int, last: int) -> list[Any]:
    """function(first, last) over parts of a range, one a core."""
    if last - first < 2 * TASK or (parts := min(_cores(), (last - first) // TASK)) == 1:
        return [function(first, last)]
    edges = np.linspace(first, last, parts + 1).astype(int).tolist()
    return list(_pool().map(lambda k: function(edges[k], edges[k + 1]), range(parts)))


@lru_cache(1)
def _cores() -> int:
    return min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 16)


@lru_cache(1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_cores(), "glhybrid-swarm")


@MOTION.kernel("void(f1, f3, i1, i1, i1, float64, int64, int64, int64, float64[:, ::1])")
def sample(times, values, starts, ends, rows, time, kind, first, last, out):  # type: ignore[no-untyped-def]
    """Channels first..last-1 at a time -> their rows of out (N, W). values: (K, 1 or 3, W); rotations unit but for
    cubic ones."""
    width = out.shape[1]
    for c in range(first, last):
        row = rows[c]
        low, high = starts[c], ends[c]
        while low < high:
            middle = (low + high) >> 1
            if times[middle] > time:
                high = middle
            else:
                low = middle + 1
        before = max(low - 1, starts[c])
        key = 1 if kind >= 3 else 0
        if kind == 0 or low == starts[c] or low == ends[c]:
            for w in range(width):
                out[row, w] = values[before, key, w]
        else:
            step = times[low] - times[before]
            u = (time - times[before]) / step
            a, b = 1 - u, u
            if kind == 2:
                dot = 0.0
                for w in range(4):
                    dot += values[before, 0, w] * values[low, 0, w]
                sign = -1.0 if dot < 0 else 1.0
                apart, together = 0.0, 0.0
                for w in range(4):
                    less = values[before, 0, w] - sign * values[low, 0, w]
                    more = values[before, 0, w] + sign * values[low, 0, w]
                    apart += less * less
                    together += more * more
                angle = 2 * math.atan2(np.sqrt(apart), np.sqrt(together))
                if angle >= 1e-9:
                    sine = math.sin(angle)
                    a, b = math.sin(a * angle) / sine, math.sin(b * angle) / sine
                b *= sign
            if kind >= 3:
                square, cube = u * u, u * u * u
                p, q = 2 * cube - 3 * square + 1, (cube - 2 * square + u) * step
                r, s = 3 * square - 2 * cube, (cube - square) * step
                for w in range(width):
                    out[row, w] = (
                        p * values[before, 1, w] + q * values[before, 2, w]
                        + r * values[low, 1, w] + s * values[low, 0, w]
                    )  # fmt: skip
            else:
                for w in range(width):
                    out[row, w] = a * values[before, 0, w] + b * values[low, 0, w]
        if kind == 2 or kind == 4:
            length = 0.0
            for w in range(4):
                length += out[row, w] * out[row, w]
            length = np.sqrt(length)
            for w in range(4):
                if length > 1e-30:
                    out[row, w] /= length
                else:
                    out[row, w] = 1.0 if w == 3 else 0.0


@MOTION.kernel("int64(f2, f2, f2, b1, f3, i1, i1, int64, int64, float64[:, :, ::1])")
def pose_level(translation, rotation, scale, posed, local, nodes, parents, first, last, world):  # type: ignore[no-untyped-def]
    """world_from_node of nodes[first:last], whose parents are done or come before them. posed: nodes whose T, R, S
    count, not `local`.

    Returns a node whose matrix is not finite, -1 if there is none.
    """
    bad = -1
    m = np.empty((3, 4))
    for k in range(first, last):
        node, parent = nodes[k], parents[k]
        if posed[node]:
            x, y, z, w = rotation[node, 0], rotation[node, 1], rotation[node, 2], rotation[node, 3]
            m[0, 0], m[0, 1], m[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
            m[1, 0], m[1, 1], m[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
            m[2, 0], m[2, 1], m[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
            for i in range(3):
                for j in range(3):
                    m[i, j] *= scale[node, j]
                m[i, 3] = translation[node, i]
        else:
            for i in range(3):
                for j in range(4):
                    m[i, j] = local[node, i, j]
        total = 0.0
        for i in range(3):
            for j in range(4):
                value = m[i, j]
                if parent >= 0:
                    value = (
                        world[parent, i, 0] * m[0, j] + world[parent, i, 1] * m[1, j] + world[parent, i, 2] * m[2, j]
                    )
                    if j == 3:
                        value += world[parent, i, 3]
                world[node, i, j] = value
                total += value
        world[node, 3, 0] = world[node, 3, 1] = world[node, 3, 2] = 0.0
        world[node, 3, 3] = 1.0
        if not np.isfinite(total):
            bad = node
    return bad


@MOTION.helper
def determinant(m):  # type: ignore[no-untyped-def]
    """Of the linear part."""
    return (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]) - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )  # fmt: skip


@MOTION.kernel("int64(f3, i1, f3, b1, i1, int64, int64, float64[:, :, ::1], uint8[::1], uint8[::1])")
def carry(world, nodes, local, plain, rows, first, last, out, flat, moved):  # type: ignore[no-untyped-def]
    """out[rows[k]] = world[nodes[k]] @ local[k], k from first to last - 1; plain: where local is the identity.

    flat: set where the result may have no volume; returns how many. moved: set where it is not what was there.
    """
    count = 0
    for k in range(first, last):
        node, row = nodes[k], rows[k]
        moved[k] = 0
        for i in range(3):
            for j in range(4):
                value = world[node, i, j]
                if not plain[k]:
                    value = (
                        world[node, i, 0] * local[k, 0, j] + world[node, i, 1] * local[k, 1, j]
                        + world[node, i, 2] * local[k, 2, j]
                    )  # fmt: skip
                    if j == 3:
                        value += world[node, i, 3]
                if out[row, i, j] != value:
                    out[row, i, j] = value
                    moved[k] = 1
        out[row, 3, 0] = out[row, 3, 1] = out[row, 3, 2] = 0.0
        out[row, 3, 3] = 1.0
        m = out[row]
        size = 0.0
        for i in range(3):
            for j in range(3):
                size += m[i, j] * m[i, j]
        flat[k] = abs(determinant(m)) <= 1e-6 * size * np.sqrt(size)
        count += 1 if flat[k] else 0
    return count


@MOTION.helper
def _positions(m, inv, origin, words):  # type: ignore[no-untyped-def]
    """The last columns of both matrices, for a world whose zero is origin."""
    x, y, z = m[0, 3] - origin[0], m[1, 3] - origin[1], m[2, 3] - origin[2]
    words[12], words[13], words[14] = x, y, z
    for i in range(3):
        words[28 + i] = -(inv[i, 0] * x + inv[i, 1] * y + inv[i, 2] * z)


@MOTION.kernel(
    "int64(f3, i1, f3, u1, i1, int64, int64, f1, int64, uint32[:, ::1], float32[:, ::1], float64[:, :, ::1], "
    "uint8[::1], float64[:, :, ::1])"
)
def place(world, ids, bounds, mesh, rows, first, last, origin, flag, bits, words, inverse, flipped, boxes):  # type: ignore[no-untyped-def]
    """Instances rows[first:last], at world[ids[row]], of a world whose zero is origin (3,).

    Both matrices in `words`, the rows of layout Instance as float32, and in column `flag` of `bits`, the same as
    uint32, whether they are mirrored; inverse (I, 3, 3); boxes (I, 2, 3), world, of bounds (M, 2, 3) by mesh.
    Returns how many are mirrored that were not, or the other way round.
    """
    turned = 0
    for n in range(first, last):
        k = rows[n]
        m, inv = world[ids[k]], inverse[k]
        det = determinant(m)
        turned += flipped[k] != (det < 0)
        flipped[k] = det < 0
        bits[k, flag] = det < 0
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                c, d = (j + 1) % 3, (j + 2) % 3
                inv[j, i] = (m[a, c] * m[b, d] - m[a, d] * m[b, c]) / det
        for i in range(3):
            middle, half = m[i, 3], 0.0
            for j in range(3):
                words[k, 4 * j + i] = m[i, j]  # columns first, as GLSL has it
                words[k, 16 + 4 * j + i] = inv[i, j]
                low, high = bounds[mesh[k], 0, j], bounds[mesh[k], 1, j]
                middle += m[i, j] * (low + high) / 2
                half += abs(m[i, j]) * (high - low) / 2
            boxes[k, 0, i], boxes[k, 1, i] = middle - half, middle + half
        _positions(m, inv, origin, words[k])
    return turned


@MOTION.kernel("void(f3, i1, f3, f1, int64, int64, float32[:, ::1])")
def rebase(world, ids, inverse, origin, first, last, words):  # type: ignore[no-untyped-def]
    """The positions of both matrices of instances first..last-1, for a world whose zero is origin (3,)."""
    for k in range(first, last):
        _positions(world[ids[k]], inverse[k], origin, words[k])
