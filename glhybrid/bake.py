"""Bakes light maps: rays from every texel to every light, and what the host makes of their answers.

Lights without a size share dispatches, 32 of them a batch, and answer with a bit a texel; while the next batch is
traced, other threads finish the last. A light with a size, or behind tints, is traced alone.
"""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from glhybrid import layout, lightmap, lightmap_seams
from glhybrid.bvh.blas import threads_available
from glhybrid.lightmap import Lightmap
from glhybrid.scene import F32, U32
from glhybrid.setup import Setup
from glhybrid.timing import Progress

ROWS_AT_ONCE = 1 << 17  # texels in a dispatch
STAGES = (4, 16)  # rays to a light with a size: everywhere, then all of them where these find a penumbra, and so on
RAYS_AT_ONCE = 8  # of an invocation: llvmpipe ends all its loops at 65,535 turns, rays included
BATCH = 32  # lights, a bit each
BAKE_INSIDE = 2.0  # as in lib/bake.glsl

Plane = tuple[int, bytes]  # the light's number; (pages, height, width, components) uint8 visibility


class Bake:
    """One baking of some lights of a scene onto a map."""

    def __init__(self, setup: Setup, map_: Lightmap, progress: Progress | None) -> None:
        self._tracer = _Tracer(setup, map_)
        self._scene, self._map, self._progress = setup.scene, map_, progress
        self._components, settings = 4 if setup.features.blended else 1, setup.settings
        self._samples = int(settings.parameter("shadows.baked.samples"))
        try:
            self._points = self._tracer.points(progress)
        except BaseException:
            self.close()
            raise
        self._chart = np.zeros(map_.pages, np.int32)
        self._chart.reshape(-1)[map_.index] = map_.chart
        self._inside = self._points[:, 3] == BAKE_INSIDE
        valid = np.zeros(map_.pages, bool)
        valid.reshape(-1)[map_.index] = ~self._inside
        self._fill: Any = None
        if self._inside.any() and (rounds := int(settings.parameter("shadows.baked.dilation"))):
            from glhybrid.lightmap_kernels import neighbours

            self._fill = neighbours(valid, self._chart, rounds)

    def lights(self, numbers: list[int], done: Callable[[int, bytes], None]) -> Iterator[Plane]:
        """Visibility of these lights, in any order. done: called with each in another thread."""
        rows = self._scene.lights
        hard = [n for n in numbers if not rows[n].has_size and self._components == 1]
        pending: list[Future[Plane]] = []
        with ThreadPoolExecutor(threads_available()) as pool:
            for first in range(0, len(hard), BATCH):
                batch = hard[first : first + BATCH]
                several = f"s {first + 1} to" if len(batch) > 1 else ""
                what = f"baking light{several} {first + len(batch)} of {len(numbers)}"
                bits = self._tracer.hard(self._points, batch, _bar(self._progress, what))
                yield from (work.result() for work in pending)
                pending = [pool.submit(self._hard, bits, k, light, done) for k, light in enumerate(batch)]
            soft = [n for n in numbers if n not in set(hard)]
            for k, light in enumerate(soft):
                found = light, self._soft(light, f"baking light {len(hard) + k + 1} of {len(numbers)}")
                yield from (work.result() for work in pending)
                pending = []
                done(*found)
                yield found
            yield from (work.result() for work in pending)

    def _hard(self, bits: U32, bit: int, light: int, done: Callable[[int, bytes], None]) -> Plane:
        """One light of a batch."""
        plane = np.zeros((*self._map.pages, 1), np.float32)
        mask = np.uint32(1 << bit)
        plane.reshape(-1)[self._map.index] = (bits[:, 0] & mask) != 0
        found = light, self._finished(plane, (bits[:, 1] & mask) != 0)
        done(*found)
        return found

    def _soft(self, light: int, what: str) -> bytes:
        """One light by itself: a few rays everywhere, more where these find a penumbra."""
        map_, components, trace = self._map, self._components, self._tracer.trace
        sized = self._scene.lights[light].has_size
        many = self._samples if sized else 1
        rows, taken = np.arange(len(map_.index)), min(many, STAGES[0])
        sums = trace(self._points, rows, light, 0, taken, _bar(self._progress, what))
        counts = np.full(len(rows), taken)
        facing = sums[:, 3].copy()
        plane = np.zeros((*map_.pages, components), np.float32)
        flat = plane.reshape(-1, components)
        flat[map_.index] = sums[:, :components] / taken
        for upto in (*(n for n in STAGES[1:] if n < many), many) if taken < many else ():
            rows = np.flatnonzero(_uneven(plane[..., 0], self._chart).reshape(-1)[map_.index] & ~self._inside)
            bar = _bar(self._progress, f"{what}: penumbrae, {upto} rays")
            # All of them have had as many: a penumbra found later than its neighbours is caught up with.
            for had in np.unique(before := counts[rows]).tolist():
                mine = rows[before == had]
                sums[mine] += trace(self._points, mine, light, had, upto, bar)
            counts[rows] = upto
            flat[map_.index[rows]] = sums[rows, :components] / upto
        return self._finished(plane, facing <= 0, facing if sized else None)

    def _finished(self, plane: F32, away: np.ndarray, facing: F32 | None = None) -> bytes:
        """(P, H, W, C) of a light: texels in solids filled, terminators and seams mended; in bytes.

        away (N,): texels whose fronts face away from it. facing (N,): N.L, if seams are to be stitched.
        """
        from glhybrid.lightmap_kernels import fill, soften

        map_, flat = self._map, plane.reshape(-1, plane.shape[3])
        if self._fill is not None:
            fill(flat, *self._fill)
        # A facet that faces away is dark by itself, and looks up nothing; but its texels are neighbours of lit facets'.
        dark = np.zeros(plane.shape[:3], np.uint8)
        dark.reshape(-1)[map_.index] = away & ~flat[map_.index].any(1)
        soften(plane, dark, self._chart)
        if facing is not None:
            across = np.full(len(flat), -1, np.float32)
            across[map_.index] = facing
            lightmap_seams.stitch(flat, across, lightmap_seams.lookups(self._scene.geometry, map_))
        return np.rint(np.clip(plane, 0, 1) * 255).astype(np.uint8).tobytes()

    def close(self) -> None:
        """Frees what tracing needs; planes made so far stay valid."""
        self._tracer.release()


def _uneven(plane: F32, chart: np.ndarray) -> np.ndarray:
    """(P, H, W) bool: texels at most two from one of their chart that differs from a neighbour, or is between 0 and 1.

    Only there is a penumbra: all others are lit or dark by their first samples, and so are all around them.
    """
    uneven = (plane > 0) & (plane < 1)
    for axis in (1, 2):
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        a, b = tuple(ahead), tuple(behind)
        differs = (plane[a] != plane[b]) & (chart[a] == chart[b])
        uneven[a] |= differs
        uneven[b] |= differs
    for _ in range(2):
        for axis in (1, 2):
            before = uneven.copy()
            ahead, behind = [slice(None)] * 3, [slice(None)] * 3
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            uneven[tuple(ahead)] |= before[tuple(behind)]
            uneven[tuple(behind)] |= before[tuple(ahead)]
    return uneven


def _bar(progress: Progress | None, stage: str) -> Callable[[int, int], None]:
    return (lambda done, total: progress(stage, done, total)) if progress is not None else lambda done, total: None


class _Tracer:
    """The programs of the bake and their buffers, in a world rebased on its middle: no camera has a say."""

    def __init__(self, setup: Setup, map_: Lightmap) -> None:
        shaders, scene, features = setup.shaders, setup.scene, setup.features
        gl, self._scene, self._map, self._write = setup.context.gl, scene, map_, setup.context.write
        centre = np.round(scene.scene.bounds().mean(0))
        scene.rebase(centre)
        constants = np.zeros(1, layout.dtype("FrameConstants"))
        constants["top_root"], constants["light_count"] = scene.top_root, len(scene.lights)
        constants["top_grid_min"], constants["top_grid_step"] = scene.top_grid(centre)
        self._buffers = (
            {"Frame": gl.buffer(constants)}
            | {
                name: gl.buffer(reserve=16 * ROWS_AT_ONCE)
                for name in ("BakeTexels", "BakePoints", "BakeSums", "BakeBits")
            }
            | {"BakeLights": gl.buffer(reserve=4 * BATCH)}
        )
        # Both sides of everything are met: what is behind a face says whether a point is inside.
        self._push = None
        if setup.settings.parameter("shadows.baked.push"):
            self._push = shaders.compute("baked_push", features.replace(single_sided=False))
        self._compute = lambda stem: shaders.compute(stem, features)  # only what some light asks for is compiled
        self._reach = lightmap.REACH / map_.density

    def _dispatch(self, program: Any, count: int, **more: Any) -> None:
        across = min(count, 1 << 16)
        given = {**self._scene.resources, **self._buffers, "bake_count": count, **more}
        program.dispatch(given, (across, math.ceil(count / across)), (64, 1))

    def _load(self, rows: np.ndarray) -> None:
        map_ = self._map
        bary = np.ascontiguousarray(map_.bary[rows], np.float32).view(np.uint32)
        self._write(self._buffers["BakeTexels"], np.column_stack([map_.instance[rows], map_.triangle[rows], bary]))

    def _read(self, name: str, count: int) -> F32:
        return np.frombuffer(self._buffers[name].read(16 * count), np.float32).reshape(-1, 4)

    def points(self, progress: Progress | None) -> F32:
        """(N, 4) float32 of all texels: where those that were in a solid are now, and BAKE_*."""
        found = np.zeros((len(self._map.index), 4), np.float32)
        if self._push is None:
            return found
        bar = _bar(progress, "placing texels")
        for rows in _parts(np.arange(len(found))):
            self._load(rows)
            self._dispatch(self._push, len(rows), bake_reach=self._reach)
            found[rows] = self._read("BakePoints", len(rows))
            bar(int(rows[-1]) + 1, len(found))
        return found

    def hard(self, points: F32, lights: list[int], bar: Callable[[int, int], None]) -> U32:
        """(N, 2) uint32 over all texels: a bit for each of these lights that arrives, and that their fronts face away
        from."""
        found, program = np.zeros((len(points), 2), np.uint32), self._compute("baked_hard")
        self._write(self._buffers["BakeLights"], np.array(lights, np.uint32))
        for part in _parts(np.arange(len(points))):
            self._load(part)
            self._write(self._buffers["BakePoints"], np.ascontiguousarray(points[part]))
            for first in range(0, len(lights), RAYS_AT_ONCE):
                end = min(first + RAYS_AT_ONCE, len(lights))
                self._dispatch(program, len(part), bake_first=first, bake_end=end)
            bits = self._buffers["BakeBits"].read(8 * len(part))
            found[part] = np.frombuffer(bits, np.uint32).reshape(-1, 2)
            bar(int(part[-1]) + 1, len(points))
        return found

    def trace(
        self, points: F32, rows: np.ndarray, light: int, first: int, end: int,
        bar: Callable[[int, int], None],
    ) -> F32:  # fmt: skip
        """(N, 4) float32 over texels `rows` (N,): how much of samples first to end of one light arrives, summed."""
        found, program = np.zeros((len(rows), 4), np.float32), self._compute("baked_trace")
        done = 0
        for part in _parts(rows):
            self._load(part)
            self._write(self._buffers["BakePoints"], np.ascontiguousarray(points[part]))
            for sample in range(first, end, RAYS_AT_ONCE):
                self._dispatch(
                    program, len(part), bake_light=light, bake_first=sample,
                    bake_end=min(sample + RAYS_AT_ONCE, end), bake_more=sample > first,
                )  # fmt: skip
            found[done : done + len(part)] = self._read("BakeSums", len(part))
            done += len(part)
            bar(done, len(rows))
        return found

    def release(self) -> None:
        for buffer in self._buffers.values():
            buffer.release()


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    return [rows[k : k + ROWS_AT_ONCE] for k in range(0, len(rows), ROWS_AT_ONCE)]
