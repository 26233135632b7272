"""Scene + Geometry -> named buffers and textures. One upload at load; a frame only moves what is rebased on the camera.

`resources` holds everything by its GLSL name; a buffer that the scene does not need is not there.
"""

import re
from typing import Any, NamedTuple

import moderngl
import numpy as np

from glhybrid import layout, textures
from glhybrid.context import Context
from glhybrid.errors import GeometryError
from glhybrid.geometry import Geometry
from glhybrid.gl import BufferTexture
from glhybrid.gpu_rows import light_rows, material_rows
from glhybrid.gpu_trees import EMPTY_TREE, GpuTrees, runs
from glhybrid.keys import MANY
from glhybrid.levels import builds_on_gpu, drawn_and_stored
from glhybrid.motion import Moment, Motion
from glhybrid.needs import Features
from glhybrid.owned import Owned
from glhybrid.scene import F32, F64, Light, Scene

_CAUSE = {"Lights": "lights", "Materials": "materials", "Textures": "textures", "TextureLevels": "textures"}


NEAR_ROWS, MOST_WRITES = 16, 12  # of Instances: rows so near go in one write, and more writes than that as one
TEXELS_A_TRIANGLE = 3  # in leaves
NO_TREES = {"nodes": 0, "depth": 0, "sah_cost": 0.0, "build_ms": 0.0, "bytes": 0}


def check_room(scene: Scene, levels: int, context: Context) -> None:
    """Raises GeometryError where the device cannot hold the scene's tree: before minutes are spent on building it."""
    limit = context.limits.texture_buffer_texels
    drawn, stored = drawn_and_stored(scene)
    needed = TEXELS_A_TRIANGLE * (drawn if levels == 1 else stored)
    if needed > limit:
        two = ", or take levels = 2" if levels == 1 and TEXELS_A_TRIANGLE * stored <= limit else ""
        raise GeometryError(
            f"{scene.name}: the tree over {needed // TEXELS_A_TRIANGLE} triangles needs {needed} texels, this device's "
            f"buffer textures hold {limit}: split the scene or decimate its meshes{two}"
        )


class MovedTree(NamedTuple):
    """What instances know of a tree whose vertices moved: its grid (3,) float32, and its box (2, 3) float64."""

    grid_min: F32
    grid_step: F32
    bounds: F64


class GpuScene:
    """Owns the GL objects of one scene. motion: what will move. rebuild: as Settings.rebuild, for the top-level tree.
    builder: as Settings.builder.

    Trees are there if `geometry` has them, else from add_trees() on.
    """

    def __init__(
        self,
        context: Context,
        scene: Scene,
        geometry: Geometry,
        features: Features,
        motion: Motion | None = None,
        rebuild: float = 1.5,
        builder: str = "auto",
    ) -> None:
        self._context = context
        self._owned = Owned()
        self._origin: F64 | None = None  # of the last rebase; None: all is to be uploaded
        self._zero: F64 = np.zeros(3)  # the same, for matrices
        self.scene, self.geometry = scene, geometry
        self.resources: dict[str, Any] = {}
        count = len(geometry.instance_id)
        # (I, 4, 4) float64 in an order of its own, and the row of it that an instance has.
        self._world: F64 = geometry.world_from_object
        self._row_of_world: Any = np.arange(count)
        self._inverse: F64 = np.empty((count, 3, 3))  # of the linear part of _world
        self._flipped, self._boxes = np.zeros(count, bool), np.empty((count, 2, 3))
        self.turned = 0  # grows when instances become mirrored, or cease to be
        self._compiled = count >= MANY or motion is not None
        movable = np.isin(geometry.instance_id, list(motion.moving)) if motion is not None else np.zeros(count, bool)
        self._movable = np.flatnonzero(movable)
        self._unsent: Any = None  # rising rows that have moved since the last rebase
        self._dark = True  # lights changed since then
        self._previous: F64 | None = None
        self._bounds = np.zeros((len(geometry.meshes), 2, 3))  # of trees
        self._instances = self._instance_rows()
        self._words = tuple(self._instances.view(t).reshape(len(self._instances), -1) for t in (np.uint32, np.float32))
        self._place(np.arange(count))
        self.trees: GpuTrees | None = None
        self._make_trees = (features.two_level, motion, rebuild, builder)
        if all(m.tree is not None for m in geometry.meshes):
            self.add_trees(geometry)
        elif features.buffer_array:  # programs that send no ray name trees all the same: see lib/buffers.glsl
            self._texels("nodes", EMPTY_TREE)
            self._texels("slots", np.zeros((0, 12), np.uint32))
        self._texels("vertices", geometry.vertices)
        self._texels("triangles", geometry.triangles)
        if geometry.tangents is not None:
            self._texels("tangents", geometry.tangents)
        if geometry.attributes is not None:
            self._texels("attributes", geometry.attributes)
        self._upload_tables(features)
        self.resources["Instances"] = self._buffer("Instances", self._instances.nbytes)
        self.lights = scene.lights
        self.resources["Lights"] = self._buffer("Lights", max(len(self.lights), 1) * layout.dtype("Light").itemsize)
        for block in ("Instances", "Lights", "Materials", "Textures", "TextureLevels") if features.buffer_array else ():
            if block in self.resources:  # the same bytes, as llvmpipe reads them faster
                self._check_texels(block, self.resources[block].size)
                view = self._owned.add(BufferTexture(context.raw, self.resources[block]))
                self.resources[re.sub(r"(?<=[a-z])(?=[A-Z])", "_", block).lower()] = view

    def add_trees(self, geometry: Geometry) -> None:
        """Readies the scene for rays. geometry: the same with the trees of its meshes (geometry.grow_trees)."""
        two_level, motion, rebuild, builder = self._make_trees
        self.geometry = geometry
        deforming = {self.mesh_of_instance(d.instances[0]) for d in motion.deformers} if motion is not None else set()
        if geometry.meshes:
            self._bounds = np.array([m.blas.bounds for m in geometry.meshes])
            self._place(np.arange(len(self._row_of_world)))
        boxes = self._boxes if two_level and geometry.meshes else None
        largest = motion.largest if motion is not None else 0
        software = self._context.device.software
        on_gpu = builds_on_gpu(rebuild, builder, software, largest)
        given = (deforming, motion is not None, rebuild, self.scene.name, software, on_gpu)
        self.trees = GpuTrees(self._texels, self._context.write, geometry, boxes, *given)
        if geometry.meshes:
            mesh, rows = geometry.instance_mesh, self._instances
            rows["grid_min"] = np.stack([m.blas.grid_min for m in geometry.meshes])[mesh]
            rows["grid_step"] = np.stack([m.blas.grid_step for m in geometry.meshes])[mesh]
            rows["root"] = self.trees.roots[mesh]
        self._origin = None  # all rows are uploaded by the next rebase

    @property
    def stack_entries(self) -> int:
        """Of a ray's stack, with room for what moves. Only once there are trees."""
        assert self.trees is not None
        return self.trees.stack_entries

    def stack_needed(self) -> int:
        """The same as trees are now."""
        return self.trees.stack_needed() if self.trees is not None else 0

    @property
    def top(self) -> Any:
        """The grid of the top-level tree, another object whenever it has changed; None without such a tree."""
        return self.trees.grid if self.trees is not None else None

    @property
    def top_root(self) -> int:
        """Row of nodes of the top-level tree."""
        return self.trees.top_root if self.trees is not None else 0

    def top_grid(self, origin: F64) -> tuple[F64, F64]:
        """(grid_min, grid_step) of the top-level tree in the world rebased on origin."""
        return self.trees.top_grid(origin) if self.trees is not None else (np.zeros(3), np.ones(3))

    @property
    def buffer_bytes(self) -> int:
        """Of all buffers, tables and trees."""
        return self._owned.buffer_bytes

    @property
    def image_bytes(self) -> int:
        """Of texture pages."""
        return sum(
            t.width * t.height * t.layers * t.components for t in self._owned if isinstance(t, moderngl.TextureArray)
        )

    def bvh_stats(self) -> dict[str, Any]:
        """What the receipt says of the trees; zeros where there are none."""
        return {"levels": self.geometry.levels} | (self.trees.stats() if self.trees is not None else NO_TREES)

    def rebase(self, origin: F64) -> None:
        """Moves the world so that `origin` (3,) float64 is zero, and uploads what that changes: matrices and lights."""
        same = origin is self._origin or (self._origin is not None and origin.tolist() == self._origin.tolist())
        if same and self._unsent is None and not self._dark:
            return
        rows, size = self._instances, self._instances.itemsize
        if self._previous is not None:
            before = self._previous[:, :3].copy()
            before[:, :, 3] -= origin
            self._context.write(self.resources["PreviousInstances"], layout.columns(before))
        if not same:
            self._origin, self._zero = origin, np.array(origin, np.float64)
            self._rebase()
            self._context.write(self.resources["Instances"], rows)
        elif self._unsent is not None and len(self._unsent):
            for first, last in runs(self._unsent, NEAR_ROWS, MOST_WRITES):
                self._context.write(self.resources["Instances"], rows[first:last], first * size)
        if self.lights and (self._dark or not same):
            self._context.write(self.resources["Lights"], light_rows(self.lights, origin))
        self._unsent, self._dark = None, False

    def _rebase(self) -> None:
        """The positions of all instances, in the rows to be uploaded."""
        rows, origin = self._instances, self._zero
        count = len(self._row_of_world)
        if self._compiled:
            from glhybrid import swarm

            given, words = (self._world, self._row_of_world, self._inverse, origin), self._words[1]
            swarm.spread(lambda a, b: swarm.rebase(*given, a, b, words), 0, count)
        elif count:
            position = self.world_from_object[:, :3, 3] - origin
            rows["world_from_object"][:, 3, :3] = position
            rows["object_from_world"][:, 3, :3] = -np.einsum("iab,ib->ia", self._inverse, position)

    def _place(self, instances: Any) -> None:
        """Both matrices of some instances, rising rows, handedness, and boxes in the world."""
        rows, count = self._instances, len(instances)
        if self._compiled:
            from glhybrid import swarm

            given = (self._world, self._row_of_world, self._bounds, self.geometry.instance_mesh, instances)
            out = (self._zero, swarm.FLAG, *self._words, self._inverse, self._flipped.view(np.uint8), self._boxes)
            self.turned += sum(swarm.spread(lambda a, b: swarm.place(*given, a, b, *out), 0, count))
        elif count:
            assert count == len(rows)  # what moves is compiled
            world = self.world_from_object
            self._inverse[:] = np.linalg.inv(world[:, :3, :3])
            rows["world_from_object"][:, :3, :3] = world[:, :3, :3].swapaxes(1, 2)
            rows["object_from_world"][:, :3, :3] = self._inverse.swapaxes(1, 2)
            rows["flipped"] = self._flipped[:] = np.linalg.det(world[:, :3, :3]) < 0
            boxes = self._bounds[self.geometry.instance_mesh]
            centre, half = boxes.mean(1), np.diff(boxes, axis=1)[:, 0] / 2
            centre = np.einsum("iab,ib->ia", world[:, :3, :3], centre) + world[:, :3, 3]
            half = np.einsum("iab,ib->ia", np.abs(world[:, :3, :3]), half)
            self._boxes[:] = np.stack([centre - half, centre + half], axis=1)

    def relight(self, lights: tuple[Light, ...]) -> None:
        """Other lights, as many as before; the next rebase uploads them."""
        if self.lights and lights != self.lights:
            self.lights, self._dark = lights, True

    def move(self, moment: Moment, trees: dict[int, MovedTree]) -> None:
        """Everything where a moment has it: instances, lights, the top-level tree. The next rebase uploads matrices.

        trees: by row of geometry.meshes, those whose vertices moved.
        """
        geometry, rows = self.geometry, self._instances
        if self.lights and moment.lights is not self.lights:
            self.lights, self._dark = moment.lights, True
        if not len(geometry.instance_id):
            return
        moved = self._movable
        if self._world is moment.world_from_object and moment.moved is not None:
            moved = moment.moved
            if len(geometry.instance_id) < len(self._world):
                moved = np.flatnonzero(np.isin(geometry.instance_id, moved))
        else:
            self._world, self._row_of_world = moment.world_from_object, geometry.instance_id.astype(np.int64)
        for mesh, tree in trees.items():
            self._bounds[mesh] = tree.bounds
            ours = np.flatnonzero(geometry.instance_mesh == mesh)
            rows["grid_min"][ours], rows["grid_step"][ours] = tree.grid_min, tree.grid_step
            moved = np.union1d(moved, ours)
        if len(moved):
            self._place(moved)
            if self.trees is not None and self.trees.top is not None:
                self.trees.move_top(self._boxes, moved)
        self._unsent = moved if self._unsent is None or not len(self._unsent) else np.union1d(self._unsent, moved)

    def keep_places(self) -> None:
        """To be called before a move, which changes them: where instances are becomes where they were."""
        if "PreviousInstances" in self.resources:
            self._previous = self.world_from_object

    def keep_previous(self, vertices: bool) -> None:
        """Makes room for where instances, and vertices too, were a frame ago: the motion AOV reads it."""
        if "PreviousInstances" not in self.resources:
            size = len(self._instances) * layout.dtype("Placement").itemsize
            self.resources["PreviousInstances"] = self._buffer("PreviousInstances", size)
            self._previous, self._origin = self.world_from_object, None
        if vertices and "previous_vertices" not in self.resources:
            self._texels("previous_vertices", self.geometry.vertices)
            self.copy_vertices()

    def copy_vertices(self) -> None:
        """The vertices of now become those of a frame ago."""
        if "previous_vertices" in self.resources:
            source = self.resources["vertices"].buffer
            self._context.gl.copy_buffer(self.resources["previous_vertices"].buffer, source)

    @property
    def world_from_object(self) -> F64:
        """(I, 4, 4) float64: where instances are now, in the order of Geometry's."""
        return self._world[self._row_of_world]

    @property
    def flipped(self) -> np.ndarray:
        """(I,) bool: instances turned inside out, whose front faces turn clockwise."""
        return self._flipped.copy()

    def mesh_of_instance(self, number: int) -> int:
        """Row of geometry.meshes of a row of Scene.instances; -1 if nothing of it is drawn."""
        found = np.flatnonzero(self.geometry.instance_id == number)
        return int(self.geometry.instance_mesh[found[0]]) if len(found) else -1

    def release(self) -> None:
        """Frees everything; nothing of the scene may be drawn after it."""
        self._owned.release()
        self.resources.clear()

    def _buffer(self, name: str, size: int) -> moderngl.Buffer:
        self._check_block(name, size)
        return self._owned.add(self._context.gl.buffer(reserve=max(size, 16), dynamic=True))

    def _check_block(self, name: str, size: int) -> None:
        limit = self._context.limits.storage_block_bytes
        if size > limit:
            what = _CAUSE.get(name, "instances")
            raise GeometryError(
                f"{self.scene.name}: {name} needs {size} bytes, this device's storage blocks hold {limit}: "
                f"use a device with a larger limit (glhybrid doctor lists them) or fewer {what}"
            )

    def _data(self, name: str, rows: np.ndarray) -> None:
        self._check_block(name, rows.nbytes)
        self.resources[name] = self._owned.add(self._context.gl.buffer(rows.tobytes() or bytes(16)))

    def _check_texels(self, name: str, size: int) -> None:
        limit = self._context.limits.texture_buffer_texels
        if size > 16 * limit:
            table = f"use fewer {_CAUSE.get(name, 'instances')}"
            raise GeometryError(
                f"{self.scene.name}: {name} needs {size // 16} texels, this device's buffer textures hold {limit}: "
                + (table if name[0].isupper() else "split the scene or decimate its meshes")
            )

    def _texels(self, name: str, rows: np.ndarray) -> BufferTexture:
        self._check_texels(name, rows.nbytes)
        buffer = self._owned.add(self._context.gl.buffer(np.ascontiguousarray(rows) if rows.nbytes else bytes(48)))
        self.resources[name] = view = self._owned.add(BufferTexture(self._context.raw, buffer))
        return view

    def _upload_tables(self, features: Features) -> None:
        geometry = self.geometry
        self._data("Records", geometry.records)
        self._data("HitGroups", geometry.hit_groups)
        pages = None
        if features.textures:
            pages = textures.pack(geometry.materials)
            count, size = pages.pages.shape[:2]
            most, side = self._context.limits.texture_layers, self._context.limits.texture_size
            if count > most or size > side:
                raise GeometryError(
                    f"{self.scene.name}: the images fill {count} pages of {size} texels a side, this device has {most} "
                    f"of {side}: use a device with larger limits (glhybrid doctor lists them) or smaller images"
                )
            array = self._owned.add(self._context.gl.texture_array((size, size, count), 4, pages.pages))
            array.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self.resources["texture_pages"] = array
            self._data("Textures", pages.textures)
            self._data("TextureLevels", pages.levels)
        self._data("Materials", material_rows(geometry.materials, pages))

    def _instance_rows(self) -> np.ndarray:
        geometry = self.geometry
        rows = np.zeros(max(len(geometry.instance_mesh), 1), layout.dtype("Instance"))
        if not len(geometry.instance_mesh):
            return rows
        rows["first_record"] = geometry.first_record
        rows["id"] = geometry.instance_id
        return rows
