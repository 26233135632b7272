"""One mirror ray per pixel, its hit lit with its own shadow rays -> radiance and distance (Kim, section 5).

Fused, one program does it all: nothing is looked up twice, best on a CPU. Split, three do a part each (ray, shadow,
shade): a GPU's traversal then does not carry the registers of the shading code; on an H100 133 frames/s became 164.
Where the program of the ray is small (plan.py), its hit's shadow rays go with it: 4 % of a frame.
"""

from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets

_HANDED_ON = ("mirror_hit", "mirror_ray")


class Reflect:
    """The mirror ray of every pixel that sends one, in one program or three. Owns nothing."""

    name = "reflect"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features, split: bool = False) -> None:
        stems = ["reflect"]
        self._images = ["reason"] if features.reason else []
        if split:
            apart = features.shadow_bits and not features.mirror_shadows
            stems = ["reflect_ray", *["reflect_shadow"] * apart, "reflect_shade"]
            self._images += [*_HANDED_ON, *["mirror_lit"] * features.shadow_bits]
        self._programs = [shaders.compute(stem, features) for stem in stems]
        self._scene = scene

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        """Returns `reflection` of layout.py, by its channel."""
        reflection = targets.get("reflection")
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_reflection": reflection}
        for name in self._images:
            resources["out_reason" if name == "reason" else name] = targets.get(name)
        for program in self._programs:
            program.dispatch(resources, targets.size)
        return {"reflection": reflection}
