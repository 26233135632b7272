"""Reflections looked up in the G-buffer -> radiance and distance: `ssr`, and `ssr-ray` with rays where that fails.

A hit is shaded from its ids, as seen along the reflected ray, with the light that the shadow pass found there.
Rejected: reading a lit picture. Of the frame before, it lags and has to be reprojected; of this one, it has highlights
and Fresnel as the camera sees them; and the contestants would differ in more than the search.

`ssr-ray` believes only what is certain: a ray that stayed before all that is seen, and then meets the very triangle
that a pixel shows. `ssr` guesses on, as screen-space reflections do: surfaces count as so thick, and rays go on behind
them. Neither sees blended surfaces in the G-buffer: `ssr-ray` looks for them with rays, in `ssr` they do not reflect
and are not reflected.
"""

from typing import Any

from glhybrid.setup import Setup
from glhybrid.targets import Targets


class Ssr:
    """Reflections marched through the G-buffer, for `ssr` and `ssr-ray`. Owns nothing."""

    name = "ssr"

    def __init__(self, setup: Setup) -> None:
        features, settings = setup.features, setup.settings
        self._program = setup.shaders.compute("ssr", features)
        self._scene = setup.scene
        self._reason = features.reason
        key = f"reflections.{settings.reflections}"
        self._uniforms: dict[str, Any] = {"march_steps": settings.parameter(f"{key}.steps")}
        if settings.reflections == "ssr":
            for name in ("thickness", "thickness_m", "fade"):
                self._uniforms[f"march_{name}"] = settings.parameter(f"{key}.{name}")
        else:
            self._uniforms |= {"march_thickness": 0.0, "march_thickness_m": 0.0}

    def run(self, targets: Targets, ids: Any, visibility: Any, screen: dict[str, Any]) -> dict[str, Any]:
        """screen: what ScreenDepth.run gave."""
        reflection = targets.get("reflection")
        resources = {**self._scene.resources, **screen, **self._uniforms, "gbuffer_id": ids}
        resources |= {"out_reflection": reflection}
        if visibility is not None:
            resources["visibility"] = visibility
        if self._reason:
            resources["out_reason"] = targets.get("reason")
        self._program.dispatch(resources, targets.size)
        return {"reflection": reflection}
