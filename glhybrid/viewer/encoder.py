"""Frames for a browser become JPEG and PNG in processes of their own: Pillow holds Python's lock for as long as a JPEG
takes, and the viewer's thread would wait each time it lets it go.

Pixels pass through memory that both share, in slots; only words and files go through pipes.
"""

import contextlib
import io
import json
import logging
import mmap
import os
import struct
import subprocess
import sys
import threading
from dataclasses import dataclass
from typing import Any

log = logging.getLogger("glhybrid")
SLOTS = 6  # the newest, one that is written, one a process, and two of a browser that has just gone
QUALITY = 85  # of JPEG


@dataclass(frozen=True)
class Coded:
    """A frame on its way: RGBA in a slot, row 0 at the bottom. exact: PNG. tag: Web.tag when it was presented."""

    slot: int
    size: tuple[int, int]
    exact: bool
    tag: Any = None


def encode(pixels: Any, size: tuple[int, int], exact: bool) -> bytes:
    """RGBA, row 0 at the bottom, as PNG if exact, else as JPEG, its colours at half size, which saves time."""
    from PIL import Image

    image = Image.frombytes("RGB", size, pixels, "raw", "RGBX", 0, -1)
    buffer = io.BytesIO()
    if exact:
        image.save(buffer, "PNG", compress_level=1)
    else:
        image.save(buffer, "JPEG", quality=QUALITY, subsampling=2)
    return buffer.getvalue()


class Encoders:
    """Two processes, so that a PNG holds up no JPEG. pixels: bytes that a slot has room for."""

    def __init__(self, pixels: int) -> None:
        self._room = pixels
        self._file = os.memfd_create("glhybrid-frames")  # takes memory as it is written to
        os.ftruncate(self._file, SLOTS * pixels)
        self._memory = mmap.mmap(self._file, SLOTS * pixels)
        words = [sys.executable, "-m", "glhybrid.viewer.encoder", str(self._file), str(SLOTS * pixels), str(pixels)]
        pipe = subprocess.PIPE
        self._lock = {exact: threading.Lock() for exact in (False, True)}
        self._processes = {  # in a session of their own: Ctrl+C is not for them, they end with their stdin
            exact: subprocess.Popen(words, stdin=pipe, stdout=pipe, pass_fds=(self._file,), start_new_session=True)
            for exact in (False, True)
        }

    def slot(self, number: int) -> memoryview:
        """Memory that the processes share, for the RGBA bytes of a picture."""
        return memoryview(self._memory)[number * self._room : (number + 1) * self._room]

    def encode(self, frame: Coded) -> bytes:
        """Waits for the file, and lets other threads go on. A process that died is done without; closed: nothing."""
        process = self._processes[frame.exact]
        assert process.stdin is not None and process.stdout is not None
        with self._lock[frame.exact]:
            if self._file < 0:
                return b""
            try:
                process.stdin.write(json.dumps([frame.slot, *frame.size, frame.exact]).encode() + b"\n")
                process.stdin.flush()
                if len(head := process.stdout.read(4)) == 4:
                    return process.stdout.read(struct.unpack("<I", head)[0])
            except (OSError, ValueError) as error:
                log.debug("the process that encodes frames: %s", error)
            width, height = frame.size
            with self.slot(frame.slot) as slot:
                return encode(bytes(slot[: 4 * width * height]), frame.size, frame.exact)

    def close(self) -> None:
        """Ends the processes, behind what they are at. Twice is harmless."""
        with self._lock[False], self._lock[True]:
            self._close()

    def _close(self) -> None:
        for process in self._processes.values():
            assert process.stdin is not None and process.stdout is not None
            with contextlib.suppress(OSError):
                process.stdin.close()
            try:
                process.wait(2)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
        if self._file >= 0:
            self._memory.close()
            os.close(self._file)
            self._file = -1


def serve(file: int, size: int, room: int) -> None:
    """The process: for each line [slot, width, height, exact] of stdin a file's length and the file on stdout."""
    memory = mmap.mmap(file, size, prot=mmap.PROT_READ)
    out = sys.stdout.buffer
    for line in sys.stdin.buffer:
        slot, width, height, exact = json.loads(line)
        data = encode(memory[slot * room : slot * room + 4 * width * height], (width, height), exact)
        out.write(struct.pack("<I", len(data)) + data)
        out.flush()


if __name__ == "__main__":
    serve(*(int(word) for word in sys.argv[1:4]))
