"""`glhybrid bench --motion`: what motion costs. How old a tree may get, how many instances may move, how fast pictures
leave the GPU.

- `refit`: a clip is played five times, with trees built anew every frame (Kim's way) by the processor and in compute,
  refitted until their SAH cost has grown by a half or by all of itself, and never built anew. For every frame: SAH cost
  to that of the tree the processor built for it, nodes and triangles tested a ray, ms by pass, and the largest
  difference to the first picture, which must be 0.
- `deformed`: moving the vertices, refitting the trees, and building them in compute, by themselves.
- `instances`: rigid bodies, all of them moving: ms for poses, for the top-level tree refitted or built, for the frame.
- `readback`: pictures a second without reading any, through the ring, and one by one.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from glhybrid import console, kernels
from glhybrid import pose as posing
from glhybrid.bench import clock, movers
from glhybrid.bench.clock import cores
from glhybrid.bench.report import machine
from glhybrid.context import Context
from glhybrid.deform import deformers
from glhybrid.errors import SettingError
from glhybrid.layout import CONSTANTS
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.stream import Shot
from glhybrid.timing import Timing

Progress = Callable[[str, int, int], None]
Builder = Literal["auto", "cpu", "gpu"]
POLICIES: tuple[tuple[float, Builder], ...] = ((1, "cpu"), (1, "gpu"), (1.5, "auto"), (2, "auto"), (0, "auto"))
TABLES = ("refit", "deformed", "instances", "readback")
BARS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class Played:
    """One scene under one `rebuild` and `builder`. Lists are by frame; *_mean over them. error: largest |difference| of
    radiance to the picture with trees built for the frame. age: frames since the tree was built."""

    scene: str
    triangles: int
    rebuild: float
    builder: str
    builds: int
    age: list[int]
    sah_ratio: list[float]
    steps_per_ray: list[float]
    refit_ms: list[float]
    trace_ms: list[float]
    error: float
    sah_ratio_mean: float = 0.0
    steps_per_ray_mean: float = 0.0
    refit_ms_mean: float = 0.0
    trace_ms_mean: float = 0.0


@dataclass(frozen=True)
class Deformed:
    """What a frame's deformation costs, ms, medians: vertices moved, boxes fitted to them in so many dispatches, trees
    built in compute in so many. nodes: rows of trees that the GPU built. clocks of the three: gpu (timestamps), wall
    where the host takes longer than the GPU, cpu over the cores in software."""

    scene: str
    triangles: int
    nodes: int
    dispatches: tuple[int, int]
    clocks: tuple[str, str, str]
    skin_ms: float
    refit_ms: float
    build_ms: float


@dataclass(frozen=True)
class Moved:
    """So many instances, all moving; medians, ms. tlas: boxes, matrices and the top-level tree, brought to the GPU.

    host_us: CPU time of the calling thread for a frame that nothing waits for, the driver's included.
    """

    instances: int
    rebuild: float
    pose_ms: float
    tlas_ms: float
    passes_ms: float
    frame_ms: float
    host_us: float


@dataclass(frozen=True)
class Read:
    """How pictures leave the GPU: `drawn` stay there; `ring N` are (H, W, 4) uint8 arrays, N on their way; `frames` are
    Frames by Renderer.frames; `single` by Renderer.render. ratio: to those that stay. A GPU's are by the clock on the
    wall, a software rasteriser's by CPU time on all its cores, which a busy machine does not change."""

    scene: str
    size: tuple[int, int]
    way: str
    per_second: float
    ratio: float


@dataclass
class MotionReport:
    """What `glhybrid bench --motion` found, a table for each of TABLES."""

    machine: dict[str, Any]
    refit: list[Played] = field(default_factory=list)
    deformed: list[Deformed] = field(default_factory=list)
    instances: list[Moved] = field(default_factory=list)
    readback: list[Read] = field(default_factory=list)

    @property
    def failures(self) -> list[str]:
        """A sentence for each animation whose pictures hang on the age of its trees."""
        return [
            f"{p.scene}, rebuild = {p.rebuild:g}: a picture differs by {p.error:g} from that with trees built for it"
            for p in self.refit
            if p.error != 0
        ]

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON; failures stand under `machine`."""
        rows = {name: [asdict(row) for row in getattr(self, name)] for name in TABLES}
        return {"machine": self.machine | {"failures": self.failures}} | rows


def run(
    scenes: Sequence[tuple[str, Scene]] = (),
    *,
    quick: bool = False,
    device: str = "auto",
    size: tuple[int, int] | None = None,
    progress: Progress = lambda stage, done, total: None,
    context: Context | None = None,
) -> MotionReport:
    """scenes: by name, whose first clip deforms something; the bench's own ring of 100,000 triangles if none is given.

    size: pixels; default 1920x1080 on a GPU, else 480x270. Raises SettingError for a scene in which nothing deforms.
    """
    for name, scene in scenes:
        if not deformers(scene, posing.find_clip(scene)):
            raise SettingError(
                f"{name}: no clip of it changes a shape, so there is no tree to refit: name another scene"
            )
    kernels.load_all()
    with Renderer(device=device, context=context) as renderer:
        software = renderer.context.device.software
        size = size or ((480, 270) if software else (1920, 1080))
        report = MotionReport(
            machine(renderer.context.device.to_dict(), cores=cores(renderer.context), size=list(size), quick=quick)
        )
        made = list(scenes) or [("ring", movers.ring(10_000 if quick else 100_000))]
        counts = (1000, 10_000) if quick else (1000, 10_000, 100_000)
        total, done = len(made) * len(POLICIES) + len(counts) * 2 + 1, 0
        for name, scene in made:
            fresh: list[tuple[float, Any]] = []
            for rebuild, builder in POLICIES:
                progress(f"refit: {name}, rebuild = {rebuild:g}", done, total)
                frames = 16 if quick else 48
                report.refit.append(play(renderer, name, scene, size, rebuild, frames, fresh, builder))
                done += 1
            report.deformed.append(deform(renderer, name, scene, size))
        for count in counts:
            bodies = movers.swarm(count)
            for rebuild in (1.0, 0.0):
                progress(f"instances: {count}", done, total)
                report.instances.append(move(renderer, bodies, size, rebuild, 5 if quick else 15))
                done += 1
        progress("readback", done, total)
        report.readback += read(renderer, "ring", movers.ring(1000), size, 10 if software else 200)
        progress("done", total, total)
    return report


def play(
    renderer: Renderer,
    name: str,
    scene: Scene,
    size: tuple[int, int],
    rebuild: float,
    frames: int,
    fresh: list[tuple[float, Any]],
    builder: Builder = "auto",
) -> Played:
    """The first clip in `frames` even steps. fresh: SAH cost and radiance of each frame with trees built for it, which
    the first call, with rebuild = 1, puts there."""
    clip = posing.find_clip(scene)
    assert clip is not None
    start, end = posing.clip_span(clip)
    first, builds = not fresh, 0
    age: list[int] = []
    ratio, steps, refit_ms, trace_ms, errors = [], [], [], [], []
    for k, now in enumerate(np.linspace(start, end, frames).tolist()):
        settings = Settings(aa=1, time=now, rebuild=rebuild, builder=builder)
        frame = renderer.render(scene, size=size, settings=settings, aovs=("bvh_steps", "instance_id"))
        assert renderer._staged is not None and renderer._staged.mover is not None
        refit = renderer._staged.mover.refit
        assert refit is not None
        cost = float(np.mean([refit.sah_cost(mesh) for mesh in refit.meshes]))
        if first:
            fresh.append((cost, frame["radiance"]))
        age.append(0 if refit.rebuilt > builds else age[-1] + 1 if age else 1)
        builds = refit.rebuilt
        ratio.append(cost / fresh[k][0])
        hit = frame["instance_id"] != CONSTANTS["ID_NONE"]
        steps.append(float(frame["bvh_steps"][hit].mean()) if hit.any() else 0.0)
        passes = {p["name"]: p["ms"] for p in frame.receipt["passes"]}
        refit_ms.append(passes.get("refit", 0.0))
        trace_ms.append(sum(passes.get(p, 0.0) for p in ("gbuffer", "shadow", "rays", "reflect")))
        errors.append(float(np.abs(frame["radiance"] - fresh[k][1]).max()))
    means = (float(np.mean(v)) for v in (ratio, steps))
    # Times of the first frames are those of compilers.
    medians = (float(np.mean(v[2:] or v)) for v in (refit_ms, trace_ms))
    return Played(
        name, scene.triangle_count(), rebuild, builder, builds, age, ratio, steps, refit_ms, trace_ms, max(errors),
        *means, *medians,
    )  # fmt: skip


def deform(renderer: Renderer, name: str, scene: Scene, size: tuple[int, int], repeats: int = 0) -> Deformed:
    """Skinning, refitting and building by themselves, over and over at one time of the first clip."""
    settings, context = Settings(aa=1, rebuild=1.0, builder="gpu", time=0.1), renderer.context
    renderer.render(scene, size=size, settings=settings)
    assert renderer._staged is not None and renderer._staged.mover is not None
    mover, software = renderer._staged.mover, context.device.software
    skin, refit, shapes = mover.skin, mover.refit, mover.motion.at(0.1).shapes
    assert skin is not None and refit is not None
    works: dict[str, Callable[[], None]] = {
        "skin": lambda: skin.run(shapes),
        "refit": refit.refit,
        "build": refit.build,
    }
    if software:
        samples, share = clock.on_cpu(works, repeats or 9, context.gl.finish), cores(context)
    else:
        samples, share = clock.on_gpu(context, works, repeats or 50), 1
    kinds = ["cpu" if software else "gpu" if samples[work].gpu else "wall" for work in works]
    skin_ms, refit_ms, build_ms = (samples[work].median(kind) / share for work, kind in zip(works, kinds, strict=True))
    dispatches, clocks = (refit.dispatches, refit.builds), (kinds[0], kinds[1], kinds[2])
    return Deformed(name, scene.triangle_count(), refit.nodes, dispatches, clocks, skin_ms, refit_ms, build_ms)


def move(renderer: Renderer, scene: Scene, size: tuple[int, int], rebuild: float, frames: int) -> Moved:
    """A swarm at `frames` times close together. frame: pictures a second through Renderer.arrays, turned over."""
    chosen = Settings(aa=1, rebuild=rebuild, reflections="none")
    times = [0.01 * k for k in range(frames + 2)]
    rows = []
    for now in times:
        receipt = renderer.render(scene, size=size, settings=chosen.replace(time=now)).receipt
        rows.append({p["name"]: p["ms"] for p in receipt["passes"]})
    middle = {name: float(np.median([row[name] for row in rows[2:]])) for name in rows[0]}
    stream = renderer.arrays(scene, (Shot(t) for t in times), size, chosen)
    next(stream)
    started = time.perf_counter()
    count = sum(1 for _ in stream)
    wall = (time.perf_counter() - started) / count * 1e3
    passes = sum(ms for name, ms in middle.items() if name not in ("pose", "tlas"))
    finish, hosts = renderer.context.gl.finish, []
    off = Timing(finish, enabled=False)
    for now in times:
        started = time.thread_time()
        renderer.draw(scene, None, size, chosen.replace(time=now), (), off)
        hosts.append(1e6 * (time.thread_time() - started))
        finish()
    host = float(np.median(hosts[2:]))
    return Moved(len(scene.instances), rebuild, middle["pose"], middle["tlas"], passes, wall, host)


def read(renderer: Renderer, name: str, scene: Scene, size: tuple[int, int], frames: int) -> list[Read]:
    """Pictures of a light scene at rest, seen from places on a circle, one sample a pixel; ways in turns."""
    scene = scene.replace(animations=())
    chosen, finish = Settings(aa=1, reflections="none"), renderer.context.gl.finish
    around = [
        Camera.look_at((4 * np.sin(a), 2.4, 4 * np.cos(a)), (0.0, -0.3, 0.0)) for a in np.linspace(0, 6.0, frames)
    ]
    shots = [Shot(None, camera) for camera in around]

    def drawn() -> None:
        for shot in shots:
            renderer.draw(scene, shot.camera, size, chosen, (), Timing(finish, enabled=False))
        finish()

    def through(in_flight: int) -> Callable[[], None]:
        def go() -> None:
            for _ in renderer.arrays(scene, shots, size, chosen, in_flight):
                pass

        return go

    def framed() -> None:
        for _ in renderer.frames(scene, shots, size, chosen):
            pass

    def single() -> None:
        for shot in shots:
            renderer.render(scene, shot.camera, size, chosen)

    ways: dict[str, Callable[[], None]] = {"drawn": drawn}
    ways |= {f"ring {n}": through(n) for n in (1, 2, 3)} | {"frames": framed, "single": single}
    clock.warm_up(renderer.context, drawn)
    samples = clock.on_cpu(ways, 5, finish)
    software = renderer.context.device.software
    kind, share = ("cpu", cores(renderer.context)) if software else ("wall", 1)
    rate = {way: 1e3 * frames * share / sample.median(kind) for way, sample in samples.items()}
    return [Read(name, size, way, value, value / rate["drawn"]) for way, value in rate.items()]


def show(report: MotionReport) -> None:
    """Tables on stdout. The bars are by frame: from the lowest to the highest of the scene."""
    rows: list[Sequence[object]] = []
    for p in report.refit:
        spread = [s for q in report.refit if q.scene == p.scene for s in q.steps_per_ray]
        policy = {0.0: "never", 1.0: f"every frame, {p.builder}"}.get(p.rebuild, f"past {p.rebuild:g}")
        rows.append((
            p.scene, p.triangles, policy, p.builds, round(p.sah_ratio_mean, 3), round(max(p.sah_ratio), 3),
            round(p.steps_per_ray_mean, 2), bars(p.steps_per_ray, min(spread), max(spread)),
            round(p.refit_ms_mean, 2), round(p.trace_ms_mean, 2), p.error,
        ))  # fmt: skip
    console.table(
        ("scene", "triangles", "built anew", "builds", "SAH to fresh", "at most", "steps a ray", "by frame", "refit ms",
         "rays ms", "image error"), rows,
    )  # fmt: skip
    print()
    console.table(
        ("deformed", "triangles", "nodes", "skin ms", "refit ms", "dispatches", "build ms", "dispatches", "clocks"),
        [(d.scene, d.triangles, d.nodes, round(d.skin_ms, 3), round(d.refit_ms, 3), d.dispatches[0],
          round(d.build_ms, 3), d.dispatches[1], ", ".join(d.clocks)) for d in report.deformed],
    )  # fmt: skip
    print()
    console.table(
        ("instances", "top level", "pose ms", "tlas ms", "passes ms", "frame ms", "host us"),
        [(m.instances, "built" if m.rebuild == 1 else "refitted", m.pose_ms, m.tlas_ms, m.passes_ms, m.frame_ms,
          round(m.host_us))
         for m in report.instances],
    )  # fmt: skip
    print()
    console.table(
        ("pictures of", "size", "way", "a second", "to drawn"),
        [(r.scene, f"{r.size[0]}x{r.size[1]}", r.way, r.per_second, round(r.ratio, 3)) for r in report.readback],
    )
    print(f"\n{report.machine['device']['renderer']}, {report.machine['cores']} cores")


def bars(values: Sequence[float], low: float, high: float) -> str:
    """A chart of one line, at most 48 wide."""
    if len(values) > 48:
        values = [float(np.mean(part)) for part in np.array_split(np.array(values), 48)]
    span = (high - low) or 1.0
    return "".join(BARS[min(int((v - low) / span * len(BARS)), len(BARS) - 1)] for v in values)
