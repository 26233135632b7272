"""Light, visibility, sky and reflection -> linear radiance; on a GPU also encoded, if the exposure is given."""

from collections.abc import Mapping
from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.passes.display import Display
from glhybrid.shaders import Program, Shaders
from glhybrid.targets import Targets


class Composite:
    """The last step of a frame: everything that earlier passes found, put together. Owns nothing."""

    name = "composite"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features, display: Display) -> None:
        self._shaders, self._scene, self._features, self._display = shaders, scene, features, display
        self._programs: dict[bool, Program] = {}  # by whether it encodes too
        self._program(features.encodes and display.given)

    def _program(self, encodes: bool) -> Program:
        if encodes not in self._programs:
            self._programs[encodes] = self._shaders.compute("composite", self._features.replace(encodes=encodes))
        return self._programs[encodes]

    def run(self, targets: Targets, ids: Any, visibility: Any, indirect: Mapping[str, Any]) -> Any:
        """indirect: images by channel: the sky's occlusion, reflections, one a lobe if these are apart."""
        radiance, encodes = targets.get("radiance"), self._features.encodes and self._display.given
        program = self._program(encodes)
        resources = {**self._scene.resources, **indirect, "gbuffer_id": ids, "radiance": radiance}
        if visibility is not None:
            resources["visibility"] = visibility
        if encodes:
            resources |= self._display.resources(targets)
        program.dispatch(resources, targets.size)
        if encodes:
            self._display.encoded(radiance)
        return radiance
