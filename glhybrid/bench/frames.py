"""Whole frames of a scene: ms a pass, ms a frame, and what the host spends on one."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from glhybrid.bench.clock import pass_clock, unpaced
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
    """passes: ms by pass, medians: by timestamps, in software from finish() to finish(). frame_ms: of frames that are
    not cut up.

    host_us: CPU time of the calling thread for one steady frame with nothing finished in it, median: our Python and
    the driver below it. A software rasteriser works through all vertices on that thread; there the host is measured on
    frames of HOST_SIZE whose primary rays are traced, the same calls but for one. host_moving_us: with a camera that
    moves, its view made anew every frame. spread: distance between the quartiles of frame_ms, as a share of it; 0 where
    frames are timed in one batch.
    """

    scene: str
    size: tuple[int, int]
    passes: dict[str, float]
    frame_ms: float
    host_us: float
    spread: float = 0.0
    host_moving_us: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: one of the report's `frames`."""
        return {
            "scene": self.scene,
            "size": list(self.size),
            "passes": [{"name": name, "ms": ms} for name, ms in self.passes.items()],
            "frame_ms": self.frame_ms,
            "host_us": self.host_us,
        }

    def evidence(self) -> dict[str, Any]:
        """What else was measured: one entry of machine.frame_measurements."""
        return {"scene": self.scene, "spread": self.spread, "host_moving_us": self.host_moving_us}


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
        timing.run("display", lambda: staged.display.image(staged.targets, radiance))

    return frame


def measure(renderer: Renderer, name: str, scene: Scene, size: tuple[int, int], repeats: int) -> FrameTimes:
    """Times `repeats` frames in each way. On a GPU after a warm-up, whole frames without a pause between them."""
    software, finish = renderer.context.device.software, renderer.context.gl.finish
    frame, off = steady_frame(renderer, scene, size, Settings()), Timing(finish, enabled=False)
    frame(off)  # compiles; the warm-up may still compile its variants
    finish()
    sample = unpaced(renderer.context, lambda: frame(off), repeats, batch=1 if software else repeats)
    timing = pass_clock(renderer.context)
    for _ in range(repeats + 1):  # the first does not count
        frame(timing)
    small, primary = (HOST_SIZE, "trace") if software else (size, "auto")
    host, moving = (1e6 * host_seconds(renderer, scene, small, primary, m) for m in (False, True))  # type: ignore[arg-type]
    return FrameTimes(name, size, timing.medians(), sample.median("wall"), host, sample.spread("wall"), moving)


def host_seconds(
    renderer: Renderer, scene: Scene, size: tuple[int, int], primary: Primary = "auto", moving: bool = False
) -> float:
    """CPU time of the calling thread for a steady frame, median of HOST_FRAMES that nothing waits for.

    moving: through another view each time, made from its camera, a thousandth of the scene further to its right.
    """
    settings = Settings(primary=primary)
    frame, off = steady_frame(renderer, scene, size, settings), Timing(renderer.context.gl.finish, enabled=False)
    frame(off)
    renderer.context.gl.finish()
    staged, camera, times = renderer.stage(scene, settings, size), choose_camera(scene, None), []
    step = camera.world_from_view[:3, 0] * float(np.linalg.norm(staged.bounds[1] - staged.bounds[0])) / 1000
    for k in range(HOST_FRAMES):
        start = time.thread_time()
        if moving:
            pose = camera.world_from_view.copy()
            pose[:3, 3] += k * step
            clip = renderer.context.limits.clip_control
            staged.look(make_view(replace(camera, world_from_view=pose), size, scene, clip, staged.bounds))
            staged.set(jitter_px=(0, 0), accumulate=0)
            staged.display.image(staged.targets, staged.frame(off))
        else:
            frame(off)
        times.append(time.thread_time() - start)
    renderer.context.gl.finish()
    return float(np.median(times))
