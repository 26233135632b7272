"""OpenGL objects that one owner frees together: they hold memory until somebody says so."""

from typing import Any, TypeVar

import moderngl

T = TypeVar("T")


class Owned(list[Any]):
    """In the order in which they were made."""

    def add(self, thing: T) -> T:
        """Returns the same thing."""
        self.append(thing)
        return thing

    @property
    def buffer_bytes(self) -> int:
        """Of the buffers among them."""
        return sum(thing.size for thing in self if isinstance(thing, moderngl.Buffer))

    def release(self) -> None:
        """Frees all, what was made last first; there is nothing left to be freed twice."""
        while self:
            self.pop().release()
