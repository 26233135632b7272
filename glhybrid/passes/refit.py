"""Trees over moved vertices: boxes refitted in compute, level by level, or built anew where they have degraded."""

from typing import Any

import numpy as np

from glhybrid import bvh, layout
from glhybrid.bvh.blas import PAD, Blas
from glhybrid.bvh.fragments import LEAF, make_grid
from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene, MovedTree
from glhybrid.motion import Shape
from glhybrid.needs import Features
from glhybrid.readback import Piece, Reading, Ring, at_once
from glhybrid.scene import F64, U32
from glhybrid.shaders import Shaders

CHECK_EVERY = 8  # refits between two looks at the trees' SAH costs, which read them back
WAIT = 2  # refits until a look is at what was read, so that nobody waits for it


class Refit:
    """Keeps the trees of some meshes true to their vertices.

    meshes: rows of geometry.meshes. rebuild: once the SAH cost has grown by this factor since the last build; 1 = every
    frame (Kim), 0 = never.
    """

    name = "refit"

    def __init__(
        self, context: Context, shaders: Shaders, scene: GpuScene, meshes: list[int], features: Features, rebuild: float
    ) -> None:
        assert scene.trees is not None
        self._gl, self._scene, self._held = context.gl, scene, scene.trees
        self.meshes = meshes
        self._rebuild = rebuild
        self._blas = {m: scene.geometry.meshes[m].blas for m in meshes}
        self._step = {m: self._blas[m].grid_step for m in meshes}
        self._built_cost = {m: self._blas[m].sah_cost for m in meshes}
        self._age = 0
        self._ring = Ring(context, 1)
        self.rebuilt = 0  # trees, since the scene was loaded
        self._program = shaders.compute("refit", features)
        self._trees = np.zeros(len(meshes), layout.dtype("RefitTree"))
        buffers = {name: scene.resources[key].buffer for name, key in (
            ("Triangles", "triangles"), ("Vertices", "vertices"), ("Nodes", "nodes"), ("Slots", "slots"))}  # fmt: skip
        self._tree_buffer = self._gl.buffer(reserve=self._trees.nbytes)
        capacity = sum(self._held.node_capacity(m) for m in meshes)
        self._order_buffer = self._gl.buffer(reserve=8 * capacity)
        self._resources: dict[str, Any] = buffers | {"RefitTrees": self._tree_buffer, "RefitOrder": self._order_buffer}
        self._levels: list[tuple[int, int]] = []
        self._order()

    def run(self, shapes: list[Shape]) -> dict[int, MovedTree]:
        """New boxes for every mesh, in the order of `meshes`; returns what the instances must know of them."""
        moved = {}
        for row, mesh, shape in zip(self._trees, self.meshes, shapes, strict=True):
            largest = float(np.abs(shape.bounds).max())
            grid_min, grid_step = make_grid(shape.bounds[0], shape.bounds[1], PAD * largest)
            row["grid_min"], row["grid_step"], row["pad"] = grid_min, grid_step, 1.6 * PAD * largest
            moved[mesh], self._step[mesh] = MovedTree(grid_min, grid_step, shape.bounds), grid_step
        self._tree_buffer.write(self._trees)
        if self._rebuild == 1:
            for mesh in self.meshes:
                moved[mesh] = self._build(mesh)
            return moved
        self.refit()
        self._age += 1
        if self._rebuild and self._age % CHECK_EVERY == 1:
            self._ring.send([self._reading(mesh) for mesh in self.meshes])
        elif len(self._ring) and self._age % CHECK_EVERY == 1 + WAIT:
            for mesh, cost in zip(self.meshes, self._ring.take(), strict=True):
                if cost > self._rebuild * self._built_cost[mesh]:
                    moved[mesh] = self._build(mesh)
                    self._built_cost[mesh] = self._blas[mesh].sah_cost
        return moved

    def sah_cost(self, mesh: int) -> float:
        """Of the tree as it stands on the GPU, in the terms of Blas.sah_cost. Waits for it."""
        return at_once(self._reading(mesh))

    def _reading(self, mesh: int) -> Reading[float]:
        first, count, step = self._held.node_first(mesh), len(self._blas[mesh].nodes), self._step[mesh]
        data = yield Piece(self._scene.resources["nodes"].buffer, first * 32, count * 32)
        return sah_cost(np.frombuffer(data, np.uint32).reshape(-1, 8), step.astype(np.float64))

    @property
    def bytes(self) -> int:
        return int(self._tree_buffer.size + self._order_buffer.size + self._ring.bytes)

    def release(self) -> None:
        self._ring.release()
        self._tree_buffer.release()
        self._order_buffer.release()

    @property
    def nodes(self) -> int:
        """Of all trees."""
        return sum(count for _, count in self._levels)

    @property
    def dispatches(self) -> int:
        """Of one refit: as many as the trees have levels."""
        return len(self._levels)

    def refit(self) -> None:
        """New boxes, on the grids that run() gave last."""
        for first, count in self._levels:
            resources = {**self._resources, "refit_first": first, "refit_count": count}
            self._program.dispatch(resources, (min(count, 65536), -(-count // 65536)), (64, 1))

    def _build(self, mesh: int) -> MovedTree:
        """Reads the vertices back and builds the tree over them."""
        geometry = self._scene.geometry
        data = geometry.meshes[mesh]
        count = sum(n for _, n in data.geometries)
        rows = geometry.triangles[data.first_triangle : data.first_triangle + count]
        first, last = int(rows[:, :3].min()), int(rows[:, :3].max())
        buffer = self._scene.resources["vertices"].buffer
        vertices = np.frombuffer(buffer.read((last - first + 1) * 32, offset=first * 32), np.float32).reshape(-1, 8)
        blas = bvh.build_blas(vertices[rows[:, :3] - first, :3], geometry=rows[:, 3].copy())
        self._blas[mesh], self._step[mesh] = blas, blas.grid_step
        self._held.replace(mesh, blas)
        self._order()
        self.rebuilt += 1
        return MovedTree(blas.grid_min, blas.grid_step, blas.bounds)

    def _order(self) -> None:
        """Nodes of all trees by level, the deepest level first."""
        levels: dict[int, list[U32]] = {}
        for tree, mesh in enumerate(self.meshes):
            first = self._held.node_first(mesh)
            for depth, nodes in enumerate(levels_of(self._blas[mesh])):
                pairs = np.column_stack([nodes + first, np.full(len(nodes), tree)]).astype(np.uint32)
                levels.setdefault(depth, []).append(pairs)
        parts = [np.concatenate(levels[depth]) for depth in sorted(levels, reverse=True)]
        ends = np.cumsum([len(p) for p in parts])
        self._levels = [(int(end) - len(p), len(p)) for p, end in zip(parts, ends, strict=True)]
        self._order_buffer.write(np.concatenate(parts))


def levels_of(blas: Blas) -> list[np.ndarray]:
    """(N,) int64 rows of nodes, an array a depth, the root first."""
    refs = blas.nodes[:, 3::4]
    levels = [np.zeros(1, np.int64)]
    while len(below := refs[levels[-1]][refs[levels[-1]] < LEAF]):
        levels.append(below.astype(np.int64))
    return levels


def sah_cost(nodes: U32, grid_step: F64) -> float:
    """Of one tree's nodes (N, 8): node and triangle at 1, relative to the root's area."""
    children = nodes.reshape(-1, 2, 4)
    words, refs = children[..., :3], children[..., 3]
    low, high = (words & 0xFFFF).astype(np.int64), (words >> 16).astype(np.int64)
    inner = refs < LEAF
    used = inner | (refs & 15 > 0)
    weight = np.where(inner, 1, refs & 15) * used
    root = _half_area(high[0].max(0) - low[0].min(0), grid_step)
    return float((root + (_half_area(high - low, grid_step) * weight).sum()) / root)


def _half_area(side: Any, step: F64) -> Any:
    x, y, z = np.moveaxis(np.asarray(side) * step, -1, 0)
    return x * y + y * z + z * x
