"""Any-hit rays to the disc of every light that has a size -> visibility with penumbras, a layer a light."""

from typing import Any

from glhybrid.setup import Setup
from glhybrid.targets import Targets

RAYS_AT_ONCE = 8  # in an invocation: llvmpipe ends all its loops at 65,535 turns


class ShadowSoft:
    """resources: what lib/shade.glsl reads, for passes that light hits and layers."""

    name = "shadow_soft"
    channel = "visibility_soft"

    def __init__(self, setup: Setup) -> None:
        features, settings = setup.features, setup.settings
        self._program = setup.shaders.compute("shadow_soft", features)
        self._scene = setup.scene
        self._drifts = features.moving and features.denoise_shadows
        self._rays = settings.parameter("shadows.ray-soft.samples")
        self.resources = {"disc_rays": settings.parameter("shadows.ray-soft.hit_samples")}

    def run(self, targets: Targets, ids: Any, set_lights: Any) -> Any:
        """set_lights(first, end) says which lights the next dispatch is for."""
        count = len(self._scene.lights)
        visibility = targets.get(self.channel, layers=count)
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_visibility": visibility, "rays": self._rays}
        if self._drifts:
            resources["out_drift"] = targets.get("visibility_drift", layers=count)
        lights = max(1, RAYS_AT_ONCE // self._rays)
        for first in range(0, count, lights):
            end = min(first + lights, count)
            if count > lights or first:
                set_lights(first, end)
            sized = any(light.has_size for light in self._scene.lights[first:end])
            for ray in range(0, self._rays if sized else 1, RAYS_AT_ONCE):
                resources |= {"ray_first": ray, "ray_end": min(ray + RAYS_AT_ONCE, self._rays)}
                self._program.dispatch(resources, targets.size)
        return visibility
