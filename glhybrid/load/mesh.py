"""OBJ, PLY, STL and OFF files to a Scene of one mesh."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.errors import LoadError, unknown
from glhybrid.load.mtl import Files
from glhybrid.load.obj import ObjReader, finish, linear_colors
from glhybrid.load.ply import Element, read_ply
from glhybrid.load.polygons import triangulate
from glhybrid.load.report import Report
from glhybrid.load.tangents import first_equal_row
from glhybrid.scene import F32, Instance, Material, Mesh, Scene, Triangles

SUFFIXES = (".obj", ".ply", ".stl", ".off")
PLY_COLORS = ("red", "green", "blue", "alpha")
PLY_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
PLY_KNOWN = {"x", "y", "z", "nx", "ny", "nz", *PLY_COLORS, *(name for pair in PLY_UV for name in pair)}


@np.errstate(all="ignore")  # a file may hold any bits; what is made is checked
def load_mesh(path: Path, *, smooth: bool = False, strict: bool = False, allow_outside: bool = False) -> Scene:
    """The Scene of an .obj, .ply, .stl or .off file: one mesh, one instance, a piece for each material.

    smooth: smooth instead of flat normals where the file has none; STL's own, one a face, are made anew.
    strict: anything dropped or changed is an error instead of a sentence in Scene.warnings.
    allow_outside: material and image files may lie outside the model's folder.
    Vertex colours are read as sRGB-encoded, MTL colours as linear; OBJ and PLY texture coordinates are turned v down.
    Scene.sha256 is over the file and then each file it names, in the order they are read.
    Raises LoadError naming file, place, value, limit and remedy.
    """
    path = Path(path)
    report = Report(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise LoadError(f"{path}: {unknown('mesh format', suffix, SUFFIXES)}")
    data = _read_bytes(path)
    hasher = hashlib.sha256(data)
    materials = [Material()]
    if suffix == ".obj":
        reader = ObjReader(path, report, Files(path, report, hasher, allow_outside), smooth)
        pieces = reader.read(data)
        materials = reader.materials
    elif suffix == ".ply":
        pieces = (_read_ply(path, data, report, smooth),)
    elif suffix == ".stl":
        pieces = (_read_stl(path, data, report, smooth),)
    else:
        pieces = (_read_off(path, data, report, smooth),)
    return Scene(
        name=path.stem,
        meshes=(Mesh(path.stem, pieces),),
        instances=(Instance(0, np.eye(4), path.stem),),
        materials=tuple(materials),
        path=path,
        sha256=hasher.hexdigest(),
        warnings=report.finish(strict),
    )


def _read_bytes(path: Path) -> bytes:
    if not path.is_file():
        what = (
            "is a folder, must be a file" if path.is_dir() else "there is no such file; check the name and the folder"
        )
        raise LoadError(f"{path}: {what}")
    try:
        return path.read_bytes()
    except OSError as error:
        raise LoadError(f"{path}: cannot be read: {error}") from None


def _polygons(
    path: Path, position: NDArray[Any], corner: NDArray[np.int64], count: NDArray[np.int64], report: Report
) -> NDArray[np.uint32]:
    """(T, 3) vertex indices of polygons laid end to end, checked."""
    if not int(np.count_nonzero(count >= 3)):
        raise LoadError(f"{path}: holds no faces, so there is nothing to draw; points and lines are not drawn")
    bad = (corner < 0) | (corner >= len(position))
    if bad.any():
        at = int(np.argmax(bad))
        face = int(np.searchsorted(np.cumsum(count), at, side="right"))
        raise LoadError(
            f"{path}: face {face}: vertex {corner[at]} is past the last ({len(position) - 1}); the file is broken"
        )
    if short := int(np.count_nonzero(count < 3)):
        report.warn(f"{short} faces with fewer than three corners are not drawn")
    triangle, _ = triangulate(position[corner].astype(np.float64), count)
    return corner[triangle].astype(np.uint32)


def _read_ply(path: Path, data: bytes, report: Report, smooth: bool) -> Triangles:
    elements = read_ply(path, data)
    vertices = elements["vertex"].columns if "vertex" in elements else {}
    if not {"x", "y", "z"} <= vertices.keys():
        raise LoadError(f"{path}: its vertices lack x, y or z; the file is broken")
    position = _stack(vertices, "x", "y", "z")
    faces = elements.get("face", Element({}, {}))
    named = next((n for n in ("vertex_indices", "vertex_index") if n in faces.lists), "")
    corner, count = faces.lists.get(named, (np.zeros(0), np.zeros(0, np.int64)))
    for name in elements:
        if name not in ("vertex", "face"):
            report.warn(f'element "{name}" is not drawn')
    for name in [*(n for n in vertices if n not in PLY_KNOWN), *elements["vertex"].lists]:
        report.warn(f'vertex property "{name}" is not used')
    for name in [*faces.columns, *(n for n in faces.lists if n != named)]:
        report.warn(f'face property "{name}" is not used')
    index = _polygons(path, position, corner.astype(np.int64), count, report)
    uv = next((_stack(vertices, *pair) for pair in PLY_UV if set(pair) <= vertices.keys()), None)
    if uv is not None:
        uv[:, 1] = 1.0 - uv[:, 1]
    triangles = Triangles(position, index, np.zeros_like(position), uv0=uv, color=_ply_colors(vertices))
    normal = _stack(vertices, "nx", "ny", "nz") if {"nx", "ny", "nz"} <= vertices.keys() else None
    return finish(triangles, normal, smooth, Material())


def _stack(columns: dict[str, NDArray[Any]], *names: str) -> F32:
    return np.stack([columns[n] for n in names], axis=1).astype(np.float32)


def _ply_colors(vertices: dict[str, NDArray[Any]]) -> F32 | None:
    if not set(PLY_COLORS[:3]) <= vertices.keys():
        return None
    columns = [vertices[k] for k in PLY_COLORS if k in vertices]
    scaled = [c / np.iinfo(c.dtype).max if c.dtype.kind in "iu" else c for c in columns]
    return linear_colors(np.clip(np.nan_to_num(np.stack(scaled, axis=1), nan=1.0), 0.0, 1.0).astype(np.float32))


def _read_stl(path: Path, data: bytes, report: Report, smooth: bool) -> Triangles:
    """Binary STL, 80 + 4 + 50 bytes a triangle, or text. Text starts with "solid", and so do some binary files."""
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count or (count >= 0 and not data.lstrip().startswith(b"solid")):
        if len(data) < 84 + 50 * count:
            raise LoadError(f"{path}: has {(len(data) - 84) // 50} triangles, its header says {count}: it is cut short")
        rows = np.frombuffer(data, [("normal", "<f4", 3), ("corner", "<f4", 9), ("attribute", "<u2")], count, 84)
        corners = rows["corner"].reshape(-1, 3).copy()
    else:
        words = data.split(b"endsolid")[0].split(b"vertex")
        try:
            corners = np.array([[float(w) for w in part.split()[:3]] for part in words[1:]], np.float32).reshape(-1, 3)
        except ValueError as error:
            raise LoadError(f"{path}: not a readable STL file: {error}; it may be cut short") from None
        if not data.lstrip().startswith(b"solid") or len(corners) % 3:
            raise LoadError(f"{path}: has {len(corners)} vertices and no end: not an STL file, or cut short")
    position, index = _share_equal(corners)
    counts = np.full(len(index) // 3, 3)
    return finish(
        Triangles(position, _polygons(path, position, index, counts, report), np.zeros_like(position)),
        None, smooth, Material(),
    )  # fmt: skip


def _share_equal(corners: F32) -> tuple[F32, NDArray[np.int64]]:
    """Vertices and the index of each corner; corners at equal positions share a vertex."""
    first = first_equal_row(corners)
    kept, index = np.unique(first, return_inverse=True)
    return corners[kept], index.ravel()


def _read_off(path: Path, data: bytes, report: Report, smooth: bool) -> Triangles:
    """OFF and COFF text: counts, then a vertex a line, then a face a line, which may end in a colour."""
    text = data.decode("latin-1")
    lines = [words for line in text.splitlines() if (words := line.partition("#")[0].split())]
    if not lines or lines[0][0] not in ("OFF", "COFF"):
        raise LoadError(f'{path}: does not start with "OFF": empty or not a text OFF file')
    has_color = lines[0][0] == "COFF"
    lines[0] = lines[0][1:]
    lines = lines if lines[0] else lines[1:]
    try:
        vertex_count, face_count = int(lines[0][0]), int(lines[0][1])
        rows = lines[1 : 1 + vertex_count]
        position = np.array([[float(w) for w in row[:3]] for row in rows], np.float64).reshape(-1, 3)
        faces = lines[1 + vertex_count : 1 + vertex_count + face_count]
        count = np.array([int(row[0]) for row in faces], np.int64)
        corner = np.array([int(w) for row, n in zip(faces, count, strict=True) for w in row[1 : 1 + n]], np.int64)
        color = np.array([[float(w) for w in row[3:7]] for row in rows], np.float32) if has_color else None
    except (ValueError, IndexError, OverflowError) as error:
        raise LoadError(f"{path}: not a readable OFF file: {error}; it may be cut short") from None
    if len(position) != vertex_count or len(faces) != face_count or len(corner) != int(count.sum()):
        raise LoadError(
            f"{path}: has {len(position)} vertices and {len(faces)} faces, "
            f"its header says {vertex_count} and {face_count}: it is cut short"
        )
    if any(len(row) > n + 1 for row, n in zip(faces, count, strict=True)):
        report.warn("face colours are not used")
    index = _polygons(path, position, corner, count, report)
    points = position.astype(np.float32)
    if color is not None:
        color = linear_colors(np.clip(color / (255.0 if color.max(initial=0.0) > 1.0 else 1.0), 0.0, 1.0))
    return finish(Triangles(points, index, np.zeros_like(points), color=color), None, smooth, Material())
