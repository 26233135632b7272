"""How far a study is and how long it will still take."""

import logging
import time
from collections.abc import Callable

log = logging.getLogger("glhybrid")
Progress = Callable[[str, int, int], None]
UNITS = 100  # of the bar to one cell
SAY_EVERY_S = 20.0


class Meter:
    """Counts cells of work. Without a terminal, where no bar is drawn, a line says the same now and then."""

    def __init__(self, progress: Progress | None, lines: bool) -> None:
        self._progress, self._lines = progress, lines
        self._done = self._total = 0.0
        self._free = 0.0  # what was there already, and took no time
        self._started = self._said = time.perf_counter()
        self._label = ""

    def expect(self, cells: float) -> None:
        """More work is known of."""
        self._total += cells
        self._show(0.0)

    def begin(self, label: str) -> None:
        """What is shown beside the bar from now on."""
        self._label = label
        self._show(0.0)

    def part(self, share: float) -> None:
        """Of the present piece of work, 0 to 1, times its cells."""
        self._show(share)

    def end(self, cells: float = 1.0, free: bool = False) -> None:
        """So much more is done. free: it took no time, and says nothing about how long the rest takes."""
        self._done += cells
        self._free += cells if free else 0.0
        self._show(0.0)

    def left_s(self) -> float | None:
        """Seconds, by the mean of what was done in this run; None before anything was."""
        worked = self._done - self._free
        if worked <= 0:
            return None
        return (time.perf_counter() - self._started) / worked * max(self._total - self._done, 0.0)

    def _show(self, share: float) -> None:
        if self._progress is not None:
            self._progress(self._label, round((self._done + share) * UNITS), max(round(self._total * UNITS), 1))
        now = time.perf_counter()
        if self._lines and now - self._said >= SAY_EVERY_S:
            self._said = now
            left = self.left_s()
            rest = "" if left is None else f", about {spoken(left)} left"
            log.info("%.0f of %.0f%s: %s", self._done, self._total, rest, self._label)


def spoken(seconds: float) -> str:
    """ "40 s", "7 min", "2 h 10 min"."""
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
