"""Tlas: the tree over instances, in the nodes of a Blas. A leaf is one instance: 0x80000000 | instance << 4 | 1."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.bvh import sweep
from glhybrid.bvh.blas import MAX_SLOTS, PAD, threads_available
from glhybrid.bvh.check import check_structure, leaf_boxes, refuse
from glhybrid.bvh.fragments import LEAF, box_fragments, identity, make_grid
from glhybrid.errors import GeometryError
from glhybrid.kernels import TREES
from glhybrid.scene import F32, F64, U32

SMALL = 256  # up to this many instances NumPy builds a good tree while Numba would be imported,
FEW = 8  # and up to this many it does so every frame
SWEEP_S = 5e-4, 5e-6  # that it takes, and for each instance
# The empty child of a single instance, which must not be entered twice. In lib/bvh.glsl: back to the world's ray;
# nothing to do for one that is there already.
REF_RETURN = 0xFFFFFFFE
MAX_EXTENT = 1e30  # a box past this cannot be traced in float32


@dataclass(frozen=True, eq=False)
class Tlas:
    """nodes (N, 8) uint32, grid_min and grid_step (3,) float32, boxes (I, 2, 3) float64 as given, depth as in Blas."""

    nodes: U32
    grid_min: F32
    grid_step: F32
    boxes: F64
    depth: int
    sah_cost: float
    build_ms: float

    @property
    def nbytes(self) -> int:
        """Bytes of its nodes, as they are uploaded."""
        return self.nodes.nbytes

    def placed(self, first: int, order: np.ndarray | None = None) -> U32:
        """(N, 8) nodes for the GPU, where they lie from row `first` of all nodes on. order: (N,) rows, root first."""
        rows = self.nodes.reshape(-1, 8)
        order = np.arange(len(rows)) if order is None else order
        place = np.empty(len(rows), np.uint32)
        place[order] = np.arange(first, first + len(rows))
        rows = rows[order]
        refs = rows[:, 3::4]
        refs[refs == LEAF] = REF_RETURN
        inner = refs < LEAF
        refs[inner] = place[refs[inner]]
        return rows

    def stats(self) -> dict[str, Any]:
        """What a receipt reports."""
        return {
            "nodes": len(self.nodes),
            "instances": len(self.boxes),
            "depth": self.depth,
            "sah_cost": self.sah_cost,
            "bytes": self.nbytes,
            "build_ms": self.build_ms,
        }

    def validate(self) -> None:
        """Prove the tree, as Blas.validate does; every instance is one leaf, and its box inside the leaf's."""
        depth, words = check_structure(self.nodes, len(self.boxes), largest_leaf=1)
        refuse(depth != self.depth, f"depth is {depth}, stated is {self.depth}")
        low, high = leaf_boxes(words, self.grid_min, self.grid_step)
        outside = ((self.boxes[:, 0] < low) | (self.boxes[:, 1] > high)).any(1)
        refuse(outside, "instance {} is outside its leaf's box")


def build_tlas(boxes: F32 | F64, moving: bool = False, threads: int | None = None) -> Tlas:
    """The tree over instances by SAH. boxes: (I, 2, 3) world boxes relative to any origin; metres.

    moving: it will be built again every frame: the fastest way instead of the best tree (100,000 instances: 50 ms).
    They are padded by 5e-7 of the largest |coordinate| and rounded outward, like those of a Blas. Raises GeometryError
    where there is no instance, or a box is empty, not finite or past 1e30; it names the instance.
    """
    started = time.perf_counter()
    boxes, grid, pad = _checked(boxes)
    fragments = box_fragments(boxes[:, 0] - pad, boxes[:, 1] + pad, *grid)
    few = len(boxes) <= (FEW if moving else SMALL)
    if few or not TREES.pay(SWEEP_S[0] + len(boxes) * SWEEP_S[1], better=not moving):
        tree = sweep.grow_tree(fragments, grid[1], max_leaf=1)
    else:
        TREES.load()
        from glhybrid.bvh import build, leaves, reinsert

        workers = threads_available() if threads is None else threads
        tree = build.grow_tree(fragments, leaves.centroid_bounds(fragments), grid[1], 1, workers)
        if not moving:
            tree = reinsert.improve(tree, fragments, grid[1])
    refs = tree.nodes[:, 3::4]
    leaf = (refs > LEAF) & (refs & 15 > 0)
    refs[leaf] = LEAF | identity(fragments)[(refs[leaf] & 0x7FFFFFFF) >> 4] << 4 | 1
    return Tlas(tree.nodes, *grid, boxes, tree.depth, tree.cost, 1e3 * (time.perf_counter() - started))


def check_boxes(boxes: F64) -> None:
    """Raises GeometryError where there is no box (I, 2, 3), there are too many, or one cannot be traced."""
    if not len(boxes):
        raise GeometryError("no instance to build a tree from")
    if len(boxes) >= MAX_SLOTS:
        raise GeometryError(f"{len(boxes)} instances, the limit is {MAX_SLOTS} (2^27); merge some meshes")
    good = (np.abs(boxes) <= MAX_EXTENT).all((1, 2)) & (boxes[:, 0] <= boxes[:, 1]).all(1)
    if not good.all():
        bad = int(np.argmin(good))
        low, high = boxes[bad].tolist()
        raise GeometryError(f"instance {bad}: its box {low} to {high} is empty, not finite or past {MAX_EXTENT:g}")


def _checked(boxes: F32 | F64) -> tuple[F64, tuple[F32, F32], float]:
    """(I, 2, 3) float64 boxes that a tree can be built over, its grid, and by how much they are to be padded."""
    boxes = np.ascontiguousarray(boxes, np.float64).reshape(-1, 2, 3)
    check_boxes(boxes)
    low, high = boxes[:, 0].min(0), boxes[:, 1].max(0)
    pad = PAD * float(np.maximum(np.abs(low), np.abs(high)).max())
    return boxes, make_grid(low, high, pad), pad
