"""Numba, used in one place: where compiled kernels are kept and how a kernel is declared.

Kernels state their signature, so they compile when their module is imported, once per machine and source version, and
load from the cache afterwards (milliseconds). Numba looks at a kernel's own file for changes; those that it borrows
compiled functions from are in the name of the folder. The cache folder is NUMBA_CACHE_DIR if set, else `numba` under
`cache_dir()`. Chosen over Numba's default, `__pycache__` beside the source, because that is often read-only or shared;
where no folder is writable the kernels still work and compile anew in each process.
"""

import functools
import hashlib
import logging
import os
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from glhybrid import interrupts

log = logging.getLogger("glhybrid")
_refused: set[Path] = set()  # folders that take no more
_declaring = threading.Lock()  # Numba's configuration is everybody's


def cache_dir() -> Path:
    """Where glhybrid keeps what it can make again: GLHYBRID_CACHE, XDG_CACHE_HOME/glhybrid or ~/.cache/glhybrid.

    GLHYBRID_CACHE=off is no folder but "keep nothing": whoever writes looks at it first.
    """
    if given := os.environ.get("GLHYBRID_CACHE"):
        return Path(given).expanduser()
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "glhybrid"
    except RuntimeError:  # no home folder at all
        return Path(tempfile.gettempdir()) / "glhybrid"


def folder() -> Path | None:
    """Where compiled kernels are kept; None: nowhere."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    return None if os.environ.get("GLHYBRID_CACHE") == "off" else cache_dir() / "numba"


def refused() -> bool:
    """Whether a folder took no more, so that not all that was compiled is kept."""
    return bool(_refused)


def writable(folder: Path) -> bool:
    """Whether files can be made in it; it is made itself where that can be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _borrowed(function: Any) -> str:
    """A name for the state of the other files whose compiled functions the function's module imports; "" for none."""
    own = function.__module__
    others = {
        thing.__module__
        for thing in function.__globals__.values()
        if (hasattr(thing, "py_func") or hasattr(thing, "_defn")) and thing.__module__ != own  # njit, intrinsic
    }
    files = [Path(str(sys.modules[name].__file__)) for name in sorted(others)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12] if files else ""


@functools.cache
def _announce(kept: bool) -> None:
    """Says so before kernels compile that never have: it takes some seconds, and nothing else shows it."""
    again = "once" if kept else "no folder keeps them, so in every process"
    log.info("compiling the kernels of the tree builder: some seconds, %s", again)


def kernel(signature: Any, **options: Any) -> Callable[[Any], Any]:
    """`numba.njit` for that signature, without the GIL, cached on disk where a folder is writable."""
    import numba
    from numba.core import config as numba_config

    config: Any = numba_config

    def compile_now(function: Any) -> Any:
        with _declaring, interrupts.deferred():  # LLVM calls Python back, and what is raised there is lost
            return declared(function)

    def declared(function: Any) -> Any:
        folder = Path(config.CACHE_DIR) if config.CACHE_DIR else cache_dir() / "numba"
        off = os.environ.get("GLHYBRID_CACHE") == "off" and not config.CACHE_DIR
        folder /= _borrowed(function)
        cached = not off and folder not in _refused and writable(folder)
        if not cached or next(folder.rglob("*.nbi"), None) is None:
            _announce(cached)
        # Read while the kernel is declared; others keep theirs.
        before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        declare = functools.partial(numba.njit, signature, nogil=True, error_model="numpy", **options)
        try:
            return declare(cache=cached)(function)
        except OSError as error:  # a full disk
            if not cached:
                raise
            _refused.add(folder)
            log.warning("%s: compiled kernels cannot be kept: %s", folder, error.strerror or error)
            return declare(cache=False)(function)
        finally:
            config.CACHE_DIR = before

    return compile_now
