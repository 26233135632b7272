"""What is bound where, so that a frame binds nothing twice.

A name of the shaders has the same binding point in all programs, as far as they have room; within a frame a program
then finds most of what it reads bound by the one before. Between frames others draw too (a window, its widgets, whoever
gave us the context): nothing is believed that was bound before the frame began.
"""

from typing import Any, Self


class Points:
    """Binding points of one kind. bound: objects by point; they are held, so that no other can be taken for one."""

    def __init__(self, count: int) -> None:
        self.bound: list[Any] = [None] * count
        self._names: dict[str, int] = {}

    def place(self, name: str, taken: set[int]) -> int:
        """The point of a name in a program whose others are `taken`: its usual one, or the next that is free."""
        count = len(self.bound)
        point = self._names.setdefault(name, len(self._names) % count)
        while point in taken:
            point = (point + 1) % count
        taken.add(point)
        return point


class Bindings:
    """Of one context: how many binding points there are of each kind, and what they hold."""

    def __init__(self, blocks: int, textures: int, images: int) -> None:
        self.blocks, self.textures, self.images = Points(blocks), Points(textures), Points(images)
        self.kept = False  # what programs bind stays as it is until forget()

    def keep(self) -> Self:
        """A frame: until the end of the with block nobody else binds anything, or forget() is called after it."""
        return self

    def __enter__(self) -> Self:
        self.forget()
        self.kept = True
        return self

    def __exit__(self, *_: object) -> None:
        self.kept = False

    def forget(self) -> None:
        """Others may have bound something."""
        for points in (self.blocks, self.textures, self.images):
            points.bound = [None] * len(points.bound)
