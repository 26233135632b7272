"""Whole frames of a scene: ms a pass, ms a frame, and what the host spends on one."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from glhybrid.bench.clock import WARM_UP_S
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.timing import Timing
from glhybrid.view import choose_camera, make_view

Primary = Literal["auto", "trace"]
HOST_SIZE = (16, 16)  # pixels
HOST_FRAMES = 20


@dataclass(frozen=True)
class FrameTimes:
    """passes: ms by pass, medians, each from finish() to finish(). frame_ms: of frames that are not cut up.

    host_us: CPU time of the calling thread for one steady frame with nothing finished in it, median: our Python and
    the driver below it. A software rasteriser works through all vertices on that thread; there the host is measured on
    frames of HOST_SIZE whose primary rays are traced, the same calls but for one.
    """

    scene: str
    size: tuple[int, int]
    passes: dict[str, float]
    frame_ms: float
    host_us: float

    def to_dict(self) -> dict[str, Any]:
        return {
            "scene": self.scene,
            "size": list(self.size),
            "passes": [{"name": name, "ms": ms} for name, ms in self.passes.items()],
            "frame_ms": self.frame_ms,
            "host_us": self.host_us,
        }


def steady_frame(
    renderer: Renderer, scene: Scene, size: tuple[int, int], settings: Settings, camera: Camera | None = None
) -> Callable[[Timing], None]:
    """What a viewer does for every frame of a scene at rest, made ready: look, constants, passes, display."""
    view = make_view(choose_camera(scene, camera), size, scene, renderer.context.limits.clip_control)
    staged = renderer.stage(scene, settings, size)

    def frame(timing: Timing) -> None:
        staged.look(view)
        staged.set(jitter_px=(0, 0), accumulate=0)
        radiance = staged.frame(timing)
        timing.run("display", lambda: staged.display.run(staged.targets, radiance))

    return frame


def measure(renderer: Renderer, name: str, scene: Scene, size: tuple[int, int], repeats: int) -> FrameTimes:
    """Times `repeats` frames in each way. On a GPU after a warm-up, whole frames without a pause between them."""
    software, finish = renderer.context.device.software, renderer.context.gl.finish
    frame, off = steady_frame(renderer, scene, size, Settings()), Timing(finish, enabled=False)
    for _ in range(2):  # the first compiles, the second may still have its variants compiled
        frame(off)
        finish()
    started = time.perf_counter()
    while not software and time.perf_counter() - started < WARM_UP_S:
        frame(off)
    finish()
    walls = []
    batch = 1 if software else repeats
    for _ in range(repeats // batch):
        wall = time.perf_counter()
        for _ in range(batch):
            frame(off)
        finish()
        walls.append((time.perf_counter() - wall) / batch)
    timing = Timing(finish)
    for _ in range(repeats + 1):  # the first does not count
        frame(timing)
    host = host_seconds(renderer, scene, HOST_SIZE, "trace") if software else host_seconds(renderer, scene, size)
    return FrameTimes(name, size, timing.medians(), float(np.median(walls)) * 1e3, host * 1e6)


def host_seconds(renderer: Renderer, scene: Scene, size: tuple[int, int], primary: Primary = "auto") -> float:
    """CPU time of the calling thread for a steady frame, median of HOST_FRAMES that nothing waits for."""
    settings = Settings(primary=primary)
    frame, off = steady_frame(renderer, scene, size, settings), Timing(renderer.context.gl.finish, enabled=False)
    frame(off)
    renderer.context.gl.finish()
    times = []
    for _ in range(HOST_FRAMES):
        start = time.thread_time()
        frame(off)
        times.append(time.thread_time() - start)
    renderer.context.gl.finish()
    return float(np.median(times))
