"""The pictures of a session: two sides and the reference, drawn in turns within a budget, and what they differ by.

In motion each frame is the first sample of a smaller picture; at rest the full one refines until it is `render`'s.
"""

import time as clock
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from glhybrid.errors import GlhybridError
from glhybrid.renderer import Renderer, Staged
from glhybrid.scene import U8
from glhybrid.settings import Settings
from glhybrid.viewer import compare, views
from glhybrid.viewer.budget import GPU_MS, REST_S, SOFTWARE_MS, Budget, scaled
from glhybrid.viewer.picture import Picture
from glhybrid.viewer.session import Session
from glhybrid.viewer.views import PICTURE

Side = Literal["a", "b", "reference"]
SLICE_MS = 25.0  # of samples between two looks at the input, at rest: more than one only where they are cheap
STAGED_AOVS = ("reason", "motion")  # need programs of their own
DISPLAY = ("exposure", "tone")


class Pictures:
    """update() draws what is due; image() and layers are what to show."""

    def __init__(self, renderer: Renderer, session: Session, texture: Callable[[str, U8], Any]) -> None:
        """texture(name, rgb): uploads an image (H, W, 3) under a name and returns the texture."""
        self.renderer, self.session = renderer, session
        self.sides: dict[Side, Picture] = {side: Picture(renderer, self._retire) for side in ("a", "b", "reference")}
        self.budget = Budget(SOFTWARE_MS if renderer.context.device.software else GPU_MS)
        self.errors: dict[Side, compare.Error] = {}
        self.legend: views.Legend | None = None
        self.size = (1, 1)
        self.scale = 1.0
        self.frame_ms = 0.0  # of the last picture in motion
        self._texture = texture
        self._flip = compare.FlipWorker()
        self._has_flip = compare.has_flip()
        self._maps: dict[Side, tuple[Any, Any]] = {}  # side -> key, FLIP's map
        self._drawn: tuple[Any, ...] = ()
        self._arrays: dict[Side, tuple[Any, Any]] = {}
        self._good: dict[str, Settings] = {"a": session.a, "b": session.b}
        self._moved_at = 0.0
        self._moving = False
        self._begun: dict[Side, Any] = {}
        self._stuck: Any = None

    # What is to be drawn

    def shown(self) -> tuple[Side, ...]:
        """The sides that are looked at."""
        s = self.session
        if s.mode == "split":
            return ("a", "b")
        if s.mode == "single":
            return ("b",) if s.flipped else ("a",)
        return ("b",) if s.flipped and s.against == "reference" else ("a", "b") if s.against == "b" else ("a",)

    def wanted(self) -> tuple[Side, ...]:
        """All that are worked on, in order of urgency."""
        shown = self.shown()
        measured = self.session.reference or (
            self.session.mode in ("difference", "flip") and self.session.against == "reference"
        )
        return (*shown, "reference") if measured else shown

    @property
    def moving(self) -> bool:
        return self._moving

    @property
    def busy(self) -> bool:
        """Whether update() would draw something."""
        return self._moving or any(not self.sides[s].finished for s in self.wanted()) or self._flip.busy

    def update(self, size: tuple[int, int]) -> bool:
        """Draws for a slice of time; whether anything to show has changed."""
        session, now = self.session, clock.monotonic()
        key = session.moves, session.transport.time
        if self._stuck == (key, session.a, session.b, id(session.scene)):
            return False  # nothing has changed since nothing could be drawn
        if self._drawn != key:
            self._drawn, self._moved_at, self._moving = key, now, True
        elif self._moving and now - self._moved_at > REST_S and not session.transport.playing:
            self._moving = False
        self.size = size
        self.scale = self.budget.next() if self._moving else 1.0
        try:
            changed = self._draw(now)
            self._good = {"a": session.a, "b": session.b}
            self._stuck = None
            return changed
        except GlhybridError as error:
            self._recover(error)
            return True

    def _draw(self, now: float) -> bool:
        session = self.session
        pixels = scaled(self.size, self.scale)
        wanted = self.wanted()
        aovs = (session.show,) if session.show in STAGED_AOVS else ()
        changed = False
        for side in wanted:
            settings = session.settings(side)
            plain = settings.replace(exposure=0.0, tone="none")
            begun = (session.lit_scene(), plain, session.moves, session.transport.time, pixels, aovs)
            if self._begun.get(side) != begun and (side != "reference" or not self._moving):
                if self._begun.get(side, (None, None))[1] != plain and side in self.shown():
                    self.budget.forget()
                self._begun[side] = begun
                camera = session.camera()
                self.sides[side].begin(session.lit_scene(), settings, camera, pixels, aovs)
                self.errors.pop(side if side != "reference" else "a", None)
                if side == "reference":
                    self.errors.clear()
            self.sides[side].redisplay(settings)
        if session.show != PICTURE and session.mode in ("single", "split"):
            changed |= self._make_arrays(pixels)
        if self._moving:
            return self._in_motion() or changed
        while (due := self._next(wanted)) is not None:
            ms = self.sides[due].step()
            if due != "reference":
                self.budget.note(ms, 1.0)
            changed = True
            if (clock.monotonic() - now) * 1e3 > SLICE_MS:
                break
        return self._measure() or changed

    def _in_motion(self) -> bool:
        """The first sample of every picture that is looked at, unless an array is."""
        total = 0.0
        start = clock.perf_counter()
        for side in self.shown():
            if self.session.show == PICTURE and self.sides[side].done == 0:
                total += self.sides[side].step(full=self.scale == 1.0)
        if total:
            self.frame_ms = total
            self.budget.note((clock.perf_counter() - start) * 1e3, self.scale)
        return total > 0

    def _next(self, wanted: tuple[Side, ...]) -> Side | None:
        """The one that has most to do, the reference last."""
        open_ = [s for s in wanted if not self.sides[s].finished]
        if self.session.show != PICTURE and self.session.mode in ("single", "split"):
            open_ = [s for s in open_ if s == "reference" or "reference" in wanted]
        sides = [s for s in open_ if s != "reference"]
        return min(sides, key=lambda s: self.sides[s].share) if sides else (open_[0] if open_ else None)

    def _make_arrays(self, pixels: tuple[int, int]) -> bool:
        session, changed = self.session, False
        for side in self.shown():
            key = self._begun[side], session.show, session.light_shown, session.a.exposure
            if self._arrays.get(side, (None,))[0] == key:
                continue
            start = clock.perf_counter()
            array = self.sides[side].array(session.show)
            names = {
                "instance_id": [i.name or session.scene.meshes[i.mesh].name for i in session.scene.instances],
                "material_id": [m.name for m in session.scene.materials],
            }
            exposure = session.a.exposure
            ev = self.sides["a"].exposure_ev() if exposure == "auto" else float(exposure)
            look = views.Look(ev, session.light_shown, names, session.scene.bounds())
            rgb, legend = views.colour(session.show, array, look)
            if side == self.shown()[0]:
                self.legend = legend
            self._arrays[side] = key, self._texture(f"array {side}", rgb)
            self.budget.note((clock.perf_counter() - start) * 1e3, self.scale)
            self.frame_ms = (clock.perf_counter() - start) * 1e3
            changed = True
        return changed

    # What is shown

    def image(self, side: Side) -> tuple[Any, bool] | None:
        """(texture, whether its first row is at the bottom) of a side; None before anything was drawn."""
        session = self.session
        if session.mode in ("difference", "flip"):
            found = self._maps.get(side)
            return (found[1], False) if found else None
        if session.show != PICTURE:
            found = self._arrays.get(side)
            return (found[1], False) if found else None
        picture = self.sides[side]
        if side in self.wanted():
            picture.show(self._exposure_for(side))
        image = picture.show(self._exposure_for(side))
        picture.filter(picture.size == self.size)
        return (image, True) if image is not None else None

    def _exposure_for(self, side: Side) -> float | None:
        """Side b and the reference at the exposure that was found for a, where both are looked at."""
        if side == "a" or self.session.a.exposure != "auto" or self.sides["a"].done == 0 or "a" not in self.wanted():
            return None
        return self.sides["a"].exposure_ev()

    def channels(self) -> tuple[str, ...]:
        """Images of passes of the sides that are looked at."""
        return tuple(dict.fromkeys(name for side in self.shown() for name in self.sides[side].channels()))

    def pass_view(self, name: str) -> str:
        """The view that shows what a pass made."""
        known = {
            "gbuffer": "triangle_id", "shadow": "visibility", "shadow_map": "visibility", "reflect": "reflection",
            "composite": "radiance", "display": PICTURE, "reference": PICTURE, "skin": "normal", "refit": "bvh_steps",
            "tlas": "instance_id", "pose": "motion",
        }  # fmt: skip
        if name in known:
            return known[name]
        return next((c for c in self.channels() if c.startswith(name) or name.startswith(c)), PICTURE)

    # Errors

    def _measure(self) -> bool:
        """Numbers and maps against the reference, or of one side against the other, as they come."""
        session, sides = self.session, self.sides
        changed = False
        if (found := self._flip.result()) is not None:
            key, error_map, mean = found
            changed = self._take_flip(key, error_map, mean)
        direct = session.mode in ("difference", "flip") and session.against == "b"
        other: Side = "b" if direct else "reference"
        if other not in self.wanted() or sides[other].done == 0:
            return changed
        step = sides[other].done if sides[other].finished else 1 << (sides[other].done.bit_length() - 1)
        for side in self.shown():
            if side == other or not sides[side].finished:
                continue
            key = side, other, self._begun[side], step, session.mode, session.gain, session.a.tone, session.a.exposure
            if self._maps.get(side, (None,))[0] == key or sides[side].done == 0:
                continue
            sides["a"].show()
            ours, theirs = (self._rgb(s) for s in (side, other))
            if ours is None or theirs is None or ours.shape != theirs.shape:
                continue
            old = self.errors.get(side)
            self.errors[side] = compare.numbers(
                ours, theirs, sides[side].radiance(), sides[other].radiance(), sides[other].done
            )
            if old is not None and old.flip is not None:
                self.errors[side] = compare.Error(
                    self.errors[side].psnr, self.errors[side].rel_mse, old.flip, sides[other].done
                )
            if self._has_flip and not self._flip.busy:
                self._flip.start((*key, ours.shape), ours, theirs)
            if session.mode == "difference":
                rgb, self.legend = views.heat(compare.difference(ours, theirs), 255.0 / session.gain, "levels of 255")
                self._maps[side] = key, self._texture(f"map {side}", rgb)
            elif session.mode == "single" or session.mode == "split":
                self._maps[side] = key, None
            elif not self._has_flip:
                session.say("FLIP needs flip-evaluator: pip install 'glhybrid[viewer]'", error=True)
                session.mode = "difference"
            else:
                old_map = self._maps.get(side)
                self._maps[side] = key, old_map[1] if old_map else None
            changed = True
        return changed

    def _take_flip(self, key: Any, error_map: Any, mean: float) -> bool:
        side = key[0]
        if self._begun.get(side) != key[2]:
            return False
        if (error := self.errors.get(side)) is not None:
            self.errors[side] = compare.Error(error.psnr, error.rel_mse, mean, error.samples)
        if self.session.mode == "flip":
            rgb, self.legend = views.heat(error_map, 1.0, "FLIP")
            self._maps[side] = key[:-1], self._texture(f"map {side}", rgb)
        return True

    def _rgb(self, side: Side) -> U8 | None:
        if self.sides[side].show(self._exposure_for(side)) is None:
            return None
        return np.asarray(self.sides[side].rgb())

    def settle(self) -> None:
        """Waits for FLIP, for pictures that are to show it."""
        if (found := self._flip.result(wait=True)) is not None:
            self._take_flip(*found)

    # Failures

    def _recover(self, error: GlhybridError) -> None:
        """Back to the settings that worked, with the reason; a scene that cannot be drawn at all is said so once."""
        session = self.session
        session.say(str(error), error=True)
        if (session.a, session.b) == (self._good["a"], self._good["b"]):
            for side in self.sides.values():
                side.drop()
            session.show = PICTURE
            self._stuck = self._drawn, session.a, session.b, id(session.scene)
        session.a, session.b = self._good["a"], self._good["b"]
        self._begun.clear()

    def _retire(self, old: Staged) -> None:
        if not any(p.staged is old for p in self.sides.values()):
            self.renderer.forget(old)

    def restart(self) -> None:
        """Everything is drawn anew, as after a reload."""
        self._begun.clear()
        self._arrays.clear()
        self._maps.clear()
        self.errors.clear()
        self.budget.forget()

    def close(self) -> None:
        self._flip.close()
