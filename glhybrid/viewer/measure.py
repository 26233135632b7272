"""How far the pictures that are looked at are from the reference, or from each other: numbers and maps, as they come.

Numbers are made anew whenever the reference has twice as many samples as the last time; FLIP follows when it is done.
"""

from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from typing import Any

from glhybrid.renderer import Renderer
from glhybrid.scene import U8
from glhybrid.viewer import compare, views
from glhybrid.viewer.picture import Picture
from glhybrid.viewer.session import Session

Upload = Callable[[str, U8], Any]


class Measure:
    """errors: by side. legend: of the map that was made last. upload(name, pixels): a texture of them."""

    def __init__(self, session: Session, renderer: Renderer, upload: Upload) -> None:
        self.errors: dict[str, compare.Error] = {}
        self.legend: views.Legend | None = None
        self._session, self._upload, self._renderer = session, upload, renderer
        self._differ: compare.Differ | None = None
        self._worker = compare.Worker()
        self._has_flip = compare.has_flip()
        self._counted: dict[str, Any] = {}  # what errors are of
        self._asked: dict[str, Any] = {}  # what FLIP was asked for
        self._flips: dict[str, tuple[Any, float, Any]] = {}  # of what, the mean, the map's texture
        self._maps: dict[str, tuple[Any, Any]] = {}

    @property
    def busy(self) -> bool:
        """Whether FLIP is being worked out."""
        return self._worker.busy

    def forget(self, side: str) -> None:
        """A side is drawn anew."""
        for table in (self.errors, self._counted, self._asked, self._flips, self._maps):
            table.pop(side, None)

    def update(self, side: str, version: Any, ours: Picture, theirs: Picture) -> bool:
        """What is due for pictures that were brought to display; whether anything has changed.

        version: of both pictures and of how they are displayed.
        """
        changed = self.deliver()
        if ours.size != theirs.size or ours.display is None or theirs.display is None:
            return changed
        key = version, theirs.done if theirs.finished else 1 << (theirs.done.bit_length() - 1)
        if self._counted.get(side) != key:
            self._counted[side] = key
            flip = self._flips.get(side)
            self.errors[side] = replace(self.differ.error(ours, theirs), flip=flip[1] if flip is not None else None)
            changed = True
        if self._has_flip and self._asked.get(side) != key and not self._worker.busy:
            self._asked[side] = key
            self._worker.start((side, key), ours.pixels(), theirs.pixels())
        return self.draw_map(side, (version, ours.done, theirs.done), ours, theirs) or changed

    @property
    def differ(self) -> compare.Differ:
        """Made, and its programs compiled, when it is first asked for."""
        if self._differ is None:
            palette = self._upload("ramp magma", views.palette("magma")[None])
            self._differ = compare.Differ(self._renderer.context, self._renderer.shaders, palette)
            self._differ.prepare()
        return self._differ

    def deliver(self, wait: bool = False) -> bool:
        """Takes FLIP's result if it is there; whether it is still of use."""
        try:
            flipped = self._worker.flipped(wait)
        except (BrokenProcessPool, MemoryError) as error:  # the process was killed, or has no room
            self._has_flip, flipped = False, None
            self._session.say(f"no FLIP from now on: {error}", error=True)
        if flipped is None:
            return False
        (side, key), pixels, mean = flipped
        if self._asked.get(side) != key:  # drawn anew meanwhile
            return False
        self._flips[side] = key, mean, self._upload(f"flip {side}", pixels)
        if side in self.errors:
            self.errors[side] = replace(self.errors[side], flip=mean)
        return True

    def draw_map(self, side: str, key: Any, ours: Picture, theirs: Picture) -> bool:
        """The map of the mode of now, of two pictures on display, unless there is one of this key."""
        session = self._session
        if session.mode == "difference":
            wanted = session.mode, key, session.gain
            if self._maps.get(side, (None,))[0] != wanted:
                image, self.legend = self.differ.map(side, ours, theirs, session.gain)
                self._maps[side] = wanted, image
                return True
        if session.mode == "flip" and side in self._flips:
            of, _, image = self._flips[side]
            if self._maps.get(side, (None,))[0] != (session.mode, of):
                self.legend = views.Scale(0.0, 1.0, compare.FLIP_UNIT, "magma")
                self._maps[side] = (session.mode, of), image
                return True
        if session.mode == "flip" and not self._has_flip:
            if not compare.has_flip():
                session.say("FLIP needs flip-evaluator: pip install 'glhybrid[viewer]'", error=True)
            session.mode = "difference"
        return False

    def map(self, side: str) -> Any:
        """The texture of a side's map in the mode of now, row 0 at the bottom; None until it is made."""
        found = self._maps.get(side)
        return found[1] if found is not None and found[0][0] == self._session.mode else None

    def settle(self) -> bool:
        """Waits for what is on its way; whether there was any."""
        return self.deliver(wait=True)

    def close(self) -> None:
        """Ends the process for FLIP and frees the images."""
        self._worker.close()
        if self._differ is not None:
            self._differ.release()
            self._differ = None
