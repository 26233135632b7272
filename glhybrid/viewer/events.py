"""Input as the viewer reads it, whatever it came from: a window, a browser, a test. Pixels, origin at the top left."""

from collections.abc import Sequence
from dataclasses import dataclass

LEFT, RIGHT, MIDDLE = 0, 1, 2
MODIFIERS = ("ctrl", "shift", "alt", "super")

LETTERS = tuple("abcdefghijklmnopqrstuvwxyz")
DIGITS = tuple("0123456789")
# Names are those of imgui.Key; digits are written there with an underscore.
NAMED = (
    "tab", "left_arrow", "right_arrow", "up_arrow", "down_arrow", "page_up", "page_down", "home", "end", "insert",
    "delete", "backspace", "space", "enter", "escape", "left_ctrl", "left_shift", "left_alt", "left_super",
    "right_ctrl", "right_shift", "right_alt", "right_super", "apostrophe", "comma", "minus", "period", "slash",
    "semicolon", "equal", "left_bracket", "backslash", "right_bracket", "grave_accent",
    *(f"f{i}" for i in range(1, 13)),
)  # fmt: skip
KEYS = frozenset((*LETTERS, *DIGITS, *NAMED))


@dataclass(frozen=True)
class Move:
    """The pointer is here now."""

    x: float
    y: float


@dataclass(frozen=True)
class Button:
    """A mouse button went down or up: 0 left, 1 right, 2 middle."""

    button: int
    down: bool


@dataclass(frozen=True)
class Wheel:
    """Steps of a wheel, up and to the right positive."""

    dx: float
    dy: float


@dataclass(frozen=True)
class Key:
    """A key of KEYS goes down or up. repeat: it was down already."""

    name: str
    down: bool
    repeat: bool = False


@dataclass(frozen=True)
class Text:
    """Characters to insert where text is edited."""

    text: str


@dataclass(frozen=True)
class Drop:
    """Files were dropped on the window."""

    paths: tuple[str, ...]


@dataclass(frozen=True)
class Focus:
    """The window has the keyboard, or lost it: then all keys are up."""

    focused: bool


@dataclass(frozen=True)
class Close:
    """The window is to be closed."""


Event = Move | Button | Wheel | Key | Text | Drop | Focus | Close


def merged(events: Sequence[Event]) -> list[Event]:
    """Of moves in a row the last: only where the pointer is now counts, and after a long frame there are hundreds."""
    pairs = zip(events, (*events[1:], None), strict=False)
    return [event for event, after in pairs if not (isinstance(event, Move) and isinstance(after, Move))]
