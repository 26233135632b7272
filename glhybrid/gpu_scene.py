"""Scene + Geometry -> named buffers and textures. One upload at load; a frame only moves what is rebased on the camera.

`resources` holds everything by its GLSL name; a buffer that the scene does not need is not there.
"""

from typing import Any

import moderngl
import numpy as np

from glhybrid import bvh, layout, textures
from glhybrid.context import Context
from glhybrid.errors import GeometryError
from glhybrid.geometry import Geometry
from glhybrid.gl import BufferTexture
from glhybrid.needs import Features
from glhybrid.scene import F64, SRGB_SLOTS, TEXTURE_SLOTS, Light, Material, Scene


class GpuScene:
    """Owns the GL objects of one scene."""

    def __init__(self, context: Context, scene: Scene, geometry: Geometry, features: Features) -> None:
        self._context = context
        self._owned: list[Any] = []
        self.scene, self.geometry = scene, geometry
        self.resources: dict[str, Any] = {}
        self.draw_records: list[tuple[tuple[int, int], list[tuple[int, int, int, int]]]] = []
        nodes, slots, roots = bvh.pack([m.blas for m in geometry.meshes])
        # Slots name triangles by their place in the mesh; hits carry the row of the whole table.
        starts = np.concatenate(
            [np.full(len(m.blas.slots), m.first_triangle, np.uint32) for m in geometry.meshes]
            or [np.zeros(0, np.uint32)]
        )
        slots = slots.copy()
        slots[:, 3] += starts
        slots[:, 7] |= self._slot_flags(slots[:, 7])
        self._tlas = None
        self.top_root = 0
        if features.two_level and geometry.meshes:
            self._centre = scene.bounds().mean(0)
            self._tlas = bvh.build_tlas(self._instance_boxes() - self._centre)
            self.top_root = len(nodes)
            tlas_nodes = self._tlas.nodes.reshape(-1, 8).copy()
            refs = tlas_nodes[:, 3::4]
            refs[refs < 0x80000000] += np.uint32(self.top_root)
            nodes = np.concatenate([nodes.reshape(-1, 8), tlas_nodes])
        self._roots = roots
        self.stack_entries = self._stack_entries()
        self._texels("nodes", nodes)
        self._texels("slots", slots)
        self._texels("vertices", geometry.vertices)
        self._texels("triangles", geometry.triangles)
        if geometry.tangents is not None:
            self._texels("tangents", geometry.tangents)
        if geometry.attributes is not None:
            self._texels("attributes", geometry.attributes)
        self._upload_tables(features)
        self._instances = self._instance_rows()
        self.resources["Instances"] = self._buffer(self._instances.nbytes)
        self.lights = scene.lights if features.shadow_rays or features.visibility or scene.lights else ()
        self.resources["Lights"] = self._buffer(max(len(self.lights), 1) * layout.dtype("Light").itemsize)
        self._origin: F64 | None = None

    @property
    def buffer_bytes(self) -> int:
        return sum(o.size for o in self._owned if isinstance(o, moderngl.Buffer))

    @property
    def image_bytes(self) -> int:
        return sum(
            t.width * t.height * t.layers * t.components for t in self._owned if isinstance(t, moderngl.TextureArray)
        )

    def bvh_stats(self) -> dict[str, Any]:
        """What the receipt says of the trees. sah_cost: mean over meshes, weighted by triangles."""
        blases = [m.blas for m in self.geometry.meshes]
        weights = np.array([max(len(b.slots), 1) for b in blases], np.float64)
        cost = float(np.average([b.sah_cost for b in blases], weights=weights)) if blases else 0.0
        nodes = sum(len(b.nodes) for b in blases)
        depth = max((b.depth for b in blases), default=0)
        if self._tlas is not None:
            nodes += len(self._tlas.nodes)
            depth += self._tlas.depth
        return {
            "levels": self.geometry.levels,
            "nodes": nodes,
            "depth": depth,
            "sah_cost": cost,
            "build_ms": float(sum(b.build_ms for b in blases) + (self._tlas.build_ms if self._tlas else 0.0)),
            "bytes": self.resources["nodes"].buffer.size + self.resources["slots"].buffer.size,
        }

    def rebase(self, origin: F64) -> None:
        """Moves the world so that `origin` (3,) float64 is zero, and uploads what that changes: matrices and lights."""
        if self._origin is not None and np.array_equal(origin, self._origin):
            return
        self._origin = origin.copy()
        poses = self.geometry.world_from_object.copy()
        if len(poses):
            poses[:, :3, 3] -= origin
            self._instances["world_from_object"] = layout.columns(poses[:, :3])
            self._instances["object_from_world"] = layout.columns(np.linalg.inv(poses)[:, :3])
        self.resources["Instances"].write(self._instances)
        if self.lights:
            self.resources["Lights"].write(light_rows(self.lights, origin))

    def top_grid(self, origin: F64) -> tuple[F64, F64]:
        """(grid_min, grid_step) of the top-level tree in the world rebased on origin."""
        if self._tlas is None:
            return np.zeros(3), np.ones(3)
        return self._tlas.grid_min + self._centre - origin, self._tlas.grid_step.astype(np.float64)

    def release(self) -> None:
        for owned in reversed(self._owned):
            owned.release()
        self._owned.clear()
        self.resources.clear()

    def _buffer(self, size: int) -> moderngl.Buffer:
        buffer = self._context.gl.buffer(reserve=max(size, 16), dynamic=True)
        self._owned.append(buffer)
        return buffer

    def _data(self, name: str, rows: np.ndarray) -> None:
        limit = self._context.limits.storage_block_bytes
        if rows.nbytes > limit:
            raise GeometryError(
                f"{self.scene.name}: {name} needs {rows.nbytes} bytes, this device's storage blocks hold {limit}: "
                "use a device with a larger limit (glhybrid doctor lists them) or fewer instances"
            )
        buffer = self._context.gl.buffer(rows.tobytes() or bytes(16))
        self._owned.append(buffer)
        self.resources[name] = buffer

    def _texels(self, name: str, rows: np.ndarray) -> None:
        texels = rows.nbytes // 16
        limit = self._context.limits.texture_buffer_texels
        if texels > limit:
            raise GeometryError(
                f"{self.scene.name}: {name} needs {texels} texels, this device's buffer textures hold {limit}: "
                "split the scene or decimate its meshes"
            )
        buffer = self._context.gl.buffer(np.ascontiguousarray(rows) if rows.nbytes else bytes(48))
        view = BufferTexture(self._context.raw, buffer)
        self._owned += [buffer, view]
        self.resources[name] = view

    def _upload_tables(self, features: Features) -> None:
        geometry = self.geometry
        self._data("Records", geometry.records)
        self._data("HitGroups", geometry.hit_groups)
        pages = None
        if features.textures:
            pages = textures.pack(geometry.materials)
            count, size = pages.pages.shape[:2]
            array = self._context.gl.texture_array((size, size, count), 4, pages.pages)
            array.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._owned.append(array)
            self.resources["texture_pages"] = array
            self._data("Textures", pages.textures)
            self._data("TextureLevels", pages.levels)
        self._data("Materials", material_rows(geometry.materials, pages))

    def _instance_rows(self) -> np.ndarray:
        geometry = self.geometry
        rows = np.zeros(max(len(geometry.instance_mesh), 1), layout.dtype("Instance"))
        if not len(geometry.instance_mesh):
            return rows
        mesh = geometry.instance_mesh
        rows["grid_min"] = np.stack([m.blas.grid_min for m in geometry.meshes])[mesh]
        rows["grid_step"] = np.stack([m.blas.grid_step for m in geometry.meshes])[mesh]
        rows["root"] = np.asarray(self._roots, np.uint32)[mesh]
        rows["first_record"] = geometry.first_record
        rows["flipped"] = np.linalg.det(geometry.world_from_object[:, :3, :3]) < 0
        rows["id"] = geometry.instance_id
        return rows

    def _instance_boxes(self) -> F64:
        """(I, 2, 3) float64 world boxes."""
        boxes = np.stack([m.blas.bounds for m in self.geometry.meshes])[self.geometry.instance_mesh]
        pose = self.geometry.world_from_object
        centre, half = boxes.mean(1), np.diff(boxes, axis=1)[:, 0] / 2
        centre = np.einsum("iab,ib->ia", pose[:, :3, :3], centre) + pose[:, :3, 3]
        half = np.einsum("iab,ib->ia", np.abs(pose[:, :3, :3]), half)
        return np.stack([centre - half, centre + half], axis=1)

    def _slot_flags(self, geometry: np.ndarray) -> np.ndarray:
        """SLOT_* bits: what the hit groups of a geometry say, so that plain triangles need no look at their record."""
        tables = []
        opaque, bits = layout.CONSTANTS["ANY_HIT_OPAQUE"], layout.CONSTANTS
        for number, mesh in enumerate(self.geometry.meshes):
            ask, single, double = (np.zeros(len(mesh.geometries), bool) for _ in range(3))
            for first in np.unique(self.geometry.first_record[self.geometry.instance_mesh == number]):
                groups = self.geometry.hit_groups[self.geometry.records[first : first + len(ask), 0]]
                ask |= groups[:, 2] != opaque
                single |= groups[:, 3] == 1
                double |= groups[:, 3] == 0
            ask |= single & double  # instances differ: each hit looks
            tables.append(
                np.where(ask, bits["SLOT_ASK"], np.where(single, bits["SLOT_SINGLE_SIDED"], 0)).astype(np.uint32)
            )
        starts = np.cumsum([0] + [len(t) for t in tables[:-1]])
        rows = geometry + np.repeat(starts, [len(m.blas.slots) for m in self.geometry.meshes]) if tables else geometry
        return np.concatenate([*tables, np.zeros(0, np.uint32)])[rows]

    def _stack_entries(self) -> int:
        """Traversal stack: depth of the trees, the sentinels, and one spare, in fours."""
        deepest = max((m.blas.depth for m in self.geometry.meshes), default=0)
        entries = deepest + 2 + (self._tlas.depth + 2 if self._tlas is not None else 0)
        if entries > 128:
            raise GeometryError(f"{self.scene.name}: trees {entries} deep exceed the traversal stack's limit of 128")
        return -(-entries // 4) * 4


def light_rows(lights: tuple[Light, ...], origin: F64) -> np.ndarray:
    """Rows of layout Light, positions relative to origin."""
    rows = np.zeros(len(lights), layout.dtype("Light"))
    for row, light in zip(rows, lights, strict=True):
        row["color"] = np.asarray(light.color) * light.intensity
        row["kind"] = layout.CONSTANTS[f"LIGHT_{light.kind.upper()}"]
        row["position"] = np.asarray(light.position) - origin
        row["range"] = light.range
        row["direction"] = light.direction
        # The cone term of KHR_lights_punctual, with its own guard against equal angles.
        scale = 1 / max(0.001, np.cos(light.inner_cone) - np.cos(light.outer_cone))
        row["cone_scale"], row["cone_offset"] = scale, -np.cos(light.outer_cone) * scale
        row["size"] = np.tan(light.angular_diameter / 2) if light.kind == "directional" else light.radius
    return rows


def material_rows(materials: tuple[Material, ...], pages: textures.TexturePages | None) -> np.ndarray:
    """Rows of layout Material."""
    rows = np.zeros(max(len(materials), 1), layout.dtype("Material"))
    plain = (
        "base_color", "emissive", "metallic", "specular_color", "roughness", "specular", "alpha_cutoff", "normal_scale",
        "occlusion_strength", "clearcoat", "clearcoat_roughness", "clearcoat_normal_scale", "transmission", "unlit",
    )  # fmt: skip
    for row, material in zip(rows, materials, strict=False):
        for name in plain:
            row[name] = getattr(material, name)
        row["dielectric_f0"] = ((material.ior - 1) / (material.ior + 1)) ** 2
        row["alpha_mode"] = layout.CONSTANTS[f"ALPHA_{material.alpha_mode}"]
        row["texture"] = -1
        for k, slot in enumerate(TEXTURE_SLOTS):
            texture = material.textures.get(slot)
            if texture is not None and pages is not None:
                row["texture"][k] = pages.row_of[id(texture), slot in SRGB_SLOTS]
                row["texture_slots"] |= 1 << k
    return rows
