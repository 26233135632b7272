"""What is kept on disk between runs, by kind: how much there is of it, and how much there may be.

All of it can be made again. A kind has its folder under `jit.cache_dir()`; what was used longest ago goes first once a
kind is past its limit, and what a process that died left half written after an hour.
"""

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from glhybrid import console, content_cache, jit
from glhybrid.errors import SettingError

REFERENCES_BYTES = 2 << 30  # fifteen of 1920x1080
_MEANINGS = {
    "bake": "light maps",
    "bvh": "trees over many triangles",
    "numba": "compiled kernels of the tree builder and of what moves",
    "probe": "places of reflection probes",
    "program": "compiled shaders",
    "reference": "what studies hold techniques against",
    "sky": "blurred skies",
    "tuning": "what was measured of devices",
    "unwrap": "charts of light maps",
}


@dataclass(frozen=True)
class Kept:
    """One kind of thing on disk. limit: bytes; 0: none, as there are few."""

    kind: str
    what: str
    files: int
    bytes: int
    limit: int


def look(kind: str = "") -> list[Kept]:
    """Every kind that there may be, by name, or one.

    Raises SettingError for one that there is not, and where GLHYBRID_CACHE says that nothing is kept.
    """
    if os.environ.get("GLHYBRID_CACHE") == "off":
        raise SettingError("GLHYBRID_CACHE=off: nothing is kept; without it, what was kept before is there")
    limits = _limits()
    if kind and kind not in limits:
        raise SettingError(f'nothing is kept of a kind "{kind}"; there are {", ".join(sorted(limits))}')
    found = []
    for name in [kind] if kind else sorted(limits):
        sizes = [size for _, size, _ in content_cache.states(_files(name))]
        found.append(Kept(name, _MEANINGS.get(name, ""), len(sizes), sum(sizes), limits[name]))
    return found


def clear(kind: str = "") -> int:
    """Deletes all that is kept, or what is of one kind; returns bytes. Files of others in these folders stay."""
    freed = 0
    for one in look(kind):
        for _, size, path in content_cache.states(_files(one.kind)):
            with contextlib.suppress(OSError):
                path.unlink()
                freed += size
    return freed


def show(found: Iterable[Kept]) -> None:
    """Prints a table, and a total."""
    rows = list(found)
    total = Kept("all", "", sum(one.files for one in rows), sum(one.bytes for one in rows), 0)
    console.table(
        ("kind", "files", "MiB", "at most", "what"),
        [
            (o.kind, o.files, f"{o.bytes / 2**20:.1f}", f"{o.limit >> 20}" if o.limit else "", o.what)
            for o in (*rows, total)
        ],
    )


def _limits() -> dict[str, int]:
    from glhybrid.bvh import cache

    return content_cache.LIMIT_BYTES | {"bvh": cache.LIMIT_BYTES, "reference": REFERENCES_BYTES, "numba": 0}


def _files(kind: str) -> Iterator[Path]:
    """Those of ours in the folder of a kind: somebody may have named a folder that holds other things too."""
    names = {"numba": ("*.nbi", "*.nbc", "*.ready"), "bvh": ("*.blas",), "reference": ("*.npz",)}.get(
        kind, (f"*.{kind}",)
    )
    folder = jit.cache_dir() / kind
    for name in (*names, "*.part"):
        yield from folder.rglob(name) if kind == "numba" else folder.glob(name)
