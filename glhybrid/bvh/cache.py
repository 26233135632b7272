"""Built trees on disk, found by the content they were built from. A file that is damaged, cut short, foreign or of
another version is rebuilt, never trusted; a folder that cannot be written is no error.

File: MAGIC, length and CRC-32 of a JSON header, the header, then nodes and slots as they lie in memory. The header
repeats the key and holds a check of every 4 MiB. Chosen over .npz, whose reading costs three times as much, and over a
memory map, which would let a later truncation of the file kill the process.
"""

import contextlib
import hashlib
import json
import os
import struct
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.bvh.blas import SMALL, Blas, build_blas, threads_available
from glhybrid.content_cache import trim
from glhybrid.jit import cache_dir
from glhybrid.scene import F32, U32

MAGIC = b"glhBLAS\n"
VERSION = 4  # of the file, the node and slot format and the builder: a new one makes all files old
CHUNK = 4 << 20
ROW = 1024  # 64-bit words that a check adds up
ROWS = 128  # of them in a block: its 1 MiB stays in a processor's cache
FEW_RUNS = 4096
LIMIT_BYTES = 2 << 30
_PREFIX = struct.Struct("<8sII")


def load_or_build(
    position: F32,
    triangle: U32 | None = None,
    geometry: U32 | None = None,
    spheres: F32 | None = None,
    sphere_triangle: U32 | None = None,
    sphere_geometry: U32 | None = None,
    max_leaf: int = 4,
    reinsert: bool = True,
    split: bool = False,
    threads: int | None = None,
    folder: Path | None = None,
) -> Blas:
    """`build_blas`, or the equal tree from the cache. build_ms is then the time of loading it.

    folder: default `bvh` under `cache_dir()`. GLHYBRID_CACHE=off keeps nothing. Small trees are not worth a file.
    """
    started = time.perf_counter()
    given = (position, triangle, geometry, spheres, sphere_triangle, sphere_geometry)
    if folder is None and os.environ.get("GLHYBRID_CACHE") != "off":
        folder = cache_dir() / "bvh"
    if folder is None or len(position) <= SMALL:
        return build_blas(*given, max_leaf=max_leaf, reinsert=reinsert, split=split, threads=threads)
    workers = threads_available() if threads is None else threads
    key = content_key(given, {"max_leaf": max_leaf, "reinsert": reinsert, "split": split}, workers)
    path = folder / f"{key}.blas"
    blas = read(path, key, started, workers)
    if blas is None:
        blas = build_blas(*given, max_leaf=max_leaf, reinsert=reinsert, split=split, threads=threads)
        if not blas.quick:
            write(path, key, blas, workers)
    return blas


def _each(function: Callable[[memoryview], Any], arrays: Iterable[np.ndarray], threads: int) -> list[Any]:
    """function of every 4 MiB of the arrays' bytes, in order; reading and hashing leave the GIL, so threads help."""
    return _map(function, _chunks(arrays), threads)


def _chunks(arrays: Iterable[np.ndarray]) -> list[memoryview]:
    views = [a.data.cast("B") for a in arrays if a.size]
    return [view[i : i + CHUNK] for view in views for i in range(0, len(view), CHUNK)]


def _map(function: Callable[[Any], Any], chunks: Sequence[Any], threads: int) -> list[Any]:
    if threads == 1 or len(chunks) < 4:
        return [function(chunk) for chunk in chunks]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, chunks))


def content_key(arrays: Iterable[np.ndarray | None], parameters: dict[str, Any], threads: int = 1) -> str:
    """SHA-256 of shapes, parameters, versions and of the digests of every 4 MiB of the arrays: 1.7 times as fast as
    BLAKE2b where processors have instructions for it. Of numbers in few runs, only the runs are digested."""
    present = [None if a is None else np.ascontiguousarray(a) for a in arrays]
    shapes = [None if a is None else [a.dtype.str, *a.shape] for a in present]
    told = [None if a is None else _runs(a) for a in present]
    parts = [a if t is None else t for a, t in zip(present, told, strict=True) if a is not None]
    digests = _each(lambda chunk: hashlib.sha256(chunk).digest(), parts, threads)
    kinds = [None if t is None else len(t) for t in told]
    about = json.dumps([VERSION, shapes, kinds, parameters], sort_keys=True).encode()
    return hashlib.sha256(about + b"".join(digests)).hexdigest()[:40]


def _runs(array: np.ndarray) -> U32 | None:
    """All that there is to know of (N,) uint32 that are the same for long, or rise by one: the step, the first number,
    and where another run begins and with what; None for others. A mesh of few materials, in order, has such."""
    if array.ndim != 1 or array.dtype != np.uint32 or not len(array):
        return None
    rises = array[1:] - array[:-1]
    for step in (0, 1):
        at = np.flatnonzero(rises != step)
        if len(at) <= FEW_RUNS:
            return np.concatenate([[step, array[0]], at + 1, array[at + 1]]).astype(np.uint32)
    return None


def read(path: Path, key: str, started: float, threads: int = 1) -> Blas | None:
    """The tree in that file, or None unless the file is whole and made for that key."""
    try:
        with open(path, "rb") as file:
            magic, length, crc = _PREFIX.unpack(file.read(_PREFIX.size))
            text = file.read(length) if length < CHUNK else b""
            if magic != MAGIC or zlib.crc32(text) != crc:
                return None
            header = json.loads(text)
            if header["version"] != VERSION or header["key"] != key:
                return None
            rows = header["nodes"], header["slots"]
            if os.fstat(file.fileno()).st_size != file.tell() + 4 * (8 * rows[0] + 12 * rows[1]):
                return None
            nodes, slots = np.empty((rows[0], 8), np.uint32), np.empty((rows[1], 12), np.uint32)
            chunks = _chunks((nodes, slots))
            starts = accumulate((len(chunk) for chunk in chunks), initial=file.tell())
            places = list(zip(chunks, starts, strict=False))
            if _map(lambda place: _fetch(file.fileno(), *place), places, threads) != header["checks"]:
                return None
        blas = Blas(
            nodes=nodes,
            slots=slots,
            grid_min=np.array(header["grid_min"], np.float32),
            grid_step=np.array(header["grid_step"], np.float32),
            bounds=np.array(header["bounds"], np.float64),
            depth=header["depth"],
            sah_cost=header["sah_cost"],
            build_ms=1e3 * (time.perf_counter() - started),
        )
    except (OSError, ValueError, KeyError, TypeError, struct.error):
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # the oldest go first
    return blas


def _fetch(descriptor: int, chunk: memoryview, start: int) -> int | None:
    """Fills the chunk from that place of a file. Returns the check of what came; None if less came.

    Read where it is checked, so that the bytes are still in the processor's cache.
    """
    return check(chunk) if os.preadv(descriptor, [chunk], start) == len(chunk) else None


def check(chunk: memoryview) -> int:
    """Of bytes: the CRC-32 of the sums of 64-bit words, along rows and columns of blocks.

    A third of the CPU time of a CRC-32 of all, and nothing gets by more easily: one word that is wrong is wrong in two
    sums, many would have to cancel in every row and column, and sums that move are told by the CRC.
    """
    words = np.frombuffer(chunk, np.uint64, len(chunk) // 8)
    block, found = ROW * ROWS, zlib.crc32(chunk[8 * len(words) :])
    for first in range(0, len(words), block):
        part = words[first : first + block]
        whole = part[: len(part) // ROW * ROW].reshape(-1, ROW)
        for sums in (whole.sum(0), whole.sum(1), part[whole.size :]):
            found = zlib.crc32(np.ascontiguousarray(sums).data.cast("B") if sums.size else b"", found)
    return found


def write(path: Path, key: str, blas: Blas, threads: int = 1) -> None:
    """Keep a tree: written beside its place, then renamed, so that no reader ever sees half a file."""
    header = {
        "version": VERSION,
        "key": key,
        "nodes": len(blas.nodes),
        "slots": len(blas.slots),
        "checks": _each(check, (blas.nodes, blas.slots), threads),
        "grid_min": blas.grid_min.tolist(),
        "grid_step": blas.grid_step.tolist(),
        "bounds": blas.bounds.tolist(),
        "depth": blas.depth,
        "sah_cost": blas.sah_cost,
    }
    text = json.dumps(header).encode()
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            temporary = Path(file.name)
            file.write(_PREFIX.pack(MAGIC, len(text), zlib.crc32(text)) + text)
            file.write(blas.nodes.data.cast("B"))
            file.write(blas.slots.data.cast("B"))
        os.replace(temporary, path)
        trim(path, LIMIT_BYTES)
    except OSError:  # read-only, full or not ours: the tree is there, only the next start is slower
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()
