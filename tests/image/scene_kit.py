"""Small scenes for the image tests, written out in numbers: no file, no loader, no built-in shape."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glhybrid.scene import (
    Camera,
    Environment,
    Image,
    Instance,
    Light,
    Material,
    Mesh,
    Scene,
    Texture,
    Triangles,
)
from glhybrid.view import View, make_view

F64 = NDArray[np.float64]
Part = tuple[Any, ...]  # (shape, material) or (shape, material, world_from_object or translation)


def quad(corners: ArrayLike, uv: ArrayLike | None = None) -> Triangles:
    """Two triangles over (4, 3) corners, counter-clockwise from the front; uv (4, 2), default 0 to 1."""
    p = np.asarray(corners, np.float64)
    n = np.cross(p[1] - p[0], p[2] - p[0])
    n /= np.linalg.norm(n)
    uv = np.asarray(uv if uv is not None else [(0, 1), (1, 1), (1, 0), (0, 0)], np.float32)
    index = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    tangent = np.append((p[1] - p[0]) / np.linalg.norm(p[1] - p[0]), 1)
    return Triangles(
        p.astype(np.float32), index, np.tile(n, (4, 1)).astype(np.float32), uv0=uv,
        tangent=np.tile(tangent, (4, 1)).astype(np.float32),
    )  # fmt: skip


def floor(half: float = 4.0, y: float = 0.0, center: tuple[float, float] = (0.0, 0.0)) -> Triangles:
    """A square that faces +Y; u along +X, v along +Z."""
    x, z = center
    return quad([(x - half, y, z + half), (x + half, y, z + half), (x + half, y, z - half), (x - half, y, z - half)])


def soup(corners: ArrayLike) -> Triangles:
    """(T, 3, 3) corners as flat triangles."""
    p = np.asarray(corners, np.float64).reshape(-1, 3, 3)
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    index = np.arange(3 * len(p), dtype=np.uint32).reshape(-1, 3)
    return Triangles(p.reshape(-1, 3).astype(np.float32), index, np.repeat(n, 3, 0).astype(np.float32))


def box(low: ArrayLike, high: ArrayLike, inside: bool = False) -> Triangles:
    """Twelve flat triangles; inside: they face inwards."""
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    unit = np.array(
        [
            [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], [(1, 0, 0), (0, 0, 0), (0, 1, 0), (1, 1, 0)],
            [(1, 0, 1), (1, 0, 0), (1, 1, 0), (1, 1, 1)], [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)],
            [(0, 1, 1), (1, 1, 1), (1, 1, 0), (0, 1, 0)], [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        ]
    )  # fmt: skip
    p = low + unit * (high - low)
    order = (0, 2, 1, 0, 3, 2) if inside else (0, 1, 2, 0, 2, 3)
    return soup(p[:, order].reshape(-1, 3, 3))


def scene(parts: Sequence[Part], camera: Camera | None = None, **extra: Any) -> Scene:
    """One instance and one mesh a part: (shape, material) or (shape, material, world_from_object or translation)."""
    meshes, instances, materials = [], [], []
    for i, part in enumerate(parts):
        placement = np.asarray(part[2], np.float64) if len(part) == 3 else np.eye(4)
        if placement.shape == (3,):
            pose = np.eye(4)
            pose[:3, 3] = placement
            placement = pose
        meshes.append(Mesh(f"part {i}", (part[0],)))
        materials.append(part[1])
        instances.append(Instance(i, placement, materials=(i,)))
    extra["lights"] = tuple(extra.get("lights", ()))
    if camera is None:
        camera = Camera.look_at((1.5, 2.5, 5.0), (0, 0.6, 0), fov_y=np.radians(40))
    return Scene("test", tuple(meshes), tuple(instances), tuple(materials), cameras=(camera,), **extra)


def matte(color: ArrayLike = (0.8, 0.8, 0.8), alpha: float = 1.0, **extra: Any) -> Material:
    """Lambert alone: no specular lobe (KHR_materials_specular 0), so that an oracle's `diffuse` is the same thing."""
    r, g, b = np.broadcast_to(np.asarray(color, float), 3)
    extra.setdefault("specular", 0.0)
    return Material("matte", (r, g, b, alpha), roughness=1.0, **{"double_sided": True} | extra)


def metal(color: ArrayLike = (1.0, 1.0, 1.0), roughness: float = 0.0, **extra: Any) -> Material:
    r, g, b = np.broadcast_to(np.asarray(color, float), 3)
    return Material("metal", (r, g, b, 1.0), metallic=1.0, roughness=roughness, **{"double_sided": True} | extra)


def plastic(color: ArrayLike = (0.6, 0.2, 0.1), roughness: float = 0.4, alpha: float = 1.0, **extra: Any) -> Material:
    r, g, b = np.broadcast_to(np.asarray(color, float), 3)
    return Material("plastic", (r, g, b, alpha), roughness=roughness, **{"double_sided": True} | extra)


def sun(direction: ArrayLike = (-0.4, -1.0, -0.3), lux: float = 3.0, color: Any = (1.0, 1.0, 1.0)) -> Light:
    d = np.asarray(direction, float)
    return Light("directional", color, lux, direction=tuple(d / np.linalg.norm(d)))


def constant_sky(radiance: ArrayLike = 1.0) -> Environment:
    return Environment(np.broadcast_to(np.asarray(radiance, np.float32), (1, 1, 3)).copy())


def texture(texels: ArrayLike, **extra: Any) -> Texture:
    """(H, W, C) uint8 with 1, 3 or 4 channels; no mip levels unless asked for."""
    t = np.asarray(texels, np.uint8)
    if t.ndim == 2:
        t = t[..., None]
    if t.shape[2] == 1:
        t = np.repeat(t, 3, 2)
    if t.shape[2] == 3:
        t = np.concatenate([t, np.full_like(t[..., :1], 255)], 2)
    return Texture(Image(np.ascontiguousarray(t)), **{"mipmap": False} | extra)


@dataclass(frozen=True)
class Rays:
    """Pixel-centre rays in float64, world space: origin, direction (H, W, 3), row 0 at the top."""

    origin: F64
    direction: F64


def camera_rays(scene: Scene, size: tuple[int, int], camera: Camera | None = None) -> Rays:
    """From Camera's definition in scene.py alone: not through View or GLSL."""
    camera = camera or scene.cameras[0]
    width, height = size
    x = (np.arange(width) + 0.5) / width * 2 - 1
    y = 1 - (np.arange(height) + 0.5) / height * 2
    x, y = np.meshgrid(x, y)
    right, up, back, eye = (camera.world_from_view[:3, k] for k in range(4))
    if camera.fov_y > 0:
        tan_y = np.tan(camera.fov_y / 2)
        d = x[..., None] * right * tan_y * width / height + y[..., None] * up * tan_y - back
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        return Rays(np.broadcast_to(eye, d.shape).copy(), d)
    half_x = camera.xmag or camera.ymag * width / height
    o = eye + x[..., None] * right * half_x + y[..., None] * up * camera.ymag
    return Rays(o, np.broadcast_to(-back, o.shape).copy())


def view_of(scene: Scene, size: tuple[int, int]) -> View:
    return make_view(scene.cameras[0], size, scene)
