"""Small glTF assets for tests, written from NumPy arrays, and a look at what was read of them."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.load.gltf import load_gltf
from glhybrid.scene import Scene, Triangles

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
QUAD_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # upright image: v down
QUAD_INDEX = np.array([0, 1, 2, 0, 2, 3], np.uint16)
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR4nGNgaGD4DwAChAGAJRc0xwAAAABJRU5ErkJggg=="
)  # 1 x 1


class Builder:
    """A glTF under construction: `json` is the document, `binary` its only buffer."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.binary = bytearray()

    def add(self, kind: str, **fields: Any) -> int:
        self.json.setdefault(kind, []).append(fields)
        return len(self.json[kind]) - 1

    def view(self, data: bytes, **fields: Any) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        offset = len(self.binary)
        self.binary += data
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), **fields)

    def accessor(self, array: Any, **fields: Any) -> int:
        array = np.asarray(array)
        width = 1 if array.ndim == 1 else array.shape[1]
        return self.add("accessors", **{
            "bufferView": self.view(array.tobytes()), "componentType": COMPONENTS[array.dtype.name],
            "type": TYPES[width], "count": len(array), **fields,
        })  # fmt: skip

    def primitive(self, attributes: dict[str, int], **fields: Any) -> dict[str, Any]:
        return {"attributes": attributes, **fields}

    def quad(self, **fields: Any) -> dict[str, Any]:
        """A unit square that faces +Z, with normals and texture coordinates."""
        normal = np.tile(np.float32([0, 0, 1]), (4, 1))
        attributes = {"POSITION": self.accessor(QUAD), "NORMAL": self.accessor(normal),
                      "TEXCOORD_0": self.accessor(QUAD_UV)}  # fmt: skip
        return {"attributes": attributes, "indices": self.accessor(QUAD_INDEX), **fields}

    def scene(self, *primitives: dict[str, Any], **node: Any) -> "Builder":
        """Puts the primitives under a mesh, a node and a scene."""
        mesh = self.add("meshes", name="lamp", primitives=list(primitives))
        self.json.setdefault("scenes", [{"nodes": []}])[0]["nodes"].append(self.add("nodes", mesh=mesh, **node))
        return self

    def document(self) -> dict[str, Any]:
        buffers = [{"byteLength": len(self.binary)}] if self.binary else []
        return {**self.json, **({"buffers": buffers} if buffers else {})}

    def glb(self) -> bytes:
        text = json.dumps(self.document()).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        if binary:
            chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def write(self, folder: Path, name: str = "test.glb") -> Path:
        path = folder / name
        path.write_bytes(self.glb())
        return path


def load(builder: Builder, folder: Path, **options: Any) -> Scene:
    return load_gltf(builder.write(folder), **options)


def piece(scene: Scene, mesh: int = 0, primitive: int = 0) -> Triangles:
    found = scene.meshes[mesh].primitives[primitive]
    assert isinstance(found, Triangles)
    return found


def textured(**material: Any) -> Builder:
    """A quad whose material may use texture 0, a 1 x 1 image."""
    b = Builder()
    b.scene(b.quad(material=0))
    b.add("materials", **material)
    b.add("textures", source=0, sampler=0)
    b.add("samplers", wrapS=33071, wrapT=33648, magFilter=9728, minFilter=9729)
    b.add("images", bufferView=b.view(PNG), mimeType="image/png", name="dot")
    return b
