"""GGX-distributed rays per pixel, their hits lit with their own shadow rays -> radiance over albedo, lobe by lobe."""

from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets

RAYS_AT_ONCE = 8  # in an invocation, shadow rays included: llvmpipe ends all its loops at 65,535 turns


class Glossy:
    """Lobes: "reflection" is the base's, "reflection_coat" the clearcoat's, made only where something is coated."""

    name = "glossy"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features, settings: Settings) -> None:
        lobes = {"reflection": features.replace(glossy_coat=False)}
        if features.clearcoat:
            lobes["reflection_coat"] = features.replace(glossy_coat=True, reason=False)
        self._programs = {name: shaders.compute("glossy", lobe) for name, lobe in lobes.items()}
        self._scene, self._features = scene, features
        self._rays = settings.parameter("reflections.ray-glossy.samples")

    @property
    def lobes(self) -> tuple[str, ...]:
        """Channels of the images."""
        return tuple(self._programs)

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        """The image of every lobe, by its channel."""
        resources = {**self._scene.resources, "gbuffer_id": ids, "rays": self._rays}
        if self._features.reason:
            resources["out_reason"] = targets.get("reason")
        shadow_rays = len(self._scene.lights) if self._features.shadow_rays else 0
        at_once = max(1, RAYS_AT_ONCE // (1 + shadow_rays + self._features.sky_samples))
        for lobe, program in self._programs.items():
            resources["out_reflection"] = targets.get(lobe)
            if self._features.denoise:
                resources["out_noise"] = targets.get(f"{lobe}_noise")
            for first in range(0, self._rays, at_once):
                resources |= {"ray_first": first, "ray_end": min(first + at_once, self._rays)}
                program.dispatch(resources, targets.size)
        return {lobe: targets.get(lobe) for lobe in self._programs}
