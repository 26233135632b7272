"""GGX-distributed rays per pixel, their hits lit with their own shadow rays -> radiance over albedo, lobe by lobe.

Fused or split as `reflect` is (passes/reflect.py): split, each ray takes a dispatch of three programs.
"""

from typing import Any

from glhybrid.emitters import emitter_rows
from glhybrid.passes.reflect import handed_on
from glhybrid.setup import Setup
from glhybrid.targets import Targets

RAYS_AT_ONCE = 8  # in an invocation, shadow rays included: llvmpipe ends all its loops at 65,535 turns


class Glossy:
    """Lobes: "reflection" is the base's, "reflection_coat" the clearcoat's, made only where something is coated."""

    name = "glossy"

    def __init__(self, setup: Setup) -> None:
        shaders, scene, features, split = setup.shaders, setup.scene, setup.features, setup.plan.split
        self._emitters: Any = None
        self.emissive_weight = 0.0  # for the frame's constants
        if features.emitters:
            rows, self.emissive_weight = emitter_rows(scene.geometry)
            features = features.replace(emitters=len(rows) > 0)
            if len(rows):
                self._emitters = setup.context.gl.buffer(rows.tobytes())
        lobes = {"reflection": features.replace(glossy_coat=False)}
        if features.clearcoat:
            lobes["reflection_coat"] = features.replace(glossy_coat=True, reason=False, reuse=features.reuse_coat)
        apart = features.shadow_bits and not features.mirror_shadows
        self._reuses = {name: lobe.reuse for name, lobe in lobes.items()}
        stems = ["glossy_ray", *["reflect_shadow"] * apart, "glossy_shade"] if split else ["glossy"]
        self._programs = {name: [shaders.compute(stem, lobe) for stem in stems] for name, lobe in lobes.items()}
        self._handed_on = handed_on(features) if split else ()
        self._scene, self._features = scene, features
        self._rays = setup.settings.parameter("reflections.ray-glossy.samples")
        shadow_rays = len(scene.lights) if features.shadow_rays else 0
        self._at_once = (
            1 if split else max(1, RAYS_AT_ONCE // (1 + shadow_rays + features.sky_samples + features.emitters))
        )

    @property
    def lobes(self) -> tuple[str, ...]:
        """Channels of the images."""
        return tuple(self._programs)

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        """The image of every lobe, by its channel."""
        resources = {**self._scene.resources, "gbuffer_id": ids, "rays": self._rays}
        if self._features.reason:
            resources["out_reason"] = targets.get("reason")
        if self._emitters is not None:
            resources["Emitters"] = self._emitters
        resources |= {name: targets.get(name) for name in self._handed_on}
        for lobe, programs in self._programs.items():
            resources["out_reflection"] = targets.get(lobe)
            if self._features.denoise:
                resources["out_noise"] = targets.get(f"{lobe}_noise")
            if self._features.denoise and self._features.moving:
                resources["out_drift"] = targets.get(f"{lobe}_drift")
            if self._reuses[lobe]:
                resources["out_rays"] = targets.get(f"{lobe}_rays", layers=self._rays)
            for first in range(0, self._rays, self._at_once):
                resources |= {"ray_first": first, "ray_end": min(first + self._at_once, self._rays)}
                for program in programs:
                    program.dispatch(resources, targets.size)
        return {lobe: targets.get(lobe) for lobe in self._programs}

    def release(self) -> None:
        """Frees the table of what shines."""
        if self._emitters is not None:
            self._emitters.release()
            self._emitters = None
