"""Files that are read anew when they are written: the scene's, and by Shaders the shaders'."""

import time as clock
from pathlib import Path

PERIOD_S = 0.5
SETTLE_S = 0.3  # a file is read once it has not changed for so long: exporters write in pieces
_MODELS = (".gltf", ".glb", ".bin", ".obj", ".mtl", ".ply", ".stl", ".off", ".toml")
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".hdr", ".exr", ".pfm")
SUFFIXES = frozenset((*_MODELS, *_IMAGES))
MOST_FILES = 512


class Watch:
    """The scene file and the models and images beside it."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._stamps = self._read()
        self._next = clock.monotonic() + PERIOD_S
        self._changed_at: float | None = None

    def _read(self) -> dict[Path, tuple[int, int]]:
        if self._path is None:
            return {}
        found: dict[Path, tuple[int, int]] = {}
        try:
            beside = [p for p in self._path.parent.iterdir() if p.suffix.lower() in SUFFIXES and p != self._path]
        except OSError:
            beside = []
        for file in (self._path, *sorted(beside)[:MOST_FILES]):
            try:
                stat = file.stat()
            except OSError:
                continue
            found[file] = stat.st_mtime_ns, stat.st_size
        return found

    def due(self) -> bool:
        """Whether the scene should be read again: once for each time that files changed and then rested."""
        now = clock.monotonic()
        if now < self._next:
            return False
        self._next = now + PERIOD_S
        stamps = self._read()
        if stamps != self._stamps:
            # Files that merely appear beside the scene are no reason: pictures are often saved there.
            if any(stamps.get(p) not in (None, old) for p, old in self._stamps.items()):
                self._changed_at = now
            self._stamps = stamps
            return False
        if self._changed_at is not None and now - self._changed_at >= SETTLE_S:
            self._changed_at = None
            return True
        return False
