"""One scene of a study: its converged reference, then every cell against it, each kept as it is finished."""

import math
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from glhybrid.errors import GlhybridError, SettingError
from glhybrid.image import replacing
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import direct, measure, reflected, results, stability, store, sweep
from glhybrid.study import paper as papers
from glhybrid.study import reference as references
from glhybrid.study.beside import Crew
from glhybrid.study.comparing import Comparing, processes
from glhybrid.study.develop import develop
from glhybrid.study.jobs import Programs
from glhybrid.study.judge import Judge
from glhybrid.study.measure import Clock, Truth
from glhybrid.study.peers.panel import Site
from glhybrid.study.progress import Meter
from glhybrid.study.reference import Reference
from glhybrid.study.results import Study
from glhybrid.study.sweep import PAIRS, Cell

REFERENCE_CELLS = 14  # what a reference counts for in the progress
ONCE = ""  # stands for what is made once a scene, beside keys of cells
PATIENCE_S = 8.0  # that a user who has pressed Ctrl-C is kept for
STAGINGS = 2  # kept ready: the scene's, and its mirrors'
SMALLEST = 16  # pixels: FLIP and the windows of SSIM want a neighbourhood


@dataclass(frozen=True)
class Effort:
    """How much is spent. size: pixels. points: of a light with a size. target, most, budget_s: of the reference.
    variants_s: after so long on a scene, techniques are measured at their defaults alone."""

    size: tuple[int, int]
    clock: Clock
    points: int
    target: float
    most: int
    budget_s: float
    variants_s: float
    pan_steps: int
    pairs: int


def effort(
    quick: bool, software: bool, size: tuple[int, int] | None, most: int | None, seconds: float | None = None
) -> Effort:
    """most, seconds: of the reference, where they are not the usual ones."""
    if quick:
        chosen = Effort(
            (256, 144) if software else (960, 540), Clock(2 if software else 32, 0.0), 16, 0.005,
            256 if software else 2048, 30.0 if software else 10.0, 150.0, 2, 4,
        )  # fmt: skip
    else:
        clock = Clock(5, 0.5, 4.0) if software else Clock(64, 0.15, 1.0)
        chosen = Effort(
            (640, 360) if software else (1920, 1080), clock, 64, 0.002, 1024 if software else 4096,
            math.inf if software else 60.0, math.inf, 8 if software else 16, 24,
        )  # fmt: skip
    if size is not None:
        if min(size) < SMALLEST:
            raise SettingError(f"--size {size[0]}x{size[1]}: a study needs at least {SMALLEST} pixels a side")
        chosen = replace(chosen, size=size)
    if seconds is not None:
        if not seconds > 0:
            raise SettingError(f"--reference-seconds {seconds:g}: a reference needs more than 0 seconds")
        chosen = replace(chosen, budget_s=seconds)
    return replace(chosen, most=most) if most is not None else chosen


class SceneStudy:
    """One scene: its reference, its cells."""

    def __init__(
        self, renderer: Renderer, name: str, scene: Scene, camera: Camera, axes: Mapping[str, Sequence[Cell]],
        spent: Effort, bounces: int, output: Path, study: Study, meter: Meter, group: str = "",
    ) -> None:  # fmt: skip
        """axes: the cells to measure, by what they are for; those of several are then put together in pairs. group: the
        scene's name where it is studied at several sizes, each under a name of its own."""
        self.renderer, self.name, self.scene, self.camera = renderer, name, scene, camera
        self.axes, self.spent, self.bounces, self.group = axes, spent, bounces, group or name
        self.folder, self.study, self.meter = output / name, study, meter
        self._crew: Crew | None = None
        self._pickled: Path | None = None  # the scene, if programs are made ahead
        self._ahead: dict[str, Future[None]] = {}  # by cell: its programs are there
        self._comparing: Comparing | None = None
        self._judge: Judge | None = None
        self._pending: list[tuple[dict[str, Any], Future[dict[str, Any]]]] = []

    def size_of_work(self) -> float:
        """In pictures of one technique, for the bar."""
        pairs = self.spent.pairs if len(self.axes) > 1 else 0
        return REFERENCE_CELLS + sum(len(cells) for cells in self.axes.values()) + pairs

    def prepare(self, crew: Crew | None) -> None:
        """Processes beside, which stand still while frames are timed; they make the programs of all cells ahead."""
        self._crew = crew
        if crew is None or not self.renderer.keeps_programs:
            return
        self._pickled = crew.hand_out(self.scene)
        self._ahead[ONCE] = crew.put(Programs(self._pickled, self.camera, self.spent.size, None))
        for cell, _ in self._wanted():
            self._compile(cell, first=False)

    def _compile(self, cell: Cell, first: bool) -> None:
        if self._crew is None or self._pickled is None or cell.key in self._ahead:
            return
        if (self.folder / f"{cell.stem}.json").is_file():
            return  # of a study that is gone on with
        job = Programs(
            self._pickled, self.camera, self.spent.size, cell.settings(Settings(exposure=0.0)),
            moving=not cell.parameters, mirrors=cell.axis_of("reflections"),
        )  # fmt: skip
        self._ahead[cell.key] = self._crew.put(job, first)

    def run(self) -> None:
        """Everything of the scene, each part kept as it is finished."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with self.study.timed(f"{self.name}: reference"):
            self.reference = self._reference()
        frame, self.exposure = develop(self.renderer, self.scene, self.camera, self.reference.radiance)
        frame.save(self.folder / "reference.png")
        frame.save(self.folder / "reference.exr", aov=())
        self._describe()
        try:
            with self.study.timed(f"{self.name}: techniques"), self.renderer.keeping(STAGINGS):
                self._cells()
        except KeyboardInterrupt:
            self._give_up()
            raise
        finally:
            if self._judge is not None:
                self._judge.release()
            if self._comparing is not None:
                self._comparing.close()

    def _wanted(self) -> list[tuple[Cell, str]]:
        wanted = [(cell, kind) for kind, cells in self.axes.items() for cell in cells]
        return sorted(wanted, key=lambda it: bool(it[0].parameters))  # something of everything first

    def _cells(self) -> None:
        seen: dict[str, dict[str, Any]] = {}
        started, left_out = time.perf_counter(), 0
        for cell, kind in self._wanted():
            if cell.parameters and time.perf_counter() - started > self.spent.variants_s:
                left_out += 1
                self.meter.end(free=True)
                continue
            self._cell(cell, kind, seen)
        self._settle()
        if left_out:
            self.study.note(f"{self.name}: {left_out} variants were left out for time; the same command adds them")
        if len(self.axes) > 1:
            cells = sweep.pairs(self._fronts(), self.spent.pairs)
            self.meter.expect(len(cells) - self.spent.pairs)
            for cell in cells:
                self._compile(cell, first=True)
            for cell in cells:
                self._cell(cell, PAIRS, seen)
            self._settle()

    def site(self) -> Site:
        """What other renderers are given and held against, once it has run."""
        return Site(
            self.name, self.scene, self.camera, self.spent.size, self.reference.radiance,
            f"{self.reference.key}-{self.reference.samples}", self.exposure, self.folder, self.reference.light,
        )  # fmt: skip

    def _describe(self) -> None:
        scene, size = self.scene, self.spent.size
        self.study.scenes[self.name] = {
            "group": self.group, "path": str(scene.path) if scene.path else None, "sha256": scene.sha256,
            "triangles": scene.triangle_count(), "instances": len(scene.instances), "lights": len(scene.lights),
            "camera": self.camera.name, "size": list(size), "exposure_ev": self.exposure,
            "reference": self.reference.to_dict() | {"png": "reference.png", "exr": "reference.exr"},
        }  # fmt: skip

    def _reference(self) -> Reference:
        """As this folder has it, so that figures of one study are all against one picture; else converged."""
        meter, spent = self.meter, self.spent
        meter.begin(f"{self.name}: reference")
        key = references.content_key(self.scene, self.camera, spent.size, self.bounces)
        asked = store.fingerprint(key, store.code_digest(), spent.target, spent.most, spent.budget_s)
        kept = store.read(self.folder / "reference.json", asked)
        if kept is not None:
            with np.load(self.folder / "reference.npz") as file:
                radiance = file["radiance"]
            meter.end(REFERENCE_CELLS, free=True)
            return Reference.from_dict(radiance, kept | {"key": key})
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
        results.mark_fronts(self.study)
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
        if cell.key in seen:
            seen[cell.key]["axes"].append(axis)
            self.meter.end(free=True)
            return
        row = store.read(path, key)
        free = row is not None
        if row is None:
            try:
                row, errors = self._measure(cell, settings, stem)
            except GlhybridError as error:
                self.study.note(f"{self.name}: {cell.label} was not measured: {error}")
                self.meter.end()
                return
            errors.add_done_callback(partial(_keep, path, key, dict(row)))
        else:
            row, errors = {k: v for k, v in row.items() if k != "key"}, Future()
            errors.set_result({})
        row |= {"axes": [axis], "cell": cell.key}
        seen[cell.key] = row
        self._pending.append((row, errors))
        self._settle(self._processes)
        self.meter.end(free=free)

    def _settle(self, most: int = 0) -> None:
        """Rows whose errors are known become the study's, until at most so many wait."""
        while self._pending and (len(self._pending) > most or self._pending[0][1].done()):
            row, errors = self._pending.pop(0)
            row |= errors.result()
            row |= {name: row.pop(name) for name in ("axes", "cell")}  # last, as where it was kept: files stay the same
            self.study.rows.append(row)

    def _give_up(self) -> None:
        """What was measured is compared yet, and kept, as far as PATIENCE_S lets; asked a second time, it is not."""
        wait([errors for _, errors in self._pending], PATIENCE_S)
        self._pending = [(row, errors) for row, errors in self._pending if errors.done()]
        self._settle()

    @cached_property
    def _processes(self) -> int:
        """That compare pictures beside this one."""
        return 0 if self.renderer.context.device.software else processes(self.spent.size)

    def _measure(self, cell: Cell, settings: Settings, stem: str) -> tuple[dict[str, Any], "Future[dict[str, Any]]"]:
        """The row but for its errors, and those."""
        args = self.renderer, self.scene, self.camera, self.spent.size
        for key in (ONCE, cell.key):
            if self._crew is not None and key in self._ahead:
                self._crew.wait(lambda: self.meter.part(0.0), self._ahead[key])
        if self._comparing is None or self._judge is None:
            truth = Truth(self.reference.radiance, self._light(), measure.specular_share(*args), self.reference.light)
            self._comparing, self._judge = Comparing(truth, self._processes), Judge(self.renderer.flip, truth)
        frame, at_rest = measure.draw(*args, settings), None
        if cell.stochastic and (not cell.parameters or papers.AXIS in self.axes):
            for radiance in measure.film(
                self.renderer, self.scene, self.camera, self.spent.size, settings, [None] * measure.REST
            ):
                at_rest = radiance
        errors = self._comparing.submit(frame, self._judge.maps(frame, at_rest), self.folder, stem)
        alone = self._crew.paused if self._crew is not None else nullcontext
        times = measure.time_frames(*args, settings, self.spent.clock, alone)
        width, height = self.spent.size
        moving = None
        if not cell.parameters:
            small = (width // 2, height // 2)
            moving = stability.pan(self.renderer, self.scene, self._pan_camera, small, settings, self.spent.pan_steps)
        parts = [errors]
        if self._mirrors is not None and cell.axis_of("reflections"):
            parts.append(self._comparing.call(_judge, self._mirrors, *self._mirrors.look(self.renderer, settings)))
        row = {
            "scene": self.name, "size": list(self.spent.size), **measure.describe(cell, times),
            "bytes": measure.memory(frame.receipt),
            "flicker": moving.flicker if moving else None,
            "flicker_p99": moving.flicker_p99 if moving else None,
            "flip_rate_percent": moving.flip_rate_percent if moving else None,
            **reflected.NOTHING,
        }  # fmt: skip
        return row, _joined(parts)

    def _light(self) -> direct.Direct | None:
        if not self.scene.lights or not self.scene.instances:
            return None
        return direct.find(self.renderer, self.scene, self.camera, self.spent.size, self.spent.points)

    @cached_property
    def _mirrors(self) -> reflected.Mirrors | None:
        return reflected.find(self.renderer, self.scene, self.camera, self.spent.size)

    @cached_property
    def _pan_camera(self) -> Camera:
        depth = stability.typical_depth(self.renderer, self.scene, self.camera)
        return stability.orthographic(self.camera, depth)


def _judge(mirrors: reflected.Mirrors, *seen: Any) -> dict[str, Any]:
    return mirrors.judge(*seen).to_dict()


def _joined(parts: "Sequence[Future[dict[str, Any]]]") -> "Future[dict[str, Any]]":
    """What all of them give, together; what one raises."""
    whole: Future[dict[str, Any]] = Future()
    left, lock = [len(parts)], Lock()

    def one_more(_: object) -> None:
        with lock:
            left[0] -= 1
            last = not left[0]
        if not last:
            return
        try:
            whole.set_result({name: value for part in parts for name, value in part.result().items()})
        except BaseException as error:
            whole.set_exception(error)

    for part in parts:
        part.add_done_callback(one_more)
    return whole


def _keep(path: Path, key: str, row: dict[str, Any], errors: "Future[dict[str, Any]]") -> None:
    """A finished cell, whatever becomes of the rest."""
    if not errors.cancelled() and errors.exception() is None:
        store.write_json(path, row | errors.result() | {"key": key})
