"""Camera and shadow rays of a pixel in one program -> ids and visibility, in place of `gbuffer` and `shadow`.

A GPU then finds the point of a pixel once and does not run empty in between: 6 % of a frame of mirrors at 260 k
triangles on an H100, 1 % of Sponza. With the mirror ray in the same program as well, frames took twice as long there.
"""

from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class Rays:
    """Owns nothing."""

    name = "rays"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._program = shaders.compute("rays", features)
        self._scene = scene

    def run(self, targets: Targets) -> tuple[Any, Any]:
        """Returns the ids, gbuffer_id of layout.py, and the visibility, a layer a light."""
        ids, visibility = targets.get("gbuffer_id"), targets.get("visibility", layers=len(self._scene.lights))
        resources = {**self._scene.resources, "out_id": ids, "out_visibility": visibility}
        self._program.dispatch(resources, targets.size)
        return ids, visibility
