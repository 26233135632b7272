"""`glhybrid bench --view`: how long the viewer takes to answer, in motion and at rest, in a window if it can.

Without one, a surface in memory stands for it: everything but the blit to the window and the swap. One row by view:
one picture; two techniques side by side while the reference converges and errors are measured; the map of differences
from that reference; filtered random rays; and, where aiohttp is installed, one picture in a browser (web_client.py).
Figures are by the clock on the wall, as the user's are.
"""

import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from glhybrid import console
from glhybrid.bench.report import machine
from glhybrid.context import Context, open_context
from glhybrid.errors import DeviceError, SettingError
from glhybrid.scene import Scene
from glhybrid.settings import Settings
from glhybrid.timing import Progress

SMALLEST = 160  # pixels a side
SCENES = ("showroom", "atrium", "plaza")
VIEWS: dict[str, dict[str, Any]] = {  # of a session
    "plain": {},
    "split": {"mode": "split", "reference": True},
    "difference": {"mode": "difference"},
    "FLIP": {"mode": "flip"},
    "filtered": {"a": Settings(shadows="ray-soft", reflections="ray-glossy")},
    "web": {},
}


@dataclass(frozen=True)
class Answered:
    """Milliseconds from a motion of the pointer to the frame that shows it (viewer/latency.py).

    share: of each side of the picture that was drawn in motion. rest: of the first motion while the picture refines.
    cpu: seconds of processor time a second of motion.
    """

    scene: str
    view: str
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
    views: Sequence[str] = tuple(VIEWS),
) -> dict[str, Any]:
    """{"machine", "answers": [Answered as a dict]}. size: of the picture; 1920x1080 on a GPU, else 1280x720.

    context: draw there, and on no window. quick: the first scene alone in all views. Raises DeviceError without the
    viewer's libraries.
    """
    from glhybrid.viewer.panels import WIDTH
    from glhybrid.viewer.surface import Memory
    from glhybrid.viewer.window import Window

    if importlib.util.find_spec("aiohttp") is None:
        views = [v for v in views if v != "web"]
    if size is not None and min(size) < SMALLEST:
        raise SettingError(f"--size {size[0]}x{size[1]}: a hand needs {SMALLEST}x{SMALLEST} pixels at least to move in")
    names = names or (SCENES[:1] if quick else SCENES)
    rows, effort = [], (1.5, 3) if quick else (3.0, 9)
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
        for number, (name, view) in enumerate((n, v) for n in names for v in views):
            progress(f"dragging {name}, {view}", number, len(names) * len(views))
            measured = _in_browser if view == "web" else _here
            rows.append(measured(surface, kind, name, view, load, *effort))
    return {"machine": machine(info.to_dict(), quick=quick), "answers": [asdict(row) for row in rows]}


def _here(
    surface: Any, kind: str, name: str, view: str, load: Callable[[str], Scene], seconds: float, rests: int
) -> Answered:
    from glhybrid.viewer.app import Viewer
    from glhybrid.viewer.latency import Hand, measure
    from glhybrid.viewer.session import Session

    hand = Hand(surface)
    viewer = Viewer(hand, Session(load(name), name, **VIEWS[view]), load, watch=False)
    try:
        cpu, wall = time.process_time(), time.perf_counter()
        answers = measure(viewer, hand, seconds, rests)
        used = (time.process_time() - cpu) / (time.perf_counter() - wall)
        return Answered(name, view, kind, viewer.picture_size, **answers.to_dict(), cpu=used)
    finally:
        viewer.close()


@dataclass
class _Tagged:
    """A browser's surface whose frames are tagged with where the pointer was, and whether anything moves."""

    surface: Any
    viewer: Any = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self.surface, name)

    def present(self, image: Any, moving: bool) -> None:
        self.surface.tag = self.viewer.controls.pointer if moving else None, self.viewer.pictures.scale
        self.surface.present(image, moving)


def _in_browser(
    surface: Any, kind: str, name: str, view: str, load: Callable[[str], Scene], seconds: float, rests: int
) -> Answered:
    """As _here(), by a client in a process of its own, from the sending of a motion to the coming of the frame."""
    from glhybrid.viewer.app import Viewer
    from glhybrid.viewer.session import Session
    from glhybrid.viewer.web import Web

    web = Web(surface.context, surface.size)
    tags: list[Any] = []
    web.sent = tags.append
    tagged = _Tagged(web)
    viewer = tagged.viewer = Viewer(tagged, Session(load(name), name, **VIEWS[view]), load, watch=False)
    size = "x".join(map(str, surface.size))
    words = [sys.executable, "-m", "glhybrid.bench.web_client", web.url, size, str(seconds), str(rests)]
    try:
        cpu, wall = time.process_time(), time.perf_counter()
        with tempfile.TemporaryFile("w+") as output:
            with subprocess.Popen(words, stdout=output) as client:
                while client.poll() is None:
                    viewer.tick()
            used = (time.process_time() - cpu) / (time.perf_counter() - wall)
            if client.returncode:
                raise DeviceError(f"the client of the viewer's stream ended with {client.returncode}")
            output.seek(0)
            found = answers(json.load(output), tags)
        return Answered(name, view, "browser", viewer.picture_size, **found, cpu=used)
    finally:
        viewer.close()
        web.close()


def answers(client: dict[str, Any], tags: Sequence[tuple[tuple[float, float] | None, float]]) -> dict[str, float]:
    """latency.Answers.to_dict() of what the client noted. tags: (pointer, share) of the frames that were sent.

    Of each frame in motion the oldest move that none before has shown; of a rest its first.
    """
    number = {(x, y): i for i, (x, y, _) in enumerate(client["moves"])}
    sent = [s for _, _, s in client["moves"]]
    shows = [
        (number[at], came, share)
        for came, (at, share) in zip(client["frames"], tags, strict=False)
        if at is not None and at in number
    ]
    drags, shares, came_s, shown = [], [], [], client["first"] - 1
    for i, came, share in shows:
        if shown < i < client["last"]:
            drags.append((came - sent[shown + 1]) * 1e3)
            shares.append(share)
            came_s.append(came)
            shown = i
    rests = [(next(came for i, came, _ in shows if i >= first) - sent[first]) * 1e3 for first in client["rests"]]
    ordered = sorted(drags)
    return {
        "median_ms": median(ordered), "p95_ms": ordered[math.ceil(0.95 * len(ordered)) - 1], "worst_ms": ordered[-1],
        "frames_s": (len(drags) - 1) / max(came_s[-1] - came_s[0], 1e-9), "share": median(shares),
        "rest_median_ms": median(rests), "rest_worst_ms": max(rests),
    }  # fmt: skip


def show(report: dict[str, Any]) -> None:
    """A table on stdout."""
    rows = [Answered(**row) for row in report["answers"]]
    console.table(
        ("scene", "view", "size", "median ms", "95 % ms", "worst ms", "frames/s", "share", "at rest ms", "worst ms"),
        [(r.scene, r.view, f"{r.size[0]}x{r.size[1]}", round(r.median_ms, 1), round(r.p95_ms, 1), round(r.worst_ms, 1),
          round(r.frames_s, 1), r.share, round(r.rest_median_ms, 1), round(r.rest_worst_ms, 1)) for r in rows],
    )  # fmt: skip
    print(f"\n{report['machine']['device']['renderer']}, {rows[0].surface if rows else ''}")
