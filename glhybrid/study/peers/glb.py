"""A scene as a GLB file, for renderers that read nothing else: geometry at rest, metallic-roughness materials.

Lights, camera and environment travel beside it (bundle.py). Spheres become triangles. What glTF's core lacks is left
out and named by `lost`.
"""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.load.shapes import sphere
from glhybrid.scene import Image, Material, Scene, Sphere, Texture, Triangles

SEGMENTS = 64  # of a sphere
FLOAT, UINT = 5126, 5125
ARRAY, ELEMENTS = 34962, 34963
WRAP = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
SLOTS = {"base_color": "baseColorTexture", "metallic_roughness": "metallicRoughnessTexture"}


def pieces(scene: Scene, mesh: int) -> list[Triangles]:
    """A mesh's pieces, all of triangles."""
    found = []
    for piece in scene.meshes[mesh].primitives:
        if isinstance(piece, Sphere):
            ball = sphere(radius=piece.radius, segments=SEGMENTS)
            assert isinstance(ball, Triangles)
            found.append(ball)
        else:
            found.append(piece)
    return found


def materials_of(scene: Scene, instance: int) -> list[int]:
    """A material a piece."""
    placed = scene.instances[instance]
    return list(placed.materials or (p.material for p in scene.meshes[placed.mesh].primitives))


def lost(scene: Scene) -> list[str]:
    """What the file cannot say of a scene."""
    kinds = {
        "clearcoat": any(m.clearcoat > 0 for m in scene.materials),
        "transmission": any(m.transmission > 0 for m in scene.materials),
        "specular and ior": any(m.ior != 1.5 or m.specular != 1 for m in scene.materials),
    }
    return [name for name, used in kinds.items() if used]


class _Writer:
    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.textures: list[dict[str, Any]] = []
        self._seen: dict[Any, int] = {}

    def view(self, data: bytes, target: int | None = None) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.views.append(view | ({"target": target} if target else {}))
        self.data += data
        return len(self.views) - 1

    def accessor(self, values: np.ndarray, kind: str) -> int:
        index = kind == "SCALAR"
        values = np.ascontiguousarray(values, np.uint32 if index else np.float32)
        entry: dict[str, Any] = {
            "bufferView": self.view(values.tobytes(), ELEMENTS if index else ARRAY), "count": len(values), "type": kind,
            "componentType": UINT if index else FLOAT,
        }  # fmt: skip
        if kind == "VEC3":
            entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def texture(self, texture: Texture) -> int:
        key = id(texture.image), texture.wrap_u, texture.wrap_v, texture.nearest
        if key not in self._seen:
            filters = {"magFilter": 9728 if texture.nearest else 9729, "minFilter": 9987 if texture.mipmap else 9729}
            self.samplers.append({"wrapS": WRAP[texture.wrap_u], "wrapT": WRAP[texture.wrap_v], **filters})
            entry = {"source": self.image(texture.image), "sampler": len(self.samplers) - 1}
            self.textures.append(entry)
            self._seen[key] = len(self.textures) - 1
        return self._seen[key]

    def image(self, image: Image) -> int:
        key = "image", id(image)
        if key not in self._seen:
            from PIL import Image as Pictures

            png = io.BytesIO()
            Pictures.fromarray(image.texels).save(png, "PNG", compress_level=1)
            self.images.append({"bufferView": self.view(png.getvalue()), "mimeType": "image/png"})
            self._seen[key] = len(self.images) - 1
        return self._seen[key]

    def reference(self, texture: Texture) -> dict[str, Any]:
        entry: dict[str, Any] = {"index": self.texture(texture), "texCoord": texture.uv_set}
        if texture.uv_transform is not None:
            m = texture.uv_transform
            scale = [float(np.hypot(m[0, 0], m[1, 0])), float(np.hypot(m[0, 1], m[1, 1]))]
            turn = float(np.arctan2(-m[1, 0], m[0, 0]))
            entry["extensions"] = {
                "KHR_texture_transform": {"offset": m[:, 2].tolist(), "scale": scale, "rotation": turn}
            }
        return entry

    def material(self, material: Material) -> dict[str, Any]:
        pbr: dict[str, Any] = {
            "baseColorFactor": list(material.base_color), "metallicFactor": material.metallic,
            "roughnessFactor": material.roughness,
        }  # fmt: skip
        pbr |= {name: self.reference(material.textures[s]) for s, name in SLOTS.items() if s in material.textures}
        entry: dict[str, Any] = {
            "name": material.name, "pbrMetallicRoughness": pbr, "doubleSided": material.double_sided,
            "alphaMode": material.alpha_mode,
        }  # fmt: skip
        if material.alpha_mode == "MASK":
            entry["alphaCutoff"] = material.alpha_cutoff
        if max(material.emissive) > 0:
            strength = max(max(material.emissive), 1.0)
            entry["emissiveFactor"] = [e / strength for e in material.emissive]
            if strength > 1:
                entry["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        if "emissive" in material.textures:
            entry["emissiveTexture"] = self.reference(material.textures["emissive"])
        if "normal" in material.textures:
            entry["normalTexture"] = self.reference(material.textures["normal"]) | {"scale": material.normal_scale}
        if material.unlit:
            entry.setdefault("extensions", {})["KHR_materials_unlit"] = {}
        return entry


def write(scene: Scene, path: Path) -> None:
    """Writes a GLB with a node an instance."""
    out = _Writer()
    materials = [out.material(m) for m in scene.materials]
    attributes: dict[int, list[dict[str, Any]]] = {}
    meshes: list[dict[str, Any]] = []
    nodes: list[dict[str, Any]] = []
    made: dict[tuple[int, tuple[int, ...]], int] = {}
    for number, instance in enumerate(scene.instances):
        chosen = tuple(materials_of(scene, number))
        if (instance.mesh, chosen) not in made:
            if instance.mesh not in attributes:
                attributes[instance.mesh] = [_attributes(out, piece) for piece in pieces(scene, instance.mesh)]
            drawn = [a | {"material": m} for a, m in zip(attributes[instance.mesh], chosen, strict=True) if a]
            made[instance.mesh, chosen] = len(meshes) if drawn else -1
            meshes += [{"name": scene.meshes[instance.mesh].name, "primitives": drawn}] if drawn else []
        index = made[instance.mesh, chosen]
        if index >= 0:
            matrix = instance.world_from_object.T.ravel().tolist()
            nodes.append({"name": instance.name or f"instance {number}", "mesh": index, "matrix": matrix})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "glhybrid"}, "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes, "meshes": meshes or None, "materials": materials,
        "accessors": out.accessors, "bufferViews": out.views, "images": out.images, "samplers": out.samplers,
        "textures": out.textures, "buffers": [{"byteLength": len(out.data)}],
    }  # fmt: skip
    document = {k: v for k, v in document.items() if v not in ([], None)}
    text = json.dumps(document)
    used = [n for n in ("texture_transform", "materials_emissive_strength", "materials_unlit") if f"KHR_{n}" in text]
    if used:
        document["extensionsUsed"] = [f"KHR_{n}" for n in used]
        text = json.dumps(document)
    body = text.encode()
    body += b" " * (-len(body) % 4)
    data = bytes(out.data) + b"\0" * (-len(out.data) % 4)
    length = 12 + 8 + len(body) + 8 + len(data)
    with path.open("wb") as file:
        file.write(struct.pack("<III", 0x46546C67, 2, length))
        file.write(struct.pack("<II", len(body), 0x4E4F534A) + body)
        file.write(struct.pack("<II", len(data), 0x004E4942) + data)


def _attributes(out: _Writer, piece: Triangles) -> dict[str, Any]:
    """Accessors of a piece; empty if it draws nothing."""
    if not len(piece.index):
        return {}
    found = {"POSITION": out.accessor(piece.position, "VEC3"), "NORMAL": out.accessor(piece.normal, "VEC3")}
    for name, values, kind in (
        ("TEXCOORD_0", piece.uv0, "VEC2"), ("TEXCOORD_1", piece.uv1, "VEC2"), ("TANGENT", piece.tangent, "VEC4"),
        ("COLOR_0", piece.color, "VEC4"),
    ):  # fmt: skip
        if values is not None:
            found[name] = out.accessor(values, kind)
    return {"attributes": found, "indices": out.accessor(piece.index.ravel(), "SCALAR")}
