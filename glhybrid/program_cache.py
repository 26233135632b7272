"""Linked programs as the driver has them, kept on disk: what one process has compiled, others load.

NVIDIA's own cache is off for root, which is who runs in containers, and a traversal takes it seconds to compile.
moderngl makes programs from text alone, so this stands between it and the driver: three functions of OpenGL, which
load what is kept in place of compiling. A driver that takes a binary no more says so; the text is then compiled.
"""

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from ctypes import CFUNCTYPE, POINTER, byref, c_int, c_uint, c_void_p, create_string_buffer
from typing import TYPE_CHECKING, Any

from glhybrid import content_cache, interrupts
from glhybrid.gl import (
    GL,
    GL_COMPILE_STATUS,
    GL_LINK_STATUS,
    GL_NUM_PROGRAM_BINARY_FORMATS,
    GL_PROGRAM_BINARY_LENGTH,
    GL_PROGRAM_BINARY_RETRIEVABLE_HINT,
)

if TYPE_CHECKING:
    from glhybrid.context import Native

KIND = "program"  # of content_cache


class ProgramCache:
    """Of one context. Give it to moderngl in the context's place. loaded, compiled: how many programs were."""

    def __init__(self, native: "Native", raw: GL, driver: str) -> None:
        """driver: whose binaries they are."""
        self._native, self._raw, self._driver = native, raw, driver
        self._key: str | None = None  # of the program being made
        self._binary: bytes | None = None
        self._texts: list[int] = []  # shaders that were not compiled, for there is a binary
        self.loaded = self.compiled = 0
        self._hooks: dict[str, Any] = {}
        if raw.get_integer(GL_NUM_PROGRAM_BINARY_FORMATS) > 0:
            self._hooks = {
                "glCompileShader": CFUNCTYPE(None, c_uint)(self._compile),
                "glGetShaderiv": CFUNCTYPE(None, c_uint, c_uint, POINTER(c_int))(self._state),
                "glLinkProgram": CFUNCTYPE(None, c_uint)(self._link),
            }

    @property
    def kept(self) -> bool:
        """Whether the driver gives binaries, and there is a place for them."""
        return bool(self._hooks) and os.environ.get("GLHYBRID_CACHE") != "off"

    def load_opengl_function(self, name: str) -> int:
        """Its address: ours of the three, else the driver's."""
        if hook := self._hooks.get(name):
            return ctypes.cast(hook, c_void_p).value or 0
        return self._native.load_opengl_function(name)

    load = load_opengl_function

    def __enter__(self) -> object:
        return self._native.__enter__()

    def __exit__(self, *error: object) -> None:
        self._native.__exit__(*error)

    def release(self) -> None:
        """Ends the context."""
        self._native.release()

    @contextmanager
    def making(self, stages: Mapping[int, str]) -> Iterator[bool]:
        """What moderngl makes within is of this text, by kind of shader, and is kept. Gives whether it was there."""
        parts = [text.encode() for _, text in sorted(stages.items())]
        self._key = content_cache.key(self._driver.encode(), *parts) if self.kept else None
        self._binary = content_cache.read(KIND, self._key) if self._key else None
        try:
            with interrupts.deferred():
                yield self._binary is not None
        finally:
            self._key, self._binary = None, None
            self._texts.clear()

    def _compile(self, shader: int) -> None:
        if self._binary is None:
            self._raw.glCompileShader(shader)
        else:
            self._texts.append(shader)

    def _state(self, shader: int, name: int, value: Any) -> None:
        if shader in self._texts and name == GL_COMPILE_STATUS:
            value[0] = 1
        else:
            self._raw.glGetShaderiv(shader, name, value)

    def _link(self, program: int) -> None:
        raw = self._raw
        if self._binary is not None:
            format_, data = int.from_bytes(self._binary[:4], "little"), self._binary[4:]
            raw.glProgramBinary(program, format_, data, len(data))
            if raw.get_program(program, GL_LINK_STATUS):
                self.loaded += 1
                return
            raw.errors()  # it is of another driver's
            self._binary = None
            for shader in self._texts:
                raw.glCompileShader(shader)
        if self._key is not None:
            raw.glProgramParameteri(program, GL_PROGRAM_BINARY_RETRIEVABLE_HINT, 1)
        raw.glLinkProgram(program)
        if self._key is not None and raw.get_program(program, GL_LINK_STATUS):
            self.compiled += 1
            self._keep(program, self._key)

    def _keep(self, program: int, key: str) -> None:
        length = self._raw.get_program(program, GL_PROGRAM_BINARY_LENGTH)
        if length <= 0:
            return
        data, got, format_ = create_string_buffer(length), c_int(0), c_uint(0)
        self._raw.glGetProgramBinary(program, length, byref(got), byref(format_), data)
        if got.value > 0 and not self._raw.errors():
            content_cache.write(KIND, key, format_.value.to_bytes(4, "little") + data.raw[: got.value])
