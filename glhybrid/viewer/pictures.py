"""The pictures of a session: two sides and the reference, drawn in turns within a budget, and what they differ by.

In motion each frame is the first sample of a smaller picture; at rest the full one refines until it is `render`'s.
"""

import time as clock
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal

from glhybrid.errors import GlhybridError
from glhybrid.pace import Interrupted
from glhybrid.renderer import Renderer
from glhybrid.scene import U8, Scene
from glhybrid.settings import Settings
from glhybrid.staged import Staged
from glhybrid.timing import Progress
from glhybrid.viewer import views
from glhybrid.viewer.budget import REST_S, Budget, scaled
from glhybrid.viewer.measure import Measure
from glhybrid.viewer.painted import Painted
from glhybrid.viewer.picture import Picture
from glhybrid.viewer.session import Session
from glhybrid.viewer.views import PICTURE

Side = Literal["a", "b", "reference"]
LONG_MS = 15.0  # a sample that takes longer is drawn in parts, with looks at the input in between
GPU_BAND_MS = 10.0  # of such a part on a GPU, whose frames in motion are short too
SLICE_MS = 25.0  # of samples between two looks at the input, at rest: more than one only where they are cheap
STAGED_AOVS = ("reason", "reason_shadows", "reason_ao", "motion")  # need programs of their own
SIDES: tuple[Side, ...] = ("a", "b", "reference")


class Pictures:
    """update() draws what is due; image() and layers are what to show."""

    def __init__(
        self, renderer: Renderer, session: Session, texture: Callable[[str, U8], Any],
        turn: Callable[[], None] | None = None, progress: Progress | None = None,
    ) -> None:  # fmt: skip
        """texture(name, rgb): uploads an image (H, W, 3) under a name and returns the texture.

        turn: called now and then while a long sample is drawn; raises Interrupted to end it. progress: of preparations.
        """
        self.renderer, self.session, self._turn = renderer, session, turn
        self.sides: dict[Side, Picture] = {side: Picture(renderer, self._retire, progress) for side in SIDES}
        self._software = renderer.context.device.software
        self.budget = Budget.of(self._software)
        if not self._software:
            renderer.shaders.pace.band_ms = GPU_BAND_MS
        self.measure = Measure(session, renderer, texture)
        self.size = (1, 1)
        self.scale = 1.0
        self.frame_ms = 0.0  # of the last picture in motion
        self._drawn: tuple[Any, ...] = ()
        self.painted = Painted(texture)
        self._good: dict[str, Settings] = {"a": session.a, "b": session.b}
        self._moved_at = 0.0
        self._lit: tuple[Scene, float] | None = None  # scene and time, the last time that nothing moved
        self._relit = False, False  # whether light or time are others than then
        self._moving = False
        self._begun: dict[Side, Any] = {}
        self._stuck: Any = None
        self._looks: tuple[Any, ...] = ()  # of arrays, at the last update

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
        """All that are worked on, in order of urgency; sides with equal settings are one picture."""
        shown = self.shown()
        sides = (*shown, "reference") if self.session.reference or self._other() == "reference" else shown
        return tuple(dict.fromkeys(self._as(side) for side in sides))

    def _other(self) -> Side | None:
        """What maps are against."""
        session = self.session
        if session.mode in ("difference", "flip"):
            return "b" if session.against == "b" else "reference"
        return "reference" if session.reference else None

    @property
    def measured(self) -> bool:
        """Whether errors are against the reference."""
        return self._other() == "reference"

    def _as(self, side: Side) -> Side:
        """The side that draws this one's picture: the first with the same settings."""
        plain = _plain(self.settings(side))
        return next(s for s in SIDES if _plain(self.settings(s)) == plain)

    def picture(self, side: Side) -> Picture:
        """The one that a side shows, which sides with equal settings share."""
        return self.sides[self._as(side)]

    @property
    def moving(self) -> bool:
        """Whether small first samples are shown, because things move."""
        return self._moving

    @property
    def drawing(self) -> bool:
        """Whether update() would draw at once."""
        return self._stuck is None and not self._moving and self._next() is not None

    @property
    def busy(self) -> bool:
        """Whether there will be more to show without any input."""
        return self._stuck is None and (self._moving or self._next() is not None or self.painted.busy)

    def update(self, size: tuple[int, int]) -> bool:
        """Draws for a slice of time; whether anything to show has changed.

        Whatever asks for another picture of a side is motion, be it a camera or a technique: it is answered small.
        """
        session, now = self.session, clock.monotonic()
        self.size = size
        if not self._software:  # there the raster is quick, and another program in motion takes its time to compile
            self.renderer.planned_size = size
        key, self._looks = self._key(), (session.show, session.light_shown)
        if self._stuck == key:
            return False  # nothing has changed since nothing could be drawn
        if self._drawn != key:
            self._drawn, self._moved_at, self._moving = key, now, True
        elif self._moving and now - self._moved_at > REST_S and not session.transport.playing:
            self._moving = False
        self.scale = self.budget.next() if self._moving else 1.0
        lit = session.lit_scene(), session.transport.time
        self._lit = lit if not self._moving or self._lit is None else self._lit
        self._relit = self._lit[0] is not lit[0], self._lit[1] != lit[1]
        try:
            changed = self._draw(now)
            self._good = {"a": session.a, "b": session.b}
            self._stuck = None
            return changed
        except Interrupted:
            return False
        except GlhybridError as error:
            self._recover(error)
            return True

    def stale(self, size: tuple[int, int]) -> bool:
        """Whether something else is looked at than when the last update() began."""
        return (size, self._drawn, self._looks) != (
            self.size, self._key(), (self.session.show, self.session.light_shown)
        )  # fmt: skip

    def _key(self) -> tuple[Any, ...]:
        return tuple(self._what(self._as(side), self.session.settings(side)) for side in self.shown())

    def _turn_for(self, picture: Picture) -> Callable[[], None] | None:
        return self._turn if self._software or picture.last_ms > LONG_MS else None

    def settings(self, side: Side) -> Settings:
        """What a side is drawn with: while light moves, something else for what is made ahead of light."""
        return _standing_in(self.session.settings(side), *self._relit)

    def stands_in(self, side: Side) -> str:
        """In words; empty unless it does."""
        wanted, drawn = self.session.settings(side), self.settings(side)
        pairs = (wanted.shadows, drawn.shadows), (wanted.reflections, drawn.reflections)
        return ", ".join(f"{theirs} instead of {ours}" for ours, theirs in pairs if ours != theirs)

    def _what(self, side: Side, settings: Settings) -> tuple[Any, ...]:
        """All that a side's picture depends on, but for how large it is drawn."""
        session = self.session
        plain, aovs = _plain(settings), (session.show,) if session.show in STAGED_AOVS else ()
        return session.lit_scene(), plain, session.moves, session.transport.time, self.size, aovs

    def _draw(self, now: float) -> bool:
        session, changed = self.session, False
        pixels = scaled(self.size, self.scale)
        for side in self.wanted():
            settings = self.settings(side)
            what = self._what(side, settings)
            old, drawn_at = self._begun.get(side, (None, None))
            due = old != what or (not self._moving and drawn_at != self.size)
            if due and not (side == "reference" and self._moving):
                self._begun[side] = what, pixels
                self.sides[side].begin(what[0], settings, session.camera(), pixels, what[-1])
                for measured in SIDES if side == "reference" else (side,):
                    self.measure.forget(measured)
            self.sides[side].redisplay(settings)
        if self._other() is not None:
            self.measure.differ  # noqa: B018  # its programs are compiled before anybody waits for them
        changed |= self.painted.take()
        if session.show != PICTURE and session.mode in ("single", "split"):
            changed |= self._make_arrays(pixels)
        if self._moving:
            return self._in_motion() or changed
        while (due := self._next()) is not None:
            picture = self.sides[due]
            ms = picture.step(turn=self._turn_for(picture))
            if ms and due != "reference":
                self.budget.note(ms, 1.0)
            changed |= ms > 0
            if (clock.monotonic() - now) * 1e3 > SLICE_MS:
                break
            if self._turn is not None:
                self._turn()  # between samples nothing is lost
        return self._measure() or changed

    def _in_motion(self) -> bool:
        """The first sample of every picture that is looked at, unless an array is."""
        total = 0.0
        start = clock.perf_counter()
        for side in dict.fromkeys(self._as(side) for side in self.shown()):
            if self.session.show == PICTURE and self.sides[side].done == 0:
                total += self.sides[side].step(full=self.scale == 1.0)
        if total:
            if self._other() == "b":
                self._measure()
            self.frame_ms = total
            self.budget.note((clock.perf_counter() - start) * 1e3, self.scale)
        return total > 0

    def _next(self) -> Side | None:
        """The one that has most to do, the reference last. Where arrays are looked at, pictures need not be made."""
        wanted = self.wanted()
        arrays = self.session.show != PICTURE and self.session.mode in ("single", "split")
        if arrays and "reference" not in wanted:
            return None
        sides: list[Side] = [s for s in wanted if s != "reference" and not self.sides[s].finished]
        if sides:
            return min(sides, key=lambda s: self.sides[s].share)
        return "reference" if "reference" in wanted and not self.sides["reference"].finished else None

    def _make_arrays(self, pixels: tuple[int, int]) -> bool:
        session, changed = self.session, False
        for side in self.shown():
            key = self._begun[self._as(side)], session.show, session.light_shown, session.a.exposure
            if self.painted.has(side, key):
                continue
            start = clock.perf_counter()
            array = self.picture(side).array(session.show, None if self._moving else self._turn_for(self.picture(side)))
            names = {
                "instance_id": [i.name or session.scene.meshes[i.mesh].name for i in session.scene.instances],
                "material_id": [m.name for m in session.scene.materials],
            }
            exposure = session.a.exposure
            ev = self.sides["a"].exposure_ev() if exposure == "auto" else float(exposure)
            look = views.Look(ev, session.light_shown, names, session.scene.bounds())
            if not self._moving:
                self.painted.start(side, key, session.show, array, look)
            else:
                self.painted.now(side, key, session.show, array, look)
                self.budget.note((clock.perf_counter() - start) * 1e3, self.scale)
                self.frame_ms = (clock.perf_counter() - start) * 1e3
                changed = True
        return changed

    # What is shown

    def image(self, side: Side) -> tuple[Any, bool] | None:
        """(texture, whether its first row is at the bottom) of a side; None before anything was drawn."""
        session = self.session
        mapped = self.measure.map(side) if not self._moving or self._other() == "b" else None
        if mapped is not None:
            return mapped, True
        if session.show != PICTURE and session.mode in ("single", "split"):
            array = self.painted.texture(side)
            return (array, False) if array is not None else None
        picture = self.picture(side)
        image = picture.show(self._exposure_for(side))
        picture.filter(picture.size == self.size)
        return (image, True) if image is not None else None

    @property
    def legend(self) -> views.Legend | None:
        """Of what is shown now."""
        session = self.session
        if session.mode in ("difference", "flip"):
            return self.measure.legend if self.measure.map(self.shown()[0]) is not None else None
        return self.painted.legend(self.shown()[0]) if session.show != PICTURE else None

    def _exposure_for(self, side: Side) -> float | None:
        """Other pictures at the exposure that was found for a, where both are looked at."""
        if self._as(side) == "a" or self.session.a.exposure != "auto" or "a" not in self.wanted():
            return None
        return self.sides["a"].exposure_ev() if self.sides["a"].show() is not None else None

    def channels(self) -> tuple[str, ...]:
        """Images of passes of the sides that are looked at."""
        return tuple(dict.fromkeys(name for side in self.shown() for name in self.picture(side).channels()))

    def pass_view(self, name: str) -> str:
        """The view that shows what a pass made."""
        known = {
            "gbuffer": "triangle_id", "rays": "visibility", "shadow": "visibility", "shadow_map": "visibility",
            "reflect": "reflection",
            "composite": "radiance", "display": PICTURE, "reference": PICTURE, "skin": "normal", "refit": "bvh_steps",
            "tlas": "instance_id", "pose": "motion",
        }  # fmt: skip
        if name in known:
            return known[name]
        return next((c for c in self.channels() if c.startswith(name) or name.startswith(c)), PICTURE)

    # Errors

    def _measure(self) -> bool:
        other = self._other()
        if other is None or self.picture(other).done == 0:
            return False
        changed, theirs = False, self.picture(other)
        for side in self.shown():
            ours = self.picture(side)
            if side == other or ours.done == 0 or ours.size != theirs.size:
                continue
            version = (
                self._begun[self._as(side)], self._begun[self._as(other)], self.session.a.tone, self.session.a.exposure
            )  # fmt: skip
            self._present(side, other)
            if self._moving:
                changed |= self.measure.draw_map(side, (version, ours.done, theirs.done), ours, theirs)
            elif ours.finished or ours is theirs:
                changed |= self.measure.update(side, version, ours, theirs, self._turn_for(ours))
        return changed

    def _present(self, *sides: Side) -> None:
        """Brings pictures to display, as they are shown."""
        for side in sides:
            self.picture(side).show(self._exposure_for(side))

    def settle(self) -> None:
        """Waits for what is painted in another thread."""
        self.painted.take(wait=True)

    # Failures

    def _recover(self, error: GlhybridError) -> None:
        """Back to the settings that worked, with the reason; a scene that cannot be drawn at all is said so once."""
        session = self.session
        session.say(str(error), error=True)
        if (session.a, session.b) == (self._good["a"], self._good["b"]):
            for side in self.sides.values():
                side.drop()
            session.show = PICTURE
            self._stuck = self._drawn
        session.a, session.b = self._good["a"], self._good["b"]
        self._begun.clear()

    def _retire(self, old: Staged) -> None:
        if not any(p.staged is old for p in self.sides.values()):
            self.renderer.forget(old)

    def restart(self) -> None:
        """Everything is drawn anew, as after a reload."""
        for idle in set(SIDES) - set(self.wanted()):
            self.sides[idle].drop()
        self._begun.clear()
        self._lit = None
        self.painted.clear()
        for side in SIDES:
            self.measure.forget(side)
        self.budget = Budget.of(self._software)

    def close(self) -> None:
        """Ends threads. The textures are the viewer's."""
        self.painted.close()
        self.measure.close()


@lru_cache(64)
def _standing_in(settings: Settings, lit: bool, posed: bool) -> Settings:
    """Light maps and probes take their time: while what they hold moves, rays and the sky stand for them."""
    if lit and settings.shadows == "baked":
        settings = settings.replace(shadows="ray")
    if (lit or posed) and settings.reflections == "probe":
        settings = settings.replace(reflections="env")
    return settings


@lru_cache(64)
def _plain(settings: Settings) -> Settings:
    """Without what only the display reads."""
    return settings.replace(exposure=0.0, tone="none")
