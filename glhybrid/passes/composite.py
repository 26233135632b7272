"""Light, visibility, sky and reflection -> linear radiance."""

from collections.abc import Mapping
from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class Composite:
    """The last step of a frame: everything that earlier passes found, put together. Owns nothing."""

    name = "composite"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._program = shaders.compute("composite", features)
        self._scene = scene

    def run(self, targets: Targets, ids: Any, visibility: Any, indirect: Mapping[str, Any]) -> Any:
        """indirect: images by channel: the sky's occlusion, reflections, one a lobe if these are apart."""
        radiance = targets.get("radiance")
        resources = {**self._scene.resources, **indirect, "gbuffer_id": ids, "radiance": radiance}
        if visibility is not None:
            resources["visibility"] = visibility
        self._program.dispatch(resources, targets.size)
        return radiance
