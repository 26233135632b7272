"""The files that a scene file names, and the textures of its materials, each image read or made once."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.errors import unknown
from glhybrid.load import patterns, sceneparts
from glhybrid.load.require import ShapeError
from glhybrid.load.tables import NOT_ZERO, Table
from glhybrid.scene import SRGB_SLOTS, TEXTURE_SLOTS, Image, Texture


class Files:
    """Those a scene file names, in its folder. digest: over it and what count() was told. warnings: in order."""

    def __init__(self, path: Path, text: bytes, allow_outside: bool) -> None:
        self.digest = hashlib.sha256(text)
        self.allow_outside = allow_outside
        self.warnings: dict[str, None] = {}
        self._folder = path.parent.resolve()

    def find(self, table: Table, key: str) -> Path:
        """The existing file that a key names. Raises LoadError, also where it lies outside and may not."""
        name = table.string(key, "")
        path = (self._folder / name).resolve()
        if not self.allow_outside and not path.is_relative_to(self._folder):
            table.fail("lies outside the scene file's folder; move it there or use --allow-outside", key)
        if not path.is_file():
            table.fail(f"there is no file {path}" if not path.exists() else "is not a file", key)
        return path

    def count(self, path: Path) -> None:
        """Adds the bytes of a file to the digest."""
        self.digest.update(hashlib.sha256(path.read_bytes()).digest())

    def warn(self, message: str) -> None:
        """One sentence, told once."""
        self.warnings[message] = None


class Textures:
    """Tables of textures: files and patterns."""

    def __init__(self, files: Files) -> None:
        self._files = files
        self._images: dict[object, Image] = {}

    def read(self, parent: Table) -> dict[str, Texture]:
        """By slot; none where the material has no table of them."""
        slots = parent.table("textures")
        if slots is None:
            return {}
        made = {slot: self._texture(slots, slot) for slot in TEXTURE_SLOTS if slot in slots}
        slots.finish()
        return made

    def _texture(self, slots: Table, slot: str) -> Texture:
        """A file name, or a table with `file` or `pattern` and how it lies on the surface."""
        if isinstance(slots.raw(slot), str):
            return Texture(self._image(slots, slot))
        table = slots.table(slot)
        assert table is not None
        if ("file" in table) == ("pattern" in table):
            table.fail("needs either file or pattern")
        repeat = table.vector("repeat", (1.0, 1.0), NOT_ZERO)
        offset = table.vector("offset", (0.0, 0.0))
        turn = np.radians(table.number("rotate_deg", 0.0))
        uv_set = table.integer("uv_set", 0, 0, 1)
        wrap: Any = table.string("wrap", "repeat", ("repeat", "clamp", "mirror"))
        nearest = table.boolean("nearest", False)
        if "file" in table:
            image = self._image(table, "file")
        else:
            image = self._pattern(table, slot)
        table.finish()
        c, s = np.cos(turn), np.sin(turn)  # KHR_texture_transform: offset, then rotation, then scale
        transform = np.array([[c * repeat[0], s * repeat[1], offset[0]], [-s * repeat[0], c * repeat[1], offset[1]]])
        plain = np.array_equal(transform, np.eye(3)[:2])
        return Texture(image, uv_set, None if plain else transform, wrap, wrap, nearest)

    def _image(self, table: Table, key: str) -> Image:
        from glhybrid.load.images import load_image

        path = self._files.find(table, key)
        if path not in self._images:
            self._images[path] = load_image(path, str(path), lambda m: self._files.warn(f"{path.name}: {m}"))
            self._files.count(path)
        return self._images[path]

    def _pattern(self, table: Table, slot: str) -> Image:
        name = table.string("pattern", "")
        if name not in patterns.PATTERNS:
            table.fail(unknown("pattern", name, patterns.PATTERNS))
        given = sceneparts.parameters(table, patterns.parameters(name))
        way = "normal" if slot.endswith("normal") else "color" if slot in SRGB_SLOTS else "data"
        key = f"{name} {sorted(given.items())} {way}"
        if key not in self._images:
            try:
                self._images[key] = patterns.pattern(name, slot, **given)
            except ShapeError as error:
                table.fail(str(error))
        return self._images[key]
