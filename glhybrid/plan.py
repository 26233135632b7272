"""What will run for a scene, settings and device, and why: decided here, carried out by frame.py, printable."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from glhybrid import kernels, needs, techniques
from glhybrid.bvh.blas import SMALL
from glhybrid.deform import at_time
from glhybrid.errors import SettingError
from glhybrid.layout import CONSTANTS
from glhybrid.levels import builds_on_gpu, choose_levels
from glhybrid.motion import Motion, wanted
from glhybrid.needs import Features
from glhybrid.scene import Scene
from glhybrid.settings import Settings
from glhybrid.tuning import VISIBILITY, Tuning, rule

if TYPE_CHECKING:
    from glhybrid.image import Frame


JOINED_LIGHTS = 8  # asked in one program: as in passes/shadow.py


@dataclass(frozen=True)
class Plan:
    """What runs: made by make(), carried out by frame.py, in the receipt as `plan`.

    levels: 1 or 2, of trees. passes: names in order. reasons: one sentence a decision. skipped: what was left out, and
    why, a sentence each.
    """

    features: Features
    levels: int
    trees: bool  # something sends rays
    primary: str  # raster or trace
    split: bool  # reflections in several programs
    joined: bool  # camera and shadow rays in one, as long as the view is not rasterised
    passes: tuple[str, ...]
    reasons: tuple[str, ...]
    skipped: tuple[str, ...]


def make(
    scene: Scene,
    settings: Settings,
    *,
    software: bool = True,
    clip_control: bool = True,
    motion: Motion | None = None,
    tuning: Tuning | None = None,
    size: tuple[int, int] = (1280, 720),
) -> Plan:
    """The plan on a device. software: a CPU rasteriser; tuning: what the device is good at, default the rule of thumb.

    motion: what moves; scene is then its start. size: pixels, which the choice between raster and rays depends on.
    """
    tuning = tuning or rule(software)
    found = needs.find(scene, settings)
    if found.features.lightmap and motion is not None and not motion.still:
        raise SettingError(
            f'shadows = baked: clip "{motion.clip.name}" moves things, and light maps hold for what stands still: '
            "leave out time, clip and frames, or take shadows = ray"
        )
    levels, why = 2, "what moves does not rebuild the rest"
    if motion is None:
        levels, why = choose_levels(scene, settings.levels, software)
    reference = settings.reflections == "reference"
    primary: str = settings.primary
    why_primary = ""
    if primary == "auto":
        primary, why_primary = tuning.primary(size[0] * size[1], scene.triangle_count())
    trees = bool(scene.instances) and (primary == "trace" or _sends_rays(found.features, settings))
    reasons = [f"{levels} level{'s' if levels > 1 else ''} of trees: {why}"] * trees + [why_primary] * bool(why_primary)
    features = found.features.replace(
        two_level=levels == 2,
        clip_control=clip_control,
        bvh_inner_steps=_inner_steps(tuning.inner_steps, software, levels),
        buffer_array=software,
        branchless=software,
    )
    kernels = settings.kernels if settings.kernels != "auto" else "fused" if software else "auto"
    split = (settings.reflections == "ray-lerp" or features.glossy) and features.reflections and not features.blended
    split = split and not (features.sky_samples or (features.glossy and features.emitters))
    split = split and kernels != "fused"
    if split:
        plain = _plain(features)
        hits = not (features.glossy or features.reflect_grid) and (kernels == "joined" or (kernels == "auto" and plain))
        features = features.replace(mirror_shadows=features.shadow_bits and plain, mirror_hits=hits)
        parts = "a program of rays and one of shading" if features.mirror_shadows else "programs of rays and of shading"
        reasons.append(f"reflections run as {parts}: a GPU keeps more rays in flight beside less shading code")
    if features.reflect_grid:
        reasons.append(_shared(features, settings))
    joined = kernels in ("auto", "joined") and _joins(features, settings, len(scene.lights))
    joined = joined and (kernels == "joined" or not (features.two_level or features.spheres or features.reflect_grid))
    features = features.replace(encodes=kernels in ("auto", "joined"))
    if features.probes:
        named = len(scene.probes)
        most = settings.parameter("reflections.probe.count")
        where = f"at most {most} probes, where what reflects is worst shown without them"
        reasons.append(f"{named} probes as the scene has them" if named else where)
    if features.march and features.blended:
        reasons.append(
            "blended surfaces are not in the G-buffer: "
            + ("every reflection looks for them with rays" if features.mirror_rays else "they are not reflected")
        )
    skipped = list(found.skipped)
    if not trees:
        skipped.append("trees: " + ("nothing sends rays" if scene.instances else "nothing is drawn"))
    passes = ["gbuffer"]
    if motion is not None and motion.deformers:
        passes = ["skin", *["refit"] * trees, "gbuffer"]
        on_gpu = builds_on_gpu(settings.rebuild, settings.builder, software, motion.largest)
        reasons += [deforming_reason(len(motion.deformers), settings.rebuild, on_gpu)] * trees
    else:
        skipped.append("skin and refit: " + ("nothing moves" if motion is None else "nothing changes shape"))
    if reference:
        passes.append("reference")
    else:
        shadow = "shadow_map" if features.shadow_maps else "shadow_soft" if features.light_discs else "shadow"
        shadow = "baked" if features.lightmap else shadow
        occlusion = {"ssao": "ssao", "ray": "ray_ao"}.get(settings.ao, "")
        passes += [shadow] * features.visibility + [occlusion] * features.occlusion
        passes += _mirror_passes(features, settings)
        passes += ["denoise"] * features.filtered + ["composite"]
    passes.append("display")
    passes = _joined(passes) if joined and primary == "trace" else passes
    return Plan(features, levels, trees, primary, split, joined, tuple(passes), tuple(reasons), tuple(skipped))


def _shared(features: Features, settings: Settings) -> str:
    """What becomes of mirror rays that only a part of the pixels send."""
    part, saved = ("four", "three quarters") if features.reflect_grid == CONSTANTS["GRID_HALF"] else ("two", "half")
    contrast = settings.parameter("reflections.ray-lerp.contrast")
    return (
        f"mirror rays leave one pixel in {part}, and those between where the picture would change by more than"
        f" {100 * contrast:g} %: things thinner than that grid may be missing from reflections; {saved} of the rays at"
        " most are saved for one more look at every pixel that reflects: where few do, full is as fast"
    )


def _sends_rays(features: Features, settings: Settings) -> bool:
    """Whether a pass looks into trees, besides traced primary visibility. Light maps are traced once."""
    return (
        settings.reflections == "reference"
        or (features.visibility and not features.shadow_maps)
        or features.mirror_rays
        or (features.occlusion and settings.ao == "ray")
        or features.blended
    )


def _inner_steps(measured: int, software: bool, levels: int) -> int:
    """In two levels traversal also stops to change trees. With a longer loop beside that code an H100 takes up to a
    quarter more for the mirror rays of `plaza`; beside any-hit functions it gains 2 % in Sponza and atrium."""
    return min(measured, 3) if levels == 2 and not software else measured


def _plain(features: Features) -> bool:
    """Whether the program of mirror rays is small enough to take another traversal: with more in it (`showroom`,
    Sponza) an H100 loses 4 to 6 % by that, without it gains 4."""
    return not (features.alpha_test or features.two_level or features.spheres or features.textures)


def _joins(features: Features, settings: Settings, lights: int) -> bool:
    """Whether camera and shadow rays may go in one program: rays, to the points of a few lights, and nothing else."""
    other = features.shadow_maps or features.lightmap or features.light_discs or features.blended or features.terminator
    return features.visibility and not other and lights <= JOINED_LIGHTS and settings.reflections != "reference"


def _joined(passes: Iterable[str]) -> list[str]:
    """The passes with one for camera and shadow rays."""
    return ["rays" if name == "gbuffer" else name for name in passes if name != "shadow"]


def _parted(passes: Iterable[str]) -> list[str]:
    """The same the other way round."""
    return [part for name in passes for part in (("gbuffer", "shadow") if name == "rays" else (name,))]


def resized(plan: Plan, tuning: Tuning, triangles: int, size: tuple[int, int]) -> Plan:
    """The same plan at another size: which of raster and rays is faster depends on it. For settings.primary = auto.

    Where nothing sends rays there are no trees, and none are built for it.
    """
    if not plan.trees:
        return plan
    primary, why = tuning.primary(size[0] * size[1], triangles)
    reasons = (why if reason.startswith(VISIBILITY) else reason for reason in plan.reasons)
    passes = _parted(plan.passes)
    passes = _joined(passes) if plan.joined and primary == "trace" else passes
    return replace(plan, primary=primary, reasons=tuple(reasons), passes=tuple(passes))


def _mirror_passes(features: Features, settings: Settings) -> list[str]:
    if not features.reflections:
        return []
    return ["screen_depth"] * features.march + [techniques.REFLECTIONS[settings.reflections].mirror_pass]


def deforming_reason(shapes: int, rebuild: float, on_gpu: bool) -> str:
    """What happens to the trees of shapes that change."""
    what = f"{shapes} tree{'s' if shapes > 1 else ''} over moving vertices"
    where = "in compute" if on_gpu else "on the processor"
    if rebuild == 1:
        return f"{what}: built anew {where} every frame, as asked for"
    grown = f"once the SAH cost has grown {rebuild:g} times"
    limit = f", and built anew {where} {grown}" if rebuild else ", never built anew"
    return f"{what}: refitted every frame{limit}"


def describe(
    scene: Scene,
    settings: Settings,
    size: tuple[int, int] = (1280, 720),
    software: bool = True,
    tuning: Tuning | None = None,
) -> dict[str, Any]:
    """The plan as the command line prints it: passes, reasons, what is skipped, features in use. Needs no device."""
    motion = wanted(scene, settings)
    scene = motion.start if motion is not None else at_time(scene, settings.time, settings.clip)
    plan = make(scene, settings, software=software, motion=motion, tuning=tuning, size=size)
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
        "reasons": [*plan.reasons, *[kernels.QUICK] * _quick(plan, scene)],
        "features": [name.removeprefix("USE_").lower() for name in on],
        "skipped": list(plan.skipped),
        **({"device rates": tuning.to_dict()} if tuning is not None else {}),
    }


def _quick(plan: Plan, scene: Scene) -> bool:
    """Whether trees come from the quick builder, unless they are kept from before or are many."""
    return plan.trees and scene.triangle_count() > SMALL and kernels.mode() != "first" and not kernels.TREES.ready()


MEASURE_SIZE = (320, 180)  # pixels: shares of a picture settle long before its details do
MEASURE_AOVS = ("instance_id", "visibility", "reflection_hit", "bvh_steps")


def measured(frame: "Frame") -> dict[str, Any]:
    """What only a picture tells, from a small one with MEASURE_AOVS: shares of pixels and of a frame's time."""
    from glhybrid.image import AOVS

    surface = frame["instance_id"] != AOVS["instance_id"].miss
    lit = frame["visibility"]
    passes = {row["name"]: row["ms"] for row in frame.receipt["passes"] if row["name"] != "display"}
    total = sum(passes.values()) or 1.0
    percent: dict[str, Any] = {"with a surface": surface, "with a mirror ray": frame["reflection_hit"] != 0}
    percent |= {f"lit by light {i}": lit[..., i] > 0 for i in range(min(lit.shape[-1], 8))}
    return {
        "size": list(frame.size),
        **{f"pixels {name}, %": round(100 * float(mask.mean()), 1) for name, mask in percent.items()},
        **{f"time in {name}, %": round(100 * ms / total, 1) for name, ms in passes.items()},
        "tree steps per pixel": round(float(frame["bvh_steps"][surface].mean()), 1) if surface.any() else 0.0,
    }
