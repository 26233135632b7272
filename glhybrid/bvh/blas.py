"""Blas: the tree over one mesh, as the shader reads it. No OpenGL; Numba only while a tree is built.

Both arrays are read through RGBA32UI texels.

node, 8 uint32: two children of 4 words, `x y z ref`. x = low | high << 16 in cells of the tree's grid, y and z
    likewise: world = grid_min + q * grid_step. ref < 0x80000000: the child is the node of that number, larger than its
    parent's; else a leaf, 0x80000000 | first slot << 4 | count, count 1..4. The root is node 0. Only a tree that is one
    leaf has an empty child, count 0, which names a slot that exists, so that reading it does no harm.
slot, 12 uint32, in leaf order: `v0.xyz triangle, v1.xyz geometry, v2.xyz kind`; vertices as float bits, kind 0.
    kind 1 is an analytic sphere, v0 its centre and v1.x its radius. triangle: id in the mesh's list of triangles;
    geometry: index of the primitive in the mesh.

Boxes hold what is in them with 5e-7 of the largest |coordinate| and a twentieth of a cell to spare, so that neither the
float32 arithmetic of a ray nor its transformation into object space can miss what it should hit (traversal.md, 5).
"""

import os
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.bvh import presplit, sweep
from glhybrid.bvh.check import check_structure, leaf_boxes, refuse, refuse_gaps, split_slots
from glhybrid.bvh.fragments import LEAF, Grown, box_fragments, identity, make_grid
from glhybrid.errors import GeometryError
from glhybrid.kernels import TREES
from glhybrid.scene import F32, F64, U16, U32

TRIANGLE, SPHERE = 0, 1
MAX_SLOTS = 1 << 27  # 27 bits of a leaf's reference
MAX_NODES = 1 << 31
MAX_COORDINATE = 1e18  # past this, products of two coordinates overflow float32 in the triangle test
SMALL = 1024  # up to this many primitives NumPy builds the tree, in less time than Numba takes to import
SWEEP_S = 5e-6  # that it takes for one
PAD = 5e-7  # of the largest |coordinate|: 8 ulp, the rounding of a rotated and moved ray


@dataclass(frozen=True, eq=False)
class Blas:
    """nodes (N, 8) and slots (S, 12) uint32, grid_min and grid_step (3,) float32, bounds (2, 3) float64, object space.

    depth: inner nodes on the longest way to a leaf; traversal needs depth + 1 stack entries and a sentinel.
    sah_cost: relative to the root's area, a node and a triangle at 1 each, of the boxes as they are stored.
    quick: the compiled builder would have made a better one, but was not compiled; another run is to build it anew.
    """

    nodes: U32
    slots: U32
    grid_min: F32
    grid_step: F32
    bounds: F64
    depth: int
    sah_cost: float
    build_ms: float
    quick: bool = False

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays, as they are uploaded."""
        return self.nodes.nbytes + self.slots.nbytes

    def stats(self) -> dict[str, Any]:
        """What a receipt reports of one tree, and how far its 16-bit grid resolves the mesh.

        grid_cells: median size, in cells, of the longest side of a leaf's box. Near 3, what rounding outward alone
        gives, the mesh is too fine for its own extent; split into several meshes it would trace faster.
        """
        words, refs = _children(self.nodes)
        counts = (refs & 15)[refs >= LEAF]
        sides = (words >> 16).astype(np.int64) - (words & 0xFFFF)
        leaves = sides[(refs >= LEAF) & ((refs & 15) > 0)]
        return {
            "nodes": len(self.nodes),
            "slots": len(self.slots),
            "triangles": len(np.unique(self.slots[:, 3])),
            "leaves": int((counts > 0).sum()),
            "triangles_per_leaf": float(counts.sum() / max((counts > 0).sum(), 1)),
            "depth": self.depth,
            "sah_cost": self.sah_cost,
            "grid_cells": float(np.median(leaves.max(-1))),
            "bytes": self.nbytes,
            "build_ms": self.build_ms,
        }

    def validate(self) -> None:
        """Prove the tree: shape, order, depth, boxes inside parents, every slot in one leaf and inside its box.

        All in float64 or integers. Of a triangle in several leaves, 91 points must each be in one of their boxes.
        Raises GeometryError that names the first node or slot at fault.
        """
        depth, words = check_structure(self.nodes, len(self.slots))
        refuse(depth != self.depth, f"depth is {depth}, stated is {self.depth}")
        low, high = leaf_boxes(words, self.grid_min, self.grid_step)
        data = self.slots.view(np.float32).astype(np.float64).reshape(-1, 3, 4)
        vertices, radius, sphere = data[..., :3], data[:, 1, :1], self.slots[:, 11:] == SPHERE
        smallest = np.where(sphere, vertices[:, 0] - radius, vertices.min(1))
        largest = np.where(sphere, vertices[:, 0] + radius, vertices.max(1))
        outside = ((smallest < low) | (largest > high)).any(1)
        several = split_slots(self.slots) if outside.any() else outside
        apart = ((largest < low) | (smallest > high)).any(1)
        refuse(apart | outside & ~several, "slot {} is outside its leaf's box")
        pieces = np.flatnonzero(several)
        refuse_gaps(vertices[pieces], low[pieces], high[pieces], self.slots[pieces], pieces)
        same = np.array_equal(np.stack([smallest.min(0), largest.max(0)]), self.bounds)
        refuse(not same, "bounds are not those of what is in it")


def _children(nodes: U32) -> tuple[U32, U32]:
    """Box words (N, 2, 3) and references (N, 2)."""
    children = nodes.reshape(-1, 2, 4)
    return children[..., :3], children[..., 3]


def threads_available() -> int:
    """Processors this process may use, at most 16."""
    return min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 16)


def build_blas(
    position: F32,
    triangle: U32 | None = None,
    geometry: U32 | None = None,
    spheres: F32 | None = None,
    sphere_triangle: U32 | None = None,
    sphere_geometry: U32 | None = None,
    max_leaf: int = 4,
    reinsert: bool = True,
    split: bool = False,
    threads: int | None = None,
) -> Blas:
    """The tree over triangles and analytic spheres of one mesh, by SAH. The same input gives the same tree, but for
    `Blas.quick` where the compiled builder is still to be compiled (kernels.py).

    position: (T, 3, 3) float32, object space, metres; triangle, geometry: (T,) uint32, default 0..T-1 and 0.
    spheres: (K, 4) float32 centre and radius, with their own ids, default 0..K-1 and 0.
    reinsert: spend up to four fifths more time on a tree that is up to 30 % cheaper to trace (reinsert.py).
    split: triangles that waste much of their boxes may be in several leaves, where that makes the tree cheaper
    (presplit.py): not for what is refitted, or where hits are counted.
    Degenerate triangles are the caller's to drop. Raises GeometryError where there is nothing, or something is not
    finite or past 1e18, or there are 2^27 primitives or more; it names the triangle.
    """
    started = time.perf_counter()
    position = np.ascontiguousarray(position, np.float32).reshape(-1, 3, 3)
    spheres = np.ascontiguousarray(np.zeros((0, 4)) if spheres is None else spheres, np.float32).reshape(-1, 4)
    flat, total = len(position), len(position) + len(spheres)
    if not 1 <= max_leaf <= 4:
        raise GeometryError(f"max_leaf {max_leaf} is not within 1..4, what a leaf's reference can say")
    if not total:
        raise GeometryError("no triangle and no sphere to build a tree from; leave the mesh out")
    if total >= MAX_SLOTS:
        raise GeometryError(f"{total} triangles in one mesh, the limit is {MAX_SLOTS} (2^27); split the mesh")
    ids = (_ids(triangle, flat, "triangle"), _ids(geometry, flat, "geometry"))
    sphere_ids = (
        _ids(sphere_triangle, len(spheres), "sphere_triangle"), _ids(sphere_geometry, len(spheres), "sphere_geometry"),
    )  # fmt: skip
    reach = np.array([-1.0, 1.0])[:, None, None] * spheres[:, 3:] + spheres[:, :3].astype(np.float64)  # (2, K, 3)
    (low, high), (sphere_low, sphere_high) = _bounds(position), _bounds(reach)
    low, high = np.minimum(low, sphere_low), np.maximum(high, sphere_high)
    if not max(high.max(), -low.min()) <= MAX_COORDINATE:  # "not <=", because of NaN
        raise GeometryError(_first_bad(position, spheres, ids[0], sphere_ids[0]))
    pad = PAD * float(np.maximum(np.abs(low), np.abs(high)).max())
    grid = make_grid(low, high, pad)
    around = box_fragments(reach[0] - pad, reach[1] + pad, *grid, first_id=flat)
    quick = total > SMALL and not TREES.pay(total * SWEEP_S, better=True)
    if quick or total <= SMALL:
        corners = position.astype(np.float64)
        fragments = box_fragments(corners.min(1) - pad, corners.max(1) + pad, *grid)
        fragments = np.concatenate([fragments, around])
        tree = sweep.grow_tree(fragments, grid[1], max_leaf, threads_available() if threads is None else threads)
        slots = np.concatenate([_triangle_slots(position, *ids), _sphere_slots(spheres, *sphere_ids)])
        slots = slots[identity(fragments)]
    else:
        TREES.load()
        from glhybrid.bvh import leaves

        workers = threads_available() if threads is None else threads
        fragments, centroids = leaves.make_fragments(position, *grid, pad, workers)
        if len(spheres):
            fragments = np.concatenate([fragments, around])
            centroids = np.maximum(centroids, leaves.centroid_bounds(around))
        pieces = None
        if split and flat:
            pieces = _pieces(fragments, flat, position, grid, pad, workers)
        tree = _grow(fragments, centroids, grid[1], max_leaf, reinsert, workers)
        if pieces is not None:
            other = _grow(pieces, leaves.centroid_bounds(pieces), grid[1], max_leaf, reinsert, workers)
            if other.cost < presplit.KEPT * tree.cost:
                tree, fragments = other, pieces
        slots = leaves.make_slots(position, *ids, fragments, workers)
        if len(spheres):
            order = identity(fragments)
            slots[order >= flat] = _sphere_slots(spheres, *sphere_ids)[order[order >= flat] - flat]
    milliseconds = 1e3 * (time.perf_counter() - started)
    return Blas(tree.nodes, slots, *grid, np.stack([low, high]), tree.depth, tree.cost, milliseconds, quick)


def _grow(fragments: U16, centroids: U16, grid_step: F32, max_leaf: int, reinsert: bool, workers: int) -> Grown:
    """The tree over fragments, which are put into leaf order."""
    from glhybrid.bvh import build

    tree = build.grow_tree(fragments, centroids, grid_step, max_leaf, workers)
    if reinsert:
        from glhybrid.bvh.reinsert import improve

        tree = improve(tree, fragments, grid_step)
    return tree


def _pieces(fragments: U16, flat: int, position: F32, grid: tuple[F32, F32], pad: float, workers: int) -> U16 | None:
    """The fragments with those of some triangles in pieces; None where no triangle is worth it."""
    from glhybrid.bvh import leaves

    area = leaves.half_surfaces(fragments[:flat], grid[1], workers)
    budget = min(int(presplit.SHARE * flat), MAX_SLOTS - 1 - len(fragments))
    more, made = presplit.split(fragments[:flat], area, position, *grid, pad, budget)
    return np.ascontiguousarray(np.concatenate([more, fragments[flat:]])) if len(made) else None


def _triangle_slots(position: F32, triangle: U32, geometry: U32) -> U32:
    slots = np.zeros((len(position), 3, 4), np.uint32)
    slots[:, :, :3] = position.view(np.uint32)
    slots[:, 0, 3], slots[:, 1, 3], slots[:, 2, 3] = triangle, geometry, TRIANGLE
    return slots.reshape(-1, 12)


def _sphere_slots(spheres: F32, triangle: U32, geometry: U32) -> U32:
    slots = np.zeros((len(spheres), 3, 4), np.uint32)
    slots[:, 0, :3], slots[:, 1, 0] = spheres[:, :3].view(np.uint32), spheres[:, 3].view(np.uint32)
    slots[:, 0, 3], slots[:, 1, 3], slots[:, 2, 3] = triangle, geometry, SPHERE
    return slots.reshape(-1, 12)


def _ids(given: U32 | None, count: int, what: str) -> U32:
    """Ids as given, or counted (triangle) or zero (geometry) where none are."""
    if given is None:
        return np.arange(count, dtype=np.uint32) if what.endswith("triangle") else np.zeros(count, np.uint32)
    if np.shape(given) != (count,):
        raise GeometryError(f"{what}: ids of shape {np.shape(given)} for {count} primitives; one id each is needed")
    return np.ascontiguousarray(given, np.uint32)


def _bounds(points: F32 | F64) -> F64:
    """(2, 3) smallest and largest of (..., 3) points; NaN if any is, +inf and -inf if there are none."""
    rows = points.reshape(-1, 3)
    wide = len(rows) // 256 * 256  # NumPy reduces long rows twenty times as fast as rows of three
    parts = [part for part in (rows[:wide].reshape(-1, 768), rows[wide:]) if len(part)]
    low = [part.min(0).reshape(-1, 3).min(0) for part in parts] or [np.full(3, np.inf)]
    high = [part.max(0).reshape(-1, 3).max(0) for part in parts] or [np.full(3, -np.inf)]
    return np.stack([np.min(low, axis=0), np.max(high, axis=0)]).astype(np.float64)


def _first_bad(position: F32, spheres: F32, triangle: U32, sphere: U32) -> str:
    """Names the first triangle or sphere that cannot be traced."""
    for what, values, number in (("triangle", position.reshape(-1, 9), triangle), ("sphere", spheres, sphere)):
        bad = np.argwhere(~(np.abs(values) <= MAX_COORDINATE))
        if len(bad):
            row, column = bad[0]
            return (
                f"{what} {number[row]}: coordinate {values[row, column]} is not finite or past {MAX_COORDINATE:g}, "
                "where float32 products overflow; drop it or scale the mesh"
            )
    return f"a sphere reaches past {MAX_COORDINATE:g}, where float32 products overflow; scale the mesh"


def pack(blases: list[Blas]) -> tuple[U32, U32, U32]:
    """All trees in one pair of arrays: nodes (N, 8), slots (S, 12), roots (B,) uint32; references count from the start.

    Raises GeometryError where a slot passes 2^27 or a node 2^31, the limits of a reference.
    """
    node_counts, slot_counts = [len(b.nodes) for b in blases], [len(b.slots) for b in blases]
    for what, total, limit in (("slots", sum(slot_counts), MAX_SLOTS), ("nodes", sum(node_counts), MAX_NODES)):
        if total > limit:
            raise GeometryError(f"{total} {what} in all trees, references hold {limit}; draw fewer distinct triangles")
    nodes = np.empty((sum(node_counts), 8), np.uint32)
    slots = np.empty((sum(slot_counts), 12), np.uint32)
    roots = np.concatenate([[0], np.cumsum(node_counts)[:-1]]).astype(np.uint32) if blases else np.zeros(0, np.uint32)
    slot = 0
    for blas, root in zip(blases, roots.tolist(), strict=True):
        part = nodes[root : root + len(blas.nodes)]
        part[:] = blas.nodes
        refs = part[:, 3::4]
        refs += np.where(refs < LEAF, np.uint32(root), np.uint32(slot << 4))
        slots[slot : slot + len(blas.slots)] = blas.slots
        slot += len(blas.slots)
    return nodes, slots, roots
