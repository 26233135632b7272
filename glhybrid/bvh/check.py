"""Proof that a tree is what it claims to be: structure in integers, geometry in float64. For tests and `validate()`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.bvh.fragments import LEAF
from glhybrid.errors import GeometryError
from glhybrid.scene import F32, F64, U32


def refuse(bad: Any, why: str) -> None:
    """GeometryError where anything is bad; {} in the text is the first index."""
    if np.any(bad):
        raise GeometryError("tree: " + why.format(int(np.argwhere(np.atleast_1d(bad))[0][0])))


def check_structure(nodes: U32, slots: int, largest_leaf: int = 4) -> tuple[int, U32]:
    """Every node has one parent before it, every slot one leaf, every child's box lies inside its parent's.

    Returns the depth and, for each slot, the box words (S, 3) of its leaf.
    """
    children = nodes.reshape(-1, 2, 4)
    words, refs = children[..., :3].astype(np.int64), children[..., 3].astype(np.int64)
    low, high = words & 0xFFFF, words >> 16
    number = np.arange(len(nodes))
    inner = refs < LEAF
    refuse(inner & (refs >= len(nodes)), "node {} names a node past the last")
    refuse(inner & (refs <= number[:, None]), "node {} names a node that does not come after it")
    refuse(
        np.bincount(refs[inner], minlength=len(nodes)) != np.minimum(number, 1), "node {} has not exactly one parent"
    )
    refuse((low > high).any(-1), "node {} has a box that is inside out")
    node, side = np.nonzero(inner)
    target = refs[inner]
    outside = (low[target].min(1) < low[node, side]) | (high[target].max(1) > high[node, side])
    refuse(np.isin(number, node[outside.any(1)]), "node {} has a grandchild outside its child's box")

    first, count = (refs & 0x7FFFFFFF) >> 4, refs & 15
    leaf = ~inner & (count > 0)
    refuse(~inner & (count > largest_leaf), f"node {{}} has a leaf of more than {largest_leaf}")
    refuse(~inner & (first + np.maximum(count, 1) > slots), "node {} has a leaf past the last slot")
    refuse(~inner & (count == 0) & (len(nodes) > 1), "node {} has an empty child in a tree of several nodes")
    node, side = np.nonzero(leaf)
    owner = np.repeat(np.arange(len(node)), count[leaf])
    slot = first[leaf][owner] + np.arange(len(owner)) - (np.cumsum(count[leaf]) - count[leaf])[owner]
    refuse(np.bincount(slot, minlength=slots) != 1, "slot {} is not in exactly one leaf")
    box = np.empty((slots, 3), np.uint32)
    box[slot] = children[node, side, :3][owner]

    level, depth = np.zeros(1, np.int64), 0
    while len(level):
        level, depth = refs[level][inner[level]], depth + 1
    return depth, box


def leaf_boxes(words: U32, grid_min: F32, grid_step: F32) -> tuple[F64, F64]:
    """Corners (S, 3) in float64 of box words (S, 3)."""
    origin, step = grid_min.astype(np.float64), grid_step.astype(np.float64)
    return origin + (words & 0xFFFF) * step, origin + (words >> 16) * step


def split_slots(slots: U32) -> NDArray[np.bool_]:
    """(S,) whether the same triangle, all twelve words, is in another slot as well."""
    _, inverse, count = np.unique(slots, axis=0, return_inverse=True, return_counts=True)
    return np.asarray(count[inverse.ravel()] > 1)


def refuse_gaps(vertices: F64, low: F64, high: F64, slots: U32, number: NDArray[np.int64]) -> None:
    """GeometryError if points spread over a triangle (P, 3, 3) are in none of the boxes of the slots that hold it."""
    if not len(slots):
        return
    weights = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12  # corners and edges too
    _, owner = np.unique(slots, axis=0, return_inverse=True)
    covered = np.zeros((int(owner.max()) + 1, len(weights)), np.uint8)
    points = np.einsum("wv,pvk->pwk", weights, vertices)
    np.maximum.at(
        covered, owner.ravel(), ((points >= low[:, None]) & (points <= high[:, None])).all(2).astype(np.uint8)
    )
    bad = number[np.flatnonzero(covered.min(axis=1)[owner.ravel()] == 0)]
    if len(bad):
        raise GeometryError(f"tree: slot {bad[0]} holds a triangle that its boxes leave partly uncovered")
