"""Environment maps from files: Radiance `.hdr` and OpenEXR `.exr`, as linear Rec. 709 radiance.

The file's pixels are taken as an equirect image: row 0 is +Y, the centre column looks along -Z, +X is to its right.
Radiance: Greg Ward, "Real Pixels" (Graphics Gems II) and the file format pages of the Radiance manual.
"""

import contextlib
import io
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.errors import LoadError
from glhybrid.scene import F32, U8

MAX_SIDE = 16384  # what common GPUs take as a texture; also keeps a false header from asking for all memory
SUFFIXES = (".hdr", ".exr")


def read_environment(path: Path | str) -> tuple[F32, tuple[str, ...]]:
    """The texels (H, W, 3) float32 of an equirect `.hdr` or `.exr`, and warnings about texels that had to be mended.

    Texels that are NaN, infinite or negative become 0 in that channel and are counted in a warning.
    Raises LoadError where the file cannot be read, is not what its suffix says, or holds another kind of image.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise LoadError(f'{path}: an environment is an equirect .hdr or .exr image, not "{suffix or path.name}"')
    texels = _read_hdr(path, _read_bytes(path)) if suffix == ".hdr" else _read_exr(path, _read_bytes(path))
    bad = ~(np.isfinite(texels) & (texels >= 0))
    if not bad.any():
        return texels, ()
    count = int(bad.any(axis=2).sum())
    return np.where(bad, np.float32(0), texels), (
        f"{path.name}: {count} of {texels.shape[0] * texels.shape[1]} texels not finite or negative: drawn as 0",
    )


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LoadError(f"{path}: cannot be read: {error.strerror or error}") from error


def _check_size(path: Path, width: int, height: int) -> None:
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise LoadError(f"{path}: size {width} x {height}: each side must be between 1 and {MAX_SIDE} pixels")


# Radiance RGBE ---------------------------------------------------------------------------------------------------

_RESOLUTION = re.compile(rb"([+-])([XY]) +(\d{1,9}) +([+-])([XY]) +(\d{1,9})\s*")


def _read_hdr(path: Path, data: bytes) -> F32:
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise LoadError(f'{path}: not a Radiance image: begins with {data[:10]!r}, not with "#?RADIANCE"')
    exposure, at = 1.0, 0
    while True:  # the header: lines up to an empty one
        end = data.find(b"\n", at, at + 4096)
        if end < 0:
            raise LoadError(f"{path}: the header has no end within the file")
        line, at = data[at:end].strip(), end + 1
        if not line:
            break
        key, _, value = line.partition(b"=")
        if key == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise LoadError(f"{path}: FORMAT={_text(value)}: only 32-bit_rle_rgbe is supported; convert it to RGB")
        if key == b"EXPOSURE":
            exposure *= _exposure(path, value)
    end = data.find(b"\n", at, at + 256)
    found = _RESOLUTION.fullmatch(data[at:end] + b"\n") if end >= 0 else None
    if not found or found[2] == found[5]:
        raise LoadError(f'{path}: no resolution line such as "-Y 512 +X 1024" after the header')
    lines, length = int(found[3]), int(found[6])
    _check_size(path, *((length, lines) if found[2] == b"Y" else (lines, length)))
    rgbe = _scanlines(path, data, end + 1, lines, length)
    # One standard sense: rows downwards ("-Y"), columns to the right ("+X").
    if found[2] == b"X":
        rgbe = rgbe.swapaxes(0, 1)
    sign = {found[2]: found[1], found[5]: found[4]}
    rgbe = rgbe[:: -1 if sign[b"Y"] == b"+" else 1, :: -1 if sign[b"X"] == b"-" else 1]
    # mantissa / 256 x 2^(exponent - 128), as most readers have it (Radiance adds half a step to the mantissa)
    scale = np.ldexp(1.0 / exposure, np.arange(256) - 136)
    scale[0] = 0.0  # exponent 0 is black whatever the mantissa
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(rgbe[..., :3] * scale[rgbe[..., 3], None], dtype=np.float32)


def _exposure(path: Path, value: bytes) -> float:
    try:
        number = float(value)
    except ValueError:
        number = 0.0
    if not 0 < number < np.inf:
        raise LoadError(f"{path}: EXPOSURE={_text(value)}: must be a number greater than 0")
    return number


def _text(value: bytes) -> str:
    return value[:40].decode("ascii", "replace").strip()


def _scanlines(path: Path, data: bytes, at: int, lines: int, length: int) -> U8:
    """(lines, length, 4) uint8: scanlines in new run-length code, old one or none, told apart line by line."""
    out = np.empty((lines, length, 4), np.uint8)
    for i in range(lines):
        head = data[at : at + 4]
        if len(head) < 4:
            raise _truncated(path, i, lines)
        if head[:2] == b"\2\2" and head[2] < 128 and 8 <= length < 32768:
            if head[2] << 8 | head[3] != length:
                raise LoadError(f"{path}: scanline {i} says it has {head[2] << 8 | head[3]} pixels, not {length}")
            planes, at = _new_rle(path, data, at + 4, length, i, lines)
            out[i] = np.frombuffer(planes, np.uint8).reshape(4, length).T
        else:
            at = _old_rle(path, data, at, out[i], i, lines)
    return out


def _new_rle(path: Path, data: bytes, at: int, length: int, line: int, lines: int) -> tuple[bytearray, int]:
    """Four planes of `length` bytes: n > 128 repeats the next byte n - 128 times, else n bytes follow."""
    planes = bytearray()
    for end in (length, 2 * length, 3 * length, 4 * length):
        while len(planes) < end:
            if at + 1 >= len(data):
                raise _truncated(path, line, lines)
            n = data[at]
            if n > 128:
                planes += data[at + 1 : at + 2] * (n - 128)
                at += 2
            else:
                planes += data[at + 1 : at + 1 + n]
                at += 1 + n
                if n == 0 or at > len(data):
                    raise _truncated(path, line, lines)
        if len(planes) != end:
            raise LoadError(f"{path}: scanline {line}: a run goes past the end of the line ({length} pixels)")
    return planes, at


def _old_rle(path: Path, data: bytes, at: int, row: U8, line: int, lines: int) -> int:
    """Plain pixels; (1, 1, 1, n) repeats the pixel before it n times, n shifted 8 bits for each code before it."""
    length = len(row)
    raw = np.frombuffer(data, np.uint8, min(4 * length, (len(data) - at) // 4 * 4), at).reshape(-1, 4)
    if len(raw) == length and not (raw[:, :3] == 1).all(axis=1).any():  # no code in it: flat
        row[:] = raw
        return at + 4 * length
    x = shift = 0
    while x < length:
        pixel = data[at : at + 4]
        if len(pixel) < 4:
            raise _truncated(path, line, lines)
        at += 4
        if pixel[:3] == b"\1\1\1":
            n = pixel[3] << shift
            if x == 0 or x + n > length:
                raise LoadError(f"{path}: scanline {line}: a run of {n} pixels at {x} does not fit ({length} pixels)")
            row[x : x + n] = row[x - 1]
            shift += 8
            x += n
            if shift > 24:
                raise LoadError(f"{path}: scanline {line}: run length code without an end at pixel {x}")
        else:
            row[x] = np.frombuffer(pixel, np.uint8)
            shift = 0
            x += 1
    return at


def _truncated(path: Path, line: int, lines: int) -> LoadError:
    return LoadError(f"{path}: the file ends within scanline {line} of {lines}, or is damaged there")


# OpenEXR ---------------------------------------------------------------------------------------------------------


def _read_exr(path: Path, data: bytes) -> F32:
    """RGB or luminance channels, half or float; the data window is the image."""
    if not data.startswith(b"\x76\x2f\x31\x01"):
        raise LoadError(f"{path}: not an OpenEXR image: begins with {data[:4]!r}")
    import OpenEXR

    header = _exr(path, OpenEXR, header_only=True).parts
    if len(header) != 1:
        raise LoadError(f"{path}: has {len(header)} parts: an environment needs a single image")
    part = header[0]
    if part.type() not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise LoadError(f"{path}: a deep image: an environment needs one value per pixel")
    low, high = part.header["dataWindow"]
    _check_size(path, int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1)
    channels = _exr(path, OpenEXR).channels()
    names = ("R", "G", "B") if {"R", "G", "B"} <= set(channels) else ("Y", "Y", "Y")
    if not set(names) <= set(channels) or {"RY", "BY"} & set(channels):
        raise LoadError(f"{path}: channels {', '.join(sorted(channels))}: an environment needs R, G and B (or Y alone)")
    planes = [channels[name].pixels for name in names]
    if any(p.dtype not in (np.float16, np.float32) for p in planes):
        raise LoadError(f"{path}: channels of type {planes[0].dtype}: an environment needs half or float")
    if any(p.shape != planes[0].shape for p in planes) or planes[0].ndim != 2:
        raise LoadError(f"{path}: channels of different sizes are not supported")
    return np.ascontiguousarray(np.stack(planes, axis=-1), dtype=np.float32)


def _exr(path: Path, module: Any, header_only: bool = False) -> Any:
    said: list[str] = []
    try:
        with _quiet(said):
            file = module.File(str(path), separate_channels=True, header_only=header_only)
            if not file.parts:
                raise RuntimeError("no image in it")
            return file
    except Exception as error:  # the library raises what its C++ throws, and says the reason on stderr
        reason = said[0].removeprefix(f"{path}: ") if said else str(error)
        raise LoadError(f"{path}: damaged or cut short: {reason}") from error


@contextlib.contextmanager
def _quiet(said: list[str]) -> Iterator[None]:
    """Collects the lines that the OpenEXR library itself writes to stdout and stderr, so that one message remains."""
    with tempfile.TemporaryFile() as sink, contextlib.redirect_stdout(io.StringIO()):
        kept = os.dup(2)
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            sink.seek(0)
            said += sink.read().decode("utf-8", "replace").splitlines()
