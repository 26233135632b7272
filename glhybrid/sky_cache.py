"""Convolved environments kept on disk by content: making one takes seconds on a CPU, reading it a millisecond.

A file is 20 bytes of BLAKE2b over the rest, then the texels; anything that does not add up is made again.
"""

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

from glhybrid.jit import cache_dir

DIGEST = 20
MOST_FILES = 256  # of about 300 KiB; the oldest go first


def key(*parts: bytes) -> str:
    """Name of what is made from these parts: map, shader text, sizes, device."""
    digest = hashlib.blake2b(digest_size=DIGEST)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def read(name: str, size: int) -> bytes | None:
    """The texels kept under that name, `size` bytes, or None."""
    try:
        content = _path(name).read_bytes()
    except OSError:
        return None
    texels = content[DIGEST:]
    whole = len(texels) == size and hashlib.blake2b(texels, digest_size=DIGEST).digest() == content[:DIGEST]
    return texels if whole else None


def write(name: str, texels: bytes) -> None:
    """Keeps texels; does nothing where the folder cannot be written or GLHYBRID_CACHE is off."""
    path = _path(name)
    if os.environ.get("GLHYBRID_CACHE") == "off":
        return
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            temporary = Path(file.name)
            file.write(hashlib.blake2b(texels, digest_size=DIGEST).digest() + texels)
        os.replace(temporary, path)
        for old in sorted(path.parent.glob("*.sky"), key=lambda p: p.stat().st_mtime)[:-MOST_FILES]:
            old.unlink()
    except OSError:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def _path(name: str) -> Path:
    return cache_dir() / "sky" / f"{name}.sky"
