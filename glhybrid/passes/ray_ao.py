"""Ambient occlusion by cosine-weighted any-hit rays of a limited length -> the open share of each pixel's sky."""

from typing import Any

from glhybrid.setup import Setup
from glhybrid.targets import Targets

RAYS_AT_ONCE = 8  # of an invocation: llvmpipe ends all its loops at 65,535 turns


class RayAo:
    """Ambient occlusion by rays, which know what the camera does not see. Owns nothing."""

    name = "ray_ao"

    def __init__(self, setup: Setup) -> None:
        features, settings = setup.features, setup.settings
        self._program = setup.shaders.compute("ray_ao", features)
        self._scene = setup.scene
        self.channel = "occlusion_rays" if features.denoise_occlusion else "occlusion"
        self._rays = settings.parameter("ao.ray.samples")
        self._radius = settings.parameter("ao.ray.radius")

    def run(self, targets: Targets, ids: Any) -> Any:
        """Returns the image of `channel`."""
        occlusion = targets.get(self.channel)
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_occlusion": occlusion}
        resources |= {"rays": self._rays, "ao_radius": self._radius}
        for first in range(0, self._rays, RAYS_AT_ONCE):
            ends = {"ray_first": first, "ray_end": min(first + RAYS_AT_ONCE, self._rays)}
            self._program.dispatch(resources | ends, targets.size)
        return occlusion
