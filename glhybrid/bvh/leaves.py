"""Triangles to fragments before a tree is grown, and to slots in leaf order after it: compiled, in threads."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numba import types

from glhybrid.bvh.boxes import clear, half_area, merge_centroid
from glhybrid.jit import kernel
from glhybrid.scene import F32, U16, U32

TASK = 16384  # fragments under which a range is not worth another thread

_T = TypeVar("_T")


def _constant(item: Any, dimensions: int) -> Any:
    """Type of an input array, which may be one that cannot be written."""
    return types.Array(item, dimensions, "C", readonly=True)


@kernel(
    types.void(
        _constant(types.float32, 3), types.int64, types.int64, types.float64[::1], types.float64[::1], types.float64,
        types.uint16[:, ::1], types.uint16[:, ::1], types.int64,
    )
)  # fmt: skip
def triangle_fragments(position, first, last, grid_min, cells, pad, fragments, centroids, row):  # type: ignore[no-untyped-def]
    """Fragments first..last-1 of as many triangles, and the bounds of their centroids in row `row` of centroids.

    cells: 1 / grid step. Rounded outward by the rule of `fragments.quantise`.
    """
    clear(centroids, row)
    for i in range(first, last):
        for axis in range(3):
            a, b, c = position[i, 0, axis], position[i, 1, axis], position[i, 2, axis]
            low = (np.float64(min(a, min(b, c))) - pad - grid_min[axis]) * cells[axis] - 0.05
            high = (np.float64(max(a, max(b, c))) + pad - grid_min[axis]) * cells[axis] + 1.05
            fragments[i, axis] = 65535 - max(int(low), 0)  # int() of a positive number rounds down,
            fragments[i, 3 + axis] = min(int(high), 65535)  # and one more than that is past the next cell
        fragments[i, 6], fragments[i, 7] = i & 65535, i >> 16
        merge_centroid(centroids, row, fragments, i)


@kernel(
    types.void(
        _constant(types.uint32, 2), _constant(types.uint32, 1), _constant(types.uint32, 1), types.uint16[:, ::1],
        types.int64, types.int64,
        types.uint32[:, ::1],
    )
)  # fmt: skip
def fill_slots(vertices, triangle, geometry, fragments, first, last, slots):  # type: ignore[no-untyped-def]
    """Slots first..last-1 of the leaves, in leaf order. vertices: (P, 9) float bits; ids past them are left alone."""
    for i in range(first, last):
        p = np.int64(fragments[i, 6]) | np.int64(fragments[i, 7]) << 16
        if p < len(vertices):
            for vertex in range(3):
                for axis in range(3):
                    slots[i, vertex * 4 + axis] = vertices[p, vertex * 3 + axis]
            slots[i, 3], slots[i, 7], slots[i, 11] = triangle[p], geometry[p], 0


@kernel(types.void(types.uint16[:, ::1], types.float32[::1], types.int64, types.int64, types.float32[::1]))
def fill_areas(fragments, step, first, last, area):  # type: ignore[no-untyped-def]
    """area[i] = half the surface area of fragment i."""
    for i in range(first, last):
        area[i] = half_area(fragments, i, step)


def _parallel(function: Callable[[int, int, int], _T], count: int, threads: int) -> list[_T]:
    """function(first, last, number of the part) over parts of range(count), one a thread."""
    edges = np.linspace(0, count, threads + 1).astype(int).tolist() if count > TASK else [0, count]
    parts = list(zip(edges, edges[1:], range(len(edges)), strict=False))
    if len(parts) == 1:
        return [function(*parts[0])]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda part: function(*part), parts))


def make_fragments(position: F32, grid_min: F32, grid_step: F32, pad: float, threads: int = 1) -> tuple[U16, U16]:
    """Of (T, 3, 3) vertices: fragments (T, 8), and the bounds of their centroids (8,)."""
    fragments, bounds = np.empty((len(position), 8), np.uint16), np.zeros((threads, 8), np.uint16)
    origin, cells = grid_min.astype(np.float64), 1 / grid_step.astype(np.float64)
    _parallel(
        lambda first, last, part: triangle_fragments(
            position, first, last, origin, cells, pad, fragments, bounds, part
        ),
        len(position),
        threads,
    )
    return fragments, bounds.max(0)


def half_surfaces(fragments: U16, grid_step: F32, threads: int = 1) -> F32:
    """(F,) half the surface areas of fragments, in square metres of the grid."""
    area = np.empty(len(fragments), np.float32)
    _parallel(lambda first, last, _: fill_areas(fragments, grid_step, first, last, area), len(fragments), threads)
    return area


def make_slots(position: F32, triangle: U32, geometry: U32, fragments: U16, threads: int = 1) -> U32:
    """(F, 12) slots in leaf order. Fragments whose id is past the triangles are left for the caller to fill."""
    slots, vertices = np.empty((len(fragments), 12), np.uint32), position.reshape(-1, 9).view(np.uint32)
    _parallel(
        lambda first, last, _: fill_slots(vertices, triangle, geometry, fragments, first, last, slots),
        len(fragments),
        threads,
    )
    return slots


def centroid_bounds(fragments: U16) -> U16:
    """(8,) uint16: union of all `merge_centroid` values."""
    half = fragments >> np.uint16(1)
    return (half - half[:, [3, 4, 5, 0, 1, 2, 6, 7]] + np.uint16(32767)).max(0)
