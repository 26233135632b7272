"""What is true of a scene's shadows, by rays alone: how much of each light arrives, and what it would bring unblocked.

A light with a size is replaced by hard ones spread over it, each traced: the mean of their answers is the share of the
light that is seen. This shares no code with any technique that filters or denoises.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glhybrid.renderer import Renderer
from glhybrid.scene import F32, F64, Camera, Light, Scene
from glhybrid.settings import Settings

MOST_LIGHTS = 16  # each needs a picture of its own
AT_ONCE = 16  # points of a light
HARD = Settings(shadows="ray", reflections="none", aa=1)


@dataclass(frozen=True, eq=False)
class Direct:
    """Direct light at the first surfaces. visibility (H, W, L), 0 to 1: the share of each light that arrives;
    unblocked (L, H, W, 3): the radiance it gives where all of it arrives; lights: their rows in Scene.lights."""

    visibility: F32
    unblocked: F32
    lights: tuple[int, ...]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(H, W, L): where a light brings anything if nothing is in its way."""
        return np.moveaxis(self.unblocked.max(-1) > 0, 0, -1)

    def direct(self, visibility: F32) -> F32:
        """(H, W, 3): the direct light that a visibility (H, W, L of the whole scene) lets through."""
        return np.einsum("hwl,lhwc->hwc", visibility[..., list(self.lights)], self.unblocked, dtype=np.float32)

    def truth(self) -> F32:
        """(H, W, 3) radiance: each light's, times the share of it that arrives."""
        return np.einsum("hwl,lhwc->hwc", self.visibility, self.unblocked, dtype=np.float32)


def find(renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int], points: int = 32) -> Direct:
    """points: of each light with a size. Only the MOST_LIGHTS strongest lights count."""
    strength = [max(light.color) * light.intensity for light in scene.lights]
    chosen = tuple(sorted(sorted(range(len(strength)), key=lambda i: -strength[i])[:MOST_LIGHTS]))
    visibility = np.stack([_arriving(renderer, scene, camera, size, scene.lights[i], points) for i in chosen], -1)
    dark = tuple(
        replace(m, emissive=(0.0, 0.0, 0.0), base_color=(0, 0, 0, m.base_color[3]) if m.unlit else m.base_color)
        for m in scene.materials
    )
    bare = scene.replace(environment=None, materials=dark)
    off = HARD.replace(shadows="none")
    unblocked = [
        renderer.render(bare.replace(lights=(scene.lights[i],)), camera, size, off)["radiance"] for i in chosen
    ]
    return Direct(visibility, np.stack(unblocked), chosen)


def _arriving(
    renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int], light: Light, points: int
) -> F32:
    """(H, W) the share of a light that is seen, AT_ONCE of its points after another: each has an image."""
    lamps = spread_over(light, points)
    total = np.zeros((size[1], size[0]), np.float32)
    for first in range(0, len(lamps), AT_ONCE):
        some = scene.replace(lights=tuple(lamps[first : first + AT_ONCE]))
        total += renderer.render(some, camera, size, HARD, aovs=("visibility",))["visibility"].sum(-1)
    return total / np.float32(len(lamps))


def spread_over(light: Light, points: int) -> list[Light]:
    """Hard lights that stand for one with a size: equal parts of its disc as any receiver sees it.

    A sun's disc is sampled as it is. A lamp's faces every receiver, so its points fill a ball with the density that
    looks like an even disc from everywhere: 1 / sqrt(R^2 - r^2).
    """
    hard = replace(light, angular_diameter=0.0, radius=0.0)
    if light.kind == "directional":
        if light.angular_diameter <= 0:
            return [hard]
        axis = np.asarray(light.direction, np.float64)
        u, v = _basis(axis)
        disc = np.tan(light.angular_diameter / 2) * _disc(points)
        around = axis + disc[:, :1] * u + disc[:, 1:] * v
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        return [replace(hard, direction=tuple(d)) for d in around.tolist()]
    if light.radius <= 0:
        return [hard]
    places = np.asarray(light.position, np.float64) + light.radius * _ball(points)
    return [replace(hard, position=tuple(p)) for p in places.tolist()]


def _basis(axis: F64) -> tuple[F64, F64]:
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)


def _disc(points: int) -> F64:
    """(N, 2) in the unit disc, evenly: Vogel's spiral."""
    k = np.arange(points)
    radius, angle = np.sqrt((k + 0.5) / points), k * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)


def _ball(points: int) -> F64:
    """(N, 3) in the unit ball, density proportional to 1 / sqrt(1 - r^2): its shadow on any plane is an even disc.

    The radius' distribution function is (2 / pi) (asin r - r sqrt(1 - r^2)), inverted here by a table.
    """
    k = np.arange(points)
    table = np.linspace(0, 1, 4097)
    share = 2 / np.pi * (np.arcsin(table) - table * np.sqrt(1 - table**2))
    radius = np.interp((k * 0.7548776662466927 + 0.5) % 1, share, table)
    z = 1 - 2 * (k + 0.5) / points
    angle = k * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - z**2)
    return radius[:, None] * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1)
