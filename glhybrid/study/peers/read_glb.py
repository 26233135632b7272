"""A GLB as flat world-space meshes with their textures as arrays, through this package's own loader."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glhybrid.scene import F64, Material, Texture, Triangles

F32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Drawn:
    """One mesh in the world. color, emissive: linear; textures (H, W, C) float32 with their factor in them, colours
    all linear; unlit: emissive holds its colour."""

    position: F64
    normal: F64
    uv: F64
    index: NDArray[np.uint32]
    color: tuple[float, float, float]
    metallic: float
    roughness: float
    emissive: tuple[float, float, float]
    opacity: float
    unlit: bool
    color_texture: F32 | None = None
    metallic_texture: F32 | None = None
    roughness_texture: F32 | None = None
    normal_texture: F32 | None = None
    opacity_texture: F32 | None = None


def read(path: Path) -> Iterator[Drawn]:
    """Every piece of every instance of a GLB."""
    import glhybrid

    scene = glhybrid.load(str(path))
    textures: dict[int, dict[str, F32]] = {}
    for instance in scene.instances:
        mesh = scene.meshes[instance.mesh]
        for k, piece in enumerate(mesh.primitives):
            assert isinstance(piece, Triangles)
            number = instance.materials[k] if instance.materials else piece.material
            material = scene.materials[number]
            if number not in textures:
                textures[number] = _textures(material)
            pose = instance.world_from_object
            normal = piece.normal.astype(np.float64) @ np.linalg.inv(pose[:3, :3])
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
            index = piece.index if np.linalg.det(pose[:3, :3]) > 0 else piece.index[:, ::-1]
            position = piece.position.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
            r, g, b, a = material.base_color
            emissive = (r, g, b) if material.unlit else material.emissive
            opacity = a if material.alpha_mode == "BLEND" else 1.0
            yield Drawn(
                position, normal, _uv(piece, material), np.ascontiguousarray(index), (r, g, b), material.metallic,
                material.roughness, emissive, opacity, material.unlit, **textures[number],
            )  # fmt: skip


def _uv(piece: Triangles, material: Material) -> F64:
    """Of the base colour's set, else of the first texture's, with its transform."""
    chosen = material.textures.get("base_color") or next(iter(material.textures.values()), None)
    uv = piece.uv1 if chosen is not None and chosen.uv_set == 1 else piece.uv0
    found = np.zeros((len(piece.position), 2)) if uv is None else uv.astype(np.float64)
    if chosen is not None and chosen.uv_transform is not None:
        found = found @ chosen.uv_transform[:, :2].T + chosen.uv_transform[:, 2]
    return found


def _textures(material: Material) -> dict[str, F32]:
    found: dict[str, F32] = {}
    if "base_color" in material.textures:
        texels = _texels(material.textures["base_color"])
        linear = np.where(texels <= 0.04045, texels / 12.92, ((texels + 0.055) / 1.055) ** 2.4)[..., :3]
        linear = np.clip(linear * np.array(material.base_color[:3]), 0, 1)
        found["color_texture"] = linear.astype(np.float32)
        if material.alpha_mode != "OPAQUE":
            alpha = texels[..., 3:] * material.base_color[3]
            if material.alpha_mode == "MASK":
                alpha = (alpha >= material.alpha_cutoff).astype(np.float64)
            found["opacity_texture"] = alpha.astype(np.float32)
    if "metallic_roughness" in material.textures:
        texels = _texels(material.textures["metallic_roughness"])
        found["roughness_texture"] = (texels[..., 1:2] * material.roughness).astype(np.float32)
        found["metallic_texture"] = (texels[..., 2:3] * material.metallic).astype(np.float32)
    if "normal" in material.textures:
        texels = _texels(material.textures["normal"])[..., :3].copy()
        texels[..., :2] = (texels[..., :2] - 0.5) * material.normal_scale + 0.5
        found["normal_texture"] = texels.astype(np.float32)
    return found


def _texels(texture: Texture) -> F64:
    return texture.image.texels.astype(np.float64) / 255
