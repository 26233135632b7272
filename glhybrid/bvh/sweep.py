"""The builder that needs no compiler: full SAH, every split of every axis, for all ranges of a depth at once in NumPy.

The sweep over presorted orders of Wald, Boulos & Shirley 2007, "Ray Tracing Deformable Scenes Using Dynamic Bounding
Volume Hierarchies". Boxes before and behind each split are running maxima; one pass finds those of many ranges, as the
number of a fragment's range stands above its 16 bits, so that every range begins anew. Costs of trees: 0.97 to 1.00 of
build.grow_tree's. Chosen over bins, whose share of the work is large in ranges of a few fragments, as most are; a loop
over nodes takes 5 times as long for 100 fragments and 30 times for thousands.
"""

from typing import Any, NamedTuple

import numpy as np

from glhybrid.bvh.fragments import LEAF, MEDIAN_DEPTH, Grown, pack_boxes, single_leaf
from glhybrid.scene import F32, F64, U16, U32

TOGETHER = 1 << 16  # fragments in one pass where there are several ranges; a processor's cache holds so many
SHORT = 4096  # fragments, up to which all axes go in one pass: calls cost more than cache misses
EVEN = 1e-6  # of a range's area, for a fragment more on one side: of equal splits the middle
ALL, EACH = (slice(0, 3),), (slice(0, 1), slice(1, 2), slice(2, 3))
_CODES = np.array([[1], [2]], np.uint8)  # of fragments that go on in the range of the left side, or of the right one


class _Ranges(NamedTuple):
    """R ranges of one depth, M fragments in all."""

    order: Any  # (3, M) fragments, range after range, in each by centroids along an axis
    count: Any  # (R,) fragments, two at least unless it is the root
    first: Any  # (R,) slot of the first
    place: Any  # (R,) 2 * parent + side
    area: Any  # (R,) float64


class _Splits(NamedTuple):
    """The cheapest split of each range."""

    cost: Any  # (R,) float32: half areas times counts of both sides
    axis: Any  # (R,)
    left: Any  # (R,) fragments on the left side
    boxes: U16  # (6, 2, R) of the sides


def grow_tree(fragments: U16, grid_step: F32, max_leaf: int = 4) -> Grown:
    """The tree over fragments (F, 8), which are put into leaf order: 4 us for each, and 0.2 ms a level."""
    total = len(fragments)
    step = grid_step.astype(np.float64) / grid_step.max()
    lanes = np.ascontiguousarray(fragments[:, :6].T)
    root = float(_areas(lanes.max(1).astype(np.int64), 65535, step))
    order = np.argsort((lanes[3:] >> 1) - (lanes[:3] >> 1) + np.uint16(32767), axis=1, kind="stable").astype(np.int32)
    slots, code = np.empty(total, np.int32), np.empty(total, np.uint8)
    todo = [(0, _Ranges(order, *(np.array([value]) for value in (total, 0, -1, root))))]
    nodes: list[tuple[Any, Any, Any]] = []  # 128 * first slot + depth, boxes of both sides, place in the parent
    leaves: list[tuple[Any, Any, Any]] = []  # first slot, count, place in the parent
    size, depth, cost = 0, 0, 0.0
    while todo:
        level, ranges = todo.pop()
        order, count, first, place, area = ranges
        owner = np.arange(len(count)).repeat(count)
        inside = np.arange(1, len(owner) + 1) - (count.cumsum() - count)[owner]
        split = _split(lanes, ranges, owner, inside, step, level)
        chosen = order.ravel().take((split.axis * len(owner))[owner] + np.arange(len(owner)))
        slots[first[owner] + inside - 1] = chosen
        inner = ((count > max_leaf) | (area * count > area + split.cost)) & (count > 1)
        if not inner.all():
            leaf = ~inner
            leaves.append((first[leaf], count[leaf], place[leaf]))
            cost += float(area[leaf] @ count[leaf])
            if not inner.any():
                continue
        nodes.append((first[inner] * 128 + level, split.boxes[:, :, inner], place[inner]))
        number = inner.cumsum() + (size - 1)
        size, depth, cost = size + len(nodes[-1][0]), max(depth, level + 1), cost + float(area[inner].sum())
        sides = np.array([split.left, count - split.left])
        below = (
            sides,
            np.array([first, first + split.left]),
            np.array([2 * number, 2 * number + 1]),
            _areas(split.boxes.astype(np.int64), 65535, step[:, None, None]),
        )
        alone = inner & (sides == 1)
        if alone.any():
            leaves.append((below[1][alone], below[0][alone], below[2][alone]))
            cost += float(below[3][alone].sum())
        deeper = inner & (sides > 1)
        kept = [side for side in (0, 1) if deeper[side].any()]
        if not kept:
            continue
        goes = deeper * _CODES
        code[chosen] = np.where(inside <= split.left[owner], goes[0][owner], goes[1][owner])
        codes = code.take(order.ravel())
        parts = [
            _Ranges(
                order.ravel().take((codes == side + 1).nonzero()[0]).reshape(3, -1),
                *(value[side, deeper[side]] for value in below),
            )
            for side in kept
        ]
        if len(parts) == 2 and sum(part.order.shape[1] for part in parts) <= TOGETHER:
            parts = [_Ranges(*(np.concatenate(both, axis=-1) for both in zip(*parts, strict=True)))]
        todo += [(level + 1, part) for part in parts]
    fragments[:] = fragments[slots]
    if not size:
        return single_leaf(fragments)
    return Grown(_in_order(nodes, leaves), depth, cost / root)


def _in_order(nodes: list[tuple[Any, Any, Any]], leaves: list[tuple[Any, Any, Any]]) -> U32:
    """(N, 8) packed nodes, depth first."""
    keys, places = (np.concatenate([made[k] for made in nodes]) for k in (0, 2))
    boxes = np.concatenate([made[1] for made in nodes], axis=2)
    first, count, leaf_places = (np.concatenate(column) for column in zip(*leaves, strict=True))
    order = np.argsort(keys)
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    refs = np.empty(2 * len(order), np.uint32)
    refs[leaf_places] = LEAF | first << 4 | count
    inner = places >= 0
    refs[places[inner]] = number[inner]
    packed = np.empty((len(order), 2, 4), np.uint32)
    packed[:, :, :3] = pack_boxes(boxes[:, :, order].transpose(2, 1, 0))
    packed[:, :, 3] = refs.reshape(-1, 2)[order]
    return packed.reshape(-1, 8)


def _split(lanes: U16, ranges: _Ranges, owner: Any, inside: Any, step: F64, depth: int) -> _Splits:
    """lanes: (6, F) uint16 of all fragments; owner, inside: (M,) number of the range, and place in it from 1 on;
    step: (3,) cells in units of the largest."""
    order, count = ranges.order, ranges.count
    length, rows = len(owner), np.arange(len(count))
    start = count.cumsum() - count
    number = owner.astype(np.uint32) << np.uint32(16)
    backward = number[-1] - number[::-1]
    behind = count[owner] - inside
    extra = np.abs(behind - inside) * (EVEN * ranges.area)[owner]
    if depth >= MEDIAN_DEPTH:
        extra[inside != (count // 2)[owner]] = np.inf
    extra[start + count - 1] = np.inf  # all is no side
    left, right, extra = inside.astype(np.float32), behind.astype(np.float32), extra.astype(np.float32)
    cells, at = step.astype(np.float32)[:, None, None], np.arange(length, dtype=np.uint64)
    bases = number * np.uint32(2) + np.uint32(65535), backward * np.uint32(2) + np.uint32(65535)
    best = _Splits(
        np.empty(len(count), np.float32), np.zeros_like(rows), np.ones_like(rows),
        np.zeros((6, 2, len(count)), np.uint16),
    )  # fmt: skip
    lowest = np.full(len(count), 2**64 - 1, np.uint64)
    for axes in ALL if length <= SHORT else EACH:
        boxes = lanes.take(order[axes], axis=1)
        before = np.maximum.accumulate(boxes | number, axis=2)
        after = np.maximum.accumulate(boxes[:, :, ::-1] | backward, axis=2)  # the last first
        costs = _areas(before, bases[0], cells) * left
        costs[:, :-1] += _areas(after, bases[1], cells)[:, -2::-1] * right[:-1]
        costs += extra
        # The bits of floats that are not negative rise as they do: smallest cost, and first place of it.
        keys = np.minimum.reduceat(costs.view(np.uint32).astype(np.uint64) << np.uint64(32) | at, start, axis=1)
        axis = keys.argmin(0)
        keys = keys[axis, rows]
        some = keys < lowest
        lowest[some], axis, place = keys[some], axis[some], keys[some].astype(np.uint32).astype(np.int64)
        best.axis[some], best.left[some] = axes.start + axis, inside[place]
        best.boxes[:, 0, some], best.boxes[:, 1, some] = before[:, axis, place], after[:, axis, length - 2 - place]
    best.cost[:] = (lowest >> np.uint64(32)).astype(np.uint32).view(np.float32)
    return best


def _areas(boxes: Any, base: Any, cells: Any) -> Any:
    """Half areas (...) of boxes (6, ...), of whose two ends' sum base is too much. cells: (3, ...)."""
    x, y, z = (boxes[:3] + boxes[3:] - base).astype(cells.dtype) * cells
    return x * (y + z) + y * z
