"""The trees of a scene on the GPU: those of its meshes in one pair of buffers, the one of its instances behind them.

Made when something first traces (GpuScene.add_trees); a scene that is rasterised alone has none.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from glhybrid import bvh, layout
from glhybrid.bvh import Blas, Tlas
from glhybrid.bvh.fragments import LEAF
from glhybrid.bvh.merging import merging
from glhybrid.errors import GeometryError
from glhybrid.geometry import Geometry
from glhybrid.gl import BufferTexture
from glhybrid.scene import F32, F64, U32

SPARE_LEVELS = 8  # of the stack, for top-level trees that come out deeper as things move
STACK_LIMIT = 128
# Entries of the stack come in so many, by whether a CPU traces: there a few more cost nothing (frames of seven scenes,
# within 1 %), and scenes of about one depth share their programs. On a GPU they are local memory.
STACK_STEP = {True: 12, False: 4}
NEAR_NODES, MOST_WRITES = 64, 16  # nodes so near go in one write, and more writes than that as one

# One node whose two children are leaves of nothing: where a ray through a scene without triangles ends at once.
EMPTY_TREE = np.array([[0, 0, 0, 0x80000000, 0, 0, 0, 0x80000000]], np.uint32)


class GpuTrees:
    """Owns no GL object: `texels` uploads rows (N, 4 k) uint32 under a name, for whoever frees them; write: Context's.

    boxes: (I, 2, 3) float64, world, of the instances, for a top-level tree; None: there is one mesh and no such tree.
    deforming: rows of geometry.meshes whose trees may be built anew, and have room for it; on_gpu: that is where.
    rebuild: growth of the top-level tree's SAH cost that has it built anew, as Settings.rebuild. software: a CPU
    traces.
    """

    def __init__(
        self,
        texels: Callable[[str, U32], BufferTexture],
        write: Callable[..., None],
        geometry: Geometry,
        boxes: F64 | None,
        deforming: set[int],
        moving: bool,
        rebuild: float,
        name: str,
        software: bool,
        on_gpu: bool = False,
    ) -> None:
        self._stack_step = STACK_STEP[software]
        self._geometry, self._name, self._rebuild, self.on_gpu, self._write = geometry, name, rebuild, on_gpu, write
        blases = [m.blas for m in geometry.meshes]
        self._depth = [b.depth for b in blases]
        room = {row: len(blases[row].slots) for row in deforming if row >= 0}
        if on_gpu:
            plans = {row: merging(triangles) for row, triangles in room.items()}
            self._depth = [max(d, plans[row].depth) if row in plans else d for row, d in enumerate(self._depth)]
            room = {row: plan.nodes for row, plan in plans.items()}
        nodes, slots, self.roots = bvh.pack([_roomy(b, room.get(row, 0)) for row, b in enumerate(blases)])
        # Slots name triangles by their place in the mesh; hits carry the row of the whole table.
        slots = slots.copy()
        slots[:, 3] += np.repeat(
            np.array([m.first_triangle for m in geometry.meshes], np.uint32), [len(b.slots) for b in blases]
        )
        slots[:, 7] |= _slot_flags(geometry, slots[:, 7])
        ends = np.cumsum([0, *(len(b.slots) for b in blases)]).tolist()
        self._slot_first, self._node_first = ends, [*self.roots.tolist(), len(nodes)]
        self.items = {row: slots[ends[row] : ends[row + 1], [3, 7]] for row in room if on_gpu}
        self._slot_words = {row: _by_geometry(slots[ends[row] : ends[row + 1], 7]) for row in deforming if row >= 0}
        self.top: Tlas | None = None  # as it was built last
        self._moving: Any = None  # the same in motion
        self.grid: tuple[F64, F32] | None = None  # its corner and steps: another object whenever they change
        self.top_root = 0  # row of nodes
        self.tops_built = 0  # top-level trees since the scene was loaded
        self._built_cost = np.inf
        if boxes is not None:
            centre = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
            self.top = bvh.build_tlas(boxes - centre, moving=moving)
            self.grid = self.top.grid_min + centre, self.top.grid_step
            self._built_cost = self.top.sah_cost
            self.top_root = len(nodes)
            nodes = np.concatenate([nodes.reshape(-1, 8), self.top.placed(self.top_root)])
        self.stack_entries = self.stack_needed(SPARE_LEVELS if moving else 0)
        self._nodes = texels("nodes", nodes if len(nodes) else EMPTY_TREE)
        self._slots = texels("slots", slots)

    def stack_needed(self, spare: int = 0) -> int:
        """Entries of the traversal stack: depth of the trees, the sentinels, and one spare, in steps of STACK_STEP.

        Raises GeometryError past STACK_LIMIT.
        """
        entries = max(self._depth, default=0) + spare + 2 + (self.top.depth + 2 if self.top is not None else 0)
        if entries > STACK_LIMIT:
            raise GeometryError(
                f"{self._name}: trees {entries} deep exceed the traversal stack's limit of {STACK_LIMIT}: "
                "geometry in a progression of sizes?"
            )
        return -(-entries // self._stack_step) * self._stack_step

    def stats(self) -> dict[str, Any]:
        """What the receipt says. sah_cost: mean over meshes, weighted by triangles; quick: as Blas, of any."""
        blases = [m.blas for m in self._geometry.meshes]
        weights = np.array([max(len(b.slots), 1) for b in blases], np.float64)
        top = self.top
        return {
            "nodes": sum(len(b.nodes) for b in blases) + (len(top.nodes) if top is not None else 0),
            "depth": max((b.depth for b in blases), default=0) + (top.depth if top is not None else 0),
            "sah_cost": float(np.average([b.sah_cost for b in blases], weights=weights)) if blases else 0.0,
            "build_ms": float(sum(b.build_ms for b in blases) + (top.build_ms if top is not None else 0.0)),
            "bytes": self._nodes.buffer.size + self._slots.buffer.size,
            "quick": any(b.quick for b in blases),
        }

    def move_top(self, boxes: F64, moved: np.ndarray) -> None:
        """The top-level tree over the boxes as they are: refitted, or built anew once that has made it worse.

        moved: rising rows of boxes that are not what they were.
        """
        from glhybrid.bvh.top import MovingTop

        assert self.top is not None
        tree, changed = self._moving or MovingTop(self.top, self.top_root), None
        anew = self._rebuild == 1
        if not anew:
            changed = tree.refit(boxes, moved)
            anew = len(boxes) > 1 and 0 < self._rebuild * self._built_cost < tree.sah_cost
        if anew:
            centre = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
            self.top = bvh.build_tlas(boxes - centre, moving=True)
            self._built_cost = self.top.sah_cost
            self.tops_built += 1
            tree = MovingTop(self.top, self.top_root)
            changed = tree.refit(boxes)
        self._moving, self.grid = tree, tree.grid
        rows, nodes = tree.rows, self._nodes.buffer
        if changed is None:
            self._write(nodes, rows, self.top_root * 32)
        elif len(changed):
            for first, last in runs(changed, NEAR_NODES, MOST_WRITES):
                self._write(nodes, rows[first:last], (self.top_root + first) * 32)

    def top_grid(self, origin: F64) -> tuple[F64, F64]:
        """(grid_min, grid_step) of the top-level tree in the world rebased on origin."""
        if self.grid is None:
            return np.zeros(3), np.ones(3)
        return self.grid[0] - origin, self.grid[1].astype(np.float64)

    def node_first(self, mesh: int) -> int:
        """Row of nodes of a mesh's root."""
        return int(self._node_first[mesh])

    def node_capacity(self, mesh: int) -> int:
        """How many nodes a mesh's tree may have."""
        return int(self._node_first[mesh + 1] - self._node_first[mesh])

    def slot_first(self, mesh: int) -> int:
        """Row of slots of a mesh's first."""
        return int(self._slot_first[mesh])

    def replace(self, mesh: int, blas: Blas) -> None:
        """Another tree over the same triangles, which it names by their place in the mesh."""
        root, slot = self.node_first(mesh), self._slot_first[mesh]
        assert len(blas.nodes) <= self.node_capacity(mesh)
        nodes, slots = blas.nodes.copy(), blas.slots.copy()
        refs = nodes[:, 3::4]
        refs += np.where(refs < LEAF, np.uint32(root), np.uint32(slot << 4))
        slots[:, 3] += np.uint32(self._geometry.meshes[mesh].first_triangle)
        slots[:, 7] = self._slot_words[mesh][slots[:, 7]]
        self._write(self._nodes.buffer, nodes, root * 32)
        self._write(self._slots.buffer, slots, slot * 48)
        self._depth[mesh] = blas.depth


def runs(rows: np.ndarray, gap: int, most: int) -> list[tuple[int, int]]:
    """(first, last) of the stretches that hold rising rows (R,), R > 0; what is up to `gap` apart is in one.

    At most `most`: else all in one, for each costs a call.
    """
    first, last = int(rows[0]), int(rows[-1])
    if len(rows) == last - first + 1:
        return [(first, last + 1)]
    ends = np.flatnonzero(rows[1:] - rows[:-1] > gap) if len(rows) > 64 else _ends(rows.tolist(), gap)
    if not len(ends) or len(ends) >= most:
        return [(first, last + 1)]
    starts = [first, *(int(rows[k + 1]) for k in ends)]
    return list(zip(starts, [*(int(rows[k]) + 1 for k in ends), last + 1], strict=True))


def _ends(rows: list[int], gap: int) -> list[int]:
    """The same for few, which is what most frames write."""
    return [k for k in range(len(rows) - 1) if rows[k + 1] - rows[k] > gap]


def _slot_flags(geometry: Geometry, numbers: U32) -> U32:
    """SLOT_* bits: what the hit groups of a geometry say, so that plain triangles need no look at their record.

    numbers: (S,) of the geometries in their meshes, by slot.
    """
    tables = []
    opaque, bits = layout.CONSTANTS["ANY_HIT_OPAQUE"], layout.CONSTANTS
    for row, mesh in enumerate(geometry.meshes):
        ask, single, double = (np.zeros(len(mesh.geometries), bool) for _ in range(3))
        for first in np.unique(geometry.first_record[geometry.instance_mesh == row]):
            groups = geometry.hit_groups[geometry.records[first : first + len(ask), 0]]
            ask |= groups[:, 2] != opaque
            single |= groups[:, 3] == 1
            double |= groups[:, 3] == 0
        ask |= single & double  # instances differ: each hit looks
        tables.append(np.where(ask, bits["SLOT_ASK"], np.where(single, bits["SLOT_SINGLE_SIDED"], 0)).astype(np.uint32))
    starts = np.cumsum([0] + [len(t) for t in tables[:-1]])
    rows = numbers + np.repeat(starts, [len(m.blas.slots) for m in geometry.meshes]) if tables else numbers
    return np.concatenate([*tables, np.zeros(0, np.uint32)])[rows]


def _roomy(blas: Blas, room: int) -> Blas:
    """With room for so many nodes, the last ones not in use."""
    spare = max(room - len(blas.nodes), 0)
    return replace(blas, nodes=np.concatenate([blas.nodes, np.zeros((spare, 8), np.uint32)])) if spare else blas


def _by_geometry(words: U32) -> U32:
    """The word that the slots of each geometry carry, by geometry."""
    geometry = words & np.uint32(layout.CONSTANTS["SLOT_GEOMETRY"])
    table = np.zeros(int(geometry.max(initial=0)) + 1, np.uint32)
    table[geometry] = words
    return table
