"""`glhybrid study`: for each scene a converged reference, then every cell of the sweep against it.

load -> reference.converge -> direct.find -> sweep.axis -> measure (kept in store) -> pareto -> sweep.pairs -> measure
     -> failures, stability -> results.json, results.csv, report.html
"""

import logging
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid import techniques
from glhybrid.errors import GlhybridError, SettingError
from glhybrid.image import Frame, replacing
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import curves, direct, measure, pareto, picture, stability, store, sweep
from glhybrid.study import reference as references
from glhybrid.study.develop import develop
from glhybrid.study.measure import Clock
from glhybrid.study.progress import Meter, Progress
from glhybrid.study.reference import Reference
from glhybrid.study.sweep import PAIRS, Cell
from glhybrid.view import choose_camera

log = logging.getLogger("glhybrid")
SCENES = ("atrium", "plaza", "showroom")
QUICK_SCENES = ("showroom", "atrium")
PARTS = ("stability", "failures")
FAILURE_CELLS = 20  # what the failure library counts for in the progress
REFERENCE_CELLS = 8  # what a reference counts for in the progress
BUSY = 1.25  # times the CPU time: from here on wall time measures the neighbours


@dataclass(frozen=True)
class Effort:
    """How much is spent. size: pixels. points: of a light with a size. target, most, budget_s: of the reference."""

    size: tuple[int, int]
    clock: Clock
    points: int
    target: float
    most: int
    budget_s: float
    pan_steps: int
    pairs: int | None


def effort(quick: bool, software: bool, size: tuple[int, int] | None, most: int | None) -> Effort:
    if quick:
        chosen = Effort(
            (256, 144) if software else (960, 540), Clock(2 if software else 32, 0.0), 16, 0.005,
            256 if software else 2048, 30.0 if software else 10.0, 2, 4,
        )  # fmt: skip
    else:
        chosen = Effort(
            (640, 360) if software else (1920, 1080), Clock(5 if software else 64, 0.5), 64, 0.002,
            1024 if software else 8192, math.inf, 8 if software else 32, None,
        )  # fmt: skip
    if size is not None:
        chosen = replace(chosen, size=size)
    return replace(chosen, most=most) if most is not None else chosen


@dataclass
class Study:
    """What was found: `machine`, `rows` and `failures` as results.json has them; scenes: by name, what rows have in
    common; curves, peers, paper: further parts; notes: what was left out, and why."""

    machine: dict[str, Any]
    rows: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)
    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    curves: list[dict[str, Any]] = field(default_factory=list)
    peers: list[dict[str, Any]] = field(default_factory=list)
    paper: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def to_dict(self) -> dict[str, Any]:
        names = ("machine", "rows", "failures", "scenes", "curves", "peers", "paper", "notes")
        return {name: getattr(self, name) for name in names}


def run(
    names: Sequence[str],
    output: Path,
    *,
    quick: bool = False,
    device: str = "auto",
    size: tuple[int, int] | None = None,
    camera: int | str | None = None,
    only: Sequence[str] = (),
    samples: int | None = None,
    bounces: int = 8,
    command: str = "",
    parts: Sequence[str] = PARTS,
    load: Callable[[str], Scene] | None = None,
    progress: Progress | None = None,
    lines: bool = False,
) -> Study:
    """Studies the scenes named, or the default ones, and writes everything to a folder; what is there and still holds
    is kept.

    only: names of techniques; default all. parts: of PARTS, what is done beside the scenes. samples: the most paths a
    pixel of the reference. command: what is printed as the line that makes this study again. lines: log lines instead
    of a bar. Raises what loading, settings, devices and writing raise, all of it before any work is done where that can
    be known.
    """
    picture.require_flip()
    only = sweep.check_names(only)
    if size is not None:
        check_size(size)
    store.prepare(output)
    load = load or _load
    scenes = {_name(name): load(name) for name in names or (QUICK_SCENES if quick else SCENES)}
    for scene in scenes.values():
        choose_camera(scene, camera)
    with Renderer(device=device) as renderer:
        spent = effort(quick, renderer.context.device.software, size, samples)
        study = Study(_machine(renderer, spent.size, command))
        meter = Meter(progress, lines)
        work = []
        for name, scene in scenes.items():
            work.append(_SceneStudy(renderer, name, scene, choose_camera(scene, camera), spent, quick, bounces,
                                    only, output, study, meter))  # fmt: skip
        for one in work:
            meter.expect(one.size_of_work())
        meter.expect(("stability" in parts) * curves.size_of_work() + ("failures" in parts) * FAILURE_CELLS)
        for one in work:
            one.run()
            finish(study, output)
        if "stability" in parts:
            study.curves = curves.run(renderer, output / "stability", quick, meter, study.note)
            finish(study, output)
        if "failures" in parts:
            study.failures = failures(renderer, output / "failures", meter, study.note)
    finish(study, output)
    return study


def _load(name: str) -> Scene:
    import glhybrid

    return glhybrid.load(name)


def _name(scene: str) -> str:
    return Path(scene).stem


def _machine(renderer: Renderer, size: tuple[int, int], command: str) -> dict[str, Any]:
    from glhybrid.bench.report import machine
    from glhybrid.bvh.blas import threads_available

    return machine(renderer.context.device.to_dict(), size=list(size), cores=threads_available(), command=command)


def failures(renderer: Renderer, folder: Path, meter: Meter, note: Callable[[str], None]) -> list[dict[str, Any]]:
    """The failure library's rows, case by case, each kept with its pictures as it is finished."""
    from glhybrid.study import failures as library

    names, rows = library.cases(), []
    for name in names:
        meter.begin(f"failure library: {name}")
        case = library.load(name)
        key = store.fingerprint(store.code_digest(), case.scene.sha256, renderer.context.device.to_dict())
        path = folder / f"{name}.json"
        kept = store.read(path, key)
        if kept is None:
            found, images = [], {}
            for k, row in enumerate(library.run(renderer, [name], pictures=True)):
                picture_of = row.pop("picture", None)
                if picture_of is not None:
                    images[str(k)] = row["image"] = f"{name}-{k}.png"
                    folder.mkdir(parents=True, exist_ok=True)
                    Frame(picture_of).save(folder / row["image"])
                found.append(row)
            kept = {"rows": found, "images": images, "key": key}
            store.write_json(path, kept)
        for row in kept["rows"]:
            if row["verdict"] == library.SKIPPED:
                note(f"failure {row['case']}: {row['because']}")
            else:
                rows.append(row)
        meter.end(FAILURE_CELLS / len(names))
    return rows


def finish(study: Study, output: Path) -> None:
    """Fronts, and every file that is made of results."""
    from glhybrid.study.report import html

    mark_fronts(study)
    store.write_json(output / "results.json", study.to_dict())
    store.write_csv(output / "results.csv", study.rows)
    html.write(study, output)


def time_key(study: Study) -> str:
    """Which time a study goes by: on a software rasteriser whose machine had other work, that of the processor."""
    ratios = [row["frame_ms"] / row["frame_cpu_ms"] for row in study.rows if row.get("frame_cpu_ms")]
    software = study.machine["device"].get("software")
    busy = bool(software and ratios and statistics.median(ratios) > BUSY)
    study.machine["busy"] = statistics.median(ratios) if busy else None
    return "frame_cpu_ms" if busy else "frame_ms"


ERRORS = {"shadows": "flip_shadow", "reflections": "flip_reflection"}  # what tells an axis' techniques apart


def mark_fronts(study: Study) -> None:
    """Rows get `pareto`: on their scene's front, whole picture; `pareto_axes`: the axes whose front they are on."""
    clock = study.machine["time"] = time_key(study)
    for name in study.scenes:
        rows = [row for row in study.rows if row["scene"] == name]
        on = set(pareto.front([r[clock] for r in rows], [r["flip"] for r in rows]))
        for i, row in enumerate(rows):
            row["pareto"], row["pareto_axes"] = i in on, []
        for kind in techniques.TECHNIQUES:
            mine = [row for row in rows if kind in row["axes"]]
            key = error_key(kind, mine)
            for i in pareto.front([r[clock] for r in mine], [r[key] for r in mine]):
                mine[i]["pareto_axes"].append(kind)


def error_key(kind: str, rows: Sequence[dict[str, Any]]) -> str:
    """The measure of an axis: its own, where the scene has it."""
    key = ERRORS.get(kind, "flip")
    return key if rows and all(row.get(key) is not None for row in rows) else "flip"


class _SceneStudy:
    """One scene: its reference, its cells."""

    def __init__(
        self, renderer: Renderer, name: str, scene: Scene, camera: Camera, spent: Effort, quick: bool, bounces: int,
        only: Sequence[str], output: Path, study: Study, meter: Meter,
    ) -> None:  # fmt: skip
        self.renderer, self.name, self.scene, self.camera, self.spent = renderer, name, scene, camera, spent
        self.quick, self.bounces, self.only = quick, bounces, only
        self.folder, self.study, self.meter = output / name, study, meter
        skipped = sweep.skipped_axes(scene)
        for kind, reason in skipped.items():
            study.note(f"{name}: {kind} are not swept: {reason}")
        kinds = [kind for kind in techniques.TECHNIQUES if kind not in skipped]
        axes = {kind: sweep.axis(kind, quick=quick, only=only) for kind in kinds}
        self.axes = {kind: cells for kind, cells in axes.items() if len(cells) > 1 or only}
        if not any(self.axes.values()):
            self.axes = {"shadows": [Cell(sweep.defaults())]}

    def size_of_work(self) -> float:
        limit = self.spent.pairs if self.spent.pairs is not None else 12
        return REFERENCE_CELLS + sum(len(cells) for cells in self.axes.values()) + (limit if len(self.axes) > 1 else 0)

    def run(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.reference = self._reference()
        frame, self.exposure = develop(self.renderer, self.scene, self.camera, self.reference.radiance)
        frame.save(self.folder / "reference.png")
        frame.save(self.folder / "reference.exr", aov=())
        self._describe()
        seen: dict[str, dict[str, Any]] = {}
        for kind, cells in self.axes.items():
            for cell in cells:
                self._cell(cell, kind, seen)
        if len(self.axes) > 1:
            cells = sweep.pairs(self._fronts(), self.spent.pairs)
            guessed = self.spent.pairs if self.spent.pairs is not None else 12
            self.meter.expect(len(cells) - guessed)
            for cell in cells:
                self._cell(cell, PAIRS, seen)

    def _describe(self) -> None:
        scene, size = self.scene, self.spent.size
        self.study.scenes[self.name] = {
            "path": str(scene.path) if scene.path else None, "sha256": scene.sha256,
            "triangles": scene.triangle_count(), "instances": len(scene.instances), "lights": len(scene.lights),
            "camera": self.camera.name, "size": list(size), "exposure_ev": self.exposure,
            "reference": self.reference.to_dict() | {"png": "reference.png", "exr": "reference.exr"},
        }  # fmt: skip

    def _reference(self) -> Reference:
        """As this folder has it, so that figures of one study are all against one picture; else converged."""
        meter, spent = self.meter, self.spent
        meter.begin(f"{self.name}: reference")
        key = references.content_key(self.scene, self.camera, spent.size, self.bounces)
        asked = store.fingerprint(key, spent.target, spent.most, spent.budget_s)
        kept = store.read(self.folder / "reference.json", asked)
        if kept is not None:
            with np.load(self.folder / "reference.npz") as file:
                radiance = file["radiance"]
            meter.end(REFERENCE_CELLS, free=True)
            return Reference(radiance, **{k: kept[k] for k in kept if k not in ("key", "images")} | {"key": key})
        found = references.converge(
            self.renderer, self.scene, self.camera, spent.size, bounces=self.bounces, target=spent.target,
            most=spent.most, budget_s=spent.budget_s,
            progress=lambda _, done, total: meter.part(REFERENCE_CELLS * min(done / total, 1.0)),
        )  # fmt: skip
        with replacing(self.folder / "reference.npz") as temporary, temporary.open("wb") as file:
            np.savez(file, radiance=found.radiance)
        store.write_json(
            self.folder / "reference.json", found.to_dict() | {"key": asked, "images": {"npz": "reference.npz"}}
        )
        meter.end(REFERENCE_CELLS)
        return found

    def _fronts(self) -> dict[str, list[Cell]]:
        """By kind the cells on its front."""
        mark_fronts(self.study)
        fronts: dict[str, list[Cell]] = {}
        for kind, cells in self.axes.items():
            by_key = {cell.key: cell for cell in cells}
            fronts[kind] = [
                by_key[row["cell"]] for row in self.study.rows
                if row["scene"] == self.name and kind in row["pareto_axes"]
            ]  # fmt: skip
        return fronts

    def _cell(self, cell: Cell, axis: str, seen: dict[str, dict[str, Any]]) -> None:
        self.meter.begin(f"{self.name}: {cell.label}")
        settings = cell.settings(Settings(exposure=self.exposure))
        stem = cell.stem
        path = self.folder / f"{stem}.json"
        key = store.fingerprint(
            store.code_digest(), self.reference.key, self.reference.samples, settings.to_dict(),
            self.renderer.context.device.to_dict(), self.spent.clock.__dict__, self.spent.points, self.spent.pan_steps,
        )  # fmt: skip
        row = seen.get(cell.key) or store.read(path, key)
        free = row is not None
        if row is None:
            try:
                row = self._measure(cell, settings, stem)
            except GlhybridError as error:
                self.study.note(f"{self.name}: {cell.label} was not measured: {error}")
                self.meter.end()
                return
            store.write_json(path, row | {"key": key})
        if cell.key in seen:
            row["axes"].append(axis)
        else:
            row = {k: v for k, v in row.items() if k != "key"} | {"axes": [axis], "cell": cell.key}
            seen[cell.key] = row
            self.study.rows.append(row)
        self.meter.end(free=free)

    def _measure(self, cell: Cell, settings: Settings, stem: str) -> dict[str, Any]:
        args = self.renderer, self.scene, self.camera, self.spent.size
        specular, light = self._specular, self._light
        frame = measure.draw(*args, settings)
        times = measure.time_frames(*args, settings, self.spent.clock)
        errors, flip = measure.figures(frame, self.reference.radiance, light, specular)
        width, height = self.spent.size
        moving = None
        if not cell.parameters:
            small = (width // 2, height // 2)
            moving = stability.pan(self.renderer, self.scene, self._pan_camera, small, settings, self.spent.pan_steps)
        images = measure.save_images(self.folder, stem, frame, flip)
        return {
            "scene": self.name, **measure.describe(cell, times), "bytes": measure.memory(frame.receipt), **errors,
            "flicker": moving.flicker if moving else None,
            "flicker_p99": moving.flicker_p99 if moving else None,
            "flip_rate_percent": moving.flip_rate_percent if moving else None,
            "images": images,
        }  # fmt: skip

    @cached_property
    def _specular(self) -> F32:
        return measure.specular_share(self.renderer, self.scene, self.camera, self.spent.size)

    @cached_property
    def _light(self) -> direct.Direct | None:
        if not self.scene.lights or not self.scene.instances:
            return None
        return direct.find(self.renderer, self.scene, self.camera, self.spent.size, self.spent.points)

    @cached_property
    def _pan_camera(self) -> Camera:
        depth = stability.typical_depth(self.renderer, self.scene, self.camera)
        return stability.orthographic(self.camera, depth)


def check_size(size: tuple[int, int]) -> None:
    """FLIP and the windows of SSIM want more than a few pixels."""
    if min(size) < 16:
        raise SettingError(f"--size {size[0]}x{size[1]}: a study needs at least 16 pixels a side")
