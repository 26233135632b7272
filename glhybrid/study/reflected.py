"""What a reflection shows: the right object, at the right distance? Asked with a scene in which every object shines in
a colour of its own and nothing else does, so that the colour at a mirror says what is seen in it, whatever made it.

Held against exact mirror rays in the same scene.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Instance, Material, Scene
from glhybrid.settings import Settings

SMOOTH = 0.3  # roughness up to which a surface is looked at: what rougher ones show has no outline
LEVELS = 8  # of each channel of a code: 511 objects, then codes come again
EXACT = Settings(shadows="none", reflections="ray-lerp", aa=1)
KEPT = ("normal", "base_color")  # textures that decide directions and holes


@dataclass(frozen=True)
class Shown:
    """right_object_percent: of smooth pixels, those that show what is there. distance_error_percent: of
    those on an object, median error of its distance along the ray; None where the technique tells no distance."""

    right_object_percent: float
    distance_error_percent: float | None


@dataclass(frozen=True, eq=False)
class Mirrors:
    """A coded scene, what its mirrors truly show, and which pixels count."""

    scene: Scene
    camera: Camera
    size: tuple[int, int]
    counted: NDArray[np.bool_]
    colour: F32
    distance: F32

    def ask(self, renderer: Renderer, settings: Settings) -> Shown:
        """What a technique shows of it; shadows have no say."""
        aovs = ("reflection", "reflection_hit")
        frame = renderer.render(self.scene, self.camera, self.size, settings.replace(shadows="none"), aovs=aovs)
        off = np.abs(frame["reflection"] - self.colour).max(-1)
        right = self.counted & (off < 0.25 / LEVELS)
        percent = 100 * float(right.sum()) / max(int(self.counted.sum()), 1)
        got, want = frame["reflection_hit"], self.distance
        told = right & np.isfinite(want) & np.isfinite(got) & (got > 0) & (want > 0)
        if not told.any():
            return Shown(percent, None)
        return Shown(percent, 100 * float(np.median(np.abs(got[told] - want[told]) / want[told])))


def find(renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int]) -> Mirrors | None:
    """None where no surface that the camera sees is smooth enough."""
    plain = Settings(shadows="none", reflections="none", aa=1)
    seen = renderer.render(scene, camera, size, plain, aovs=("roughness", "instance_id"))
    counted = (seen["instance_id"] != 0xFFFFFFFF) & (seen["roughness"] <= SMOOTH)
    if not counted.any():
        return None
    marked = coded(scene)
    truth = renderer.render(marked, camera, size, EXACT, aovs=("reflection", "reflection_hit"))
    counted &= truth["reflection_hit"] > 0
    return Mirrors(marked, camera, size, counted, truth["reflection"], truth["reflection_hit"])


def coded(scene: Scene) -> Scene:
    """Every object a mirror that shines in its code; no lights, no sky."""
    materials: list[Material] = []
    instances: list[Instance] = []
    for number, instance in enumerate(scene.instances):
        pieces = scene.meshes[instance.mesh].primitives
        chosen = instance.materials or tuple(p.material for p in pieces)
        rows = []
        for row in chosen:
            old = scene.materials[row]
            rows.append(len(materials))
            materials.append(
                replace(
                    old, base_color=(1.0, 1.0, 1.0, old.base_color[3]), metallic=1.0, roughness=0.0, unlit=False,
                    emissive=code(number), clearcoat=0.0, transmission=0.0,
                    textures={slot: t for slot, t in old.textures.items() if slot in KEPT},
                )
            )  # fmt: skip
        instances.append(replace(instance, materials=tuple(rows)))
    return scene.replace(
        lights=(), environment=None, materials=tuple(materials) or scene.materials, instances=tuple(instances)
    )


def code(number: int) -> tuple[float, float, float]:
    """A colour that no neighbour shares; black is the sky's."""
    n = number % (LEVELS**3 - 1) + 1
    return n % LEVELS / LEVELS, n // LEVELS % LEVELS / LEVELS, n // LEVELS**2 / LEVELS
