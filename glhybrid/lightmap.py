"""Where light maps hold what: charts of every instance in the pages of an atlas, and the surface point of each texel.

Every instance has texels of its own, since light reaches each differently; the charts are those of its mesh. A texel
that a bilinear lookup anywhere on a chart may read has a point on that chart: the one closest to the texel's centre, so
that nothing is extrapolated. Spheres get octahedral maps with a border. No OpenGL.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from glhybrid.errors import SettingError
from glhybrid.geometry import Geometry
from glhybrid.scene import F32, F64, U32
from glhybrid.timing import Progress
from glhybrid.unwrap import Charts, unwrap

REACH = 1.4142136  # texels from a point to the middle of any that a bilinear lookup there reads
BORDER = 1  # texels round a chart that lookups read
SPHERE_TEXELS = 3.5449077  # sqrt(4 pi): an octahedral map as large as the sphere
REMEDY = "give a lower shadows.baked.texels (per metre) or shadows.baked.budget, or take shadows = ray"


class Limits(NamedTuple):
    """Of the device: texels a side and layers of an array texture. Ours: texels of a light, bytes of all lights."""

    side: int
    layers: int
    texels: int = 1 << 26
    bytes: int = 2 << 30


@dataclass(frozen=True, eq=False)
class Lightmap:
    """Pages (count, height, width) and what lies where.

    places (R, 4) int32: for instance i, row i has the row of its geometry 0; a geometry's row has the corner x, y, the
    page, and what to add to a row of triangles for its row of uv (a sphere: texels a side of its map). uv (U, 8)
    float32: three corners in texels from the corner of the place, two spare. Texels with a point: index (N,) int64
    into all pages, row-major; instance, triangle (N,) uint32; bary (N, 2) float32 of the second and third vertex (a
    sphere: its octahedral coordinates); chart (N,) int32, unlike for any two charts.
    """

    density: float  # texels a metre
    pages: tuple[int, int, int]
    places: np.ndarray
    uv: F32
    index: np.ndarray
    instance: U32
    triangle: U32
    bary: F32
    chart: np.ndarray


class _Shape(NamedTuple):
    """One geometry at one scale. size: of its rectangle. Charts at (C, 2) corners, (C, 2) large; a sphere has none."""

    size: tuple[int, int]
    first: int  # row of triangles
    charts: Charts | None = None
    texels: float = 0.0  # a unit of the charts
    corner: np.ndarray = np.zeros((0, 2), np.int64)
    chart_size: np.ndarray = np.zeros((0, 2), np.int64)


_NONE = np.zeros(0, np.int64)
_NO_CHARTS = Charts(np.zeros((0, 3, 2), np.float32), np.zeros(0, np.uint32), np.zeros((0, 2), np.float32))


class _Texels(NamedTuple):
    """Of a shape, those with a point."""

    x: np.ndarray
    y: np.ndarray
    triangle: np.ndarray
    bary: np.ndarray
    chart: np.ndarray
    uv: F32  # (T, 8); empty for a sphere


def make(
    geometry: Geometry, lights: int, texels: float, budget: int, triangles: int, limits: Limits,
    bytes_per_texel: int = 1, progress: Progress | None = None,
) -> Lightmap:  # fmt: skip
    """Lays out the maps. texels a metre; 0 = as many as make `budget` texels of surface in all.

    Raises SettingError where a mesh has more than `triangles`, or the maps do not fit the device.
    """
    stored = sum(count for mesh in geometry.meshes for _, count in mesh.geometries)
    if stored > triangles:
        raise SettingError(
            f"shadows.baked: {stored} triangles to unwrap, the limit is {triangles} (about a minute for a million): "
            "set shadows.baked.triangles to more, or take shadows = ray"
        )
    scale = np.cbrt(np.abs(np.linalg.det(geometry.world_from_object[:, :3, :3])))
    density = texels or float(np.sqrt(budget / max(_area(geometry, scale), 1e-30)))
    level = np.ceil(np.log2(np.maximum(scale / max(float(scale.max(initial=0)), 1e-30), 2.0**-20)))  # of equal layout
    charts = _unwrapped(geometry, stored, progress)
    shapes: dict[tuple[int, int, int], _Shape] = {}
    keys: list[tuple[int, tuple[int, int, int]]] = []  # instance and piece, for every place
    first_place = []
    for i, mesh in enumerate(geometry.instance_mesh.tolist()):
        first_place.append(len(keys))
        largest = float(scale[(geometry.instance_mesh == mesh) & (level == level[i])].max())
        spheres = {s[1]: s for s in geometry.meshes[mesh].spheres}
        for number, (first, count) in enumerate(geometry.meshes[mesh].geometries):
            key = mesh, number, int(level[i])
            keys.append((i, key))
            if key in shapes:
                continue
            if number in spheres:
                row, _, ball = spheres[number]
                side = max(int(np.ceil(SPHERE_TEXELS * float(ball[3]) * largest * density)), 4) + 2 * BORDER
                shapes[key] = _Shape((side, side), row)
            elif count:
                shapes[key] = _arranged(charts[mesh, number], first, largest * density)
            else:
                shapes[key] = _Shape((1, 1), first, _NO_CHARTS)
    sizes = np.array([shape.size for shape in (shapes[key] for _, key in keys)]).reshape(-1, 2)
    if sizes.max(initial=0) > limits.side:
        raise SettingError(
            f"shadows.baked: a map of {sizes.max()} texels a side for one mesh, the device's limit is {limits.side}: "
            f"{REMEDY}"
        )
    at, (count, height, width) = _pages(sizes, limits.side)
    needed = count * lights, count * height * width, count * lights * height * width * bytes_per_texel
    if needed[0] > limits.layers or needed[1] > limits.texels or needed[2] > limits.bytes:
        raise SettingError(
            f"shadows.baked: {count} pages of {width}x{height} texels for each of {lights} lights are {needed[0]} "
            f"layers, {needed[1]} texels a light and {needed[2] >> 20} MiB; the limits are {limits.layers}, "
            f"{limits.texels} and {limits.bytes >> 20}: {REMEDY}"
        )
    pieces = {key: _sphere(shape) if shape.charts is None else _filled(shape) for key, shape in shapes.items()}
    ends = np.cumsum([0, *(len(p.uv) for p in pieces.values())]).tolist()
    uv_first = {key: end - shapes[key].first for key, end in zip(pieces, ends, strict=False)}
    places = np.zeros((len(first_place) + len(keys), 4), np.int32)
    places[: len(first_place), 0] = np.array(first_place, np.int64) + len(first_place)
    rows = places[len(first_place) :]
    rows[:, :2], rows[:, 2] = at[:, 1:], at[:, 0]
    rows[:, 3] = [
        uv_first[key] if shapes[key].charts is not None else shapes[key].size[0] - 2 * BORDER for _, key in keys
    ]
    parts = [pieces[key] for _, key in keys]
    return Lightmap(
        density=density,
        pages=(count, height, width),
        places=places,
        uv=np.concatenate([*(p.uv for p in pieces.values()), np.zeros((1, 8), np.float32)]),
        index=_joined(
            [(page * height + y + p.y) * width + x + p.x for (page, x, y), p in zip(at.tolist(), parts, strict=True)],
            np.int64,
        ),
        instance=_joined([np.full(len(p.x), i, np.uint32) for (i, _), p in zip(keys, parts, strict=True)], np.uint32),
        triangle=_joined([p.triangle for p in parts], np.uint32),
        bary=_joined([p.bary for p in parts], np.float32, (0, 2)),
        chart=_numbered([p.chart for p in parts]),
    )


def _joined(parts: list[Any], kind: Any, empty: tuple[int, ...] = (0,)) -> Any:
    return np.concatenate(parts).astype(kind, copy=False) if parts else np.zeros(empty, kind)


def _numbered(charts: list[np.ndarray]) -> np.ndarray:
    """Numbers that no two pieces share, from 1."""
    first, parts = 1, []
    for chart in charts:
        parts.append(chart + first)
        first += int(chart.max(initial=-1)) + 1
    return np.asarray(_joined(parts, np.int32))


def _area(geometry: Geometry, scale: F64) -> float:
    """Square metres of all instances."""
    areas = []
    for mesh in geometry.meshes:
        total = sum(4 * np.pi * float(s[2][3]) ** 2 for s in mesh.spheres)
        for first, count in mesh.geometries:
            c = geometry.vertices[geometry.triangles[first : first + count, :3], :3].astype(np.float64)
            if count:
                total += float(np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum()) / 2
        areas.append(total)
    return float((np.array(areas)[geometry.instance_mesh] * scale**2).sum()) if areas else 0.0


def _unwrapped(geometry: Geometry, total: int, progress: Progress | None) -> dict[tuple[int, int], Charts]:
    """Charts of every mesh and geometry that has triangles."""
    charts, done = {}, 0
    for row, mesh in enumerate(geometry.meshes):
        for number, (first, count) in enumerate(mesh.geometries):
            if not count or any(s[1] == number for s in mesh.spheres):
                continue
            corners = geometry.vertices[geometry.triangles[first : first + count, :3], :3]

            def report(n: int, before: int = done) -> None:
                if progress is not None:
                    progress("unwrapping", before + n, total)

            charts[row, number] = unwrap(corners, report)
            done += count
            report(0, done)
    return charts


def _arranged(charts: Charts, first: int, texels: float) -> _Shape:
    """Charts in their rectangle at so many texels a unit."""
    size = np.ceil(charts.size.astype(np.float64) * texels - 1e-6).astype(np.int64).clip(1) + 2 * BORDER
    area = float((size[:, 0] * size[:, 1]).sum())
    width = max(int(size[:, 0].max()), int(np.ceil(np.sqrt(1.05 * area))))
    corner = _shelves(size, width)[:, 1:]
    return _Shape((width, int((corner[:, 1] + size[:, 1]).max())), first, charts, texels, corner, size)


def _filled(shape: _Shape) -> _Texels:
    """The point of every texel that a lookup on some chart may read."""
    from glhybrid import lightmap_kernels as kernels

    charts, corner = shape.charts, shape.corner
    assert charts is not None
    if charts is _NO_CHARTS:
        return _Texels(_NONE, _NONE, _NONE, _NONE.reshape(0, 2), _NONE, np.zeros((0, 8), np.float32))
    uv = charts.uv.astype(np.float64) * shape.texels + BORDER + corner[charts.chart][:, None]
    boxes = np.concatenate([corner, corner + shape.chart_size], axis=1)[charts.chart]
    width, height = shape.size
    nearest, bary = kernels.rasterise(uv, boxes, height, width, REACH)
    y, x = np.nonzero(nearest >= 0)
    triangle = nearest[y, x]
    rows = np.zeros((len(uv), 8), np.float32)
    rows[:, :6] = uv.reshape(-1, 6)
    return _Texels(x, y, triangle + shape.first, bary[y, x], charts.chart[triangle].astype(np.int64), rows)


def _sphere(shape: _Shape) -> _Texels:
    """An octahedral map whose border repeats what lies across its edge."""
    side = shape.size[0] - 2 * BORDER
    y, x = (a.ravel() for a in np.mgrid[0 : side + 2, 0 : side + 2])
    p, q = x - 1, y - 1
    out = (p < 0) | (p >= side)
    p, q = np.where(out, p.clip(0, side - 1), p), np.where(out, side - 1 - q, q)
    out = (q < 0) | (q >= side)
    p, q = np.where(out, side - 1 - p, p), np.where(out, q.clip(0, side - 1), q)
    uv = ((np.stack([p, q], 1) + 0.5) / side).astype(np.float32)
    return _Texels(x, y, np.full(len(x), shape.first), uv, np.zeros(len(x), np.int64), np.zeros((0, 8), np.float32))


def _shelves(size: np.ndarray, width: int, height: int = 1 << 40) -> np.ndarray:
    """(R, 3) int64 page, x, y of rectangles (R, 2) on shelves of pages that wide and high, the tallest first."""
    at = np.zeros((len(size), 3), np.int64)
    page = x = y = shelf = 0
    for row in np.lexsort((-size[:, 0], -size[:, 1])).tolist():
        w, h = size[row].tolist()
        if x + w > width:
            x, y, shelf = 0, y + shelf, 0
        if y + h > height:
            page, x, y, shelf = page + 1, 0, 0, 0
        at[row] = page, x, y
        x, shelf = x + w, max(shelf, h)
    return at


def _pages(size: np.ndarray, limit: int) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Places (R, 3) of pieces, and (pages, height, width)."""
    if not len(size):
        return np.zeros((0, 3), np.int64), (1, 1, 1)
    area = float((size[:, 0] * size[:, 1]).sum())
    width = min(max(int(size[:, 0].max()), int(np.ceil(np.sqrt(1.1 * area)))), limit)
    at = _shelves(size, width, limit)
    return at, (int(at[:, 0].max()) + 1, int((at[:, 2] + size[:, 1]).max()), width)
