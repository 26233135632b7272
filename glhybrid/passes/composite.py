"""Light, visibility, sky and reflection -> linear radiance."""

from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class Composite:
    name = "composite"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._program = shaders.compute("composite", features)
        self._scene = scene

    def run(self, targets: Targets, ids: Any, visibility: Any, reflection: Any) -> Any:
        radiance = targets.get("radiance")
        resources = {**self._scene.resources, "gbuffer_id": ids, "radiance": radiance}
        if visibility is not None:
            resources["visibility"] = visibility
        if reflection is not None:
            resources["reflection"] = reflection
        self._program.dispatch(resources, targets.size)
        return radiance
