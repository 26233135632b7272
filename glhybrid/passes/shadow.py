"""One any-hit ray per pixel and light -> visibility, a layer a light (Kim, section 4)."""

from functools import cached_property
from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Program, Shaders
from glhybrid.targets import Targets

LIGHTS_AT_ONCE = 8  # in a dispatch: llvmpipe ends all loops of an invocation at 65,535 turns, rays included


class Shadow:
    """Any-hit rays from what the camera sees to every light. Owns nothing."""

    name = "shadow"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._shaders, self._scene, self._features = shaders, scene, features
        self.channel = "visibility_tint" if features.blended else "visibility"

    @cached_property
    def _program(self) -> Program:
        return self._shaders.compute("shadow", self._features)

    def run(self, targets: Targets, ids: Any, set_lights: Any, wait: bool = True) -> Any:
        """set_lights(first, end) says which lights the next dispatch is for. wait: as Program.dispatch has it."""
        count = len(self._scene.lights)
        visibility = targets.get(self.channel, layers=count)
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_visibility": visibility}
        for first in range(0, count, LIGHTS_AT_ONCE):
            if count > LIGHTS_AT_ONCE or first:
                set_lights(first, min(first + LIGHTS_AT_ONCE, count))
            self._program.dispatch(resources, targets.size, wait=wait)
        return visibility
