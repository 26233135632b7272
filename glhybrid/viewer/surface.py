"""Where the viewer's image goes and its input comes from. `Memory` is the one without a display."""

import time
from collections import deque
from typing import Any, Protocol

from glhybrid.context import Context
from glhybrid.errors import SettingError
from glhybrid.viewer.events import Event


class Surface(Protocol):
    """size in pixels; scale: how much larger than at 96 dots an inch text should be; visible: False if minimised."""

    context: Context

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of what is presented, pixels."""

    @property
    def scale(self) -> float:
        """How much larger than at 96 dots an inch text should be."""

    @property
    def visible(self) -> bool:
        """False while nobody can see it: then nothing is drawn."""

    def poll(self, timeout: float) -> list[Event]:
        """What happened since; waits for at most `timeout` seconds while nothing does."""
        ...

    def present(self, image: Any, moving: bool) -> None:
        """Shows a framebuffer of this size. moving: more follows at once, so that speed counts more than quality."""
        ...

    def title(self, text: str) -> None:
        """Names the window."""

    def cursor(self, name: str) -> None:
        """The pointer's shape, by CSS's name."""

    def get_clipboard(self) -> str:
        """The text that was copied last, here or elsewhere."""

    def set_clipboard(self, text: str) -> None:
        """Copies a text."""

    def close(self) -> None:
        """Ends it; the context may go with it."""


class Memory:
    """A surface that nobody sees: for screenshots, tests and as the base of the web's. Events are given by feed()."""

    visible = True

    def __init__(self, context: Context, size: tuple[int, int], scale: float = 1.0) -> None:
        self.context, self.scale = context, scale
        self._size = size
        self._events: deque[Event] = deque()
        self.clipboard = self.caption = ""
        self.presented = 0

    @property
    def size(self) -> tuple[int, int]:
        return self._size

    def resize(self, size: tuple[int, int]) -> None:
        """Raises SettingError for a size that the device cannot draw."""
        limit = self.context.limits.texture_size
        if not (1 <= size[0] <= limit and 1 <= size[1] <= limit):
            raise SettingError(f"size {size[0]}x{size[1]}: this device draws from 1x1 to {limit}x{limit} pixels")
        self._size = size

    def feed(self, *events: Event) -> None:
        """Events for the next poll(), as from a user."""
        self._events.extend(events)

    def poll(self, timeout: float) -> list[Event]:
        if not self._events and timeout > 0:
            time.sleep(min(timeout, 0.01))
        found = list(self._events)
        self._events.clear()
        return found

    def present(self, image: Any, moving: bool) -> None:
        self.presented += 1

    def title(self, text: str) -> None:
        self.caption = text

    def cursor(self, name: str) -> None:
        pass

    def get_clipboard(self) -> str:
        return self.clipboard

    def set_clipboard(self, text: str) -> None:
        self.clipboard = text

    def close(self) -> None:
        pass
