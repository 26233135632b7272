"""`glhybrid bench`: how fast this machine traces, draws and builds, and that all that is timed finds the same hits.

run -> for every scene: scenes.make or a file -> rays.Tracer -> clock -> check -> Row
       frames.measure, builds.measure -> Report
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid import kernels
from glhybrid.bench import builds, clock, frames, peers, scenes
from glhybrid.bench.clock import Sample
from glhybrid.bench.rays import ANY_HIT, CLASSES, MOST_RAYS, Tracer, Variant, variants
from glhybrid.bench.report import Report, Row, machine, sm_clock_mhz
from glhybrid.context import Context
from glhybrid.errors import SettingError, unknown
from glhybrid.scene import Scene
from glhybrid.shaders import Shaders
from glhybrid.view import choose_camera

Progress = Callable[[str, int, int], None]
SIZES = {"10k": 10_000, "100k": 100_000, "1m": 1_000_000, "4m": 4_000_000}
QUICK_SIZES = ("10k", "100k", "1m")
TUNED = ("hall", "100k")  # where --quick tries every variant
SAME_T = 1e-5  # relative: one tree, one arithmetic
SAME_PLACE = 1e-3  # relative: vertices rounded otherwise, so that grazing rays meet the surface elsewhere
ROUNDING = 4 * 2.0**-24  # of the largest coordinate: what float32 cannot tell
OTHER_ROUNDING = 1e-4  # share of rays that may differ where vertices are rounded otherwise, or edges are not watertight
PEERS = ("embree", "embree_fast", "mitsuba")
FEW = 4  # rays that make no share
Works = dict[tuple[str, Any], tuple[Callable[[], None], Callable[[], NDArray[Any]]]]


def run(
    names: Sequence[str] = (),
    *,
    quick: bool = False,
    with_peers: bool = False,
    device: str = "auto",
    size: tuple[int, int] | None = None,
    load: Callable[[str], Scene] | None = None,
    progress: Progress = lambda stage, done, total: None,
    context: Context | None = None,
) -> Report:
    """Measures the scenes named, or the bench's own and the built-in ones.

    names: files, built-in scenes, or scenes of the bench as `hall`, `hall:100k`. size: pixels, one ray of each class
    for each; default 1920x1080 on a GPU, 1280x720 or, if quick, 480x270 on a software rasteriser.
    Raises what loading, devices and shaders raise. A hit that differs is no exception but one of `failures`.
    """
    from glhybrid.context import open_context

    # Everything that can be refused is refused before any work is done.
    if size is not None and size[0] * size[1] > MOST_RAYS:
        raise SettingError(f"--size {size[0]}x{size[1]}: the bench sends at most {MOST_RAYS:,} rays of a class")
    own = [name for name in names if name.partition(":")[0] in scenes.SITES]
    jobs = [job for name in own or ([] if names else scenes.SITES) for job in _sizes(name, quick)]
    files = {name: (load or _load)(name) for name in names if name not in own}
    kernels.load_all()
    opened = context or open_context(device)
    try:
        return _Bench(opened, quick, with_peers, size, progress).run(jobs, files, load or _load, builtin=not names)
    finally:
        if context is None:
            opened.close()


def _load(name: str) -> Scene:
    import glhybrid

    return glhybrid.load(name)


def _sizes(name: str, quick: bool) -> list[tuple[str, str]]:
    """`hall:100k` -> that site at that size; `hall` -> at all sizes."""
    site, _, size = name.partition(":")
    if not size:
        return [(site, size) for size in (QUICK_SIZES if quick else SIZES)]
    if size.lower() not in SIZES:
        raise SettingError(f"{name}: {unknown('size', size, SIZES)}")
    return [(site, size.lower())]


class _Bench:
    def __init__(
        self, context: Context, quick: bool, with_peers: bool, size: tuple[int, int] | None, progress: Progress
    ) -> None:
        self.context, self.quick, self.with_peers, self.progress = context, quick, with_peers, progress
        self.software = context.device.software
        small = (480, 270) if quick else (1280, 720)
        self.size = size or (small if self.software else (1920, 1080))
        self.repeats = (3 if quick else 7) if self.software else (20 if quick else 50)
        self.shaders = Shaders(context)
        self.report = Report(
            machine(
                context.device.to_dict(),
                cores=clock.cores(context),
                size=list(self.size),
                quick=quick,
                repeats=self.repeats,
                warm_up_s=0.0 if self.software else clock.WARM_UP_S,
                clock="CPU time / cores" if self.software else "GL timestamps",
            )
        )
        if with_peers:
            for missing in (peers.Embree.missing, peers.mitsuba_missing()):
                if missing:
                    self.report.note(f"skipped: {missing}")

    def run(
        self, jobs: list[tuple[str, str]], files: dict[str, Scene], load: Callable[[str], Scene], builtin: bool
    ) -> Report:
        """jobs: sites and sizes. files: scenes by name, traced and drawn. builtin: draw the built-in scenes as well."""
        drawn: dict[str, Scene | None] = dict(files) | {name: None for name in (_builtin() if builtin else ())}
        total, done = len(jobs) + len(files) + len(drawn), 0
        try:
            for site, size in jobs:
                self.progress(f"rays: {site} {size}", done, total)
                everything = not self.quick or not builtin or (site, size) == TUNED
                self.trace(site, scenes.make(site, SIZES[size]), everything, build=site == jobs[0][0])
                done += 1
            for name, scene in files.items():
                self.progress(f"rays: {name}", done, total)
                self.trace(Path(name).stem, scene, everything=True, build=True)
                done += 1
            for name, given in drawn.items():
                self.progress(f"frames: {name}", done, total)
                self.draw(Path(name).stem, given or load(name))
                done += 1
        finally:
            self.shaders.release()
        self.progress("done", total, total)
        return self.report

    def draw(self, name: str, scene: Scene) -> None:
        """Whole frames of a scene as it is."""
        from glhybrid.renderer import Renderer

        with Renderer(context=self.context) as renderer:
            repeats = (3 if self.quick else 7) if self.software else 100
            self.report.frames.append(frames.measure(renderer, name, scene, self.size, repeats))

    def trace(self, name: str, scene: Scene, everything: bool, build: bool) -> None:
        """All classes of rays of one scene by every variant, or by the renderer's own, and by the peers."""
        with Tracer(self.context, self.shaders, scene, choose_camera(scene, None), self.size) as tracer:
            tried = variants(tracer.scene, self.software) if everything else [tracer.own]
            classes = [c for c in CLASSES if len(tracer.rays[c])]
            for missing in set(CLASSES) - set(classes):
                self.report.note(f"{name}: the camera sees nothing that sends {missing} rays")
            ours: Works = {(c, v): tracer.launch(c, v) for c in classes for v in tried}
            corners = tracer.triangles() if self.with_peers or build else None
            theirs: Works = {}
            if self.with_peers and corners is None:
                self.report.note(f"{name}: no peers, for it has analytic spheres or too many triangles to flatten")
            elif self.with_peers and not peers.Embree.missing and corners is not None:
                embrees = [peers.Embree(corners, fast) for fast in (False, True)]
                theirs = {(c, e.name): e.launch(c, tracer.rays[c]) for c in classes for e in embrees}
            samples = self._time(ours, theirs)
            found = {key: read() for key, (_, read) in (ours | theirs).items()}
            if self.with_peers and corners is not None and not peers.mitsuba_missing():
                answers, why = peers.ask_mitsuba(corners, {c: tracer.rays[c] for c in classes}, self.repeats)
                if why:
                    self.report.note(f"{name}: {why}")
                for c, (sample, result) in answers.items():
                    samples[c, "mitsuba"], found[c, "mitsuba"] = sample, result
            self._check(name, tracer, found)
            self._rows(name, scene, tracer, samples)
            if build and corners is not None:
                self.report.builds.append(builds.measure(name, corners, 1 if self.quick else 3))

    def _time(self, ours: Works, theirs: Works) -> dict[tuple[str, Any], Sample]:
        """A software rasteriser and its peers in turns; a GPU first, without a pause."""
        finish = self.context.gl.finish
        if self.software:
            return clock.on_cpu({key: work for key, (work, _) in (ours | theirs).items()}, self.repeats, finish)
        samples = clock.on_gpu(self.context, {key: work for key, (work, _) in ours.items()}, self.repeats)
        if "sm_clock_mhz" not in self.report.machine:
            self.report.machine["sm_clock_mhz"] = sm_clock_mhz(self.context.device.cuda)
        return samples | clock.on_cpu({key: work for key, (work, _) in theirs.items()}, 3)

    def _check(self, name: str, tracer: Tracer, found: dict[tuple[str, Any], NDArray[Any]]) -> None:
        """Every variant and peer against the renderer's own variant, ray by ray."""
        for (c, who), result in found.items():
            own = found[c, tracer.own]
            same_tree = isinstance(who, Variant) and who.levels == tracer.own.levels
            wrong = differing(c, own, result, tracer.extent, SAME_T if same_tree else SAME_PLACE)
            if len(wrong) > (0 if same_tree else max(OTHER_ROUNDING * len(own), FEW)):
                i = int(wrong[0])
                self.report.failures.append(
                    f"{name}, {tracer.scene.triangle_count()} triangles, {c} rays: {who} differs from {tracer.own} at "
                    f"{len(wrong)} of {len(own)}, first at ray {i}: {result[i]} against {own[i]}"
                )

    def _rows(self, name: str, scene: Scene, tracer: Tracer, samples: dict[tuple[str, Any], Sample]) -> None:
        per_core = {
            key: _rate(tracer, key[0], s.median("cpu")) for key, s in samples.items() if isinstance(key[1], str)
        }
        cores = clock.cores(self.context)
        for (c, who), sample in samples.items():
            ours = isinstance(who, Variant)
            kind = "cpu" if self.software or not ours else ("gpu" if sample.gpu else "wall")
            rate = _rate(tracer, c, sample.median(kind))
            row = Row(
                name, scene.triangle_count(), c, str(who), len(tracer.rays[c]), kind, rate, sample.spread(kind),
                wall_ms=sample.median("wall"), cpu_ms=sample.median("cpu"),
                gpu_ms=sample.median("gpu") if sample.gpu else None,
                own=who == tracer.own, peer=not ours,
                **{f"ratio_{name}_per_core": rate / per_core[c, name] for name in PEERS if (c, name) in per_core},
            )  # fmt: skip
            if kind == "wall" and not self.software:
                self.report.note("this driver's timer queries disagree with the clock: rates are by wall time")
            if ours and self.software:
                row = replace(row, mrays_s=rate * cores)
            if who == tracer.own and not self.quick:
                row = replace(row, steps_per_ray=tracer.steps(c, tracer.own))
            self.report.rows.append(row)


def _builtin() -> list[str]:
    from glhybrid.load.builtin import scenes as builtin_scenes

    return [scene.name for scene in builtin_scenes()]


def _rate(tracer: Tracer, name: str, milliseconds: float) -> float:
    """Million rays a second."""
    return len(tracer.rays[name]) / max(milliseconds, 1e-6) / 1e3


def differing(
    name: str, own: NDArray[Any], other: NDArray[Any], extent: float, tolerance: float = SAME_T
) -> NDArray[np.int64]:
    """Rays of a class for which two answers differ: in being blocked, in hitting at all, or in the distance."""
    if name == ANY_HIT:
        return np.flatnonzero(own.astype(bool) != other.astype(bool))
    a, b = own.astype(np.float64), other.astype(np.float64)
    hit = np.isfinite(a)
    with np.errstate(invalid="ignore"):
        far = ~(np.abs(a - b) <= tolerance * np.abs(a) + ROUNDING * extent)
    return np.flatnonzero((hit != np.isfinite(b)) | hit & far)
