"""Slow oracles for rays, on the CPU: brute force in float64, and the packed tree as the shader walks it.

- `closest_hit`, `any_hit`: every triangle for every ray, float64. Trust these.
- `traverse`: the packed nodes and slots of a Blas, in float64 (a second oracle that can do millions of rays) or in
  float32, operation by operation what glsl/lib does, with counts of nodes and triangles. The float32 form is the
  specification of the shader, and of what its watertightness rests on.
Kernels compile on first use (seconds, once per machine), so only tests and the study import this module.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from glhybrid.bvh import Blas
from glhybrid.bvh.blas import threads_available
from glhybrid.jit import kernel
from glhybrid.scene import F64, U32

NO_HIT = 0xFFFFFFFF
LEAF = 0x80000000
Test = Literal["woop", "moller-trumbore"]


@dataclass(frozen=True, eq=False)
class Hits:
    """One row a ray. t: float64, in lengths of the direction, +inf = miss. triangle: uint32, NO_HIT = miss.

    bary: (R, 2) weights of the second and third vertex. From `traverse` also geometry, the slot, and the counts of
    nodes visited (two boxes each) and of triangles tested, uint32.
    """

    t: F64
    triangle: U32
    bary: F64
    geometry: U32 | None = None
    slot: U32 | None = None
    nodes_visited: U32 | None = None
    triangles_tested: U32 | None = None

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(R,) bool: whether anything was met."""
        return self.triangle != NO_HIT


@njit
def shear(d):  # type: ignore[no-untyped-def]
    """Axes and shear that turn the direction into the z axis (Woop, Benthin & Wald 2013, listing 1).

    Not swapping x and y for negative z mirrors the picture, and so the sign of all three weights: the test ignores it.
    """
    z = 0
    if abs(d[1]) > abs(d[z]):
        z = 1
    if abs(d[2]) > abs(d[z]):
        z = 2
    x, y = (z + 1) % 3, (z + 2) % 3
    return x, y, z, d[x] / d[z], d[y] / d[z]


@njit
def woop(v, o, d, frame):  # type: ignore[no-untyped-def]
    """Watertight ray/triangle test. v: (9,) vertices; frame: shear(d). Returns hit, t, weights of vertices 2 and 3.

    Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013, in the precision of its arguments,
    without their fallback to double. Watertight because both triangles at an edge compute its sign from the same two
    rounded points, so no operation may be contracted (GLSL: `precise`). An edge belongs to both sides: there is no gap.
    t is that of the plane, which is more exact than the mean of the depths, kept between the depths of the vertices.
    """
    x, y, z, sx, sy = frame
    az, bz, cz = v[z] - o[z], v[3 + z] - o[z], v[6 + z] - o[z]
    ax, ay = (v[x] - o[x]) - sx * az, (v[y] - o[y]) - sy * az
    bx, by = (v[3 + x] - o[x]) - sx * bz, (v[3 + y] - o[y]) - sy * bz
    cx, cy = (v[6 + x] - o[x]) - sx * cz, (v[6 + y] - o[y]) - sy * cz
    a, b, c = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    zero = a - a
    if (a < zero or b < zero or c < zero) and (a > zero or b > zero or c > zero):
        return False, zero, zero, zero
    det = a + b + c
    if det == zero:
        return False, zero, zero, zero
    az, bz, cz = az / d[z], bz / d[z], cz / d[z]
    nx, ny, nz = normal(v)
    slope = nx * d[0] + ny * d[1] + nz * d[2]
    if slope == zero:
        t = (a * az + b * bz + c * cz) / det
    else:
        t = (nx * (v[0] - o[0]) + ny * (v[1] - o[1]) + nz * (v[2] - o[2])) / slope
        t = min(max(t, min(az, bz, cz)), max(az, bz, cz))
    return True, t, b / det, c / det


@njit
def normal(v):  # type: ignore[no-untyped-def]
    """(v1 - v0) x (v2 - v0) of (9,) vertices."""
    ax, ay, az = v[3] - v[0], v[4] - v[1], v[5] - v[2]
    bx, by, bz = v[6] - v[0], v[7] - v[1], v[8] - v[2]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit
def moller_trumbore(v, o, d):  # type: ignore[no-untyped-def]
    """The control: Moeller & Trumbore 1997, which leaks at edges and vertices. Returns as `woop` does."""
    ax, ay, az = v[3] - v[0], v[4] - v[1], v[5] - v[2]
    bx, by, bz = v[6] - v[0], v[7] - v[1], v[8] - v[2]
    px, py, pz = d[1] * bz - d[2] * by, d[2] * bx - d[0] * bz, d[0] * by - d[1] * bx
    det = ax * px + ay * py + az * pz
    zero = det - det
    if det == zero:
        return False, zero, zero, zero
    sx, sy, sz = o[0] - v[0], o[1] - v[1], o[2] - v[2]
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    b, c = (sx * px + sy * py + sz * pz) / det, (d[0] * qx + d[1] * qy + d[2] * qz) / det
    if b < zero or c < zero or b + c > det / det:
        return False, zero, zero, zero
    return True, (bx * qx + by * qy + bz * qz) / det, b, c


@njit
def sphere(centre, radius, o, d, t_min):  # type: ignore[no-untyped-def]
    """Nearest t >= t_min where the ray meets the sphere (Haines et al., Ray Tracing Gems 2019, ch. 7). Hit, t."""
    fx, fy, fz = o[0] - centre[0], o[1] - centre[1], o[2] - centre[2]
    a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    b = -(fx * d[0] + fy * d[1] + fz * d[2])
    k = b / a
    x, y, z = fx + k * d[0], fy + k * d[1], fz + k * d[2]
    under = radius * radius - (x * x + y * y + z * z)
    if under < a - a:
        return False, under
    root = np.sqrt(a * under)
    q = b + root if b >= a - a else b - root
    first, second = (fx * fx + fy * fy + fz * fz - radius * radius) / q, q / a
    near, far = min(first, second), max(first, second)
    t = near if near >= t_min else far
    return t >= t_min, t


@njit
def volume(ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    """(a x b) . c"""
    return (ay * bz - az * by) * cx + (az * bx - ax * bz) * cy + (ax * by - ay * bx) * cz


@kernel(
    types.void(
        types.float64[:, ::1], types.float64[:, ::1], types.float64[:, ::1], types.float64[::1], types.float64[::1],
        types.boolean, types.int64, types.int64, types.float64[::1], types.uint32[::1], types.float64[:, ::1],
    )
)  # fmt: skip
def _brute_force(vertices, origins, directions, t_min, t_max, any_hit, first, last, t, triangle, bary):  # type: ignore[no-untyped-def]
    # Pluecker form with sums and differences of vertices (Embree's robust test): well conditioned far away, tight at
    # edges, and another arithmetic than woop's, so that the two can check each other.
    for r in range(first, last):
        ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
        dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
        nearest = t_max[r]
        for i in range(len(vertices)):
            ax, ay, az = vertices[i, 0] - ox, vertices[i, 1] - oy, vertices[i, 2] - oz
            bx, by, bz = vertices[i, 3] - ox, vertices[i, 4] - oy, vertices[i, 5] - oz
            cx, cy, cz = vertices[i, 6] - ox, vertices[i, 7] - oy, vertices[i, 8] - oz
            a = volume(bx + cx, by + cy, bz + cz, cx - bx, cy - by, cz - bz, dx, dy, dz)
            b = volume(cx + ax, cy + ay, cz + az, ax - cx, ay - cy, az - cz, dx, dy, dz)
            c = volume(ax + bx, ay + by, az + bz, bx - ax, by - ay, bz - az, dx, dy, dz)
            det = a + b + c
            if (min(a, b, c) < 0 and max(a, b, c) > 0) or det == 0:
                continue
            ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            distance = (nx * ax + ny * ay + nz * az) / (nx * dx + ny * dy + nz * dz)
            if t_min[r] <= distance <= nearest and (distance < nearest or triangle[r] == NO_HIT):
                nearest = distance
                t[r], triangle[r], bary[r, 0], bary[r, 1] = distance, i, b / det, c / det
                if any_hit:
                    break


def _walk(  # type: ignore[no-untyped-def]
    nodes, slots, points, grid_min, grid_step, origins, directions, t_min, t_max, tiny, any_hit, control, first, last,
    t, triangle, geometry, slot, bary, visited, tested,
):  # fmt: skip
    """All float arrays of one type, which is the precision of every operation. points: slots as that type."""
    stack = np.empty(128, np.uint32)
    idir, low_offset, high_offset = np.empty_like(grid_min), np.empty_like(grid_min), np.empty_like(grid_min)
    entry = np.empty(2, grid_min.dtype)
    cells, rounding = tiny[1], tiny[2]
    vertex = np.empty(9, grid_min.dtype)
    for r in range(first, last):
        o, d = origins[r], directions[r]
        frame = shear(d)
        for k in range(3):
            slope = d[k] / grid_step[k]
            if abs(slope) < tiny[0]:
                slope = tiny[0] if slope >= slope - slope else -tiny[0]
            idir[k] = tiny[3] / slope
            place = (o[k] - grid_min[k]) / grid_step[k]
            pad = (abs(place) + cells) * rounding
            low_offset[k], high_offset[k] = (place + pad) * idir[k], (place - pad) * idir[k]
        nearest, size, current = t_max[r], 0, np.uint32(0)
        while True:
            if current < LEAF:
                visited[r] += np.uint32(1)
                for side in range(2):
                    near, far = t_min[r], nearest
                    for k in range(3):
                        word = nodes[current, side * 4 + k]
                        a = grid_min.dtype.type(word & np.uint32(0xFFFF)) * idir[k] - low_offset[k]
                        b = grid_min.dtype.type(word >> np.uint32(16)) * idir[k] - high_offset[k]
                        near, far = max(near, min(a, b)), min(far, max(a, b))
                    entry[side] = near if near <= far else np.inf
                closer = np.int64(entry[1] < entry[0])
                if any_hit and max(entry[0], entry[1]) < np.inf:
                    closer = 1 - closer
                if entry[1 - closer] < np.inf:
                    stack[size] = nodes[current, (1 - closer) * 4 + 3]
                    size += 1
                if entry[closer] < np.inf:
                    current = nodes[current, closer * 4 + 3]
                    continue
            else:
                start, count = np.int64(current & np.uint32(0x7FFFFFFF)) >> 4, np.int64(current & np.uint32(15))
                for s in range(start, start + count):
                    tested[r] += np.uint32(1)
                    if slots[s, 11] == 1:
                        hit, distance = sphere(points[s, :3], points[s, 4], o, d, t_min[r])
                        b, c = distance - distance, distance - distance
                    else:
                        for k in range(9):
                            vertex[k] = points[s, k // 3 * 4 + k % 3]
                        if control:
                            hit, distance, b, c = moller_trumbore(vertex, o, d)
                        else:
                            hit, distance, b, c = woop(vertex, o, d, frame)
                    if not hit or not t_min[r] <= distance <= nearest:
                        continue
                    if distance == nearest and slots[s, 3] >= triangle[r]:  # of equals the lowest id, in any tree
                        continue
                    nearest = distance
                    t[r], triangle[r], geometry[r], slot[r] = distance, slots[s, 3], slots[s, 7], s
                    bary[r, 0], bary[r, 1] = b, c
                    if any_hit:
                        size = 0
                        break
            if size == 0:
                break
            size -= 1
            current = stack[size]


@lru_cache
def _walk_kernel(precision: type) -> Any:
    real = types.float32 if precision is np.float32 else types.float64
    ids, line, rows = types.uint32[::1], real[::1], real[:, ::1]
    table = types.uint32[:, ::1]
    flags = [types.boolean, types.boolean, types.int64, types.int64]
    results = [types.float64[::1], ids, ids, ids, types.float64[:, ::1], ids, ids]
    return kernel(types.void(table, table, rows, line, line, rows, rows, line, line, line, *flags, *results))(_walk)


def _in_parts(function: Callable[[int, int], None], count: int, threads: int | None) -> None:
    workers = threads_available() if threads is None else threads
    edges = np.linspace(0, count, 8 * workers + 1).astype(int).tolist()
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(function, edges, edges[1:]))


def _rays(origins: Any, directions: Any, t_min: Any, t_max: Any, precision: type) -> list[NDArray[Any]]:
    """Rays as contiguous arrays of one precision: (R, 3), (R, 3), (R,), (R,); single values stand for all rays."""
    directions = np.array(directions, precision, order="C").reshape(-1, 3)
    count = len(directions)
    rays: list[NDArray[Any]] = [np.array(np.broadcast_to(origins, (count, 3)), precision, order="C"), directions]
    return rays + [np.array(np.broadcast_to(end, (count,)), precision) for end in (t_min, t_max)]


def closest_hit(
    triangles: Any, origins: Any, directions: Any, t_min: Any = 0.0, t_max: Any = np.inf, threads: int | None = None,
    any_hit: bool = False,
) -> Hits:  # fmt: skip
    """The nearest of (T, 3, 3) triangles within [t_min, t_max] of each ray, all of them tried, in float64.

    origins, directions: (R, 3); t_min, t_max: (R,) or one number. Of equal t the lowest index wins. About 3 ns a
    triangle and ray. any_hit: stop at the first that is found.
    """
    vertices = np.ascontiguousarray(triangles, np.float64).reshape(-1, 9)
    rays = _rays(origins, directions, t_min, t_max, np.float64)
    count = len(rays[1])
    hits = Hits(np.full(count, np.inf), np.full(count, NO_HIT, np.uint32), np.zeros((count, 2)))
    _in_parts(
        lambda a, b: _brute_force(vertices, *rays, any_hit, a, b, hits.t, hits.triangle, hits.bary), count, threads
    )
    return hits


def any_hit(
    triangles: Any, origins: Any, directions: Any, t_min: Any = 0.0, t_max: Any = np.inf, threads: int | None = None
) -> NDArray[np.bool_]:
    """(R,) bool: whether anything is within [t_min, t_max], by brute force in float64."""
    return closest_hit(triangles, origins, directions, t_min, t_max, threads, any_hit=True).hit


def traverse(
    blas: Blas, origins: Any, directions: Any, t_min: Any = 0.0, t_max: Any = np.inf, *, any_hit: bool = False,
    precision: type = np.float64, test: Test = "woop", threads: int | None = None,
) -> Hits:  # fmt: skip
    """The packed tree, walked as glsl/lib/bvh.glsl walks it, with counts.

    precision np.float32 is the shader's arithmetic without contraction; np.float64 is an oracle for many rays.
    """
    rays = _rays(origins, directions, t_min, t_max, precision)
    count = len(rays[1])
    ids = [np.full(count, NO_HIT, np.uint32) for _ in range(3)] + [np.zeros(count, np.uint32) for _ in range(2)]
    triangle, geometry, slot, visited, tested = ids
    t, bary = np.full(count, np.inf), np.zeros((count, 2))
    # Smallest slope, so that no product is 0 * inf; cells and their share for rounding of plane and origin; one.
    constants: NDArray[Any] = np.array([1e-20, 65536, 6e-7 if precision is np.float32 else 1e-14, 1], precision)
    tree: tuple[Any, ...] = (blas.nodes, blas.slots, blas.slots.view(np.float32).astype(precision),
            blas.grid_min.astype(precision), blas.grid_step.astype(precision))  # fmt: skip
    walk = _walk_kernel(precision)
    _in_parts(
        lambda a, b: walk(*tree, *rays, constants, any_hit, test != "woop", a, b,
                          t, triangle, geometry, slot, bary, visited, tested),
        count, threads,
    )  # fmt: skip
    return Hits(t, triangle, bary, geometry, slot, visited, tested)
