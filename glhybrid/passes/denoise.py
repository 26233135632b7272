"""Filters noisy images over time and space: soft shadows light by light, the open sky, glossy reflections lobe by lobe.

One guide a frame (normals, depths, ids, roughness); then for each signal one dispatch that gathers what earlier frames
know and, of few rays over a lobe, what those of neighbours met (lib/reuse.glsl); one that finds how bright it is about
each pixel; and a few of a wavelet filter that compares pixels by that. A signal's images are made at its first use.

Chosen: exact counts of samples and their measured variance steer everything, so that a converged image passes through
unchanged. Rejected: a fixed blend factor and blur radii by roughness alone, which blur what needs no filter; pixels
compared by their own few samples, which leaves the rarest of these as specks and edges torn; a lobe's footprint taken
for round, which at a slant blurs it across by twice its width.
"""

from math import tan
from typing import Any

from glhybrid.scene import Light
from glhybrid.setup import Setup
from glhybrid.targets import Targets

SIGNALS = {"reflection": 1, "reflection_coat": 2, "visibility": 3, "occlusion": 4}  # as in lib/denoise.glsl
# By how many standard deviations history may be off what is seen: what chance explains; where lights have changed, and
# so most of it is no chance.
TOLERANCE, RELIT = 3.0, 0.3
KEYS = {"visibility": "shadows.ray-soft", "occlusion": "ao.ray"}  # of others: reflections.ray-glossy


class Denoise:
    """Owns no image: those of the frame before are exchanged by name with each frame."""

    name = "denoise"

    def __init__(self, setup: Setup) -> None:
        shaders, scene, features = setup.shaders, setup.scene, setup.features
        self._scene, self._features, self._settings = scene, features, setup.settings
        self._guide = shaders.compute("denoise_guide", features)
        wanted = ["visibility"] * features.denoise_shadows + ["occlusion"] * features.denoise_occlusion
        if features.denoise:
            wanted += ["reflection"] + ["reflection_coat"] * features.clearcoat
        self._programs, self._reuses = {}, {}
        for signal in wanted:
            reuse = features.reuse if signal == "reflection" else features.reuse_coat and signal == "reflection_coat"
            self._reuses[signal] = reuse
            named = features.replace(denoise_signal=SIGNALS[signal], reuse=reuse)
            self._programs[signal] = (
                shaders.compute("denoise_temporal", named),
                shaders.compute("denoise_level", named),
                shaders.compute("denoise_atrous", named),
                shaders.compute("denoise_atrous", named.replace(denoise_last=True)),
            )
        self._odd = self._relit = False
        self._lit: tuple[Any, object] | None = None  # lights and sky of the frame before
        self._lights: dict[int, Light] = {}  # those with a size, as they were a frame ago
        self._sized = [i for i, light in enumerate(scene.lights) if light.has_size]

    def begin(self, targets: Targets, ids: Any, sky: object) -> None:
        """The guide of this frame; the one before becomes history, with all images of its signals.

        sky: what is equal as long as the environment is.
        """
        self._odd = not self._odd
        before, self._lit = self._lit, (self._scene.lights, sky)
        self._relit = before is not None and (before[0] is not self._lit[0] or before[1] != sky)
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_guide": targets.get(self._now("guide"))}
        if self._features.moving:
            resources["out_moved"] = targets.get("denoise_moved")
        self._guide.dispatch(resources, targets.size)

    def visibility(self, targets: Targets, image: Any) -> None:
        """Filters the layers of lights with a size, in place."""
        for light in self._sized if "visibility" in self._programs else ():
            now = self._scene.lights[light]
            was = self._lights.get(light, now)
            self._lights[light] = now
            more = {"layer": light, "light_moved": _moved(was, now)}
            self._filter(targets, "visibility", image, more)

    def indirect(self, targets: Targets, images: dict[str, Any]) -> None:
        """Filters the open share of the sky and every lobe's image, in place."""
        for signal in images.keys() & self._programs.keys():
            noise = {} if signal == "occlusion" else {"noise": targets.get(f"{signal}_noise")}
            self._filter(targets, signal, images[signal], noise)

    def _now(self, name: str, before: bool = False) -> str:
        return f"{name}_odd" if self._odd != before else f"{name}_even"

    def _drifts(self, signal: str) -> bool:
        return self._features.moving and signal != "occlusion"

    def _parameter(self, signal: str, name: str) -> Any:
        return self._settings.parameter(f"{KEYS.get(signal, 'reflections.ray-glossy')}.{name}")

    def _filter(self, targets: Targets, signal: str, image: Any, more: dict[str, Any]) -> None:
        layers = len(self._scene.lights) if signal == "visibility" else 0

        counts = "counts_moving" if self._drifts(signal) else "counts"

        def get(part: str, before: bool = False) -> Any:
            return targets.get(self._now(f"{signal}_{part}", before), layers=layers)

        temporal, level, step, last = self._programs[signal]
        ping, pong = targets.get("denoise_ping"), targets.get("denoise_pong")
        resources = {
            **self._scene.resources, **more, "guide": targets.get(self._now("guide")),
            "guide_before": targets.get(self._now("guide", before=True)), "signal": image,
            "history": get("history", before=True), "counts": get(counts, before=True),
            "level_before": get("level", before=True),
            "out_history": get("history"), "out_counts": get(counts), "out_filtered": ping,
            "history_frames": float(self._parameter(signal, "history")),
            "samples": float(self._parameter(signal, "samples")),
            "tolerance": RELIT if self._relit and signal.startswith("reflection") else TOLERANCE,
        }  # fmt: skip
        if self._reuses[signal]:
            resources["rays"] = targets.get(f"{signal}_rays", layers=self._parameter(signal, "samples"))
        if self._features.moving:
            resources["moved"] = targets.get("denoise_moved")
        if self._drifts(signal):
            resources["drift"] = targets.get(f"{signal}_drift", layers=layers)
        temporal.dispatch(resources, targets.size)
        resources["history"], resources["out_signal"] = get("history"), image
        level.dispatch(resources | {"filtered": ping, "out_level": get("level")}, targets.size)
        resources |= {"level": get("level"), "counts": get(counts)}
        count = self._parameter(signal, "iterations")
        for i in range(count):
            resources |= {"filtered": ping, "out_filtered": pong, "stride": 1 << i}
            (last if i == count - 1 else step).dispatch(resources, targets.size)
            ping, pong = pong, ping


def _moved(was: Light, now: Light) -> tuple[float, float, float, float]:
    """How far a light has come, m or of its direction, and by how much it has grown, as its size is in layout Light."""
    if was is now:
        return 0.0, 0.0, 0.0, 0.0
    sun = now.kind == "directional"
    a, b = (x.direction if sun else x.position for x in (was, now))
    grown = tan(now.angular_diameter / 2) - tan(was.angular_diameter / 2) if sun else now.radius - was.radius
    return b[0] - a[0], b[1] - a[1], b[2] - a[2], grown
