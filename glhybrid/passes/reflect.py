"""One mirror ray per pixel, its hit lit with its own shadow rays -> radiance and distance (Kim, section 5).

Fused, one program does it all: nothing is looked up twice, best on a CPU. Split, three do a part each (ray, shadow,
shade): a GPU's traversal then does not carry the registers of the shading code; on an H100 133 frames/s became 164.
Where the program of the ray is small (plan.py), its hit's shadow rays go with it: 4 % of a frame; and the composite
pass shades what was met: 2 %. Where surfaces have textures, that pass gets slower by more than the other takes.
"""

from functools import cached_property
from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Program, Shaders
from glhybrid.targets import Targets


def handed_on(features: Features) -> tuple[str, ...]:
    """Channels by which the programs of a split reflection tell each other what the mirror rays met."""
    optional = {"mirror_instance": features.two_level, "mirror_lit": features.shadow_bits}
    return ("mirror_hit", "mirror_ray", *(name for name, needed in optional.items() if needed))


def programs(features: Features, split: bool) -> tuple[str, ...]:
    """Stems of what runs one after another for one mirror ray."""
    if not split:
        return ("reflect",)
    apart = features.shadow_bits and not features.mirror_shadows
    return ("reflect_ray", *["reflect_shadow"] * apart, "reflect_shade")


class Reflect:
    """The mirror ray of every pixel that sends one, in one program or in parts. Owns nothing."""

    name = "reflect"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features, split: bool = False) -> None:
        self._shaders, self._scene, self._features, self._split = shaders, scene, features, split
        self._images = handed_on(features) if split else ()

    @cached_property
    def _programs(self) -> list[Program]:
        """But for the last one of a split reflection."""
        stems = programs(self._features, self._split)
        return [self._shaders.compute(stem, self._features) for stem in (stems[:-1] if self._split else stems)]

    @cached_property
    def _shade(self) -> Program:
        return self._shaders.compute("reflect_shade", self._features)

    def run(self, targets: Targets, ids: Any, shade: bool = True) -> dict[str, Any]:
        """Returns `reflection` of layout.py, by its channel; of a split one not shaded, what was met (handed_on)."""
        handed = {name: targets.get(name) for name in self._images}
        resources = {**self._scene.resources, **handed, "gbuffer_id": ids}
        if self._features.reason:
            resources["out_reason"] = targets.get("reason")
        programs, results = self._programs, handed
        if shade:
            results = {"reflection": targets.get("reflection")}
            resources["out_reflection"] = results["reflection"]
            programs = [*programs, self._shade] if self._split else programs
        for program in programs:
            program.dispatch(resources, targets.size)
        return results
