"""`glhybrid bench --view`: how long the viewer takes to answer, in motion and at rest, in a window if it can.

Without one, a surface in memory stands for it: everything but the blit to the window and the swap. Figures are by the
clock on the wall, as the user's are.
"""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

from glhybrid import console
from glhybrid.bench.report import machine
from glhybrid.context import Context, open_context
from glhybrid.scene import Scene
from glhybrid.timing import Progress

SCENES = ("showroom", "atrium", "plaza")


@dataclass(frozen=True)
class Answered:
    """Milliseconds from a motion of the pointer to the frame that shows it (viewer/latency.py).

    share: of each side of the picture that was drawn in motion. rest: of the first motion while the picture refines.
    cpu: seconds of processor time a second of motion.
    """

    scene: str
    surface: str
    size: tuple[int, int]
    median_ms: float
    p95_ms: float
    worst_ms: float
    frames_s: float
    share: float
    rest_median_ms: float
    rest_worst_ms: float
    cpu: float


def run(
    names: Sequence[str] = (),
    *,
    load: Callable[[str], Scene],
    quick: bool = False,
    device: str = "auto",
    size: tuple[int, int] | None = None,
    progress: Progress = lambda stage, done, total: None,
    context: Context | None = None,
) -> dict[str, Any]:
    """{"machine", "answers": [Answered as a dict]}. size: of the picture; 1920x1080 on a GPU, else 1280x720.

    context: draw there, and on no window. Raises DeviceError without the viewer's libraries.
    """
    from glhybrid.viewer.app import Viewer
    from glhybrid.viewer.latency import Hand, measure
    from glhybrid.viewer.panels import WIDTH
    from glhybrid.viewer.session import Session
    from glhybrid.viewer.surface import Memory
    from glhybrid.viewer.window import Window

    rows, about = [], {}
    with ExitStack() as ending:
        surface: Any
        if context is None and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            surface, kind = Window((640, 360), device, vsync=False), "window"
        else:
            opened = context or ending.enter_context(open_context(device))
            surface, kind = Memory(opened, (640, 360)), "memory"
        ending.callback(surface.close)
        info = surface.context.device
        size = size or ((1280, 720) if info.software else (1920, 1080))
        surface.resize((size[0] + WIDTH, size[1]))
        about = machine(info.to_dict(), quick=quick)
        for number, name in enumerate(names or SCENES):
            progress(f"dragging {name}", number, len(names or SCENES))
            hand = Hand(surface)
            viewer = Viewer(hand, Session(load(name), name), load, watch=False)
            try:
                cpu, wall = time.process_time(), time.perf_counter()
                answers = measure(viewer, hand, *((1.5, 3) if quick else (5.0, 9)))
                used = (time.process_time() - cpu) / (time.perf_counter() - wall)
                rows.append(Answered(name, kind, viewer.picture_size, **answers.to_dict(), cpu=used))
            finally:
                viewer.close()
    return {"machine": about, "answers": [asdict(row) for row in rows]}


def show(report: dict[str, Any]) -> None:
    """A table on stdout."""
    rows = [Answered(**row) for row in report["answers"]]
    console.table(
        ("scene", "size", "median ms", "95 % ms", "worst ms", "frames/s", "share", "at rest ms", "worst ms"),
        [(r.scene, f"{r.size[0]}x{r.size[1]}", round(r.median_ms, 1), round(r.p95_ms, 1), round(r.worst_ms, 1),
          round(r.frames_s, 1), r.share, round(r.rest_median_ms, 1), round(r.rest_worst_ms, 1)) for r in rows],
    )  # fmt: skip
    print(f"\n{report['machine']['device']['renderer']}, {rows[0].surface if rows else ''}")
