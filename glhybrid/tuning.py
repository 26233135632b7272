"""What a device is good at, measured once and kept: whether to rasterise or to trace what the camera sees, and which
variant of the tracer to run.

The model of primary visibility has three rates: the raster costs something a pixel and something a triangle, rays cost
something a pixel. They are measured on two scenes of unequal size; the plan then compares both for the scene at hand.
GLHYBRID_TUNING=off measures nothing and goes by the rule of thumb, as does GLHYBRID_CACHE=off, which keeps nothing.
"""

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from glhybrid import content_cache

if TYPE_CHECKING:
    from glhybrid.context import Context
    from glhybrid.shaders import Shaders

VERSION = 1  # of what is measured and kept
ALL_STEPS = 1 << 20  # inner nodes in a row: until a leaf
BUDGET_S = 1.2  # variants that would begin later than this are not tried
FEW, MANY = 2_000, 20_000  # triangles of the two scenes
WARM_UP_S = 0.3  # of unpaced work, after which a GPU has raised its clock
WORTH = 1.1  # a variant replaces the first one only if it is faster by this: one small scene says little of others
VISIBILITY = "primary visibility"  # what the reason for it begins with
_GPU = "compute reaches a GPU's memory faster than its raster units"


@dataclass(frozen=True)
class Tuning:
    """Rates of one device. inner_steps: the fastest variant; variants: ns a ray by inner steps, of those tried.

    raster_ns_pixel, raster_ns_triangle, trace_ns_pixel: nanoseconds of an idle device.
    source: measured, kept, or rule where nothing was measured.
    """

    raster_ns_pixel: float
    raster_ns_triangle: float
    trace_ns_pixel: float
    inner_steps: int
    variants: dict[str, float]
    took_s: float
    source: str = "measured"

    def primary(self, pixels: int, triangles: int) -> tuple[str, str]:
        """raster or trace for that many pixels and drawn triangles, and why."""
        raster = 1e-6 * (pixels * self.raster_ns_pixel + triangles * self.raster_ns_triangle)
        trace = 1e-6 * pixels * self.trace_ns_pixel
        chosen = "raster" if raster <= trace else "trace"
        said = f"{VISIBILITY} is {'rasterised' if chosen == 'raster' else 'traced'}: "
        if self.source == "rule":
            why = "a CPU rasterises faster than it traces" if chosen == "raster" else _GPU
            return chosen, said + why
        return chosen, f"{said}by this device's rates {raster:.3g} ms by raster, {trace:.3g} by rays"

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON, as it is kept on disk."""
        return asdict(self)


def rule(software: bool) -> Tuning:
    """Without a measurement: CPUs rasterise, GPUs trace."""
    raster, trace = (0.0, 1.0) if software else (1.0, 0.0)
    return Tuning(raster, 0.0, trace, candidates(software)[0], {}, 0.0, "rule")


def tuned(context: "Context") -> Tuning:
    """Of this device: kept from before, else measured now and kept. What is kept and damaged is measured again."""
    if "off" in (os.environ.get("GLHYBRID_TUNING"), os.environ.get("GLHYBRID_CACHE")):
        return rule(context.device.software)
    from glhybrid.shaders import Shaders

    shaders = Shaders(context)
    try:
        name = cache_key(context, shaders)
        found = _read(content_cache.read("tuning", name))
        if found is None:
            found = measure(context, shaders)
            content_cache.write("tuning", name, json.dumps(asdict(found)).encode())
    finally:
        shaders.release()
    return found


def cache_key(context: "Context", shaders: "Shaders") -> str:
    """Of the driver, its device and threads, and of the shaders that are measured."""
    device, threads = context.device, os.environ.get("LP_NUM_THREADS", "")
    about = [VERSION, device.vendor, device.renderer, device.version, threads, os.cpu_count()]
    return content_cache.key(json.dumps(about).encode(), shaders.text("gbuffer"), shaders.text("tuning"))


def _read(data: bytes | None) -> Tuning | None:
    """What was kept, or None unless every rate is a positive number."""
    try:
        kept = Tuning(**json.loads(data or b""))
        rates = [kept.raster_ns_pixel, kept.trace_ns_pixel, kept.took_s, *kept.variants.values()]
        fine = all(0 < float(rate) < math.inf for rate in rates) and 0 <= float(kept.raster_ns_triangle) < math.inf
        if not fine or str(kept.inner_steps) not in kept.variants:
            return None
    except (ValueError, TypeError, AttributeError):
        return None
    return Tuning(**{**asdict(kept), "source": "kept"})


def candidates(software: bool) -> tuple[int, ...]:
    """Inner steps worth a try, the likeliest first.

    What lost to the first everywhere on both kinds of device is no variant, % of the rate: nodes through storage blocks
    (H100 4 to 8, llvmpipe 20 to 35) or of 64 bytes with float planes (H100 3 to 15, llvmpipe 5); the stack in shared
    memory (H100 40 to 60); work groups of 32 (H100 1 to 7); boxes as centre and half extent, a stack that drops what is
    behind the hit, the top of the stack in a register, projecting instead of shearing triangles (H100 1 to 14);
    the minimum of both planes instead of the near one by sign (H100 4 to 9); two triangles a turn (llvmpipe 4).
    Groups of 128 rays or 16x8 pixels, and rows instead of Morton order, are within 1 of 64 and 8x8. On an H100 one step
    is 5 to 30 behind 4, two are 2 to 9, six and eight up to 4; all at once is up to 5 ahead in one scene and 3 to 25
    behind in others. Of frames in one level, 5 steps take 0.4 to 2 less than 4, 6 to 12 up to 4 more than 5.
    """
    return (ALL_STEPS, 3) if software else (5, 4, 3, ALL_STEPS)


def measure(context: "Context", shaders: "Shaders") -> Tuning:
    """Takes about a second: two small scenes are built, drawn and traced."""
    started = time.perf_counter()
    size = (320, 192) if context.device.software else (1920, 1088)
    pixels = size[0] * size[1]
    few, many = (_Stage(context, shaders, triangles, size) for triangles in (FEW, MANY))
    try:
        works = {"few": few.raster(), "many": many.raster(), "trace": many.trace()}
        times = _race(context, works, warm_up_s=0.0 if context.device.software else WARM_UP_S)
        triangle = max(times["many"] - times["few"], 0.0) / (many.triangles - few.triangles)
        pixel = max(times["few"] - triangle * few.triangles, 0.05 * times["few"]) / pixels
        tried: dict[str, Callable[[], Any]] = {}
        for candidate in candidates(context.device.software):  # all compiled first: a GPU that waits lowers its clock
            if tried and time.perf_counter() - started > BUDGET_S:
                break
            tried[str(candidate)] = many.rays(candidate)
        costs = _race(context, tried, warm_up_s=0.0 if context.device.software else WARM_UP_S)
        variants = {name: cost / pixels * 1e9 for name, cost in costs.items()}
        first, best = next(iter(variants)), min(variants, key=lambda name: variants[name])
        steps = int(best if variants[best] * WORTH < variants[first] else first)
    finally:
        few.release()
        many.release()
    took = time.perf_counter() - started
    return Tuning(1e9 * pixel, 1e9 * triangle, 1e9 * times["trace"] / pixels, steps, variants, took)


def _race(context: "Context", works: dict[str, Callable[[], Any]], warm_up_s: float = 0.0) -> dict[str, float]:
    """Seconds a launch by the clock: the least over some rounds in turns, so that a busy neighbour counts little."""
    software, finish = context.device.software, context.gl.finish
    for work in works.values():
        work()
    finish()
    started = time.perf_counter()
    while time.perf_counter() - started < warm_up_s:
        for work in works.values():
            work()
        finish()
    launches, rounds = (1, 4) if software else (16, 4)
    best = dict.fromkeys(works, math.inf)
    for _ in range(rounds):
        for name, work in works.items():
            begun = time.perf_counter()
            for _ in range(launches):
                work()
            finish()
            best[name] = min(best[name], (time.perf_counter() - begun) / launches)
    return {name: max(seconds, 1e-9) for name, seconds in best.items()}


class _Stage:
    """One small scene on the device, with the passes that are compared."""

    def __init__(self, context: "Context", shaders: "Shaders", triangles: int, size: tuple[int, int]) -> None:
        from glhybrid import geometry, kernels, needs
        from glhybrid.bench import scenes
        from glhybrid.frame_constants import FrameConstants
        from glhybrid.gpu_scene import GpuScene
        from glhybrid.settings import Settings
        from glhybrid.targets import Targets
        from glhybrid.view import make_view

        scene, software = scenes.make("spheres", triangles), context.device.software
        with kernels.TREES.left_alone():  # no reason to compile: trees of spheres are as cheap without
            found = geometry.build(scene, 1, tangents=False, attributes=False)
        features = needs.find(scene, Settings()).features.replace(
            clip_control=context.limits.clip_control,
            buffer_array=software,
            branchless=software,
            bvh_inner_steps=candidates(software)[0],
        )
        self.context, self.shaders, self.size, self.triangles = context, shaders, size, scene.triangle_count()
        self.upload = GpuScene(context, scene, found, features)
        self.features = features.replace(bvh_stack=self.upload.stack_entries)
        self.constants = FrameConstants(context, scene, Settings())
        view = make_view(scene.cameras[0], size, scene, context.limits.clip_control)
        self.upload.rebase(view.origin)
        self.constants.look(view, len(scene.lights))
        self.constants.upload()
        self.upload.resources["Frame"] = self.constants.buffer
        self.targets = Targets(context, size)
        self._passes: list[Any] = []

    def raster(self) -> Callable[[], Any]:
        from glhybrid.passes.gbuffer import GBufferRaster

        drawn = GBufferRaster(self.context, self.shaders, self.upload, self.features)
        self._passes.append(drawn)
        return lambda: drawn.run(self.targets)

    def trace(self) -> Callable[[], Any]:
        from glhybrid.passes.gbuffer import GBufferTrace

        traced = GBufferTrace(self.shaders, self.upload, self.features)
        return lambda: traced.run(self.targets)

    def rays(self, inner_steps: int) -> Callable[[], Any]:
        """Every pixel's camera ray, one that leaves its hit in a random direction, and a shadow ray."""
        program = self.shaders.compute("tuning", self.features.replace(bvh_inner_steps=inner_steps))
        given = {**self.upload.resources, "out_id": self.targets.get("gbuffer_id")}
        return lambda: program.dispatch(given, self.size)

    def release(self) -> None:
        for made in self._passes:
            made.release()
        self.targets.release()
        self.constants.release()
        self.upload.release()
