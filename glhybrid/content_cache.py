"""What takes seconds to make, kept on disk by content: reading it takes milliseconds.

Each kind of thing has its folder. A file is 20 bytes of BLAKE2b over the rest, then the bytes kept; anything that does
not add up is made again. The oldest files go first once a kind has filled its share of the disk.
"""

import contextlib
import hashlib
import os
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from glhybrid.jit import cache_dir

DIGEST = 20
STALE_SECONDS = 3600  # a temporary file this old was left by a process that died
LIMIT_BYTES = {
    "sky": 80 << 20, "unwrap": 512 << 20, "bake": 1 << 30, "probe": 1 << 20, "tuning": 1 << 20,
    "program": 256 << 20,
}  # fmt: skip


def key(*parts: bytes) -> str:
    """Name of what is made from these parts: data, parameters, shader text, device."""
    digest = hashlib.blake2b(digest_size=DIGEST)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def read(kind: str, name: str, size: int | None = None) -> bytes | None:
    """What is kept under that name, or None; also None if it is damaged or not of `size` bytes."""
    path = _path(kind, name)
    try:
        content = path.read_bytes()
    except OSError:
        return None
    kept = content[DIGEST:]
    whole = size in (None, len(kept)) and hashlib.blake2b(kept, digest_size=DIGEST).digest() == content[:DIGEST]
    if whole:
        with contextlib.suppress(OSError):
            os.utime(path)  # the oldest go first
    return kept if whole else None


def write(kind: str, name: str, data: bytes) -> None:
    """Keeps data; does nothing where the folder cannot be written or GLHYBRID_CACHE is off."""
    path = _path(kind, name)
    if os.environ.get("GLHYBRID_CACHE") == "off":
        return
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            temporary = Path(file.name)
            file.write(hashlib.blake2b(data, digest_size=DIGEST).digest() + data)
        os.replace(temporary, path)
        trim(path, LIMIT_BYTES[kind])
    except OSError:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def trim(newest: Path, limit: int) -> None:
    """Deletes what was used longest ago, of files named like `newest` beside it, until they are within the limit; and
    what dead processes left."""
    now, kept = time.time(), []
    for used, size, path in states(newest.parent.iterdir()):
        if path.suffix == newest.suffix:
            kept.append((used, size, path))
        elif path.suffix == ".part" and now - used > STALE_SECONDS:
            with contextlib.suppress(OSError):
                path.unlink()
    total = sum(size for _, size, _ in kept)
    for _, size, path in sorted(kept):
        if total <= limit:
            break
        if path != newest:
            with contextlib.suppress(OSError):
                path.unlink()
                total -= size


def states(paths: Iterable[Path]) -> Iterator[tuple[float, int, Path]]:
    """(time of the last use, bytes, path) of the files that are there."""
    for path in paths:
        with contextlib.suppress(OSError):
            state = path.stat()
            yield state.st_mtime, state.st_size, path


def _path(kind: str, name: str) -> Path:
    return cache_dir() / kind / f"{name}.{kind}"
