"""Pictures in a row as one file: .mp4 (H.264, through PyAV), .webp, .gif (through Pillow) and .apng.

A movie is written beside its final name by a thread of its own and moved there when it is whole; nothing is left of one
that was not finished. Pictures that wait to be encoded are few, so a fast renderer does not fill the memory.
"""

import queue
import struct
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from glhybrid.errors import OutputError
from glhybrid.image import encode_png, metadata, replacing

Pixels = NDArray[np.uint8]
WAITING = 3  # pictures between the renderer and the encoder
WEBP_QUALITY = 90  # of 100
H264_CRF = "18"  # constant rate factor: hardly to be told from lossless (x264's own guide)
GIF_TICKS, MILLISECONDS = 100, 1000  # a second
GIF_FASTEST = 50  # frames a second: players show anything faster at ten


def check(path: str, size: tuple[int, int], fps: float) -> None:
    """Raises OutputError before any work is done where this movie could not be written."""
    suffix = Path(path).suffix.lower()
    if suffix == ".mp4":
        try:
            import av  # noqa: F401
        except ImportError:
            raise OutputError(
                f"{path}: mp4 needs PyAV: pip install 'glhybrid[video]'; .webp, .gif and numbered pictures do not"
            ) from None
        if size[0] % 2 or size[1] % 2:
            even = "x".join(str(s + s % 2) for s in size)
            raise OutputError(
                f"{path}: H.264 needs an even width and height, not {size[0]}x{size[1]}: use --size {even}"
            )
    if suffix == ".gif" and fps > GIF_FASTEST:
        raise OutputError(f"{path}: GIF plays at most {GIF_FASTEST} frames a second, not {fps:g}: use --fps or .webp")
    if suffix in (".gif", ".webp") and max(size) > (65535 if suffix == ".gif" else 16383):
        raise OutputError(f"{path}: {size[0]}x{size[1]} is more than {suffix} holds: use .mp4 or numbered pictures")


class Movie:
    """A file that takes pictures in order: `with Movie(...) as movie: movie.add(rgb)`, (H, W, 3) uint8 as displayed.

    count: how many there will be. An error of the encoder is raised by a later add() or at the end, as OutputError.
    """

    def __init__(self, path: Path, fps: float, count: int, receipt: Mapping[str, Any]) -> None:
        self._path = path
        self._queue: queue.Queue[Pixels | None] = queue.Queue(WAITING)
        self._error: BaseException | None = None
        self._whole = False
        encode = {".mp4": _h264, ".apng": _apng}.get(path.suffix.lower(), _pillow)
        self._thread = threading.Thread(target=self._work, args=(encode, fps, count, metadata(receipt)), daemon=True)

    def add(self, rgb: Pixels) -> None:
        """Hands on the next picture; waits while the encoder is behind. Raises OutputError if it failed."""
        while self._error is None:
            try:
                self._queue.put(rgb, timeout=0.2)
                return
            except queue.Full:
                continue
        self._raise()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        self._whole = kind is None
        while self._thread.is_alive():
            try:
                self._queue.put(None, timeout=0.2)
                break
            except queue.Full:
                continue
        self._thread.join()
        if kind is None:
            self._raise()

    def _raise(self) -> None:
        if isinstance(self._error, OutputError):
            raise self._error
        if self._error is not None:
            raise OutputError(f"{self._path}: cannot be written: {self._error}") from self._error

    def _work(self, encode: "Encode", fps: float, count: int, texts: dict[str, str]) -> None:
        try:
            with replacing(self._path) as temporary:
                frames = self._frames()
                encode(temporary, frames, fps, count, texts)
                assert next(frames, None) is None, f"more than {count} pictures"  # waits for the end, or _Unfinished
        except _Unfinished:
            pass
        except BaseException as error:
            self._error = error
            while self._queue.get() is not None:  # whoever waits to add one must not wait for ever
                pass

    def _frames(self) -> Iterator[Pixels]:
        while (rgb := self._queue.get()) is not None:
            yield rgb
        if not self._whole:
            raise _Unfinished


Encode = Callable[[Path, Iterator[Pixels], float, int, dict[str, str]], None]


class _Unfinished(Exception):
    """Whoever made the pictures gave up."""


def _pillow(path: Path, frames: Iterator[Pixels], fps: float, count: int, texts: dict[str, str]) -> None:
    from PIL import Image

    suffix = path.suffix.lower()
    first = next(frames)

    class Strip(Image.Image):
        """All pictures, one at a time: Pillow asks for each by seek() and keeps only what it has encoded."""

        n_frames = count
        _at = 0

        def seek(self, frame: int) -> None:
            if frame >= count:
                raise EOFError
            while self._at < frame:
                self._im = Image.fromarray(next(frames)).im
                self._at += 1

        def tell(self) -> int:
            return self._at

    strip = Strip()
    picture = Image.fromarray(first)
    strip._im, strip._mode, strip._size = picture.im, picture.mode, picture.size
    durations = _durations(fps, count, GIF_TICKS if suffix == ".gif" else MILLISECONDS)
    options: dict[str, Any] = {"save_all": True, "duration": durations, "loop": 0}
    if suffix == ".webp":
        options |= {"quality": WEBP_QUALITY, "method": 4}
    else:
        options["comment"] = "; ".join(f"{k}: {v}" for k, v in texts.items()).encode()
    with path.open("wb") as file:
        strip.save(file, suffix[1:].upper(), **options)


def _durations(fps: float, count: int, ticks: int) -> list[int]:
    """Milliseconds that each picture is shown, in whole ticks of a second, never half a tick late."""
    rate = Fraction(fps).limit_denominator(10**6)
    ends = [round(ticks * k / rate) * 1000 // ticks for k in range(count + 1)]
    return [b - a for a, b in pairwise(ends)]


def _apng(path: Path, frames: Iterator[Pixels], fps: float, count: int, texts: dict[str, str]) -> None:
    """Lossless: the compressed rows of single PNGs, strung together (PNG specification, third edition, 11.3.4)."""
    with path.open("wb") as file:

        def chunk(kind: bytes, data: bytes) -> None:
            file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))

        sequence = 0
        for number, (rgb, duration) in enumerate(zip(frames, _durations(fps, count, MILLISECONDS), strict=True)):
            size = rgb.shape[1], rgb.shape[0]
            if number == 0:
                file.write(b"\x89PNG\r\n\x1a\n")
                chunk(b"IHDR", struct.pack(">IIBBBBB", *size, 8, 2, 0, 0, 0))
                chunk(b"sRGB", b"\0")
                for key, text in texts.items():
                    chunk(b"tEXt", key.encode("latin-1") + b"\0" + text.encode("latin-1", "replace"))
                chunk(b"acTL", struct.pack(">II", count, 0))
            chunk(b"fcTL", struct.pack(">IIIIIHHBB", sequence, *size, 0, 0, duration, MILLISECONDS, 0, 0))
            sequence += 1
            rows = _image_data(encode_png(rgb, {}))
            if number == 0:
                chunk(b"IDAT", rows)
            else:
                chunk(b"fdAT", struct.pack(">I", sequence) + rows)
                sequence += 1
        chunk(b"IEND", b"")


def _image_data(png: bytes) -> bytes:
    """What lies in the IDAT chunks."""
    found, at = [], 8
    while at < len(png):
        (length,) = struct.unpack_from(">I", png, at)
        if png[at + 4 : at + 8] == b"IDAT":
            found.append(png[at + 8 : at + 8 + length])
        at += 12 + length
    return b"".join(found)


def _h264(path: Path, frames: Iterator[Pixels], fps: float, count: int, texts: dict[str, str]) -> None:
    """8 bits, 4:2:0, limited range, BT.709: what every player shows. The picture's sRGB curve is BT.709's within what
    players care for, and they expect no other; the index is in front, so that it plays while it loads."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    rate = Fraction(fps).limit_denominator(1001)
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        container.metadata.update(title=path.name, comment="; ".join(f"{k}: {v}" for k, v in texts.items()))
        stream: Any = container.add_stream("h264", rate=rate, options={"crf": H264_CRF, "preset": "medium"})
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.color_range, context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1, 1
        for number, rgb in enumerate(frames):
            if number == 0:
                stream.height, stream.width = rgb.shape[:2]
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24").reformat(
                format="yuv420p", src_color_range=ColorRange.JPEG, dst_color_range=ColorRange.MPEG,
                dst_colorspace=Colorspace.ITU709,
            )  # fmt: skip
            picture.pts, picture.time_base = number, 1 / rate
            for packet in stream.encode(picture):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
