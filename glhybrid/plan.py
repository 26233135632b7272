"""What will run for a scene, settings and device, and why: decided here, carried out by renderer.py, printable."""

from dataclasses import dataclass
from typing import Any

from glhybrid import needs
from glhybrid.geometry import choose_levels
from glhybrid.needs import Features
from glhybrid.scene import Scene
from glhybrid.settings import Settings


@dataclass(frozen=True)
class Plan:
    """passes: names in order. reasons: one sentence a decision. skipped: what was left out, and why."""

    features: Features
    levels: int
    primary: str  # raster or trace
    passes: tuple[str, ...]
    reasons: tuple[str, ...]
    skipped: tuple[str, ...]


def make(scene: Scene, settings: Settings, *, software: bool = True, clip_control: bool = True) -> Plan:
    """The plan on a device. software: a CPU rasteriser, where loops run to their end instead of in bounded turns."""
    found = needs.find(scene, settings)
    levels, why = choose_levels(scene, settings.levels)
    reference = settings.reflections == "reference"
    primary = settings.primary if settings.primary != "auto" else ("raster" if software else "trace")
    reasons = [f"{levels} level{'s' if levels > 1 else ''} of trees: {why}"]
    if settings.primary == "auto":
        reasons.append(
            "primary visibility is rasterised: a CPU rasterises faster than it traces" if software
            else "primary visibility is traced: compute reaches a GPU's memory faster than its raster units"
        )  # fmt: skip
    features = found.features.replace(
        two_level=levels == 2, clip_control=clip_control, bvh_inner_steps=1 << 20 if software else 3, software=software
    )
    passes = ["gbuffer"]
    if reference:
        passes.append("reference")
    else:
        passes += ["shadow"] * features.visibility + ["reflect"] * features.reflections + ["composite"]
    passes.append("display")
    return Plan(features, levels, primary, tuple(passes), tuple(reasons), found.skipped)


def describe(scene: Scene, settings: Settings, size: tuple[int, int] = (1280, 720)) -> dict[str, Any]:
    """The plan as the command line prints it, without a device: passes, reasons, what is skipped, features in use."""
    plan = make(scene, settings)
    on = [name for name, value in plan.features.defines().items() if name.startswith("USE_") and value]
    return {
        "scene": scene.name,
        "triangles": scene.triangle_count(),
        "instances": len(scene.instances),
        "lights": len(scene.lights),
        "size": list(size),
        "levels": plan.levels,
        "primary": plan.primary,
        "passes": list(plan.passes),
        "reasons": list(plan.reasons),
        "features": [name.removeprefix("USE_").lower() for name in on],
        "skipped": list(plan.skipped),
    }
