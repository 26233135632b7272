"""The paper again (Kim, table 1 and figure 8): its method against many rays and a denoiser, with the error of both.

The paper gives frames a second of its own renderer and of Unreal Engine 4 on three scenes, and pictures at roughness
0.25. Here both methods are of one renderer on one device, so that nothing differs but the method.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.errors import GlhybridError
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import measure, picture, reference, stages, store
from glhybrid.study.measure import Clock
from glhybrid.study.progress import Meter
from glhybrid.study.sweep import Cell, defaults

AXIS = "paper"
SCENES = ("atrium", "plaza", "showroom")
KIM = {"shadows": "ray", "reflections": "ray-lerp"}
MANY = {"shadows": "ray-soft", "reflections": "ray-glossy"}
SAMPLES = (1, 4, 16)
ROUGHNESS = (0.1, 0.25, 0.5, 0.75)
LADDER_SIZE, QUICK_LADDER_SIZE = (320, 240), (160, 120)
LADDER_FRAMES, LADDER_S = 32, 0.1  # of each way, at each roughness
LADDER_CELLS = 6  # what it counts for in the progress
SIZE, QUICK_SIZE = (1920, 1080), (480, 270)
# What the paper printed: frames a second on an RTX 2070 SUPER at 1920x1080, and its lead in per cent.
PRINTED = (
    {"scene": "A", "kim": (87, 93), "unreal": (58, 60), "lead": (45, 60)},
    {"scene": "B", "kim": (97, 102), "unreal": (59, 61), "lead": (59, 73)},
    {"scene": "C", "kim": (125, 131), "unreal": (60, 62), "lead": (102, 118)},
)


def cells() -> list[Cell]:
    """Kim's method, and the many-ray one with several counts of rays."""
    keys = [f"{kind}.{name}.samples" for kind, name in MANY.items()]
    return [Cell(defaults() | KIM), *(Cell(defaults() | MANY, dict.fromkeys(keys, n)) for n in SAMPLES)]


def table(rows: Sequence[dict[str, Any]], clock: str) -> list[dict[str, Any]]:
    """Table 1: of each scene both methods, and by how many per cent Kim's is faster. Without the other: null."""
    lines = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        mine = [row for row in rows if row["scene"] == scene and AXIS in row["axes"]]
        kim = next((row for row in mine if _is(row, KIM)), None)
        if kim is None:
            continue
        others: list[dict[str, Any] | None] = [row for row in mine if _is(row, MANY)]
        for many in others or [None]:
            line: dict[str, Any] = {"scene": scene, "kim": _figures(kim, clock), "many": None, "lead_percent": None}
            if many is not None:
                line["many"] = _figures(many, clock) | {"samples": max(many["parameters"].values(), default=None)}
                line["lead_percent"] = 100 * (many[clock] / kim[clock] - 1)
            lines.append(line)
    return lines


def _is(row: dict[str, Any], method: dict[str, str]) -> bool:
    return all(row[kind] == name for kind, name in method.items())


def _figures(row: dict[str, Any], clock: str) -> dict[str, Any]:
    names = (
        "label", "flip", "flip_at_rest", "flip_reflection", "flip_reflection_at_rest", "flip_shadow", "rel_mse",
        "bias_percent", "bias_error_percent",
    )  # fmt: skip
    return {name: row[name] for name in names} | {"ms": row[clock], "frames_per_second": 1e3 / row[clock]}


def ways() -> list[Cell]:
    """To reflect, that the ladder sets side by side."""
    base, glossy = defaults() | {"shadows": "none", "reflections": "ray-glossy"}, "reflections.ray-glossy"
    found = [Cell(base | {"reflections": "ray-lerp"})]
    for n in SAMPLES:
        found += [
            Cell(base, {f"{glossy}.samples": n}),
            Cell(base, {f"{glossy}.samples": n, f"{glossy}.denoise": False}),
        ]
    return found


def ladder_truth(
    renderer: Renderer, roughness: float, quick: bool
) -> tuple[Scene, Camera, reference.Mask, reference.Reference]:
    """The scene of one roughness, whose pixels count, and what is true of it; kept by reference.converge."""
    scene, camera = stages.mirror_floor(roughness)
    size, (target, most) = ladder_size(quick), (0.004, 2048) if quick else (0.002, 4096)
    plain = Settings(aa=1, reflections="none")
    floor = renderer.render(scene, camera, size, plain, aovs=("instance_id",))["instance_id"] == 0
    truth = reference.converge(renderer, scene, camera, size, bounces=2, target=target, most=most, counted=floor)
    return scene, camera, floor, truth


def ladder_size(quick: bool) -> tuple[int, int]:
    """Of its pictures."""
    return QUICK_LADDER_SIZE if quick else LADDER_SIZE


def ladder(renderer: Renderer, folder: Path, quick: bool, clock: Clock, meter: Meter) -> dict[str, Any]:
    """Figure 8 in figures: bias, RMSE, FLIP and time of ways to reflect in a metal floor, by its roughness.

    What is reflected are unlit bodies and the sky: the error is of the lobe alone. Figures are over the floor's pixels,
    bias against all light, RMSE in units of the reference's mean.
    """
    meter.begin("the paper's figure 8")
    size = ladder_size(quick)
    key = store.fingerprint(
        store.code_digest(), size, [way.key for way in ways()], clock.__dict__, renderer.context.device.to_dict()
    )
    brief = replace(clock, frames=min(clock.frames, LADDER_FRAMES), seconds=min(clock.seconds, LADDER_S))
    path = folder / "ladder.json"
    if (kept := store.read(path, key)) is not None:
        meter.end(LADDER_CELLS, free=True)
        return {k: v for k, v in kept.items() if k != "key"}
    rows = []
    for i, roughness in enumerate(ROUGHNESS):
        scene, camera, floor, truth = ladder_truth(renderer, roughness, quick)
        want = truth.radiance.astype(np.float64)
        mean = float(want[floor].mean())
        drawn = []
        for way in ways():
            settings = way.settings(Settings())
            try:
                got = renderer.render(scene, camera, size, settings)["radiance"]
            except GlhybridError as error:
                rows.append({"roughness": roughness, "label": way.name("reflections"), "error": str(error)})
                continue
            drawn.append((way, settings, got))
        for way, settings, got in drawn:  # one after another, so that a GPU has its clock from the first on
            times = measure.time_frames(renderer, scene, camera, size, settings, brief)
            off = got.astype(np.float64)[floor] - want[floor]
            bias, bias_error = truth.light.bias(float(got[floor].mean(0, dtype=np.float64) @ picture.LUMINANCE))
            rows.append({
                "roughness": roughness, "label": way.name("reflections"),
                "bias_percent": bias, "bias_error_percent": bias_error,
                "rmse": float(np.sqrt((off**2).mean())) / mean,
                "flip": picture.weighted_mean(renderer.flip.hdr(got, truth.radiance), floor),
                "frame_ms": times.frame_ms, "frame_cpu_ms": times.cpu_ms, "noise_flip": truth.noise_flip,
            })  # fmt: skip
        meter.part(LADDER_CELLS * (i + 1) / len(ROUGHNESS))
    found = {"size": list(size), "rows": rows}
    store.write_json(path, found | {"key": key})
    meter.end(LADDER_CELLS)
    return found
