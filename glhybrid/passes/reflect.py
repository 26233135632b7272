"""One mirror ray per pixel, its hit lit with its own shadow rays -> radiance and distance (Kim, section 5)."""

from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class Reflect:
    name = "reflect"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._program = shaders.compute("reflect", features)
        self._scene = scene
        self._reason = features.reason

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        reflection = targets.get("reflection")
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_reflection": reflection}
        if self._reason:
            resources["out_reason"] = targets.get("reason")
        self._program.dispatch(resources, targets.size)
        return {"reflection": reflection}
