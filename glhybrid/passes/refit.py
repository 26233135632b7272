"""Trees over moved vertices: boxes refitted in compute, or built anew where they have degraded: see rebuild.py."""

from typing import Any

import numpy as np

from glhybrid import bvh, layout
from glhybrid.bvh.blas import PAD
from glhybrid.bvh.fragments import make_grid
from glhybrid.bvh.merging import key_axes
from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene, MovedTree
from glhybrid.motion import Shape
from glhybrid.needs import Features
from glhybrid.passes.rebuild import Rebuild
from glhybrid.passes.refit_cost import Cost
from glhybrid.passes.refit_ways import Climb, Levels
from glhybrid.readback import Ring, at_once
from glhybrid.shaders import Shaders

CHECK_EVERY = 8  # refits between two looks at the trees' SAH costs
WAIT = 2  # refits until a look is at what was read, so that nobody waits for it


class Refit:
    """Keeps the trees of some meshes true to their vertices.

    meshes: rows of geometry.meshes. rebuild: once the SAH cost has grown by this factor since the last build; 1 = every
    frame (Kim), 0 = never. The GPU builds, all trees at once, where GpuTrees.on_gpu; else the CPU, after reading back.
    """

    name = "refit"

    def __init__(
        self, context: Context, shaders: Shaders, scene: GpuScene, meshes: list[int], features: Features, rebuild: float
    ) -> None:
        assert scene.trees is not None
        self._scene, self._held, self._write = scene, scene.trees, context.write
        self.meshes = meshes
        self._rebuild = rebuild
        blases = [scene.geometry.meshes[m].blas for m in meshes]
        self._built_cost: list[float | None] = [b.sah_cost for b in blases]  # None: not read back yet
        self._age = 0
        self._ring = Ring(context, 1)
        self.rebuilt = 0  # trees, since the scene was loaded
        self._trees = np.zeros(len(meshes), layout.dtype("RefitTree"))
        self._trees["node_first"] = [self._held.node_first(m) for m in meshes]
        self._trees["node_count"] = [len(b.nodes) for b in blases]
        self._room = room = [self._held.node_capacity(m) for m in meshes]
        self._trees["entry_first"] = np.cumsum([0, *room[:-1]])
        self._tree_buffer = context.gl.buffer(reserve=self._trees.nbytes)
        resources: dict[str, Any] = {name: scene.resources[key].buffer for name, key in (
            ("Triangles", "triangles"), ("Vertices", "vertices"), ("Nodes", "nodes"), ("Slots", "slots"))}  # fmt: skip
        resources["RefitTrees"] = self._tree_buffer
        self._make_cost = lambda: Cost(context, shaders, features, resources, room)
        self._cost = self._make_cost() if rebuild not in (0, 1) else None
        way = Levels if context.device.software and not self._held.on_gpu else Climb
        self._way = way(context, shaders, features, resources, self._trees, sum(room))
        self._way.link(dict(enumerate(blases)))
        self._builder: Rebuild | None = None
        if self._held.on_gpu:
            self._builder = Rebuild(context, shaders, features, self._held, meshes, self._way.resources)
            self._trees["key_bits"] = self._builder.key_bits

    def run(self, shapes: list[Shape]) -> dict[int, MovedTree]:
        """New boxes for every mesh, in the order of `meshes`; returns what the instances must know of them."""
        moved = {}
        for row, mesh, shape in zip(self._trees, self.meshes, shapes, strict=True):
            largest = float(np.abs(shape.bounds).max())
            grid_min, grid_step = make_grid(shape.bounds[0], shape.bounds[1], PAD * largest)
            row["grid_min"], row["grid_step"], row["pad"] = grid_min, grid_step, 1.6 * PAD * largest
            moved[mesh] = MovedTree(grid_min, grid_step, shape.bounds)
        if self._builder is not None:
            self._trees["axes"] = key_axes(self._trees["grid_step"], self._builder.key_bits)
        self._write(self._tree_buffer, self._trees)
        if self._rebuild == 1:
            return moved | self._build(range(len(self.meshes)))
        self.refit()
        self._age += 1
        if self._rebuild and self._cost is not None and self._age % CHECK_EVERY == 1:
            self._ring.send(self._cost.readings())
        elif len(self._ring) and self._age % CHECK_EVERY == 1 + WAIT:
            costs = self._ring.take()
            self._built_cost = [c if b is None else b for b, c in zip(self._built_cost, costs, strict=True)]
            pairs = enumerate(zip(self._built_cost, costs, strict=True))
            worse = [tree for tree, (built, cost) in pairs if built is not None and cost > self._rebuild * built]
            moved |= self._build(worse)
        return moved

    def sah_cost(self, mesh: int) -> float:
        """Of the tree as it stands on the GPU, in the terms of Blas.sah_cost. Waits for it."""
        self._cost = self._cost or self._make_cost()
        self._write(self._tree_buffer, self._trees)  # they may have been built since
        return at_once(self._cost.readings()[self.meshes.index(mesh)])

    @property
    def bytes(self) -> int:
        """Of everything that keeps trees up to date, the builder's buffers included."""
        own = self._tree_buffer.size + self._way.bytes + self._ring.bytes
        return int(own + sum(part.bytes for part in (self._builder, self._cost) if part is not None))

    def release(self) -> None:
        self._ring.release()
        self._tree_buffer.release()
        self._way.release()
        for part in (self._builder, self._cost):
            if part is not None:
                part.release()

    @property
    def nodes(self) -> int:
        """Rows of all trees; of those that the GPU built, some are not in use."""
        return int(self._trees["node_count"].sum())

    @property
    def dispatches(self) -> int:
        """Of one refit."""
        return self._way.dispatches

    @property
    def builds(self) -> int:
        """Dispatches of a build in compute; 0 where none is."""
        return self._builder.dispatches if self._builder is not None else 0

    def refit(self) -> None:
        """New boxes, on the grids that run() gave last."""
        self._way.run()

    def build(self) -> None:
        """All trees anew, where the GPU builds, on the grids that run() gave last."""
        assert self._builder is not None
        self._builder.run()

    def _build(self, trees: Any) -> dict[int, MovedTree]:
        """Some trees anew; of them, what is other than run() gave it."""
        if not trees:
            return {}
        if self._builder is None:
            self.rebuilt += len(trees)
            return {self.meshes[tree]: self._build_on_cpu(tree) for tree in trees}
        self.build()
        self.rebuilt += len(self.meshes)
        self._trees["node_count"] = self._room
        self._built_cost = [None] * len(self.meshes)
        return {}

    def _build_on_cpu(self, tree: int) -> MovedTree:
        """Reads the vertices back and builds the tree over them."""
        geometry, mesh = self._scene.geometry, self.meshes[tree]
        data = geometry.meshes[mesh]
        count = sum(n for _, n in data.geometries)
        rows = geometry.triangles[data.first_triangle : data.first_triangle + count]
        first, last = int(rows[:, :3].min()), int(rows[:, :3].max())
        buffer = self._scene.resources["vertices"].buffer
        vertices = np.frombuffer(buffer.read((last - first + 1) * 32, offset=first * 32), np.float32).reshape(-1, 8)
        blas = bvh.build_blas(vertices[rows[:, :3] - first, :3], geometry=rows[:, 3].copy())
        row = self._trees[tree]
        row["grid_step"], row["node_count"], self._built_cost[tree] = blas.grid_step, len(blas.nodes), blas.sah_cost
        self._held.replace(mesh, blas)
        self._way.link({tree: blas})
        return MovedTree(blas.grid_min, blas.grid_step, blas.bounds)
