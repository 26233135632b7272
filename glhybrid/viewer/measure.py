"""How far the pictures that are looked at are from the reference, or from each other: numbers and maps, as they come.

Numbers are made anew whenever the reference has twice as many samples as the last time.
"""

from collections.abc import Callable
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
        self._counted: dict[str, Any] = {}  # what errors are of
        self._flips: dict[str, tuple[Any, Any]] = {}  # of what, the map's texture
        self._maps: dict[str, tuple[Any, Any]] = {}

    def forget(self, side: str) -> None:
        """A side is drawn anew."""
        for table in (self.errors, self._counted, self._flips, self._maps):
            table.pop(side, None)

    def update(
        self, side: str, version: Any, ours: Picture, theirs: Picture, turn: Callable[[], None] | None = None
    ) -> bool:
        """What is due for pictures that were brought to display; whether anything has changed.

        version: of both pictures and of how they are displayed. turn: called now and then where FLIP takes long.
        """
        if ours.size != theirs.size or ours.display is None or theirs.display is None:
            return False
        key, changed = (version, theirs.done if theirs.finished else 1 << (theirs.done.bit_length() - 1)), False
        if self._counted.get(side) != key:
            with self._renderer.shaders.pace.turns(turn):
                image, mean = self.differ.flip(f"flip {side}", ours, theirs)
            self.errors[side] = replace(self.differ.error(ours, theirs), flip=mean)
            self._flips[side], self._counted[side], changed = (key, image), key, True
        return self.draw_map(side, (version, ours.done, theirs.done), ours, theirs) or changed

    @property
    def differ(self) -> compare.Differ:
        """Made, and its programs compiled, when it is first asked for."""
        if self._differ is None:
            palette = self._upload("ramp magma", views.palette("magma")[None])
            self._differ = compare.Differ(self._renderer.context, self._renderer.shaders, self._renderer.flip, palette)
            self._differ.prepare()
        return self._differ

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
            of, image = self._flips[side]
            if self._maps.get(side, (None,))[0] != (session.mode, of):
                self.legend = views.Scale(0.0, 1.0, compare.FLIP_UNIT, "magma")
                self._maps[side] = (session.mode, of), image
                return True
        return False

    def map(self, side: str) -> Any:
        """The texture of a side's map in the mode of now, row 0 at the bottom; None until it is made."""
        found = self._maps.get(side)
        return found[1] if found is not None and found[0][0] == self._session.mode else None

    def close(self) -> None:
        """Frees the images."""
        if self._differ is not None:
            self._differ.release()
            self._differ = None
