"""Ambient occlusion from the G-buffer, by horizons (GTAO) -> the open share of each pixel's sky.

It sees what the camera sees: nothing off the screen or behind something occludes, and everything is as thick as it is
deep. Points and planes are exact, as those of `ssr`; noise of the slices is averaged over 5 x 5 pixels of one plane.
"""

from typing import Any

from glhybrid.setup import Setup
from glhybrid.targets import Targets


class Ssao:
    """Ambient occlusion by the horizons of the G-buffer. Owns nothing."""

    name = "ssao"
    channel = "occlusion"

    def __init__(self, setup: Setup) -> None:
        features, settings = setup.features, setup.settings
        self._planes = setup.shaders.compute("screen_plane", features)
        self._program = setup.shaders.compute("ssao", features)
        self._filter = setup.shaders.compute("ssao_filter", features)
        self._scene, self._reason = setup.scene, features.reason_ao
        given = {name: settings.parameter(f"ao.ssao.{name}") for name in ("radius", "slices", "steps")}
        self._uniforms = {"ao_radius": given["radius"], "slices": given["slices"], "steps": given["steps"]}

    def run(self, targets: Targets, ids: Any) -> Any:
        """Returns `occlusion` of layout.py."""
        plane, raw, occlusion = (targets.get(name) for name in ("screen_plane", "occlusion_raw", "occlusion"))
        resources = {**self._scene.resources, **self._uniforms, "gbuffer_id": ids, "screen_plane": plane}
        self._planes.dispatch({**resources, "out_plane": plane}, targets.size)
        told = {"out_reason_ao": targets.get("reason_ao")} if self._reason else {}
        self._program.dispatch({**resources, **told, "out_occlusion": raw}, targets.size)
        self._filter.dispatch({**resources, "occlusion_raw": raw, "out_occlusion": occlusion}, targets.size)
        return occlusion
