"""The compiled builder: binned SAH over 16-bit boxes. Import it only where a large tree is really built.

Method: Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies": all three axes are binned in one
pass over the fragments (see fragments.py), which are then partitioned in place, without a branch. Up to four fragments
are not binned: the cheapest of all their subtrees and leaves is found by dynamic programming over subsets (Karras &
Aila 2013, "Fast Parallel Construction of High-Quality Bounding Volume Hierarchies", section 4, for n = 4). Chosen over
float boxes and an index array, which move three times the memory; textbook.binned_sah is that control.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit, types

from glhybrid.bvh.boxes import centroid, clear, half_area, merge, merge_centroid, swap
from glhybrid.bvh.fragments import LEAF, MEDIAN_DEPTH, Grown, single_leaf
from glhybrid.bvh.leaves import TASK
from glhybrid.jit import kernel
from glhybrid.scene import F32, U16, U32

BINS = 16
SMALL = 32  # ranges up to this size get half the bins: same cost of the tree within 0.02 %, 15 % less time
STACK = 128  # > MEDIAN_DEPTH + 27 + 2, as there are at most 2^27 fragments


@njit
def split_few(fragments, first, n, step, max_leaf, subset, cost, choice):  # type: ignore[no-untyped-def]
    """The best subtree over n <= 4 fragments. Bit i of a subset is fragment first + i; fills choice and cost.

    Returns the subset that goes left, after moving it to the front; 0 = make a leaf.
    """
    everything = (1 << n) - 1
    for s in range(1, everything + 1):
        low = s & -s
        clear(subset, s)
        merge(subset, s, fragments, first + (low >> 1) - (low >> 3))  # log2 of 1, 2, 4, 8
        if s == low:
            cost[s] = half_area(subset, s, step)
            continue
        merge(subset, s, subset, s ^ low)
        area = half_area(subset, s, step)
        count = (s & 1) + (s >> 1 & 1) + (s >> 2 & 1) + (s >> 3)
        best, choice[s] = np.float32(np.inf), 0
        if count <= max_leaf:
            best = area * np.float32(count)
        left = (s - 1) & s
        while left:
            if left & low:  # each pair of halves once
                c = area + cost[left] + cost[s ^ left]
                if c < best:
                    best, choice[s] = c, left
            left = (left - 1) & s
        cost[s] = best
    left, middle = choice[everything], first
    for i in range(n):
        if left >> i & 1:
            swap(fragments, middle, first + i)
            middle += 1
    return middle if left else first


@njit
def split_bins(fragments, first, last, low, span, step, bins, count, right):  # type: ignore[no-untyped-def]
    """Axis, bins and first bin of the right side of the cheapest split into two; the bins of that axis are filled.

    low, span: (3,) int64, smallest centroid and extent of the centroids, not all zero.
    """
    n = last - first
    size = BINS if n > SMALL else BINS // 2
    for i in range(3 * BINS):
        clear(bins, i)
        count[i] = 0
    # Multiply and shift put the largest centroid in bin size - 1 at most, and past bin 0 if span > 0.
    low0, low1, low2 = low[0], low[1], low[2]
    scale0, scale1, scale2 = (size << 16) // (span[0] + 1), (size << 16) // (span[1] + 1), (size << 16) // (span[2] + 1)
    for i in range(first, last):
        x = (centroid(fragments, i, 0) - low0) * scale0 >> 16
        y = ((centroid(fragments, i, 1) - low1) * scale1 >> 16) + BINS
        z = ((centroid(fragments, i, 2) - low2) * scale2 >> 16) + 2 * BINS
        merge(bins, x, fragments, i)
        merge(bins, y, fragments, i)
        merge(bins, z, fragments, i)
        count[x] += 1
        count[y] += 1
        count[z] += 1
    best, best_axis, best_split = np.float32(np.inf), 0, 1
    for axis in range(3):
        if span[axis] == 0:
            continue
        offset, side = axis * BINS, 3 * BINS
        clear(bins, side)
        total = 0
        for i in range(size - 1, 0, -1):
            merge(bins, side, bins, offset + i)
            total += count[offset + i]
            right[i] = half_area(bins, side, step) * np.float32(total)
        clear(bins, side)
        total = 0
        for i in range(1, size):
            merge(bins, side, bins, offset + i - 1)
            total += count[offset + i - 1]
            c = half_area(bins, side, step) * np.float32(total) + right[i]
            if c < best and 0 < total < n:
                best, best_axis, best_split = c, axis, i
    return best_axis, size, best_split


@njit
def select_middle(fragments, first, last, axis):  # type: ignore[no-untyped-def]
    """Quickselect: afterwards no centroid before the middle is larger than any behind it."""
    middle = (first + last) >> 1
    a, b = first, last - 1
    while a < b:
        pivot = centroid(fragments, (a + b) >> 1, axis)
        i, j = a, b
        while i <= j:
            while centroid(fragments, i, axis) < pivot:
                i += 1
            while centroid(fragments, j, axis) > pivot:
                j -= 1
            if i <= j:
                swap(fragments, i, j)
                i += 1
                j -= 1
        if middle <= j:
            b = j
        elif middle >= i:
            a = i
        else:
            break
    return middle


@kernel(
    types.Tuple((types.int64, types.int64, types.int64, types.float64))(
        types.uint16[:, ::1], types.uint32[:, ::1], types.int64[:, ::1], types.uint16[:, ::1], types.float32[::1],
        types.int64, types.int64, types.boolean,
    )
)  # fmt: skip
def grow(fragments, nodes, todo, todo_centroids, step, max_leaf, median_depth, once):  # type: ignore[no-untyped-def]
    """Build the subtree of the range in todo[0]; with `once`, split it a single time and leave its halves in todo.

    fragments: (F, 8) uint16, reordered in place so that leaves are ranges. nodes: (n, 8) uint32 for n fragments,
    filled from row 0 in depth-first order; the last row is the root's parent. todo: (STACK, 5) int64 first, last,
    depth, parent row, side; todo_centroids: (STACK, 8) uint16 bounds of their centroids. step: see half_area.
    Returns the number of nodes, of ranges left in todo, the largest depth and the summed cost in half areas.
    """
    bins = np.empty((3 * BINS + 1, 8), np.uint16)
    count = np.empty(3 * BINS, np.int64)
    right = np.empty(BINS, np.float32)
    subset, subset_cost, choice = np.empty((16, 8), np.uint16), np.empty(16, np.float32), np.zeros(16, np.int64)
    low, span = np.empty(3, np.int64), np.empty(3, np.int64)
    child, child_centroids = np.empty((3, 8), np.uint16), np.empty((2, 8), np.uint16)
    size, deepest, total, waiting = 0, 0, 0.0, 1
    while waiting:
        waiting -= 1
        first, last, depth = todo[waiting, 0], todo[waiting, 1], todo[waiting, 2]
        parent, parent_ref = todo[waiting, 3], todo[waiting, 4] * 4 + 3
        n, widest = last - first, 0
        for axis in range(3):
            low[axis] = 65534 - np.int64(todo_centroids[waiting, axis])
            span[axis] = np.int64(todo_centroids[waiting, 3 + axis]) - low[axis]
            if span[axis] > span[widest]:
                widest = axis
        clear(child, 0)
        clear(child, 1)
        if n <= 4:
            middle = split_few(fragments, first, n, step, max_leaf, subset, subset_cost, choice)
            if middle == first:
                nodes[parent, parent_ref] = np.uint32(LEAF | first << 4 | n)
                total += np.float64(subset_cost[(1 << n) - 1])
                continue
        elif span[widest] > 0 and depth < median_depth:
            axis, parts, split = split_bins(fragments, first, last, low, span, step, bins, count, right)
            for i in range(parts):
                merge(child, np.int64(i >= split), bins, axis * BINS + i)
            start, scale = low[axis], (parts << 16) // (span[axis] + 1)
            clear(child_centroids, 0)
            clear(child_centroids, 1)
            middle = first
            for i in range(first, last):  # Lomuto's partition without a branch
                left = np.int64((centroid(fragments, i, axis) - start) * scale >> 16 < split)
                merge_centroid(child_centroids, 1 - left, fragments, i)
                swap(fragments, i, middle)
                middle += left
        else:
            middle = select_middle(fragments, first, last, widest)
            clear(child_centroids, 0)
            clear(child_centroids, 1)
            for i in range(first, last):
                merge_centroid(child_centroids, np.int64(i >= middle), fragments, i)
                merge(child, np.int64(i >= middle), fragments, i)
        if n <= 4:
            for i in range(first, last):
                merge(child, np.int64(i >= middle), fragments, i)
        clear(child, 2)
        merge(child, 2, child, 0)
        merge(child, 2, child, 1)
        total += np.float64(half_area(child, 2, step))
        nodes[parent, parent_ref] = np.uint32(size)
        for side in range(2):
            for axis in range(3):
                lower, upper = np.int64(65535) - np.int64(child[side, axis]), np.int64(child[side, 3 + axis])
                nodes[size, side * 4 + axis] = np.uint32(lower | upper << 16)
        for side in range(1, -1, -1):  # the left side is taken next, so it lies beside its parent
            todo[waiting, 0], todo[waiting, 1] = (first, middle) if side == 0 else (middle, last)
            todo[waiting, 2], todo[waiting, 3], todo[waiting, 4] = depth + 1, size, side
            clear(todo_centroids, waiting)
            merge(todo_centroids, waiting, child_centroids, side)
            waiting += 1
        size += 1
        deepest = max(deepest, depth + 1)
        if once:
            break
    return size, waiting, deepest, total


def _root_area(nodes: U32, step: F32) -> float:
    """Half the area of the whole tree's box, in the units of half_area."""
    words = nodes[0].reshape(2, 4)[:, :3]
    x, y, z = ((words >> 16).max(0).astype(np.float64) - (words & 0xFFFF).min(0)) * step
    return float(x * y + y * z + z * x)


class _Range(NamedTuple):
    """Fragments first..last-1, to become side `side` of node `parent` at the given depth."""

    first: int
    last: int
    depth: int
    parent: int
    side: int
    centroids: U16


def grow_tree(fragments: U16, centroids: U16, grid_step: F32, max_leaf: int = 4, threads: int = 1) -> Grown:
    """The tree over all fragments, which are put into leaf order. centroids: `centroid_bounds` of all.

    The top is split one node at a time until ranges are small; then each range is one task that writes its own rows.
    The result does not depend on the number of threads.
    """
    step = (grid_step / grid_step.max()).astype(np.float32)
    scratch = np.empty((len(fragments), 8), np.uint32)  # only the pages where nodes come to lie are ever touched
    limit = max(TASK, len(fragments) // 32)
    depth, cost = 0, 0.0

    def work(part: _Range) -> tuple[U32, list[_Range], int, float]:
        once = part.last - part.first > limit
        rows = np.empty((2, 8), np.uint32) if once else scratch[part.first : part.last]
        todo, bounds = np.empty((STACK, 5), np.int64), np.empty((STACK, 8), np.uint16)
        todo[0], bounds[0] = (part.first, part.last, part.depth, len(rows) - 1, 0), part.centroids
        size, waiting, deepest, areas = grow(fragments, rows, todo, bounds, step, max_leaf, MEDIAN_DEPTH, once)
        halves = [_Range._make([*todo[i].tolist(), bounds[i]]) for i in range(waiting)]
        return rows[:size], halves, deepest, areas

    def run(parts: list[_Range]) -> list[tuple[U32, list[_Range], int, float]]:
        if threads == 1 or len(parts) < 2:
            return [work(part) for part in parts]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(work, parts))

    def is_small(part: _Range) -> bool:
        return part.last - part.first <= limit

    blocks: list[U32] = []  # nodes: first the top, one node a block, so that a block's number is its node's
    owners: list[_Range] = []
    level = [_Range(0, len(fragments), 0, -1, 0, centroids)]
    small: list[_Range] = []
    while level:
        small += filter(is_small, level)
        large = [part for part in level if not is_small(part)]
        level = []
        for part, (nodes, halves, _, areas) in zip(large, run(large), strict=True):
            level += [half._replace(parent=len(blocks)) for half in halves]
            blocks.append(nodes)
            owners.append(part)
            cost += areas
    small.sort(key=lambda part: part.first)
    for part, (nodes, _, deepest, areas) in zip(small, run(small), strict=True):
        blocks.append(nodes)
        owners.append(part)
        depth, cost = max(depth, deepest), cost + areas

    nodes, offset = np.concatenate(blocks), 0
    if not len(nodes):
        return single_leaf(fragments)
    for block, part in zip(blocks, owners, strict=True):
        if part.parent >= 0:
            leaf = LEAF | part.first << 4 | (part.last - part.first)
            nodes[part.parent, part.side * 4 + 3] = offset if len(block) else leaf
        if is_small(part):
            refs = nodes[offset : offset + len(block), 3::4]
            refs += np.where(refs < LEAF, np.uint32(offset), np.uint32(0))
        offset += len(block)
    return Grown(nodes, depth, cost / _root_area(nodes, step))
