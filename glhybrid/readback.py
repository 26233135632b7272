"""Images on their way from the GPU to the host: a ring of buffers, so that copying never holds up drawing.

Reading a texture makes the host wait for everything before it, and the GPU for the host. Here the GPU copies into one
of a few buffers when it comes to it, a fence tells when, and the host takes the oldest while the next are drawn.

What is to be read is a *reading*: a generator that yields the texture or buffer to copy, is sent its bytes when they
are there, and returns what it makes of them. `at_once` runs one without a ring.
"""

import ctypes
from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from glhybrid import gl
from glhybrid.context import Context
from glhybrid.errors import DeviceError

T = TypeVar("T")
Reading = Generator[Any, Any, T]
ALIGNMENT = 256  # of each image in a buffer: a line of any cache, a component of any format
PATIENCE_NS = 10**9  # of one look at a fence; a frame may take many


def at_once(reading: "Reading[T]") -> T:
    """What a reading returns, waiting for the GPU."""
    try:
        source = next(reading)
        reading.send(source.read())
    except StopIteration as done:
        result: T = done.value
        return result
    raise AssertionError("a reading yields once")


@dataclass(frozen=True)
class Piece:
    """Some bytes of a buffer, to be read in its stead."""

    buffer: moderngl.Buffer
    offset: int
    size: int

    def read(self) -> bytes:
        """Waits for the GPU."""
        return self.buffer.read(self.size, offset=self.offset)


class Ring:
    """Up to `slots` sets of readings under way, first in, first out. Owns their buffers, which grow as needed."""

    def __init__(self, context: Context, slots: int = 3) -> None:
        assert slots >= 1
        self._context, self._free = context, [_Slot(context) for _ in range(slots)]
        self._sent: deque[tuple[_Slot, list[_Part]]] = deque()

    def __len__(self) -> int:
        """Sets under way."""
        return len(self._sent)

    @property
    def full(self) -> bool:
        """Whether a set has to be taken before the next is sent."""
        return not self._free

    @property
    def bytes(self) -> int:
        """Of its buffers, as far as they have grown."""
        return sum(slot.size for slot in (*self._free, *(slot for slot, _ in self._sent)))

    def send(self, readings: Sequence[Reading[Any]]) -> None:
        """Starts the readings one by one and has the GPU copy what each yields; returns at once. Not while full."""
        slot, end, parts = self._free.pop(), 0, []
        for reading in readings:
            part = _Part(reading, end)
            try:
                source = next(reading)
            except StopIteration as done:
                part.result, part.done = done.value, True
            else:
                part.size = _size(source)
                slot.reserve(end + part.size)
                slot.copy(source, end)
                end += -(-part.size // ALIGNMENT) * ALIGNMENT
            parts.append(part)
        slot.fence()
        self._sent.append((slot, parts))

    def take(self) -> list[Any]:
        """What the oldest set's readings return, waiting until the GPU has come that far."""
        slot, parts = self._sent.popleft()
        try:
            slot.wait()
            with slot as data:
                for part in parts:
                    if not part.done:
                        part.finish(data[part.start : part.start + part.size])
        finally:
            self._free.append(slot)
        return [part.result for part in parts]

    def release(self) -> None:
        """Frees the buffers; sets under way are lost."""
        for slot in (*self._free, *(slot for slot, _ in self._sent)):
            slot.release()
        self._free.clear()
        self._sent.clear()


@dataclass
class _Part:
    reading: Reading[Any]
    start: int
    size: int = 0
    done: bool = False
    result: Any = None

    def finish(self, data: NDArray[np.uint8]) -> None:
        try:
            self.reading.send(data)
        except StopIteration as done:
            self.result, self.done = done.value, True
        assert self.done, "a reading yields once"


class _Slot:
    """One buffer in memory that the host reads fast, and the fence behind what was copied into it."""

    def __init__(self, context: Context) -> None:
        self._context, self._fence = context, None
        self._buffer: Any = None
        self.size = 0

    def reserve(self, size: int) -> None:
        """Room for that many bytes; what was copied before stays."""
        if size <= self.size:
            return
        old, raw = self._buffer, self._context.raw
        self._buffer = self._context.gl.buffer(reserve=size)
        # The same storage, with word of what it is for: else drivers may keep it where the host reads slowly.
        raw.glBindBuffer(gl.GL_COPY_READ_BUFFER, self._buffer.glo)
        raw.glBufferData(gl.GL_COPY_READ_BUFFER, size, None, gl.GL_STREAM_READ)
        if old is not None:
            self._context.gl.copy_buffer(self._buffer, old)
            old.release()
        self.size = size

    def copy(self, source: Any, offset: int) -> None:
        if isinstance(source, Piece):
            copy = self._context.gl.copy_buffer
            copy(self._buffer, source.buffer, source.size, read_offset=source.offset, write_offset=offset)
        elif isinstance(source, moderngl.Buffer):
            self._context.gl.copy_buffer(self._buffer, source, source.size, write_offset=offset)
        else:
            source.read_into(self._buffer, alignment=1, write_offset=offset)

    def fence(self) -> None:
        raw = self._context.raw
        self._fence = raw.glFenceSync(gl.GL_SYNC_GPU_COMMANDS_COMPLETE, 0)
        raw.glFlush()  # the GPU is to start now, not when somebody waits

    def wait(self) -> None:
        raw, state = self._context.raw, gl.GL_TIMEOUT_EXPIRED
        while state == gl.GL_TIMEOUT_EXPIRED:
            state = raw.glClientWaitSync(self._fence, gl.GL_SYNC_FLUSH_COMMANDS_BIT, PATIENCE_NS)
        raw.glDeleteSync(self._fence)
        self._fence = None
        if state == gl.GL_WAIT_FAILED:
            raise DeviceError("waiting for a picture failed: the driver was reset or lost; start again")

    def __enter__(self) -> NDArray[np.uint8]:
        """The bytes, (size,) uint8: gone with the end of the block."""
        if not self.size:
            return np.zeros(0, np.uint8)
        raw = self._context.raw
        raw.glBindBuffer(gl.GL_COPY_READ_BUFFER, self._buffer.glo)
        address = raw.glMapBufferRange(gl.GL_COPY_READ_BUFFER, 0, self.size, gl.GL_MAP_READ_BIT)
        if not address:
            raise DeviceError(f"{self.size} bytes of pictures cannot be read back: the driver is out of memory")
        return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_ubyte)), (self.size,))

    def __exit__(self, *_: object) -> None:
        if self.size:
            raw = self._context.raw
            raw.glBindBuffer(gl.GL_COPY_READ_BUFFER, self._buffer.glo)
            raw.glUnmapBuffer(gl.GL_COPY_READ_BUFFER)
            raw.glBindBuffer(gl.GL_COPY_READ_BUFFER, 0)

    def release(self) -> None:
        if self._fence is not None:
            self._context.raw.glDeleteSync(self._fence)
            self._fence = None
        if self._buffer is not None:
            self._buffer.release()
            self._buffer, self.size = None, 0


def _size(source: Any) -> int:
    """Bytes of a buffer or of a texture's first level."""
    if isinstance(source, (moderngl.Buffer, Piece)):
        return int(source.size)
    texel = source.components * int(source.dtype[1:])
    return int(source.width * source.height * getattr(source, "layers", 1) * texel)
