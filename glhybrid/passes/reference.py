"""The progressive path tracer: what all techniques are held against.

A wave of paths goes from surface to surface together: `extend` finds what each meets, `shade` decides there how it goes
on and where light may come from, `connect` looks whether it does. Who ends leaves the list, so that lanes stay at work,
and no program holds more than one traversal; a list's length stays on the device, which dispatches by it.
Laine, Karras, Aila, "Megakernels Considered Harmful", HPG 2013.
"""

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from glhybrid.context import Context
from glhybrid.emitters import emitter_rows
from glhybrid.gpu_scene import GpuScene
from glhybrid.layout import CONSTANTS
from glhybrid.needs import Features
from glhybrid.owned import Owned
from glhybrid.pace import Bands, spread_rows
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets

TILE = 64  # pixels
WAVE, SOFTWARE_WAVE = 1 << 20, 1 << 13  # paths: enough for a GPU's lanes at the last bounces; as fit a CPU's caches
SAMPLES_AT_ONCE = 16  # in a wave on a GPU, of small pictures


class Reference:
    """Owns the tables that light is sampled by, what shines, and the lists of paths."""

    name = "reference"

    def __init__(self, context: Context, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        software = context.device.software
        self._context, self._pace, self._bands = context, shaders.pace, Bands()
        self._owned = Owned()
        self._resources = dict(scene.resources)
        self._scene = scene
        self.emissive_weight = 0.0
        self._wave, self._at_once = (SOFTWARE_WAVE, 1) if software else (WAVE, SAMPLES_AT_ONCE)
        if features.emitters:
            rows, self.emissive_weight = emitter_rows(scene.geometry)
            features = features.replace(emitters=len(rows) > 0)
            if len(rows):
                self._resources["Emitters"] = self._owned.add(context.gl.buffer(rows.tobytes()))
        self._kinds = 1 + features.environment + features.emitters  # of light
        programs = (shaders.compute(f"reference_{part}", features) for part in ("extend", "shade", "connect", "mean"))
        self._extend, self._shade, self._connect, self._mean = programs
        self._lists: Any = None
        self._counts: Any = None

    def run(self, targets: Targets, staged: Any, timing: Any, progress: Any) -> Any:
        """Averages settings.samples paths a pixel -> radiance."""
        radiance = targets.get("radiance")
        for done, _ in self.steps(targets, staged, timing):
            if progress is not None:
                progress("samples", done, staged.settings.samples)
        return radiance

    def steps(self, targets: Targets, staged: Any, timing: Any) -> Iterator[tuple[int, Any]]:
        """(paths a pixel so far, radiance) after each wave, until settings.samples are averaged.

        Between waves anything may be drawn; some rows of the image then have more paths than others.
        """
        settings = staged.settings
        across, down = (-(-n // 8) for n in targets.size)
        # Of a wave at most; what a picture's samples are averaged by must not depend on the pace.
        most_rows = max(min(self._wave // (TILE * across), down), 1)
        at_once = max(min(self._wave // (TILE * across * down), self._at_once), 1)
        slots = TILE * across * most_rows * at_once
        radiance = targets.get("radiance")
        resources = {**self._resources, **self._room(targets, slots, settings.bounces), "radiance": radiance}
        spread = 0.0 if settings.aa == 1 else 1.0
        done = 0
        while done < settings.samples:
            count = min(at_once, settings.samples - done)
            for first, every, rows in spread_rows(down, partial(self._most, most_rows, across * count)):
                if first:
                    yield done, radiance
                timing.frame()
                staged.set(
                    sample_first=done, sample_count=count, jitter_px=(spread, spread),
                    emissive_weight=self.emissive_weight,
                )  # fmt: skip
                resources["wave"] = (first | every << 16, across * rows, count, -(-slots // CONSTANTS["PATH_WIDTH"]))
                timing.run("reference", lambda: self._paced(resources, settings.bounces))
            done += count
            yield done, radiance

    def _most(self, rows: int, tiles: int) -> int:
        """Rows of so many tiles in a wave."""
        return min(self._bands.rows(tiles), rows) if self._pace.on else rows

    def _paced(self, resources: dict[str, Any], bounces: int) -> None:
        """One wave, timed where the pace wants to know."""
        start = time.perf_counter()
        self._run_wave(resources, bounces)
        if self._pace.on:
            self._context.raw.glFinish()  # unlike moderngl's, it lets other threads go on
            _, tiles, samples, _ = resources["wave"]
            self._bands.note(tiles * samples, (time.perf_counter() - start) * 1e3, self._pace.band_ms)

    def _run_wave(self, resources: dict[str, Any], bounces: int) -> None:
        _, tiles, samples, _ = resources["wave"]
        counts, none = self._counts
        self._context.gl.copy_buffer(counts, none)
        lists = CONSTANTS["PATH_LISTS"]
        all_paths = (TILE * tiles * samples, 1)
        for depth in range(bounces + 2):
            resources["depth"] = depth
            row = 16 * lists * depth
            for program in (self._extend, self._shade):
                if depth == 0:
                    program.dispatch(resources, all_paths, (TILE, 1))
                else:
                    program.dispatch_indirect(resources, counts, row)
            # These and the next `extend` read and write nothing of each other: one's last rays do not keep the others.
            if depth <= bounces:
                for kind in range(0 if len(self._scene.lights) else 1, self._kinds):
                    resources["light_list"] = kind + 1
                    self._connect.dispatch_indirect(resources, counts, row + 16 * (kind + 1), wait=False)
        self._mean.dispatch(resources, (TILE * tiles, 1), (TILE, 1))

    def _room(self, targets: Targets, slots: int, bounces: int) -> dict[str, Any]:
        """What so many paths are kept in."""
        width = CONSTANTS["PATH_WIDTH"]
        rows = -(-slots // width)
        parts = CONSTANTS["PATH_PARTS"] + CONSTANTS["PATH_LIGHT_PARTS"] * self._kinds
        size = 4 * rows * width * (2 + self._kinds)
        if self._lists is None or self._lists.size != size:
            self._free(self._lists)
            self._lists = self._owned.add(self._context.gl.buffer(reserve=size))
        none = np.zeros((bounces + 3, CONSTANTS["PATH_LISTS"], 4), np.uint32)
        none[..., 1:3] = 1
        if self._counts is None or self._counts[0].size != none.nbytes:
            self._free(*self._counts or ())
            self._counts = tuple(self._owned.add(self._context.gl.buffer(none.tobytes())) for _ in range(2))
        paths = targets.get("paths", size=(width, rows * parts))
        return {"paths": paths, "PathLists": self._lists, "PathCounts": self._counts[0]}

    def _free(self, *owned: Any) -> None:
        for one in owned:
            if one is not None:
                self._owned.remove(one)
                one.release()

    def release(self) -> None:
        self._owned.release()
