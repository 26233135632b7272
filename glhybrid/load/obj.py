"""Wavefront OBJ to a Scene: one mesh, one piece per material.

A reader of our own: trimesh reads relative indices, index 0 and concave polygons wrongly, and all without a word.
Lines are sorted by keyword first, then each kind is parsed as one array.
"""

import codecs
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from glhybrid.errors import LoadError
from glhybrid.load import tangents
from glhybrid.load.mtl import Files, is_number, read_mtl
from glhybrid.load.polygons import triangulate
from glhybrid.load.report import Report
from glhybrid.scene import F32, F64, Material, Triangles

I64 = NDArray[np.int64]
BYTE_ORDER_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
SILENT = frozenset({"o", "g", "s", "mg", "vp", "lod", "bevel", "c_interp", "d_interp", "shadow_obj", "trace_obj"})


@dataclass
class _Lines:
    """Lines of one keyword: their numbers (from 1) and what follows the keyword."""

    number: list[int]
    rest: list[str]


class ObjReader:
    """Collects the statements of one file, in order."""

    def __init__(self, path: Path, report: Report, files: Files, smooth: bool) -> None:
        self.path, self.report, self.files, self.smooth = path, report, files, smooth
        self.materials: list[Material] = []
        self._lines: dict[str, _Lines] = {}

    def fail(self, number: int, problem: str) -> NoReturn:
        """Raises LoadError naming file and line."""
        raise LoadError(f"{self.path}: line {number}: {problem}")

    def read(self, data: bytes) -> tuple[Triangles, ...]:
        """The pieces of the model; `materials` is filled with theirs."""
        self._sort(self._decode(data))
        position, color = self._vertices()
        uv = self._vectors("vt", 1)
        if len(uv):
            uv = np.concatenate([uv[:, :2], np.zeros((len(uv), 2 - min(2, uv.shape[1])))], axis=1)
            uv[:, 1] = 1.0 - uv[:, 1]  # OBJ counts v from the bottom, glTF from the top
        normal = self._vectors("vn", 3)[:, :3]
        corner, count = self._faces(len(position), len(uv), len(normal))
        for keyword in ("p", "l"):
            if keyword in self._lines:
                self.report.warn(
                    f"{len(self._lines[keyword].rest)} {'points' if keyword == 'p' else 'lines'} are not drawn"
                )
        if not len(count):
            raise LoadError(f"{self.path}: holds no faces, so there is nothing to draw; points and lines are not drawn")
        triangle, face = triangulate(position[corner[:, 0]], count)
        slots = self._material_slots(face)
        return tuple(
            self._piece(corner[triangle[slots == s]], position, color, uv, normal, s)
            for s in range(len(self.materials))
        )

    def _decode(self, data: bytes) -> str:
        for mark, encoding in BYTE_ORDER_MARKS:
            if data.startswith(mark):
                return data[len(mark) :].decode(encoding, "replace")
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError:
            return data.decode("latin-1")  # only names and comments hold such letters

    def _sort(self, text: str) -> None:
        if "\0" in text[:1024]:
            raise LoadError(f"{self.path}: is not text, so not an OBJ file")
        if "\\\n" in text or "\\\r\n" in text:  # a line that goes on; its number is that of its last part
            text = text.replace("\\\r\n", " ").replace("\\\n", " ")
        for number, line in enumerate(text.split("\n"), 1):
            keyword, _, rest = line.strip().replace("\t", " ").partition(" ")
            if not keyword or keyword[0] == "#":
                continue
            lines = self._lines.setdefault(keyword, _Lines([], []))
            lines.number.append(number)
            lines.rest.append(rest)
        for keyword, lines in self._lines.items():
            if keyword not in SILENT | {"v", "vt", "vn", "f", "l", "p", "usemtl", "mtllib"}:
                self.report.warn(f'"{keyword}" is not drawn ({len(lines.rest)} lines)')

    def _vectors(self, keyword: str, least: int) -> F64:
        """(N, width) numbers of all lines of a keyword; lines shorter than the longest are filled with NaN."""
        lines = self._lines.get(keyword)
        if lines is None:
            return np.zeros((0, 3))
        words = [rest.partition("#")[0].split() for rest in lines.rest]
        lengths = np.fromiter(map(len, words), np.int64, len(words))
        if lengths.min() < least:
            where = int(np.argmin(lengths))
            self.fail(lines.number[where], f'"{keyword}" has {lengths[where]} numbers, must have {least} or more')
        try:
            numbers = np.array([float(w) for ws in words for w in ws])
        except ValueError:
            for number, ws in zip(lines.number, words, strict=True):
                for word in ws:
                    if not is_number(word):
                        self.fail(number, f'"{word}" is not a number')
            raise
        if lengths.min() == lengths.max():
            return numbers.reshape(len(words), -1)
        filled = np.full((len(words), int(lengths.max())), np.nan)
        filled[np.arange(filled.shape[1]) < lengths[:, None]] = numbers
        return filled

    def _vertices(self) -> tuple[F64, F32 | None]:
        """(V, 3) positions and, where all lines are x y z r g b, (V, 4) linear colours."""
        rows = self._vectors("v", 3)
        color = None
        if rows.shape[1] >= 6:
            srgb = np.clip(np.nan_to_num(rows[:, 3:6], nan=1.0), 0.0, 1.0)
            color = linear_colors(srgb.astype(np.float32))
        return rows[:, :3], color

    def _faces(self, positions: int, uvs: int, normals: int) -> tuple[I64, I64]:
        """(C, 3) indices of position, uv and normal of each corner, -1 = none, and (F,) corners of each face."""
        lines = self._lines.get("f")
        if lines is None:
            return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
        words = [rest.partition("#")[0].split() for rest in lines.rest]
        count = np.fromiter(map(len, words), np.int64, len(words))
        number = np.array(lines.number)
        flat = [w for ws in words for w in ws]
        corner_line = np.repeat(number, count)
        raw = self._corner_indices(flat, corner_line)
        absent = np.iinfo(np.int64).min
        corner = np.full(raw.shape, -1)
        for column, (keyword, total) in enumerate((("v", positions), ("vt", uvs), ("vn", normals))):
            given = raw[:, column] != absent
            # A negative index counts back from the lines of that keyword read so far.
            seen = np.searchsorted(np.array(self._lines.get(keyword, _Lines([], [])).number), corner_line)
            index = np.where(raw[:, column] > 0, raw[:, column] - 1, raw[:, column] + seen)
            bad = given & ((raw[:, column] == 0) | (index < 0) | (index >= total))
            if bad.any():
                at = int(np.argmax(bad))
                what = "OBJ counts from 1" if raw[at, column] == 0 else f"the file has {total}"
                self.fail(int(corner_line[at]), f'"{flat[at]}" refers to {keyword} {raw[at, column]}; {what}')
            corner[given, column] = index[given]
        if short := int(np.count_nonzero(count < 3)):
            self.report.warn(f"{short} faces with fewer than three corners are not drawn")
        return corner, count

    def _corner_indices(self, words: list[str], line: I64) -> I64:
        """(C, 3) numbers of the words v, v/vt, v//vn and v/vt/vn; the smallest int64 where there is none."""
        absent = np.iinfo(np.int64).min
        result = np.full((len(words), 3), absent)
        slashes = {w.count("/") for w in words}
        try:
            if slashes == {0}:
                result[:, 0] = [int(w) for w in words]
            elif slashes == {2} and not any("//" in w for w in words):
                result[:] = np.array([int(n) for w in words for n in w.split("/")]).reshape(-1, 3)
            else:
                for i, w in enumerate(words):
                    for column, n in enumerate(w.split("/")):
                        if n:
                            result[i, column] = int(n)
                        elif column == 0:
                            raise ValueError
        except (ValueError, IndexError, OverflowError):
            for w, number in zip(words, line, strict=True):
                parts = w.split("/")
                if len(parts) > 3 or not all(_is_index(p) for p in parts[:1] + [p for p in parts[1:] if p]):
                    self.fail(int(number), f'"{w}" must be v, v/vt, v//vn or v/vt/vn, each a whole number')
            raise
        return result

    def _material_slots(self, face: I64) -> I64:
        """The slot in `materials` of each triangle, by its face; fills `materials` in order of first use."""
        library = self._library()
        uses = self._lines.get("usemtl", _Lines([], []))
        line = np.array(self._lines["f"].number)[face]
        use = np.searchsorted(np.array(uses.number), line) - 1
        slots = np.zeros(len(face), np.int64)
        by_name: dict[str | None, int] = {}
        for u in np.unique(use):
            name = uses.rest[u].strip() if u >= 0 else None
            if name not in by_name:
                by_name[name] = len(self.materials)
                if name is not None and name not in library:
                    self.report.warn("is in no material library: drawn in white", f'material "{name}"')
                self.materials.append(library.get(name or "", Material(name or "")))
            slots[use == u] = by_name[name]
        return slots

    def _library(self) -> dict[str, Material]:
        materials: dict[str, Material] = {}
        for rest in self._lines.get("mtllib", _Lines([], [])).rest:
            # The statement takes several names, and a name may hold blanks: the whole line first, then its words.
            whole = rest.strip().replace("\\", "/")
            for name in [whole] if (self.path.parent / whole).is_file() else whole.split():
                data = self.files.read(self.path.parent, Path(name), str(self.path))
                if data is None:
                    self.report.warn(f'material library "{name}" is not there')
                    continue
                path = self.path.parent / name
                materials.update(read_mtl(path, self._decode(data), self.report, self.files))
        return materials

    def _piece(self, corner: I64, position: F64, color: F32 | None, uv: F64, normal: F64, material: int) -> Triangles:
        """Triangles of (T, 3, 3) corner indices. Corners equal in position, uv and normal share a vertex."""
        flat = corner.reshape(-1, 3)
        has_normal = bool(len(normal)) and bool(np.all(flat[:, 2] >= 0))
        has_uv = bool(np.any(flat[:, 1] >= 0))
        key = (flat[:, 0] * np.int64(len(uv) + 1) + flat[:, 1] + 1) * np.int64(len(normal) + 1) + flat[:, 2] + 1
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        vertex = flat[first]
        padded_uv = np.concatenate([uv, np.zeros((1, 2))]).astype(np.float32) if has_uv else None  # -1 = (0, 0)
        points = np.ascontiguousarray(position[vertex[:, 0]], np.float32)
        index = inverse.reshape(-1, 3).astype(np.uint32)
        triangles = Triangles(
            points,
            index,
            np.zeros_like(points),
            material,
            uv0=None if padded_uv is None else np.ascontiguousarray(padded_uv[vertex[:, 1]]),
            color=None if color is None else np.ascontiguousarray(color[vertex[:, 0]]),
        )
        return finish(triangles, normal[vertex[:, 2]] if has_normal else None, self.smooth, self.materials[material])


def finish(triangles: Triangles, normal: NDArray[Any] | None, smooth: bool, material: Material) -> Triangles:
    """The triangles with unit normals, made if there are none, and tangents if the material has a normal map."""
    if normal is None:
        triangles = tangents.smooth(triangles) if smooth else tangents.flat(triangles)
    else:
        triangles = tangents.with_normals(triangles, normal)
    if "normal" in material.textures:
        texture = material.textures["normal"]
        triangles = tangents.with_tangents(triangles, texture.uv_set, texture.uv_transform)
    return triangles


def linear_colors(srgb: F32) -> F32:
    """(V, 4) linear of (V, 3) or (V, 4) sRGB-encoded colours in [0, 1], as scanners and painters write them."""
    rgb = np.where(srgb[:, :3] <= 0.04045, srgb[:, :3] / 12.92, ((srgb[:, :3] + 0.055) / 1.055) ** 2.4)
    alpha = srgb[:, 3:4] if srgb.shape[1] == 4 else np.ones((len(srgb), 1))
    return np.concatenate([rgb, alpha], axis=1).astype(np.float32)


def _is_index(word: str) -> bool:
    try:
        return abs(int(word)) < 1 << 62
    except ValueError:
        return False
