"""Long dispatches in bands, with a turn for others in between: what keeps a window alive where a pass takes a second.

Off, a dispatch is one dispatch. On, the rows of tiles of each program that works on tiles (lib/tile.glsl) are drawn a
few at a time, as many as take at most about `band_ms`; pixels are the same to the bit.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

BAND_MS = 40.0  # where nothing else is asked for
GROWTH = 4.0  # of a band over the one before, at most: what is not measured yet is not believed


class Interrupted(Exception):
    """What was being drawn is not wanted any more. Images that it wrote to hold a part of it."""


class Pace:
    """band_ms: of drawing between two turns. away_s: seconds spent in turns so far."""

    def __init__(self) -> None:
        self.band_ms = BAND_MS
        self._turn: Callable[[], None] | None = None
        self.away_s = 0.0

    @property
    def on(self) -> bool:
        """Whether dispatches are drawn in bands, with turns in between."""
        return self._turn is not None

    @contextmanager
    def turns(self, turn: Callable[[], None] | None) -> Iterator[None]:
        """turn: called between bands until the end of the block; what it raises goes through the drawing."""
        before, self._turn = self._turn, turn
        try:
            yield
        finally:
            self._turn = before

    def give_turn(self) -> None:
        """Calls back, if anybody wants a turn; its time is no work's."""
        if self._turn is not None:
            start = time.perf_counter()
            try:
                self._turn()
            finally:
                self.away_s += time.perf_counter() - start

    def clock(self) -> float:
        """Seconds, turns left out."""
        return time.perf_counter() - self.away_s


def spread_rows(count: int, most: Callable[[], int]) -> Iterator[tuple[int, int, int]]:
    """(first, every which one, how many) of rows, until all were there once; 0 comes first. most: of the next ones.

    The rows of a band lie apart, all over the image, so that what one takes tells what the next will: a sky over a wood
    would let bands grow in the sky. A band that is too long is halved, into its even and its odd rows.
    """
    waiting = [(0, 1)]
    while waiting:
        first, every = waiting.pop()
        rows = -(-(count - first) // every)
        if rows > max(most(), 1):
            waiting += [(first + every, 2 * every), (first, 2 * every)]
        else:
            yield first, every, rows


class Bands:
    """How much of one program is drawn at a time: learns what a tile costs."""

    def __init__(self) -> None:
        self._tiles = 0.0  # in a band

    def rows(self, across: int) -> int:
        """Rows of so many tiles for the next band, at most."""
        return max(int(self._tiles / across), 1)

    def note(self, tiles: int, ms: float, band_ms: float) -> None:
        """So many tiles took so long; the next ones are to take about band_ms."""
        fits = tiles * band_ms / max(ms, 1e-3)
        self._tiles = min(fits, GROWTH * tiles)
