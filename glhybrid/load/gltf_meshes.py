"""Mesh primitives of a glTF asset to Triangles."""

import json
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.load import tangents
from glhybrid.load.gltf_accessors import AccessorReader
from glhybrid.load.gltf_document import Document, Item
from glhybrid.load.gltf_materials import Materials, ParsedMaterial
from glhybrid.scene import F32, U16, U32, Mesh, MorphTarget, Triangles

MODES = ("POINTS", "LINES", "LINE_LOOP", "LINE_STRIP", "TRIANGLES", "TRIANGLE_STRIP", "TRIANGLE_FAN")
TRIANGLES, STRIP, FAN = 4, 5, 6
DRAWN = re.compile("POSITION|NORMAL|TANGENT|TEXCOORD_[01]|COLOR_0|JOINTS_[01]|WEIGHTS_[01]")
UNIT_TOLERANCE = 1e-4  # squared length of a normal; float32 gives 1e-7, 8-bit quantised ones 1e-2


@dataclass(frozen=True)
class MeshUse:
    """A mesh of the file as the scene has it. slot: its index in MeshReader.meshes, -1 = nothing to draw. materials:
    one for each primitive, None = the mesh's own."""

    slot: int
    materials: tuple[int, ...] | None
    name: str


class MeshReader:
    """Reads the meshes of a document. smooth: make smooth instead of flat normals where a file has none.

    Meshes that differ in nothing but name and materials, which is how glTF writes one shape in many materials, become
    one mesh: the acceleration structure is built once and instances bring their materials.
    """

    def __init__(self, doc: Document, accessors: AccessorReader, materials: Materials, smooth: bool = False) -> None:
        self.doc, self.accessors, self.materials, self.smooth = doc, accessors, materials, smooth
        self.meshes: list[Mesh] = []
        self._uses: dict[int, MeshUse] = {}
        self._shapes: dict[str, tuple[int, list[int]]] = {}  # shape -> slot, numbers of the primitives drawn

    def use(self, index: int) -> MeshUse:
        """A mesh, read when a node first uses it. Raises LoadError."""
        if index not in self._uses:
            self._uses[index] = self._use(self.doc.items("meshes")[index])
        return self._uses[index]

    def _use(self, item: Item) -> MeshUse:
        primitives = item.children("primitives", "primitive")
        used = [p.index("material", "materials") for p in primitives]
        follow = [m.tangent_texture if (m := self.materials.parsed(u)) else None for u in used]
        shape = json.dumps([
            item.data.get("weights"),
            [{k: v for k, v in p.data.items() if k != "material"} for p in primitives],
            [None if f is None else (f.uv_set, f.transform) for f in follow],
        ], sort_keys=True)  # fmt: skip
        if shape not in self._shapes:
            mesh, drawn = self._read(item, primitives)
            self._shapes[shape] = len(self.meshes) if drawn else -1, drawn
            self.meshes += [mesh] if drawn else []
        slot, drawn = self._shapes[shape]
        if slot < 0:
            return MeshUse(-1, None, item.name)
        ours = tuple(self.materials.use(used[n]) for n in drawn)
        pieces = [p for p in self.meshes[slot].primitives if isinstance(p, Triangles)]
        for number, piece in zip(drawn, pieces, strict=True):
            self._check_uv(primitives[number], piece, self.materials.parsed(used[number]))
        return MeshUse(slot, None if ours == tuple(p.material for p in pieces) else ours, item.name)

    def _read(self, item: Item, primitives: list[Item]) -> tuple[Mesh, list[int]]:
        """The mesh and the numbers of the primitives that are drawn."""
        targets = {len(p.children("targets", "target")) for p in primitives}
        if len(targets) > 1:
            raise item.fail(f"its primitives have {' and '.join(map(str, sorted(targets)))} morph targets, must agree")
        target_count = targets.pop() if targets else 0
        weights = item.numbers("weights", None, (0.0,) * target_count)
        if len(weights) != target_count:
            raise item.fail(f"has {len(weights)} morph weights, must have {target_count}, one for each target")
        drawn = {n: made for n, p in enumerate(primitives) if (made := self._primitive(p)) is not None}
        return Mesh(item.name, tuple(drawn.values()), weights), list(drawn)

    def _primitive(self, item: Item) -> Triangles | None:
        mode = item.integer("mode", TRIANGLES, high=len(MODES) - 1)
        attributes = item.child("attributes")
        if attributes is None:
            raise item.fail('"attributes" is missing')
        if "POSITION" not in attributes.data:
            item.warn("not drawn: it has no POSITION")
            return None
        accessor = self.doc.items("accessors")[attributes.required_index("POSITION", "accessors")]
        if item.extension("KHR_draco_mesh_compression") and not accessor.data.keys() & {"bufferView", "sparse"}:
            raise item.fail("is only there Draco-compressed, which is not read; export it without Draco compression")
        position = self.accessors.attribute(attributes, "POSITION", "VEC3")
        assert position is not None
        index = self._triangle_index(item, mode, len(position))
        if mode < TRIANGLES:
            item.warn(f"{MODES[mode]} are not drawn")
            return None
        if not len(index):
            item.warn("not drawn: it has no complete triangle")
            return None
        for name in attributes.data:
            if not DRAWN.fullmatch(name):
                item.warn(f"{name} is not used")
        material = item.index("material", "materials")
        made = self._triangles(
            attributes, position, index, self.materials.use(material), item.children("targets", "target")
        )
        return self._with_tangents(made, item, attributes, self.materials.parsed(material))

    def _triangles(self, attributes: Item, position: F32, index: U32, material: int, targets: list[Item]) -> Triangles:
        """Everything but tangents."""
        count = len(position)
        read = self.accessors.attribute
        normal = read(attributes, "NORMAL", "VEC3", count)
        triangles = Triangles(
            position,
            index,
            np.zeros_like(position) if normal is None else _unit_normals(attributes, normal, position, index),
            material,
            uv0=read(attributes, "TEXCOORD_0", "VEC2", count),
            uv1=read(attributes, "TEXCOORD_1", "VEC2", count),
            color=self._color(attributes, count),
            joints=self._joints(attributes, count),
            weights=self._weights(attributes, count),
            morph_targets=tuple(self._morph_target(t, count) for t in targets),
        )
        if (triangles.joints is None) != (triangles.weights is None):
            raise attributes.fail("JOINTS_0 and WEIGHTS_0 must come together")
        if triangles.joints is not None and triangles.joints.shape != triangles.weights.shape:  # type: ignore[union-attr]
            raise attributes.fail("JOINTS_1 and WEIGHTS_1 must come together")
        if normal is None:
            triangles = tangents.smooth(triangles) if self.smooth else tangents.flat(triangles)
        return triangles

    def _with_tangents(
        self, triangles: Triangles, item: Item, attributes: Item, material: ParsedMaterial | None
    ) -> Triangles:
        """Given tangents where the file has usable ones, made ones where a normal map needs them."""
        given = None
        if "NORMAL" in attributes.data:  # without normals tangents mean nothing and must be ignored (3.7.2.1)
            given = self.accessors.attribute(attributes, "TANGENT", "VEC4", len(triangles.position))
        if given is not None:
            fixed = _unit_tangents(given, triangles.index)
            if fixed is not None:
                if np.any(fixed[:, 3] != given[:, 3]):
                    item.warn("TANGENT has a handedness other than 1 and -1: its sign was used")
                return replace(triangles, tangent=fixed)
            item.warn("some TANGENT has no direction: all were made anew")
        follow = material.tangent_texture if material else None
        if follow is None:
            return triangles
        return tangents.with_tangents(triangles, follow.uv_set, follow.uv_transform)

    def _triangle_index(self, item: Item, mode: int, vertex_count: int) -> U32:
        """(T, 3); none for points and lines, whose indices are checked all the same."""
        if "indices" in item.data:
            raw = self.accessors.unsigned(item, "indices", "SCALAR")[:, 0]
            last = int(raw.max(initial=0))
            if last >= vertex_count:
                raise item.fail(f"index {last} is past the last vertex ({vertex_count - 1}); the file is broken")
            if len(raw) and last == np.iinfo(raw.dtype).max:
                item.warn(f"index {last} would restart the primitive in some viewers, here it is a vertex")
            corner: NDArray[Any] = raw
        else:
            corner = np.arange(vertex_count, dtype=np.uint32)
        if mode == TRIANGLES:
            if left := len(corner) % 3:
                item.warn(f"the last {left} of its vertices make no triangle")
                corner = corner[: len(corner) - left]
            return np.ascontiguousarray(corner, np.uint32).reshape(-1, 3)
        if mode < TRIANGLES or len(corner) < 3:
            return np.zeros((0, 3), np.uint32)
        i = np.arange(len(corner) - 2)
        odd = i % 2
        order = (i, i + 1 + odd, i + 2 - odd) if mode == STRIP else (i + 1, i + 2, np.zeros_like(i))  # 3.7.2.1
        return corner[np.stack(order, axis=1)].astype(np.uint32)

    def _check_uv(self, item: Item, triangles: Triangles, material: ParsedMaterial | None) -> None:
        if material is None:
            return
        for uv_set in sorted({ref.uv_set for ref in material.textures.values()}):
            if (triangles.uv0, triangles.uv1)[uv_set] is None:
                item.warn(f"has no TEXCOORD_{uv_set}, which its textures read: they show one texel")

    def _color(self, attributes: Item, count: int) -> F32 | None:
        color = self.accessors.attribute(attributes, "COLOR_0", "VEC3 VEC4", count)
        if color is None:
            return None
        if color.shape[1] == 3:
            color = np.concatenate([color, np.ones((count, 1), np.float32)], axis=1)
        inside = (color >= 0.0) & (color <= 1.0)  # False for NaN
        if not inside.all():
            attributes.warn("COLOR_0 outside 0 to 1 was clamped")
            color = np.clip(np.nan_to_num(color, nan=1.0), 0.0, 1.0)
        return color

    def _joints(self, attributes: Item, count: int) -> U16 | None:
        sets = [self.accessors.unsigned(attributes, f"JOINTS_{k}", "VEC4", count) for k in (0, 1)
                if f"JOINTS_{k}" in attributes.data]  # fmt: skip
        if any(s.max(initial=0) > 65535 for s in sets):
            raise attributes.fail("a joint index is past 65535")
        return np.concatenate(sets, axis=1).astype(np.uint16) if sets else None

    def _weights(self, attributes: Item, count: int) -> F32 | None:
        read = [self.accessors.attribute(attributes, f"WEIGHTS_{k}", "VEC4", count) for k in (0, 1)]
        sets = [s for s in read if s is not None]
        if not sets:
            return None
        weights = np.nan_to_num(np.concatenate(sets, axis=1), nan=0.0, posinf=0.0, neginf=0.0)
        total = weights.sum(axis=1, keepdims=True)
        if np.any((np.abs(total - 1.0) > 0.02) & (total > 0.0)):  # 8-bit weights are off by up to 4/255
            attributes.warn("joint weights that do not add up to 1 were scaled")
        return np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0)

    def _morph_target(self, item: Item, count: int) -> MorphTarget:
        for name in item.data:
            if name not in ("POSITION", "NORMAL", "TANGENT"):
                item.warn(f"{name} is not morphed")
        return MorphTarget(
            *(self.accessors.attribute(item, n, "VEC3", count) for n in ("POSITION", "NORMAL", "TANGENT"))
        )


def _unit_normals(attributes: Item, normal: F32, position: F32, index: U32) -> F32:
    """The normals with length 1; those without direction replaced by smooth ones, if a triangle uses them."""
    squared = np.einsum("ij,ij->i", normal, normal)
    if np.all(np.abs(squared - 1.0) <= UNIT_TOLERANCE):
        return normal
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        length = np.linalg.norm(normal.astype(np.float64), axis=1, keepdims=True)
        unit = (normal / length).astype(np.float32)
    bad = ~np.isfinite(unit).all(axis=1)
    if bad.any():
        unit[bad] = tangents.smooth_normals(position, index)[bad]
        used = np.zeros(len(normal), bool)
        used[index] = True
        if (bad & used).any():
            attributes.warn("normals without direction were replaced by smooth ones")
    return unit


def _unit_tangents(tangent: F32, index: U32) -> F32 | None:
    """The tangents with length 1 and handedness 1 or -1; None if one that is used has no direction."""
    xyz = tangent[:, :3]
    squared = np.einsum("ij,ij->i", xyz, xyz)
    sign = np.where(tangent[:, 3] < 0.0, np.float32(-1.0), np.float32(1.0))
    if np.all(np.abs(squared - 1.0) <= UNIT_TOLERANCE) and np.array_equal(sign, tangent[:, 3]):
        return tangent
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        unit = xyz / np.linalg.norm(xyz.astype(np.float64), axis=1, keepdims=True)
    if not np.isfinite(unit[index.ravel()]).all():
        return None
    unit = np.where(np.isfinite(unit), unit, np.array([1.0, 0.0, 0.0]))
    return np.concatenate([unit, sign[:, None]], axis=1).astype(np.float32)
