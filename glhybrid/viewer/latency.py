"""How long the viewer takes to answer: a made-up hand drags the camera, and each motion is timed to the frame that
shows it, on whatever surface.

The hand moves by the clock, as a mouse does, whether the viewer keeps up or not: what is waited for because the frame
before is still being drawn counts too.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any

from glhybrid.viewer.events import LEFT, Button, Event, Move

if TYPE_CHECKING:
    from glhybrid.viewer.app import Viewer

RATE = 125  # motions a second, a plain mouse's
WARM_UP = 10  # frames in motion, in which programs are compiled and the budget learns
TURN_S = 2.0  # once round the path
REST_STEP_S = 0.137  # between the moments at rest at which drags begin, so that they meet a sample anywhere


@dataclass(frozen=True)
class Answers:
    """Milliseconds from a motion of the pointer to the frame that shows it.

    drags: in motion, of the first motion that each frame shows. rests: of the first motion while a picture refines.
    frames_s and shares of each side of the picture: in motion.
    """

    drags: tuple[float, ...]
    rests: tuple[float, ...]
    frames_s: float
    shares: tuple[float, ...]

    def to_dict(self) -> dict[str, float]:
        """Median, 95th percentile and worst, in milliseconds."""
        ordered = sorted(self.drags)
        return {
            "median_ms": median(ordered), "p95_ms": ordered[math.ceil(0.95 * len(ordered)) - 1],
            "worst_ms": ordered[-1], "frames_s": self.frames_s, "share": median(self.shares),
            "rest_median_ms": median(self.rests), "rest_worst_ms": max(self.rests),
        }  # fmt: skip


def place(step: int, size: tuple[int, int]) -> Move:
    """Where the hand is after so many steps on a surface of this size: on a circle at the left, which is never the
    panel's. No two places are the same."""
    width, height = size
    angle, radius = 2 * math.pi * step / RATE / TURN_S, 0.15 * min(width, height) + 1e-4 * step
    return Move(0.16 * width + radius * math.sin(angle), 0.5 * height + radius * math.cos(angle))


@dataclass
class Hand:
    """A surface whose pointer is led. What else it is, the surface underneath is."""

    surface: Any
    answers: list[float] = field(default_factory=list)
    _began: float | None = None
    _next: int = 0
    _waiting: float | None = None  # since when the oldest motion is not shown

    def __getattr__(self, name: str) -> Any:
        return getattr(self.surface, name)

    def _place(self, step: int) -> Move:
        return place(step, self.surface.size)

    def press(self) -> None:
        """From now on the pointer drags."""
        self._began, self._next, self._waiting = time.perf_counter(), 0, None

    def release(self) -> None:
        """The pointer lets go with the next poll()."""
        self._began = self._waiting = None
        self._next = -1

    def poll(self, timeout: float) -> list[Event]:
        """The surface's events, and the hand's that are due by now."""
        found: list[Event] = list(self.surface.poll(0.0 if self._began is not None or self._next < 0 else timeout))
        if self._next < 0:
            self._next = 0
            return [*found, Button(LEFT, False)]
        if self._began is None:
            return found
        due = int((time.perf_counter() - self._began) * RATE)
        if due < self._next and timeout > 0:
            time.sleep(min(timeout, max(self._began + self._next / RATE - time.perf_counter(), 0.0)))
            due = int((time.perf_counter() - self._began) * RATE)
        if due < self._next:
            return found
        if self._waiting is None:
            self._waiting = self._began + self._next / RATE
        first: list[Event] = [self._place(0), Button(LEFT, True)] if self._next == 0 else []
        moves = [self._place(step) for step in range(max(self._next, 1), due + 1)]
        self._next = due + 1
        return [*found, *first, *moves]

    def present(self, image: Any, moving: bool) -> None:
        """Notes how long the oldest motion waited to be seen, ms."""
        self.surface.present(image, moving)
        self.surface.context.raw.glFinish()
        if self._waiting is not None and moving:
            self.answers.append((time.perf_counter() - self._waiting) * 1e3)
            self._waiting = None


def measure(viewer: "Viewer", hand: Hand, seconds: float = 5.0, rests: int = 7) -> Answers:
    """Drags for so long, then begins a drag so many times while the picture refines. hand: the viewer's surface."""
    pictures = viewer.pictures

    def tick(until: Callable[[], bool]) -> None:
        while viewer.running and not until():
            viewer.tick()

    def wait(duration: float) -> None:
        end = time.perf_counter() + duration
        tick(lambda: time.perf_counter() >= end)

    tick(lambda: pictures.sides["a"].done > 1 or pictures.sides["a"].finished)
    hand.press()
    wait(min(seconds, 2.0))
    tick(lambda: len(hand.answers) >= WARM_UP)
    hand.press()  # what waits since a frame of before is not counted
    hand.answers.clear()
    shares, start = [], time.perf_counter()
    while viewer.running and time.perf_counter() - start < seconds:
        viewer.tick()
        shares.append(pictures.scale)
    took, drags = time.perf_counter() - start, tuple(hand.answers)
    answered = []
    for number in range(rests):
        hand.release()
        tick(lambda: not pictures.moving)
        wait(number * REST_STEP_S)
        hand.answers.clear()
        hand.press()
        tick(lambda: bool(hand.answers))
        answered.append(hand.answers[0])
    hand.release()
    viewer.tick()
    return Answers(drags, tuple(answered), len(drags) / took, tuple(shares))
