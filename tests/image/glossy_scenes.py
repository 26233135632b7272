"""Scenes whose glossy reflections the reference and `ray-glossy` agree on: no diffuse light passes from thing to thing."""

from typing import TYPE_CHECKING, Any

import numpy as np
from compare import Noisy
from scene_kit import box, floor, metal, scene

from glhybrid.scene import Camera, Environment, Material, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer

SIZE = (160, 120)


def painted(r: float, g: float, b: float) -> Material:
    """One radiance from everywhere: what a reflection shows of it is the same in every model."""
    return Material("painted", (r, g, b, 1.0), unlit=True, double_sided=True)


def smooth_sky() -> Environment:
    """Bright above, warmer to one side, without a sun."""
    height, width = 64, 128
    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    up = (np.cos(theta)[:, None] * np.ones(width))[..., None]
    right = (np.sin(theta)[:, None] * np.sin(phi))[..., None]
    radiance = 0.55 + 0.45 * up * np.array([0.2, 0.5, 1.0]) + 0.15 * right * np.array([1.0, 0.6, 0.2])
    return Environment((1.35 * np.maximum(radiance, 0.05)).astype(np.float32))


def things(material: Material, **extra: Any) -> Scene:
    """A floor of the material under a box, a thin post and a ball. At roughness 0.25 a mirror ray mixed with the sky
    by roughness is 4 % too bright over the picture, 8 % over what it has of the floor."""
    parts = [
        (floor(4.0), material), (box((-0.5, 0, -0.5), (0.5, 1.3, 0.5)), painted(0.35, 0.08, 0.05), (-0.9, 0, -0.3)),
        (box((-0.06, 0, -0.06), (0.06, 1.8, 0.06)), painted(0.05, 0.05, 0.06), (0.1, 0, 0.2)),
        (Sphere(0.5), painted(0.1, 0.2, 0.4), (1.0, 0.5, -0.1)),
    ]  # fmt: skip
    camera = Camera.look_at((0.4, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44))
    return scene(parts, camera, **({"environment": smooth_sky()} | extra))


def metal_floor(roughness: float) -> Scene:
    return things(metal((0.95, 0.93, 0.9), roughness))


def draw(renderer: "Renderer", world: Scene, samples: int = 4, *aovs: str, size: Any = SIZE, **settings: Any) -> Any:
    """One frame by `ray-glossy`; parameters without their prefix."""
    parameters = {"samples": samples} | settings.pop("parameters", {})
    given = {name if "." in name else f"reflections.ray-glossy.{name}": value for name, value in parameters.items()}
    chosen = Settings(**({"aa": 1, "reflections": "ray-glossy"} | settings), parameters=given)
    return renderer.render(world, size=size, settings=chosen, aovs=aovs)


def batches(renderer: "Renderer", world: Scene, count: int, **given: Any) -> Noisy:
    """Mean and variance of `count` frames under seeds of their own."""
    total: NDArray[np.float64] | float = 0.0
    square: NDArray[np.float64] | float = 0.0
    for seed in range(count):
        values = draw(renderer, world, seed=seed, **given)["radiance"].astype(np.float64)
        total, square = total + values, square + values**2
    mean = np.asarray(total) / count
    return Noisy(mean, np.maximum(np.asarray(square) / count - mean**2, 0) / (count - 1))
