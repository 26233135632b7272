"""Times of passes, around finish(): timer queries report almost nothing on software rasterisers."""

import time
from collections.abc import Callable
from statistics import median
from typing import TypeVar

T = TypeVar("T")

Progress = Callable[[str, int, int], None]  # told of a long job: what it counts, how many are done, of how many


class Timing:
    """Milliseconds by pass, one entry a frame. Off: run() only runs. clock: seconds."""

    def __init__(
        self, finish: Callable[[], None], enabled: bool = True, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._finish, self._clock = finish, clock
        self.enabled = enabled
        self._frames: list[dict[str, float]] = []

    def frame(self) -> None:
        """A new frame begins."""
        self._frames.append({})

    def run(self, name: str, work: Callable[[], T]) -> T:
        """The result of work(), timed from finish() to finish()."""
        if not self.enabled:
            return work()
        self._finish()
        start = self._clock()
        result = work()
        self._finish()
        row = self._frames[-1]
        row[name] = row.get(name, 0.0) + (self._clock() - start) * 1e3
        return result

    def take(self) -> dict[str, float]:
        """Milliseconds by pass, summed over the frames so far, which are forgotten."""
        total: dict[str, float] = {}
        for frame in self._frames:
            for name, ms in frame.items():
                total[name] = total.get(name, 0.0) + ms
        self._frames.clear()
        return total

    def medians(self) -> dict[str, float]:
        """Milliseconds by pass, over all frames but the first, which also compiles (unless it is the only one)."""
        frames = self._frames[1:] or self._frames
        names = dict.fromkeys(name for frame in frames for name in frame)
        return {name: median(frame[name] for frame in frames if name in frame) for name in names}
