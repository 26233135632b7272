"""How far the pictures that are looked at are from the reference, or from each other: numbers and maps, as they come.

Numbers are made anew whenever the reference has twice as many samples as the last time; FLIP follows when it is done.
"""

from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from typing import Any

from glhybrid.scene import F32, U8
from glhybrid.viewer import compare, views
from glhybrid.viewer.picture import Picture
from glhybrid.viewer.session import Session

Upload = Callable[[str, U8], Any]


class Measure:
    """errors: by side. legend: of the map that was made last."""

    def __init__(self, session: Session, upload: Upload) -> None:
        self.errors: dict[str, compare.Error] = {}
        self.legend: views.Legend | None = None
        self._session, self._upload = session, upload
        self._worker = compare.Worker()
        self._has_flip = compare.has_flip()
        self._pairs: dict[str, tuple[Any, U8, U8]] = {}
        self._flips: dict[str, tuple[Any, F32, float]] = {}
        self._asked: dict[str, Any] = {}
        self._maps: dict[str, tuple[Any, Any]] = {}

    @property
    def busy(self) -> bool:
        return self._worker.busy

    def forget(self, side: str) -> None:
        """A side is drawn anew."""
        for table in (self.errors, self._pairs, self._flips, self._asked, self._maps):
            table.pop(side, None)

    def update(self, side: str, version: Any, ours: Picture, theirs: Picture) -> bool:
        """What is due for pictures that were brought to display; whether anything has changed.

        version: of both pictures and of how they are displayed.
        """
        changed = self._deliver()
        done = theirs.done if theirs.finished else 1 << (theirs.done.bit_length() - 1)
        key = version, done
        if self._pairs.get(side, (None,))[0] != key and not self._worker.counting:
            first, second = ours.rgb(), theirs.rgb()
            if first.shape != second.shape:
                return changed
            self._pairs[side] = key, first, second
            self._worker.count((side, key), first, second, ours.radiance(), theirs.radiance(), theirs.done)
            changed = True
        if self._has_flip and side in self._pairs and not self._worker.flipping:
            key, first, second = self._pairs[side]
            if self._asked.get(side) != key:
                self._asked[side] = key
                self._worker.start((side, key), first, second)
        return self._make_map(side) or changed

    def _deliver(self, wait: bool = False) -> bool:
        """Takes what is done; whether there was anything that is still of use."""
        changed = False
        if (counted := self._worker.counted(wait)) is not None:
            (side, key), error = counted
            if self._pairs.get(side, (None,))[0] == key:  # else drawn anew meanwhile
                flip = self._flips.get(side)
                self.errors[side] = replace(error, flip=flip[2] if flip is not None else None)
                changed = True
        try:
            flipped = self._worker.flipped(wait)
        except (BrokenProcessPool, MemoryError) as error:  # the process was killed, or has no room
            self._has_flip, flipped = False, None
            self._session.say(f"no FLIP from now on: {error}", error=True)
        if flipped is not None:
            (side, key), error_map, mean = flipped
            if self._asked.get(side) == key:
                self._flips[side] = key, error_map, mean
                if side in self.errors:
                    self.errors[side] = replace(self.errors[side], flip=mean)
                self._make_map(side)
                changed = True
        return changed

    def _make_map(self, side: str) -> bool:
        mode = self._session.mode
        if mode == "difference" and side in self._pairs:
            key, ours, theirs = self._pairs[side]
            wanted = mode, key, self._session.gain
            if self._maps.get(side, (None,))[0] != wanted:
                high = 255.0 / self._session.gain
                rgb, self.legend = views.heat(compare.difference(ours, theirs), high, "levels of 255")
                self._maps[side] = wanted, self._upload(f"map {side}", rgb)
                return True
        if mode == "flip" and side in self._flips:
            key, error_map, _ = self._flips[side]
            if self._maps.get(side, (None,))[0] != (mode, key):
                rgb, self.legend = views.heat(error_map, 1.0, "equal ... as unlike as can be")
                self._maps[side] = (mode, key), self._upload(f"map {side}", rgb)
                return True
        if mode == "flip" and not self._has_flip:
            if not compare.has_flip():
                self._session.say("FLIP needs flip-evaluator: pip install 'glhybrid[viewer]'", error=True)
            self._session.mode = "difference"
        return False

    def map(self, side: str) -> Any:
        """The texture of a side's map in the mode of now, row 0 at the top; None until it is made."""
        found = self._maps.get(side)
        return found[1] if found is not None and found[0][0] == self._session.mode else None

    def settle(self) -> bool:
        """Waits for what is on its way; whether there was any."""
        return self._deliver(wait=True)

    def close(self) -> None:
        self._worker.close()
