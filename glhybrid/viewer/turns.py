"""Input while something long runs on the viewer's thread: looked at in between, so that the window stays alive.

Two kinds of long things. A sample drawn in bands (pace.py): what needs no drawing is answered at once, all else ends
the sample and waits for the next turn of the loop. Preparations (reading files, trees, light maps, programs): they are
shown as they go, Esc ends them, and other input waits.
"""

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from glhybrid.errors import GlhybridError
from glhybrid.pace import Interrupted
from glhybrid.shaders import Shaders
from glhybrid.viewer.controls import Controls
from glhybrid.viewer.events import Button, Close, Event, Focus, Key, Move, Text, Wheel
from glhybrid.viewer.gui import Gui
from glhybrid.viewer.surface import Surface

LOOK_S = 0.03  # between two looks at the input in a preparation
PATIENCE_S = 0.3  # a preparation that takes longer is shown


class Cancelled(GlhybridError):
    """The user has ended a preparation."""


@dataclass
class Job:
    """A preparation. done of total; total 0: nobody knows. since: when it began. at_once: it is shown from then on."""

    what: str
    done: int
    total: int
    since: float
    at_once: bool = False

    @property
    def shown(self) -> bool:
        """Whether it has taken long enough to be told."""
        return self.at_once or clock.monotonic() - self.since > PATIENCE_S


class Turns:
    """pending: events that wait for the loop. job: what is being prepared.

    take: an event that needs no drawing. present: a frame of what there is. stale: whether the sample that is being
    drawn is not what is wanted any more.
    """

    def __init__(
        self, surface: Surface, controls: Controls, take: Callable[[Event], None],
        present: Callable[[], None], stale: Callable[[], bool],
    ) -> None:  # fmt: skip
        self._surface, self._controls = surface, controls
        self.gui: Gui
        self._take, self._present, self._stale = take, present, stale
        self.pending: list[Event] = []
        self.job: Job | None = None
        self.presented = False  # whether there is anything to see yet
        self.presenting = False  # whether a frame is being made now
        self._software = surface.context.device.software
        self._looked = 0.0

    def turn(self) -> None:
        """Between two bands of a sample. Raises Interrupted."""
        events = self._surface.poll(0.0)
        for number, event in enumerate(events):
            if not self._needs_no_drawing(event):
                self.pending += events[number:]
                raise Interrupted
            self._take(event)
        if events:
            self._present()
        if self._stale():
            raise Interrupted

    def _needs_no_drawing(self, event: Event) -> bool:
        controls = self._controls
        if isinstance(event, Text):
            return True
        if controls.dragging:
            return False
        if isinstance(event, Button | Wheel):
            return self.gui.wants_pointer or controls.pointer[0] >= controls.size[0]
        if isinstance(event, Key):
            return not event.down or self.gui.wants_keys
        return isinstance(event, Move | Focus)

    def progress(self, what: str, done: int, total: int) -> None:
        """How far a preparation is. Raises Cancelled. In the middle of a frame nothing comes of it."""
        if self.presenting:
            return
        now = clock.monotonic()
        job = self.job = self.job or Job(what, done, total, now, at_once=not self.presented)
        changed, job.what, job.done, job.total = job.what != what or now == job.since, what, done, total
        if changed and what.startswith(("compiling", "measuring")) and not self._software:
            job.at_once = True  # it takes a while on a GPU, and without threads of its own nobody has a turn until then
        elif now - self._looked < LOOK_S:
            return
        self._looked = now
        events = self._surface.poll(0.0)
        wanted = [e for e in events if not (isinstance(e, Key) and e.name == "escape")]
        self.pending += wanted
        if len(wanted) < len(events) or any(isinstance(e, Close) for e in events):
            self.job = None
            raise Cancelled(f"{what}: ended")
        if job.shown and self._surface.visible:
            self._present()

    @contextmanager
    def endless(self, shaders: Shaders) -> Iterator[None]:
        """Compiling in here cannot be ended, nor is it shown."""
        told, shaders.progress = shaders.progress, None
        try:
            yield
        finally:
            shaders.progress = told

    def prepared(self) -> None:
        """There is nothing to prepare any more."""
        self.job = None
