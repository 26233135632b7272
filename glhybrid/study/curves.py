"""Error of every technique over one parameter of a small scene, and where each breaks.

Shadows are held against float64 rays on the CPU (oracle.py), reflections against the converged path tracer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid import techniques
from glhybrid.errors import GlhybridError
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import metrics, picture, reference, stability, stages, store, sweep
from glhybrid.study.oracle import Oracle
from glhybrid.study.progress import Meter

QUICK_SIZE, SIZE = (120, 90), (240, 180)
MOTION_FRAMES = 6
GHOST = "ghost"
CELLS = 3.0  # what a curve counts for in the progress
LEFT = 0.05
LEAVE_FRAME, WATCHED = 8, 40  # of the ghost: when the box goes, and how long its trace is followed
Size = tuple[int, int]
Errors = Callable[[Settings], float]  # of one technique
Measure = Callable[[Renderer, Scene, Camera, tuple[int, int], float], Errors]


@dataclass(frozen=True)
class Curve:
    """kind: whose techniques. values: of the parameter, ascending; quick: fewer. measure: given what does not depend on
    the technique, the error under settings. bar: the error from which a technique counts as broken."""

    name: str
    title: str
    parameter: str
    measure_name: str
    kind: str
    values: Sequence[float]
    quick: Sequence[float]
    stage: Callable[[float], tuple[Scene, Camera]]
    measure: Measure
    bar: float
    about: str
    log: bool = True
    only: Callable[[techniques.Technique], bool] = lambda technique: technique.name != "none"


# Measures -------------------------------------------------------------------------------------------------------------


def wrong_shadow(renderer: Renderer, scene: Scene, camera: Camera, size: Size, _: float) -> Errors:
    """Per cent of pixels that face the light and are on the wrong side of one half."""
    oracle = Oracle(scene)
    seen = oracle.seen(camera, size)
    counted, want = oracle.facing(seen, scene.lights[0]), oracle.visibility(seen, scene.lights[0])

    def measure(settings: Settings) -> float:
        frame = renderer.render(scene, camera, size, settings, aovs=("visibility",))
        return metrics.wrong_shadow_percent(frame["visibility"][..., 0], want, counted).all

    return measure


def glossy_error(renderer: Renderer, scene: Scene, camera: Camera, size: Size, _: float) -> Errors:
    """HDR-FLIP over the pixels of the first instance."""
    want = reference.converge(renderer, scene, camera, size, bounces=4, target=0.004, most=512).radiance
    ids = renderer.render(scene, camera, size, Settings(aa=1, reflections="none"), aovs=("instance_id",))["instance_id"]

    def measure(settings: Settings) -> float:
        got = renderer.render(scene, camera, size, settings)["radiance"]
        return picture.weighted_mean(renderer.flip.hdr(got, want), ids == 0) or 0.0

    return measure


def motion_error(renderer: Renderer, scene: Scene, camera: Camera, size: Size, step: float) -> Errors:
    """HDR-FLIP of the last of MOTION_FRAMES, each `step` pixels further on, against the same frame at rest."""
    depth = float(np.linalg.norm(camera.world_from_view[:3, 3]))
    metres = step * 2 * depth * float(np.tan(camera.fov_y / 2)) / size[1]

    def frame(settings: Settings, back: int) -> F32:
        pose = camera.world_from_view.copy()
        pose[:3, 3] -= back * metres * pose[:3, 0]
        return renderer.render(scene, replace(camera, world_from_view=pose), size, settings)["radiance"]

    def measure(settings: Settings) -> float:
        renderer.render(scene, camera, (16, 16), settings)  # another size makes all anew: what follows has no past
        moved = [frame(settings, back) for back in reversed(range(MOTION_FRAMES))][-1]
        renderer.render(scene, camera, (16, 16), settings)
        rested = [frame(settings, 0) for _ in range(MOTION_FRAMES)][-1]
        return float(renderer.flip.hdr(moved, rested).mean())

    return measure


CURVES = (
    Curve(
        "origin", "Distance from the origin", "metres from the origin", "wrong shadow, %", "shadows",
        (0, 1, 10, 100, 1e3, 1e4, 1e5, 1e6), (0, 1e2, 1e4, 1e6), lambda v: stages.posts(offset=v), wrong_shadow, 0.5,
        "The whole scene is moved away; float32 coordinates lose what the distance takes.",
    ),
    Curve(
        "scale", "Scale", "metres to the scene's metre", "wrong shadow, %", "shadows",
        (1e-3, 1e-2, 0.1, 1, 10, 100, 1e3), (1e-3, 1, 1e3), lambda v: stages.posts(scale=v), wrong_shadow, 0.5,
        "A model in millimetres or kilometres; fixed distances in metres become too much or too little.",
    ),
    Curve(
        "sun", "Elevation of the sun", "degrees above the horizon", "wrong shadow, %", "shadows",
        (1, 2, 5, 10, 20, 40, 80), (2, 10, 40), lambda v: stages.posts(v), wrong_shadow, 0.5,
        "A low sun stretches a texel of a depth map over metres of floor.",
    ),
    Curve(
        "thickness", "Thickness of a wall", "metres", "light in a sealed room, %", "shadows",
        (0.001, 0.003, 0.01, 0.03, 0.1, 0.3), (0.003, 0.03, 0.3), stages.room, wrong_shadow, 0.1,
        "No light may enter; bias wider than the wall lets it in.",
    ),
    Curve(
        "roughness", "Roughness of a metal floor", "roughness", "HDR-FLIP of the floor", "reflections",
        (0, 0.05, 0.1, 0.15, 0.25, 0.35, 0.5, 0.75, 1), (0, 0.1, 0.25, 0.5, 1), stages.mirror_floor, glossy_error, 0.1,
        "A mirror ray lerped with a blurred sky is right at 0 and ignores objects in proportion to roughness.",
        log=False,
    ),
    Curve(
        "motion", "Camera step", "pixels a frame", "HDR-FLIP against the same frame at rest", "",
        (0, 0.5, 1, 2, 4, 8, 16), (0, 1, 8), lambda _: stages.mirror_floor(0.25), motion_error, 0.05,
        "What a technique keeps of earlier frames is wrong where the camera has moved.", only=lambda t: t.stochastic,
    ),
)  # fmt: skip


Note = Callable[[str], None]


def run(renderer: Renderer, folder: Path, quick: bool, meter: Meter, note: Note) -> list[dict[str, Any]]:
    """Every curve, kept in `folder` as it is finished; last the trace of what is gone."""
    found = [make(renderer, name, folder, quick, meter, note) for name in names()]
    return [curve for curve in found if curve is not None]


def names() -> list[str]:
    """Of all curves, that of what is gone last."""
    return [curve.name for curve in CURVES] + [GHOST]


def make(renderer: Renderer, name: str, folder: Path, quick: bool, meter: Meter, note: Note) -> dict[str, Any] | None:
    """One curve, kept in `folder`; None where no technique has it."""
    size = QUICK_SIZE if quick else SIZE
    if name == GHOST:
        return _ghosts(renderer, size, folder, meter, note)
    curve = next(curve for curve in CURVES if curve.name == name)
    return _one(renderer, curve, size, quick, folder, meter, note)


def _chosen(curve: Curve) -> list[techniques.Technique]:
    kinds = [curve.kind] if curve.kind else list(techniques.TECHNIQUES)
    return [t for kind in kinds for t in sweep.contestants(kind) if curve.only(t)]


def _settings(technique: techniques.Technique) -> Settings:
    """Of a technique alone, as far as a picture allows."""
    others = {"shadows": "ray", "reflections": "none"}
    return Settings(aa=1).replace(**(others | {technique.kind: technique.name}))


def _key(renderer: Renderer, size: tuple[int, int], chosen: Sequence[techniques.Technique], *more: Any) -> str:
    names = [t.name for t in chosen]
    return store.fingerprint(store.code_digest(), size, names, renderer.context.device.to_dict(), *more)


def _kept(path: Path, key: str, meter: Meter) -> dict[str, Any] | None:
    kept = store.read(path, key)
    if kept is None:
        return None
    meter.end(CELLS, free=True)
    return {k: v for k, v in kept.items() if k != "key"}


def _one(
    renderer: Renderer, curve: Curve, size: tuple[int, int], quick: bool, folder: Path, meter: Meter, note: Note
) -> dict[str, Any] | None:
    meter.begin(f"stability: {curve.title.lower()}")
    values = [float(v) for v in (curve.quick if quick else curve.values)]
    chosen = _chosen(curve)
    key = _key(renderer, size, chosen, values)
    path = folder / f"{curve.name}.json"
    if (kept := _kept(path, key, meter)) is not None:
        return kept
    errors: dict[str, list[float | None]] = {t.name: [] for t in chosen}
    for i, value in enumerate(values if chosen else ()):
        scene, camera = curve.stage(value)
        measure = curve.measure(renderer, scene, camera, size, value)
        for technique in chosen:
            try:
                errors[technique.name].append(measure(_settings(technique)))
            except GlhybridError as error:
                note(f"{curve.title}: {technique.name} at {value:g} was not measured: {error}")
                errors[technique.name].append(None)
        meter.part(CELLS * (i + 1) / len(values))
    meter.end(CELLS)
    if not chosen:
        return None
    lines = [{"technique": n, "errors": e, "breaks": breaks(values, e, curve.bar)} for n, e in errors.items()]
    result = {
        "name": curve.name, "title": curve.title, "parameter": curve.parameter, "measure": curve.measure_name,
        "values": values, "log": curve.log, "bar": curve.bar, "about": curve.about, "size": list(size), "lines": lines,
    }  # fmt: skip
    store.write_json(path, result | {"key": key})
    return result


def _ghosts(renderer: Renderer, size: tuple[int, int], folder: Path, meter: Meter, note: Note) -> dict[str, Any] | None:
    meter.begin("stability: what is gone")
    chosen = [t for kind in techniques.TECHNIQUES for t in sweep.contestants(kind) if t.stochastic]
    key = _key(renderer, size, chosen)
    path = folder / f"{GHOST}.json"
    if (kept := _kept(path, key, meter)) is not None:
        return kept
    lines = []
    for technique in chosen:
        try:
            life, left = ghosts(renderer, size, _settings(technique))
        except GlhybridError as error:
            note(f"What is gone: {technique.name} was not measured: {error}")
            continue
        lines.append({"technique": technique.name, "errors": left, "breaks": None, "half_life": life})
    meter.end(CELLS)
    if not lines:
        return None
    lives = ", ".join(f"{e['technique']} {'never' if e['half_life'] is None else e['half_life']}" for e in lines)
    result = {
        "name": GHOST, "title": "What is gone", "parameter": "frames after a box has gone",
        "measure": "share of it that is left", "values": list(range(WATCHED)), "log": False, "bar": LEFT,
        "about": f"Frames until at most {100 * LEFT:g} % of it is left: {lives}.", "size": list(size), "lines": lines,
    }  # fmt: skip
    store.write_json(path, result | {"key": key})
    return result


def breaks(values: Sequence[float], errors: Sequence[float | None], bar: float) -> float | None:
    """The value at which a technique passes the bar, walking away from where it is best; None if it never does.

    The walk goes both ways; of two ends that fail, the first one met counts.
    """
    good = [i for i, e in enumerate(errors) if e is not None]
    if not good:
        return None
    best = min(good, key=lambda i: errors[i] or 0.0)
    steps = sorted(good, key=lambda i: (abs(i - best), i))
    return next((values[i] for i in steps if (errors[i] or 0.0) > bar), None)


def ghosts(renderer: Renderer, size: tuple[int, int], settings: Settings) -> tuple[int | None, list[float]]:
    """Frames until at most LEFT of what a box changed in a picture is left after it has gone, and the share by frame.

    None: it has not faded after WATCHED frames. A technique without a memory has 0.
    """
    fps = 24.0
    scene, camera = stages.leaving(LEAVE_FRAME / fps)
    frames = []
    for n in range(LEAVE_FRAME + WATCHED):
        at = settings.replace(time=(n + 0.5) / fps)
        frames.append(renderer.render(scene, camera, size, at)["radiance"] @ picture.LUMINANCE)
    before, after = np.mean(frames[LEAVE_FRAME - 3 : LEAVE_FRAME], axis=0), np.mean(frames[-8:], axis=0)
    energy = np.abs(before - after)
    counted = energy > 0.05 * energy.max()
    sign = np.sign(before - after)[counted]
    total = float(energy[counted].sum()) or 1.0
    shares = [float(((f - after)[counted] * sign).sum()) / total for f in frames[LEAVE_FRAME:]]
    left = [share if share > 1e-6 else 0.0 for share in shares]  # below: rounding
    return stability.half_life(left, LEFT), left
