"""What lamps of the analytic kind leave on a surface, in float64 NumPy, and how tests draw it."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy_brdf import Brdf, dot, unit
from scene_kit import sun

from glhybrid.scene import Camera, Light, Material, Scene
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.image import Frame
    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]


SIZE = (64, 48)
DOWN = Camera.look_at((0, 3, 0.001), (0, 0, 0), (0, 0, -1), fov_y=np.radians(50))
ASKANCE = Camera.look_at((0.5, 1.2, 3.0), (0, 0.2, 0), fov_y=np.radians(45))


def draw(renderer: "Renderer", world: Scene, *aovs: str, size: tuple[int, int] = SIZE, **settings: Any) -> "Frame":
    return renderer.render(world, size=size, settings=Settings(**({"aa": 1} | settings)), aovs=aovs)


def lamp_at(light: Light, position: "F64") -> "tuple[F64, F64]":
    """Irradiance facing the light (..., 3) and the unit direction to it, by KHR_lights_punctual."""
    color = np.asarray(light.color) * light.intensity
    axis = unit(light.direction)
    if light.kind == "directional":
        return np.broadcast_to(color, position.shape), np.broadcast_to(-axis, position.shape)
    to = np.asarray(light.position) - position
    d = np.linalg.norm(to, axis=-1)
    to /= d[..., None]
    falloff = 1 / d**2
    if light.range > 0:
        falloff *= np.clip(1 - (d / light.range) ** 4, 0, 1)
    if light.kind == "spot":
        inner, outer = np.cos(light.inner_cone), np.cos(light.outer_cone)
        scale = 1 / max(0.001, inner - outer)
        falloff *= np.clip(dot(-to, axis) * scale - outer * scale, 0, 1) ** 2
    return color * falloff[..., None], to


def on_floor(rays: Any) -> "dict[str, F64]":
    """What `direct` reads of a frame, for an unshadowed floor at y = 0: no AOV needed."""
    p = rays.origin - rays.direction * (rays.origin[..., 1:2] / rays.direction[..., 1:2])
    up = np.zeros_like(p)
    up[..., 1] = 1
    return {"position": p, "normal": up, "visibility": np.ones((*p.shape[:2], 8))}


def direct(frame: Any, world: Scene, brdf: Brdf, origin: "F64", normal: "F64 | None" = None, **given: Any) -> "F64":
    """Direct light of all lamps on the frame's surface points, shadows from its `visibility`."""
    p = frame["position"].astype(np.float64)
    n = frame["normal"].astype(np.float64) if normal is None else normal
    v = unit(origin - p)
    total = np.zeros_like(p)
    for i, light in enumerate(world.lights):
        irradiance, to = lamp_at(light, p)
        total += brdf.times_cosine(n, v, to, **given) * irradiance * frame["visibility"][..., i : i + 1]
    return total


LAMPS = {
    "point": Light("point", (1.0, 0.7, 0.4), 5.0, position=(0.3, 1.1, 0.2)),
    "point with range": Light("point", (1.0, 1.0, 1.0), 5.0, position=(0.3, 1.1, 0.2), range=1.8),
    "spot": Light("spot", (0.5, 1.0, 1.0), 9.0, position=(-0.4, 1.5, 0.3), direction=(0.196116, -0.980581, 0.0),
                  inner_cone=0.2, outer_cone=0.6),
    "hard spot": Light("spot", (1.0, 1.0, 1.0), 9.0, position=(0.0, 1.5, 0.0), inner_cone=0.4, outer_cone=0.4),
    "spot with range": Light("spot", (1.0, 1.0, 1.0), 9.0, position=(0.0, 1.5, 0.0), inner_cone=0.0, outer_cone=0.7,
                             range=1.9),
    "sun": sun((0.3, -1, 0.2), 4.0, (1.0, 0.9, 0.8)),
}  # fmt: skip


def material_of(brdf: Brdf, **more: Any) -> Material:
    names = ("metallic", "roughness", "ior", "specular", "clearcoat", "clearcoat_roughness", "transmission")
    fields = {name: float(getattr(brdf, name)) for name in names}
    r, g, b = (float(c) for c in np.broadcast_to(brdf.base_color, 3))
    color = tuple(float(c) for c in np.broadcast_to(brdf.specular_color, 3))
    return Material("given", (r, g, b, 1.0), specular_color=color, **(fields | more))  # type: ignore[arg-type]
