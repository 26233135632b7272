"""Input over the picture: what pointer and keys do to a session. Needs no OpenGL; actions with one go out as names."""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field

from glhybrid import techniques
from glhybrid.viewer import camera_control as control
from glhybrid.viewer.events import LEFT, MIDDLE, RIGHT, Button, Event, Focus, Key, Move, Wheel
from glhybrid.viewer.session import MODES, Session
from glhybrid.viewer.views import PICTURE

DIVIDER_MOST = 0.98  # of the width: its handle stays where it can be taken
CLICK_PX, DIVIDER_PX, DOUBLE_S = 4.0, 7.0, 0.35
TURN = 0.0075  # radians a pixel
FLY_S = 4.0  # seconds to cross the scene

HELP = (
    ("Left drag", "orbit; with Shift pan, with Ctrl look around"),
    ("Right drag", "look around; W A S D Q E fly, wheel sets the speed"),
    ("Middle drag, wheel", "pan; dolly to the pointer"),
    ("Click, double click", "pick; turn about the point"),
    ("L or E held, drag", "light's direction; environment's rotation"),
    ("F, Home, 1 to 9", "frame the selection; the scene's camera; its cameras"),
    ("X, M, R", "flip sides; single, split, difference, FLIP; reference"),
    ("V, T, Y (Shift: back)", "next view; shadows; reflections"),
    ("Space, left, right", "play; step a frame"),
    ("+ and -, O", "exposure; automatic exposure"),
    ("C, P, B", "copy the command; save the picture; bookmark"),
    ("F5, Tab, H, Ctrl+Q", "reload; panel; this help; quit"),
    ("Esc", "back to the picture; ends what is being prepared"),
    ("Drop a file", "opens it; what is open is read again when it is written"),
    ("Ctrl+click a slider", "type the number"),
)


@dataclass
class Controls:
    """feed() takes events that the panels do not want. size: of the picture, which begins at (0, 0).

    act: carries out what is no state of the session: pick, look_at, save, copy, bookmark, reload, quit.
    focus: metres to what the view's centre shows.
    """

    session: Session
    act: Callable[[str, tuple[float, float]], None]
    focus: Callable[[], float]
    views: Callable[[], tuple[str, ...]]
    size: tuple[int, int] = (1, 1)
    speed: float = 1.0
    pointer: tuple[float, float] = (-1.0, -1.0)
    dragging: str = ""
    _down: set[str] = field(default_factory=set)
    _pressed: tuple[float, float] = (0.0, 0.0)
    _travel: float = 0.0
    _clicked: tuple[float, float, float] = (-1e9, 0.0, 0.0)

    def feed(self, event: Event, pointer_free: bool, keys_free: bool) -> None:
        """free: the panels do not want this kind of input."""
        if isinstance(event, Move):
            self._move(event)
        elif isinstance(event, Button):
            self._button(event, pointer_free)
        elif isinstance(event, Wheel) and pointer_free:
            self._wheel(event)
        elif isinstance(event, Key):
            if event.down and keys_free:
                self._down.add(event.name)
                self._key(event)
            elif not event.down:
                self._down.discard(event.name)
        elif isinstance(event, Focus) and not event.focused:
            self._down.clear()
            self.dragging = ""

    def held(self, name: str) -> bool:
        """Whether a key is down, either one of its kind."""
        return name in self._down or f"left_{name}" in self._down or f"right_{name}" in self._down

    def over_divider(self) -> bool:
        """Whether the pointer could take hold of the line between two pictures."""
        x = self.pointer[0]
        near = abs(x - self.session.divider * self.size[0]) <= DIVIDER_PX
        return self.session.mode == "split" and near and x < self.size[0]

    def _button(self, event: Button, free: bool) -> None:
        if event.down:
            if not free or self.dragging or self.pointer[0] >= self.size[0]:
                return
            self._pressed, self._travel = self.pointer, 0.0
            self.dragging = {LEFT: self._left(), RIGHT: "look", MIDDLE: "pan"}.get(event.button, "")
            return
        done, self.dragging = self.dragging, ""
        if event.button == LEFT and done in ("orbit", "pan", "look") and self._travel < CLICK_PX:
            when, x, y = self._clicked
            now = clock.monotonic()
            twice = now - when < DOUBLE_S and abs(x - self.pointer[0]) + abs(y - self.pointer[1]) < 2 * CLICK_PX
            self._clicked = now, *self.pointer
            self.act("look_at" if twice else "pick", self.pointer)

    def _left(self) -> str:
        if self.over_divider():
            return "divider"
        if "l" in self._down:
            return "light"
        if "e" in self._down:
            return "environment"
        return "pan" if self.held("shift") else "look" if self.held("ctrl") else "orbit"

    def _move(self, event: Move) -> None:
        dx, dy = event.x - self.pointer[0], event.y - self.pointer[1]
        self.pointer = event.x, event.y
        if not self.dragging or (dx == 0 and dy == 0):
            return
        before, self._travel = self._travel, self._travel + abs(dx) + abs(dy)
        if self.dragging == "divider":
            self.session.divider = min(max(event.x / max(self.size[0], 1), 1 - DIVIDER_MOST), DIVIDER_MOST)
            return
        if self._travel < CLICK_PX:
            return
        if before < CLICK_PX:  # what was held back while it could have been a click
            dx, dy = event.x - self._pressed[0], event.y - self._pressed[1]
        self._drag(dx, dy)

    def _drag(self, dx: float, dy: float) -> None:
        session = self.session
        if self.dragging == "light":
            if (sun := session.sun()) >= 0:
                azimuth, elevation = session.light_angle(sun)
                session.turn_light(sun, azimuth + 0.4 * dx, elevation - 0.4 * dy)
            return
        if self.dragging == "environment":
            if session.scene.environment is not None:
                session.turn_environment(session.environment_angle + 0.4 * dx)
            return
        pose = session.start_moving(self.focus())
        if self.dragging == "orbit":
            session.move_to(control.orbit(pose, dx * TURN, dy * TURN))
        elif self.dragging == "look":
            session.move_to(control.look(pose, dx * TURN * 0.6, -dy * TURN * 0.6))
        elif self.dragging == "pan":
            session.move_to(control.pan(pose, dx, dy, self.size))

    def _wheel(self, event: Wheel) -> None:
        if self.dragging == "look":
            self.speed = min(max(self.speed * 1.2**event.dy, 0.01), 100.0)
        elif event.dy and self.pointer[0] < self.size[0]:
            pose = self.session.start_moving(self.focus())
            at = self.pointer[0] - self.size[0] / 2, self.pointer[1] - self.size[1] / 2
            self.session.move_to(control.dolly(pose, event.dy, at, self.size))

    def tick(self, seconds: float) -> None:
        """Flies while its keys are held with the right button."""
        if self.dragging != "look":
            return
        step = self.speed * seconds * self.session.extent() / FLY_S * (3 if self.held("shift") else 1)
        axis = {k: (k in self._down) for k in "wasdqe"}
        ahead, side, up = axis["w"] - axis["s"], axis["d"] - axis["a"], axis["e"] - axis["q"]
        if ahead or side or up:
            pose = self.session.start_moving(self.focus())
            self.session.move_to(control.fly(pose, side * step, up * step, ahead * step))

    @property
    def flying(self) -> bool:
        """Whether keys move the camera now."""
        return self.dragging == "look" and bool(self._down & set("wasdqe"))

    def _key(self, event: Key) -> None:
        name, session = event.name, self.session
        back = -1 if self.held("shift") else 1
        if self.held("ctrl"):
            if name == "q":
                self.act("quit", self.pointer)
            elif name == "c":
                self.act("copy", self.pointer)
            return
        if self.dragging == "look" and name in "wasdqe":
            return
        if name in ("equal", "minus"):
            now = 0.0 if session.a.exposure == "auto" else float(session.a.exposure)
            session.set("a", exposure=min(max(now + (0.25 if name == "equal" else -0.25), -20.0), 20.0))
            return
        if event.repeat and name not in ("left_arrow", "right_arrow"):
            return
        if name in "123456789":
            if int(name) <= len(session.scene.cameras):
                session.use_camera(int(name) - 1)
        elif name == "f":
            pose = session.start_moving(self.focus())
            session.move_to(control.frame(pose, session.bounds(), self.size))
        elif name == "home":
            session.use_camera(session.camera_index)
        elif name == "x":
            self.flip()
        elif name == "m":
            session.mode = MODES[(MODES.index(session.mode) + back) % len(MODES)]
            session.edited()
        elif name == "r":
            session.reference = not session.reference
            session.edited()
        elif name == "v":
            names = self.views()
            at = names.index(session.show) if session.show in names else 0
            session.show = names[(at + back) % len(names)]
            session.edited()
        elif name in ("t", "y"):
            kind = "shadows" if name == "t" else "reflections"
            offered = list(techniques.TECHNIQUES[kind])
            side = "b" if session.flipped else "a"
            at = offered.index(getattr(getattr(session, side), kind))
            session.set("b" if session.flipped else "a", **{kind: offered[(at + back) % len(offered)]})
        elif name == "o":
            session.set("a", exposure="auto")
        elif name == "space":
            self.play()
        elif name in ("left_arrow", "right_arrow"):
            if session.transport.clip >= 0:
                session.transport.step(-1 if name == "left_arrow" else 1)
        elif name == "tab":
            session.panel = not session.panel
        elif name in ("h", "f1"):
            session.help = not session.help
        elif name == "escape":
            session.picked, session.help, session.show = None, False, PICTURE
            session.edited()
        elif action := {"c": "copy", "p": "save", "b": "bookmark", "f5": "reload"}.get(name):
            self.act(action, self.pointer)

    def flip(self) -> None:
        """Shows settings B in place of A, or A again."""
        self.session.flipped = not self.session.flipped
        self.session.edited()

    def play(self) -> None:
        """Starts or halts the clip; the file's first where none is chosen."""
        session = self.session
        if session.transport.clip < 0 and session.scene.animations:
            session.transport.choose(session.scene, 0)
        session.transport.toggle()
