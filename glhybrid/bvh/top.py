"""A top-level tree in motion, compiled: refitted whole, or along the paths from what has moved to the root.

Small trees begin with the same functions as plain Python (kernels.py). The grid that boxes are rounded to stays as it
is for as long as they lie in it, so that one that moves concerns its own leaf and what is above; it is made with room
around.
"""

import numpy as np

from glhybrid.bvh.blas import PAD
from glhybrid.bvh.fragments import LEAF, make_grid
from glhybrid.bvh.tlas import REF_RETURN, Tlas, check_boxes
from glhybrid.kernels import MOTION
from glhybrid.scene import F32, F64

ROOM = 1 / 8  # of the boxes' extent, that a grid leaves on every side
MOST_ROOM = 8  # times the boxes' extent, that a grid may be as large as for where they have been
TOGETHER = 6  # levels of a treelet, up to 63 nodes of 32 bytes
LOOK_EVERY = 64  # refits: whether the boxes still need so large a grid


@MOTION.helper
def _fit(boxes, row, zero, low, cells, words):  # type: ignore[no-untyped-def]
    """The words of a child that is instance `row`, rounded outward as fragments.quantise does; False if it is not in
    the grid, or nowhere. low: (2, 3), the grid's corner from zero, with the padding for lower and upper sides."""
    for axis in range(3):
        a = np.floor((boxes[row, 0, axis] - zero[axis] - low[0, axis]) * cells[axis] - 0.05)
        b = np.ceil((boxes[row, 1, axis] - zero[axis] - low[1, axis]) * cells[axis] + 0.05)
        if not (a >= 0 and b <= 65535 and a <= b):
            return False
        words[axis] = np.uint32(np.int64(a) | np.int64(b) << 16)
    return True


@MOTION.helper
def _join(nodes, node, words):  # type: ignore[no-untyped-def]
    """The words of a child that is an inner node."""
    alone = nodes[node, 7] == REF_RETURN
    for axis in range(3):
        left = np.int64(nodes[node, axis])
        right = left if alone else np.int64(nodes[node, 4 + axis])
        words[axis] = np.uint32(min(left & 65535, right & 65535) | max(left >> 16, right >> 16) << 16)


@MOTION.helper
def _area(words, cells):  # type: ignore[no-untyped-def]
    """Half the surface of a child's box."""
    x = (np.int64(words[0] >> 16) - np.int64(words[0] & 65535)) / cells[0]
    y = (np.int64(words[1] >> 16) - np.int64(words[1] & 65535)) / cells[1]
    z = (np.int64(words[2] >> 16) - np.int64(words[2] & 65535)) / cells[2]
    return x * y + y * z + z * x


@MOTION.helper
def _cost(total, nodes, cells):  # type: ignore[no-untyped-def]
    """SAH cost, node and leaf at 1, from the sum over all children."""
    words = np.empty(3, np.uint32)
    _join(nodes, 0, words)
    return total / _area(words, cells) + 1


@MOTION.kernel("void(uint32[:, ::1], int64, int64[::1], int64[::1])")
def link(nodes, first, parent, leaf):  # type: ignore[no-untyped-def]
    """Where each node (N,), and each instance (I,), is a child: 2 * node + which of the two. first: of refs."""
    for node in range(len(nodes)):
        for child in range(2):
            ref = nodes[node, 4 * child + 3]
            if ref == REF_RETURN:
                continue
            if ref >= LEAF:
                leaf[(ref & np.uint32(0x7FFFFFFF)) >> np.uint32(4)] = 2 * node + child
            else:
                parent[ref - first] = 2 * node + child


@MOTION.kernel("boolean(f3, f1, f2, f1, int64, uint32[:, ::1], float64[::1])")
def sweep(boxes, zero, low, cells, first, nodes, total):  # type: ignore[no-untyped-def]
    """Boxes (I, 2, 3) into all nodes (N, 8), children before parents; False if one is not in the grid.

    cells: 1 / grid step. total: (2,), the sum over children of their half areas, and the SAH cost.
    """
    words = np.empty(3, np.uint32)
    total[0] = 0
    for node in range(len(nodes) - 1, -1, -1):
        for child in range(2):
            ref = nodes[node, 4 * child + 3]
            if ref == REF_RETURN:
                continue
            if ref < LEAF:
                _join(nodes, ref - first, words)
            elif not _fit(boxes, (ref & np.uint32(0x7FFFFFFF)) >> np.uint32(4), zero, low, cells, words):
                return False
            for axis in range(3):
                nodes[node, 4 * child + axis] = words[axis]
            total[0] += _area(words, cells)
    total[1] = _cost(total[0], nodes, cells)
    return True


@MOTION.kernel("int64(f3, i1, i1, i1, f1, f2, f1, uint32[:, ::1], float64[::1], uint8[::1], int64[::1])")
def climb(boxes, rows, leaf, parent, zero, low, cells, nodes, total, marks, touched):  # type: ignore[no-untyped-def]
    """The same for instances `rows` that have moved: from each leaf up, as far as boxes change.

    Returns how many nodes did, rising in `touched` (N,); -1 if an instance is not in the grid. marks: (N,) zeros.
    """
    words, old = np.empty(3, np.uint32), np.empty(3, np.uint32)
    count, inside = 0, True
    for row in rows:
        if not _fit(boxes, row, zero, low, cells, words):
            inside = False
            break
        place = leaf[row]
        while True:
            node, at = place >> 1, 4 * (place & 1)
            same = True
            for axis in range(3):
                old[axis] = nodes[node, at + axis]
                same &= old[axis] == words[axis]
            if same:
                break
            total[0] += _area(words, cells) - _area(old, cells)
            for axis in range(3):
                nodes[node, at + axis] = words[axis]
            if not marks[node]:
                marks[node] = 1
                touched[count] = node
                count += 1
            if node == 0:
                break
            _join(nodes, node, words)
            place = parent[node]
    for k in range(count):
        marks[touched[k]] = 0
    if not inside:
        return -1
    touched[:count].sort()
    total[1] = _cost(total[0], nodes, cells)
    return count


@MOTION.kernel("void(f3, float64[:, ::1])")
def extent(boxes, out):  # type: ignore[no-untyped-def]
    """(2, 3) of all boxes."""
    out[0], out[1] = np.inf, -np.inf
    for row in range(len(boxes)):
        for axis in range(3):
            out[0, axis] = min(out[0, axis], boxes[row, 0, axis])
            out[1, axis] = max(out[1, axis], boxes[row, 1, axis])


@MOTION.kernel("void(u2, int64[::1])")
def treelets(nodes, order):  # type: ignore[no-untyped-def]
    """All rows of nodes (N, 8), root first, TOGETHER levels of a subtree next to each other, parents before children:
    a way from a leaf to the root then lies in few places, each one write."""
    roots = np.zeros(len(nodes), np.int64)
    count, head, tail = 0, 0, 1
    while head < tail:
        order[count] = roots[head]
        start, head, count = count, head + 1, count + 1
        for level in range(TOGETHER):
            end = count
            for k in range(start, end):
                for child in range(2):
                    ref = nodes[order[k], 4 * child + 3]
                    if ref >= LEAF:
                        continue
                    if level == TOGETHER - 1:
                        roots[tail] = ref
                        tail += 1
                    else:
                        order[count] = ref
                        count += 1
            start = end


class MovingTop:
    """rows: (N, 8) uint32, the tree for the GPU, where they lie from `first` on. sah_cost: as it is now.

    grid: (corner (3,) float64 in the world, step (3,) float32), another tuple whenever it changes.
    """

    def __init__(self, tree: Tlas, first: int) -> None:
        order = np.zeros(len(tree.nodes), np.int64)
        treelets(tree.nodes.reshape(-1, 8), order)
        self.built, self.rows = tree, tree.placed(first, order)
        self._first, self._age = first, 0
        self._parent = np.zeros(len(self.rows), np.int64)
        self._leaf = np.zeros(len(tree.boxes), np.int64)
        link(self.rows, first, self._parent, self._leaf)
        self._marks, self._touched = np.zeros(len(self.rows), np.uint8), np.zeros(len(self.rows), np.int64)
        self._total = np.zeros(2)
        self._extent = np.zeros((2, 3))  # of the boxes that the grid was made for
        self._on: tuple[F64, F64, F64] | None = None  # zero, low (2, 3), cells
        self.grid: tuple[F64, F32] = (np.zeros(3), np.ones(3, np.float32))

    @property
    def sah_cost(self) -> float:
        """Of the tree as it is now, in the terms of Tlas.sah_cost."""
        return float(self._total[1])

    def refit(self, boxes: F64, moved: np.ndarray | None = None) -> np.ndarray | None:
        """The same tree over boxes (I, 2, 3) float64, world. moved: rows of those that differ from the last call's.

        Returns the rising rows that have changed; None: all may have. Raises GeometryError as build_tlas does.
        """
        self._age += 1
        if self._on is None or (self._age % LOOK_EVERY == 0 and self._too_large(boxes)):
            moved = None
            self._lay(boxes)
        assert self._on is not None
        zero, low, cells = self._on
        if moved is not None and 8 * len(moved) <= len(self.rows) + 8:
            given = (moved, self._leaf, self._parent, zero, low, cells)
            count = climb(boxes, *given, self.rows, self._total, self._marks, self._touched)
            if count >= 0:
                return self._touched[:count]
        if not sweep(boxes, zero, low, cells, self._first, self.rows, self._total):
            zero, low, cells = self._lay(boxes, outgrown=True)
            inside = sweep(boxes, zero, low, cells, self._first, self.rows, self._total)
            assert inside
        return None

    def _too_large(self, boxes: F64) -> bool:
        now = np.empty((2, 3))
        extent(boxes, now)
        return bool((now[1] - now[0]).max() * MOST_ROOM < (self._extent[1] - self._extent[0]).max())

    def _lay(self, boxes: F64, outgrown: bool = False) -> tuple[F64, F64, F64]:
        """Another grid. Coordinates are from the middle of all: float32 tells them apart best there."""
        check_boxes(boxes)
        before = self._extent.copy()
        extent(boxes, self._extent)
        low, high = self._extent
        if self._on is not None and outgrown:  # what went past the edge may come back
            both = np.minimum(low, before[0]), np.maximum(high, before[1])
            if (both[1] - both[0]).max() <= MOST_ROOM * (high - low).max():
                self._extent[:] = low, high = both
        zero, size = (low + high) / 2, high - low
        half = size * (0.5 + ROOM) + ROOM / 4 * size.max()  # what is flat has a way to go too
        pad = PAD * float(half.max())
        low32, step = make_grid(-half, half, pad)
        corner = low32.astype(np.float64)
        self.grid = corner + zero, step
        self._on = zero, np.stack([corner + pad, corner - pad]), 1 / step.astype(np.float64)
        return self._on
