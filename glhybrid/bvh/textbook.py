"""A plain full binned-SAH build on float boxes, for its cost alone: the measure for trees that are built faster.

Its kernel compiles on first use (seconds, once per machine), so only tests and `bench` import this module.
"""

from typing import Any

import numpy as np
from numba import types

from glhybrid.jit import kernel


@kernel(
    types.UniTuple(types.float64, 2)(
        types.float32[:, ::1], types.float32[:, ::1], types.uint32[::1], types.int64, types.int64, types.int64[:, ::1]
    )
)  # fmt: skip
def _binned_sah(low, high, order, bins, max_leaf, stack):  # type: ignore[no-untyped-def]
    size, total, depth = 1, 0.0, 0
    root = 0.0
    box, centre = np.empty((2, 3), np.float32), np.empty((2, 3), np.float32)
    count = np.empty((3, bins), np.int64)
    bin_low, bin_high = np.empty((3, bins, 3), np.float32), np.empty((3, bins, 3), np.float32)
    behind, side = np.empty(bins, np.float64), np.empty((2, 3), np.float32)
    while size:
        size -= 1
        first, last, level = stack[size, 0], stack[size, 1], stack[size, 2]
        n, depth = last - first, max(depth, level)
        box[0], box[1], centre[0], centre[1] = np.inf, -np.inf, np.inf, -np.inf
        for i in range(first, last):
            p = order[i]
            for k in range(3):
                c = low[p, k] + high[p, k]
                box[0, k], box[1, k] = min(box[0, k], low[p, k]), max(box[1, k], high[p, k])
                centre[0, k], centre[1, k] = min(centre[0, k], c), max(centre[1, k], c)
        x, y, z = (
            np.float64(box[1, 0] - box[0, 0]),
            np.float64(box[1, 1] - box[0, 1]),
            np.float64(box[1, 2] - box[0, 2]),
        )
        area = x * y + y * z + z * x
        if level == 0:
            root = area
        best, best_axis, best_split = np.inf, -1, 0
        if n > 1:
            count[:], bin_low[:], bin_high[:] = 0, np.inf, -np.inf
            for i in range(first, last):
                p = order[i]
                for axis in range(3):
                    if centre[1, axis] > centre[0, axis]:
                        at = (low[p, axis] + high[p, axis] - centre[0, axis]) / (centre[1, axis] - centre[0, axis])
                        b = min(np.int64(at * bins), bins - 1)
                        count[axis, b] += 1
                        for k in range(3):
                            bin_low[axis, b, k] = min(bin_low[axis, b, k], low[p, k])
                            bin_high[axis, b, k] = max(bin_high[axis, b, k], high[p, k])
            for axis in range(3):
                for turn in range(2):
                    side[0], side[1], m = np.inf, -np.inf, 0
                    for step in range(1, bins):
                        b = bins - step if turn == 0 else step - 1
                        for k in range(3):
                            side[0, k] = min(side[0, k], bin_low[axis, b, k])
                            side[1, k] = max(side[1, k], bin_high[axis, b, k])
                        m += count[axis, b]
                        x, y, z = side[1, 0] - side[0, 0], side[1, 1] - side[0, 1], side[1, 2] - side[0, 2]
                        half = np.float64(x * y + y * z + z * x) * m if m else 0.0
                        if turn == 0:
                            behind[b] = half
                        elif 0 < m < n and half + behind[step] < best:
                            best, best_axis, best_split = half + behind[step], axis, step
        if n <= max_leaf and area * n <= area + best:
            total += area * n
            continue
        total += area
        middle = first
        if best_axis < 0:
            middle = (first + last) // 2
        else:
            for i in range(first, last):
                p = order[i]
                at = (low[p, best_axis] + high[p, best_axis] - centre[0, best_axis]) / (
                    centre[1, best_axis] - centre[0, best_axis]
                )
                if min(np.int64(at * bins), bins - 1) < best_split:
                    order[i], order[middle] = order[middle], p
                    middle += 1
        stack[size, 0], stack[size, 1], stack[size, 2] = first, middle, level + 1
        stack[size + 1, 0], stack[size + 1, 1], stack[size + 1, 2] = middle, last, level + 1
        size += 2
    return total / root, np.float64(depth)


def binned_sah(position: Any, bins: int = 16, max_leaf: int = 4) -> tuple[float, int]:
    """SAH cost and depth of a textbook build: float32 boxes, all bins at every node, leaves when they are cheaper.

    position: (T, 3, 3). The measure for `bvh.build_blas`, whose cost is of its coarser, padded boxes.
    """
    position = np.asarray(position, np.float32).reshape(-1, 3, 3)
    stack = np.zeros((4096, 3), np.int64)
    stack[0] = 0, len(position), 0
    order = np.arange(len(position), dtype=np.uint32)
    low, high = np.ascontiguousarray(position.min(1)), np.ascontiguousarray(position.max(1))
    cost, depth = _binned_sah(low, high, order, bins, max_leaf, stack)
    return float(cost), int(depth)
