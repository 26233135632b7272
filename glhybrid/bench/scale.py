"""`glhybrid bench --scale`: what a frame costs against triangles, pixels, lights and instances, one at a time.

Every curve is fitted by a power law, least squares of the logarithms: time ~ value ** exponent. A point that a device
refuses, that memory does not hold or that would take too long ends its curve, and the curve says so.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glhybrid import kernels
from glhybrid.bench import clock, scenes
from glhybrid.bench.frames import HOST_SIZE, host_seconds, steady_frame
from glhybrid.bench.report import machine
from glhybrid.errors import GlhybridError
from glhybrid.scene import Environment, Instance, Light, Material, Mesh, Scene
from glhybrid.settings import Settings
from glhybrid.timing import Timing

if TYPE_CHECKING:
    from glhybrid.context import Context
    from glhybrid.renderer import Renderer

Progress = Callable[[str, int, int], None]
SITE, TRIANGLES = "spheres", 100_000  # where nothing else is said
SIZES = {
    "90p": (160, 90), "180p": (320, 180), "360p": (640, 360), "540p": (960, 540), "720p": (1280, 720),
    "1080p": (1920, 1080), "1440p": (2560, 1440), "2160p": (3840, 2160),
}  # fmt: skip
VALUES: dict[str, tuple[int, ...]] = {
    "triangles": (10_000, 30_000, 100_000, 260_000, 1_000_000, 4_000_000, 10_000_000, 16_000_000),
    "pixels": tuple(w * h for w, h in list(SIZES.values())[2:]),
    "lights": (1, 4, 16, 64, 256),
    "instances": (1, 10, 100, 1_000, 10_000, 100_000, 1_000_000),
}
QUICK: dict[str, tuple[int, ...]] = {
    "triangles": (10_000, 100_000, 1_000_000),
    "pixels": tuple(w * h for w, h in list(SIZES.values())[:3]),  # below 360p: minutes in software
    "lights": (1, 4, 16),
    "instances": (1, 100, 10_000),
}
BYTES_A_TRIANGLE = 500  # at its peak: mesh, tree, builder, and a copy on a device that shares our memory
LONGEST_S = 60.0  # of one point; quick: a quarter
BALL = 320  # triangles of what is repeated


@dataclass(frozen=True)
class Point:
    """One measurement. frame_ms: median by `clock`; wall_ms: the same by the wall, from finish() to finish()."""

    value: int
    triangles: int
    instances: int
    lights: int
    size: tuple[int, int]
    primary: str
    clock: str
    frame_ms: float
    spread: float
    wall_ms: float
    passes: dict[str, float]
    host_us: float
    build_ms: float
    stage_ms: float
    buffer_bytes: int

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON; passes as in the receipt."""
        passes = [{"name": name, "ms": ms} for name, ms in self.passes.items()]
        return {**self.__dict__, "size": list(self.size), "passes": passes}


@dataclass
class Curve:
    """over: what changes. ended: why no further value was measured."""

    over: str
    points: list[Point] = field(default_factory=list)
    ended: str = ""

    @property
    def exponents(self) -> dict[str, float]:
        """Of the frame, of each pass, of the host and of the tree's build; from three points on."""
        found = {
            "frame": [p.frame_ms for p in self.points], "host": [p.host_us for p in self.points],
            "build": [p.build_ms for p in self.points],
        }  # fmt: skip
        for name in self.points[0].passes if self.points else ():
            found[name] = [p.passes.get(name, 0.0) for p in self.points]
        values = [p.value for p in self.points]
        return {name: exponent(values, row) for name, row in found.items() if len(row) > 2 and min(row) > 0}

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON, with its exponents."""
        points = [p.to_dict() for p in self.points]
        return {"over": self.over, "points": points, "exponents": self.exponents, "ended": self.ended}


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope of log y over log x, least squares."""
    return float(np.polyfit(np.log(np.asarray(x, np.float64)), np.log(np.asarray(y, np.float64)), 1)[0])


@dataclass
class Scaling:
    """What `glhybrid bench --scale` found."""

    machine: dict[str, Any]
    curves: list[Curve] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"machine": self.machine, "curves": [curve.to_dict() for curve in self.curves]}


def subject(triangles: int = TRIANGLES, lights: int = 1) -> Scene:
    """The bench's spheres, all of them mirrors, under a plain sky and one sun or many lamps."""
    scene = scenes.make(SITE, triangles)
    low, high = scene.bounds()
    lamps = [
        Light("point", intensity=400.0 / lights, position=(float(x), float(high[1] + 3), float(z)))
        for x, z in _spread(lights, low, high)
    ]
    sky = Environment(np.full((1, 1, 3), 0.4, np.float32))
    return scene.replace(
        materials=(Material(roughness=0.2, double_sided=True),),
        lights=scene.lights if lights == 1 else tuple(lamps),
        environment=sky,
    )


def crowd(instances: int) -> Scene:
    """Balls of BALL triangles on a square grid that fills the same picture whatever their number."""
    ball = scenes.ball(BALL)
    side = math.ceil(math.sqrt(instances))
    base = subject(scenes.SMALLEST)
    low, high = base.bounds()
    step = (high - low)[[0, 2]] / side
    drawn = [Instance(0, np.eye(4), "floor", (0,))]
    size = 0.4 * float(step.min())
    k, poses = np.arange(instances), np.tile(np.diag([size, size, size, 1.0]), (instances, 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = low[0] + (k % side + 0.5) * step[0], size
    poses[:, 2, 3] = low[2] + (k // side + 0.5) * step[1]
    drawn += [Instance(1, pose, "", (0,)) for pose in poses]
    return base.replace(meshes=(scenes.floor(), Mesh("ball", (ball,))), instances=tuple(drawn))


def _spread(count: int, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.float64]:
    """(count, 2) places on the plane: a rank-1 lattice."""
    i = np.arange(count)
    unit = np.stack([(i + 0.5) / count, (i * 0.61803398875 + 0.5) % 1.0], 1)
    return np.asarray(low[[0, 2]] + unit * (high - low)[[0, 2]])


def run(
    over: Sequence[str] = tuple(VALUES),
    *,
    quick: bool = False,
    context: "Context",
    size: tuple[int, int] | None = None,
    values: dict[str, tuple[int, ...]] | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> Scaling:
    """Measures the curves named. size: pixels where they are not what changes; default 1920x1080, 320x180 in software.

    values: other values than VALUES.
    """
    kernels.load_all()
    software = context.device.software
    chosen = values or (QUICK if quick else VALUES)
    size = size or ((320, 180) if software else (1920, 1080))
    about = machine(context.device.to_dict(), cores=clock.cores(context), size=list(size), quick=quick)
    result = Scaling(about)
    total, done = sum(len(chosen[name]) for name in over), 0
    for name in over:
        curve = Curve(name)
        result.curves.append(curve)
        for value in chosen[name]:
            progress(f"{name}: {value:,}", done, total)
            done += 1
            if why := _too_much(curve, value, quick):
                curve.ended = f"{value:,} {name}: {why}"
                break
            try:
                curve.points.append(_measure(context, name, value, size, quick))
            except (GlhybridError, MemoryError) as error:
                curve.ended = f"{value:,} {name}: {error or 'out of memory'}"
                break
    progress("done", total, total)
    return result


def _too_much(curve: Curve, value: int, quick: bool) -> str:
    """Why a point is not even tried: memory, or time by what the last one took."""
    if curve.over == "triangles":
        need, have = value * BYTES_A_TRIANGLE, _available_bytes()
        if need > have:
            return f"about {need >> 30} GiB are needed, {have >> 30} GiB are free"
    if curve.points:
        last = curve.points[-1]
        more, growth = value / last.value, 0.0
        if len(curve.points) > 2:  # staging has a fixed part, compiling, and one that grows
            before = curve.points[-2]
            growth = max(last.stage_ms - before.stage_ms, 0.0) / (last.value - before.value) * (value - last.value)
        frames = last.wall_ms * (more if curve.over in ("pixels", "lights") else more**0.3)
        seconds, limit = (8 * frames + last.stage_ms + growth) / 1e3, LONGEST_S * (0.25 if quick else 1.0)
        if seconds > limit:
            return f"about {seconds:.0f} s would be needed, {limit:.0f} are given to a point"
    return ""


def _available_bytes() -> int:
    try:
        with open("/proc/meminfo") as file:
            rows = dict(line.split(":", 1) for line in file)
        return int(rows["MemAvailable"].split()[0]) << 10
    except (OSError, KeyError, ValueError):
        return 8 << 30


def _measure(context: "Context", over: str, value: int, size: tuple[int, int], quick: bool) -> Point:
    from glhybrid.renderer import Renderer

    scene = subject(value) if over == "triangles" else subject(lights=value) if over == "lights" else subject()
    if over == "instances":
        scene = crowd(value)
    if over == "pixels":
        size = next(s for s in SIZES.values() if s[0] * s[1] == value)
    with Renderer(context=context) as renderer:
        begun = time.perf_counter()
        settings = Settings(exposure=0.0)
        frame = steady_frame(renderer, scene, size, settings)
        off = Timing(context.gl.finish, enabled=False)
        frame(off)  # compiles
        context.gl.finish()
        stage_ms = (time.perf_counter() - begun) * 1e3
        return _times(renderer, scene, value, size, frame, stage_ms, quick)


def _times(
    renderer: "Renderer", scene: Scene, value: int, size: tuple[int, int], frame: Callable[[Timing], None],
    stage_ms: float, quick: bool,
) -> Point:  # fmt: skip
    context = renderer.context
    software, finish = context.device.software, context.gl.finish
    off = Timing(finish, enabled=False)
    repeats = (3 if quick else 5) if software else 30
    works: dict[str, Callable[[], object]] = {"frame": lambda: frame(off)}
    samples = clock.on_cpu(works, repeats, finish) if software else clock.on_gpu(context, works, repeats)
    sample = samples["frame"]
    if software:
        sample = replace(sample, cpu=[ms / clock.cores(context) for ms in sample.cpu])
    kind = "cpu" if software else "gpu" if sample.gpu else "wall"
    timing = clock.pass_clock(context)
    for _ in range(3 if software else 10):
        frame(timing)
    staged = renderer.stage(scene, Settings(exposure=0.0), size)
    build_ms, upload, primary = staged.upload.bvh_stats()["build_ms"], staged.upload.buffer_bytes, staged.plan.primary
    host = host_seconds(renderer, scene, HOST_SIZE if software else size, "trace" if software else "auto")
    return Point(
        value, scene.triangle_count(), len(scene.instances), len(scene.lights), size, primary, kind,
        sample.median(kind), sample.spread(kind), sample.median("wall"), timing.medians(), host * 1e6, float(build_ms),
        stage_ms, upload,
    )  # fmt: skip


def show(result: Scaling) -> None:
    """Tables on stdout, one a curve, and the exponents."""
    from glhybrid import console

    for curve in result.curves:
        passes = list(dict.fromkeys(name for p in curve.points for name in p.passes))
        if curve.points:
            console.table(
                (curve.over, "frame ms", "+-", *(f"{n} ms" for n in passes), "host us", "build ms", "MiB", "primary"),
                [
                    (f"{p.value:,}", f"{p.frame_ms:.2f}", f"{p.spread * 50:.0f}%",
                     *(f"{p.passes.get(name, 0.0):.2f}" for name in passes),
                     f"{p.host_us:.0f}", f"{p.build_ms:.0f}", f"{p.buffer_bytes / 2**20:.1f}", p.primary)
                    for p in curve.points
                ],
            )  # fmt: skip
        laws = ", ".join(f"{name} ~ {curve.over}^{power:.2f}" for name, power in curve.exponents.items())
        print(laws or "too few points for an exponent")
        if curve.ended:
            print(f"ended at {curve.ended}")
        print()
    m = result.machine
    clocks = {p.clock for curve in result.curves for p in curve.points}
    by = ", ".join(sorted(clocks)) or "no"
    print(f"{m['device']['renderer']}, {m['cores']} cores; frames by {by} time, median")


def chart(result: Scaling) -> str:
    """One SVG: a chart a curve, both axes logarithmic, a line for the frame and one a pass."""
    from glhybrid.study.report.charts import NARROW, Line, curves, standalone

    width, height = NARROW
    parts = []
    for k, curve in enumerate(c for c in result.curves if len(c.points) > 1):
        x = [float(p.value) for p in curve.points]
        names = list(dict.fromkeys(name for p in curve.points for name in p.passes))  # a plan may change on the way
        rows = {"frame": [p.frame_ms for p in curve.points]}
        rows |= {name: [max(p.passes.get(name, math.nan), 1e-4) for p in curve.points] for name in names}
        powers = curve.exponents
        lines = [
            Line(f"{name} ^{powers[name]:.2f}" if name in powers else name, x, y) for name, y in rows.items()
        ]  # fmt: skip
        svg = curves(lines, title=f"ms over {curve.over}", x_label=curve.over, y_label="ms a frame")
        at = f'<svg x="{k % 2 * width}" y="{k // 2 * height}" width="{width}" height="{height}"'
        parts.append(svg.replace("<svg", at, 1))
    rows_of_charts = -(-len(parts) // 2)
    whole = f'<svg class="chart" viewBox="0 0 {2 * width} {rows_of_charts * height}" role="img">{"".join(parts)}</svg>'
    return standalone(whole)
