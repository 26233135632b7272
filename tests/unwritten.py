"""New images and buffers that hold what nobody wrote: what a GPU gives, where Mesa's software renderer gives zeros.

Every pair of bytes is 7FC0: no number as a float of 16 or of 32 bits, and as an integer neither 0, nor -1, nor a row that
any table has. Whatever is read before it was written then shows, as NaN or as pictures that differ.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import moderngl

PATTERN = bytes.fromhex("c07f")
_SIZES = {"f1": 1, "f2": 2, "f4": 4, "u1": 1, "u2": 2, "u4": 4, "i1": 1, "i2": 2, "i4": 4}


def garbage(count: int) -> bytes:
    return PATTERN * (count // 2) + PATTERN[: count % 2]


@contextmanager
def filled() -> "Iterator[None]":
    """Textures, texture arrays and buffers that are made without data hold garbage, in every context of the process."""
    kinds: Any = moderngl.Context
    old = {name: getattr(kinds, name) for name in ("texture", "texture_array", "buffer")}

    def image(name: str) -> Any:
        def make(self: Any, size: tuple[int, ...], components: int, data: Any = None, **more: Any) -> Any:
            if data is None and not more.get("samples"):
                rows = size[1] * (size[2] if len(size) > 2 else 1)
                row = size[0] * components * _SIZES[more.get("dtype", "f1")]
                step = more.get("alignment", 1)
                data = garbage((row + step - 1) // step * step * rows)
            return old[name](self, size, components, data, **more)

        return make

    def buffer(self: Any, data: Any = None, reserve: int = 0, dynamic: bool = False) -> Any:
        return old["buffer"](self, garbage(reserve) if data is None else data, 0, dynamic)

    for name, method in (("texture", image("texture")), ("texture_array", image("texture_array")), ("buffer", buffer)):
        setattr(kinds, name, method)
    try:
        yield
    finally:
        for name, method in old.items():
            setattr(kinds, name, method)
