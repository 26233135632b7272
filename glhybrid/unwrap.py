"""Charts of a mesh in the plane, by xatlas, in metres of the surface: what light maps are laid out from. No OpenGL.

xatlas finds charts and flattens them; its time grows faster than a chart, so a mesh is handed over in clusters of
neighbouring triangles. It also stretches charts to whole texels of an atlas that is not ours: undone here by giving
each axis of a chart the length it has on the surface. What xatlas cannot place is flattened triangle by triangle.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from glhybrid import content_cache
from glhybrid.scene import F32, F64, U32

VERSION = 1  # of this module's results
SETTLE_S = 0.002  # xatlas ends by a call to its thread that is lost if that is about to wait, and then waits for ever
CLUSTER = 2048  # triangles handed to xatlas at a time: 69 k smooth ones take 5 s, where all at once take 52


class Charts(NamedTuple):
    """uv (T, 3, 2) float32: corners in metres, every chart from (0, 0). chart (T,) uint32. size (C, 2) float32, m."""

    uv: F32
    chart: U32
    size: F32


def unwrap(corners: F32, progress: Callable[[int], None] | None = None) -> Charts:
    """Charts of triangles (T, 3, 3), kept on disk by content. progress: called with the triangles done.

    Triangles that share an edge have corners of equal coordinates.
    """
    name = content_cache.key(b"%d" % VERSION, np.ascontiguousarray(corners).tobytes())
    if (kept := content_cache.read("unwrap", name)) is not None:
        return _unpack(kept, len(corners))
    uv, chart = np.zeros((len(corners), 3, 2)), np.zeros(len(corners), np.uint32)
    count = done = 0
    for rows in clusters(corners):
        flat, own = _flatten(corners[rows])
        uv[rows], chart[rows] = flat, own + np.uint32(count)
        count += int(own.max()) + 1
        done += len(rows)
        if progress is not None:
            progress(done)
    charts = _measured(corners, uv, chart, count)
    content_cache.write("unwrap", name, charts.uv.tobytes() + charts.chart.tobytes() + charts.size.tobytes())
    return charts


def _unpack(data: bytes, triangles: int) -> Charts:
    ends = 24 * triangles, 28 * triangles
    return Charts(
        np.frombuffer(data[: ends[0]], np.float32).reshape(-1, 3, 2),
        np.frombuffer(data[ends[0] : ends[1]], np.uint32),
        np.frombuffer(data[ends[1] :], np.float32).reshape(-1, 2),
    )


def clusters(corners: F32) -> list[np.ndarray]:
    """Rows of (T, 3, 3) triangles in groups of about CLUSTER that lie together, in Morton order of their middles."""
    if len(corners) <= 2 * CLUSTER:
        return [np.arange(len(corners))]
    middle = corners.mean(1, dtype=np.float64)
    low = middle.min(0)
    cell = ((middle - low) * (1023 / max(float(np.ptp(middle, axis=0).max()), 1e-30))).astype(np.uint32)
    code = sum(_spread(cell[:, k]) << np.uint32(k) for k in range(3))
    return np.array_split(np.argsort(code, kind="stable"), -(-len(corners) // CLUSTER))


def _spread(x: U32) -> U32:
    """Ten bits, two zeros after each."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | x << np.uint32(shift)) & np.uint32(mask)
    return x


def _flatten(corners: F32) -> tuple[F64, U32]:
    """(T, 3, 2) coordinates, each axis of a chart still to be measured, and (T,) charts numbered from 0."""
    import xatlas

    points, inverse = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    index = inverse.reshape(-1, 3).astype(np.uint32)
    uv, chart = _planar(corners), np.arange(len(corners), dtype=np.uint32)
    # About the middle and at a size of one: xatlas compares areas with fixed epsilons.
    scale = 1 / max(float(np.ptp(points, axis=0).max()), 1e-30)
    points = ((points - points.mean(0)) * scale).astype(np.float32)
    try:
        atlas = xatlas.Atlas()
        atlas.add_mesh(points, index)
        atlas.generate()
    except RuntimeError:  # a mesh that xatlas refuses
        return uv, chart
    finally:
        time.sleep(SETTLE_S)
    if not atlas.atlas_count:
        return uv, chart
    _, placed, flat = atlas.get_mesh(0)
    flat = flat.astype(np.float64) * (atlas.width, atlas.height)
    for number in range(atlas.get_mesh_chart_count(0)):
        faces = np.asarray(atlas.get_mesh_chart(0, number).faces, np.int64)
        ours = flat[placed[faces]]
        sides = ours[:, 1:] - ours[:, :1]
        area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        if len(faces) and np.isfinite(ours).all() and area.sum() > 0:
            uv[faces], chart[faces] = ours, len(corners) + number
    return uv, np.unique(chart, return_inverse=True)[1].astype(np.uint32)


def _planar(corners: F32) -> F64:
    """(T, 3, 2): every triangle in its own plane, the first corner at 0, the first edge along x."""
    p = corners.astype(np.float64)
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    length = np.maximum(np.linalg.norm(a, axis=1), 1e-30)
    along = (a * b).sum(1) / length
    uv = np.zeros((len(p), 3, 2))
    uv[:, 1, 0] = length
    uv[:, 2, 0] = along
    uv[:, 2, 1] = np.linalg.norm(np.cross(a, b), axis=1) / length
    return uv


def _measured(corners: F32, uv: F64, chart: U32, count: int) -> Charts:
    """Each chart from (0, 0), its axes as long as on the surface: the root mean square of dP/du and dP/dv by area."""
    p = corners.astype(np.float64)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    det = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    weight = np.linalg.norm(np.cross(e1, e2), axis=1)
    fine = np.abs(det) > 1e-12 * (np.linalg.norm(d1, axis=1) * np.linalg.norm(d2, axis=1) + 1e-300)
    safe = np.where(fine, det, 1)
    along_u = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) / safe[:, None]
    along_v = (e2 * d1[:, :1] - e1 * d2[:, :1]) / safe[:, None]
    weight = np.where(fine, weight, 0)
    total = np.bincount(chart, weight, count)
    scale = np.ones((count, 2))
    for k, d in enumerate((along_u, along_v)):
        square = np.bincount(chart, weight * (d * d).sum(1), count)
        scale[:, k] = np.where(total > 0, np.sqrt(square / np.where(total > 0, total, 1)), 1)
    uv = uv * scale[chart][:, None]
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for k in range(3):
        np.minimum.at(low, chart, uv[:, k])
        np.maximum.at(high, chart, uv[:, k])
    return Charts((uv - low[chart][:, None]).astype(np.float32), chart, (high - low).astype(np.float32))
