"""Polygons of any number of corners to triangles, concave ones included."""

import numpy as np
from numpy.typing import NDArray

from glhybrid.scene import F64

I64 = NDArray[np.int64]


def triangulate(position: F64, counts: I64) -> tuple[I64, I64]:
    """Triangles of polygons laid end to end.

    position: (C, 3) of each corner; counts: (F,) corners of each polygon, those below 3 give nothing.
    Returns corners (T, 3), indices into the C corners, and the polygon (T,) of each triangle, both in polygon order
    and with the winding of the polygon. Convex polygons become fans about their first corner, concave ones lose ear
    after ear (Meisters 1975); one that crosses itself gives some triangulation.
    """
    first = np.cumsum(counts) - counts
    made = np.maximum(counts - 2, 0)
    start = np.cumsum(made) - made
    corners = np.zeros((int(made.sum()), 3), np.int64)
    for n in np.unique(counts[counts >= 3]):
        which = np.flatnonzero(counts == n)
        fan = np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        triangles = np.broadcast_to(fan, (len(which), n - 2, 3)).copy()
        if n > 3:
            polygon = position[first[which][:, None] + np.arange(n)]
            normal = _newell_normals(polygon)
            for concave in np.flatnonzero(~_convex(polygon, normal)):
                triangles[concave] = _clip_ears(polygon[concave], normal[concave])
        corners[start[which][:, None] + np.arange(n - 2)] = triangles + first[which][:, None, None]
    return corners, np.repeat(np.arange(len(counts)), made)


def _newell_normals(polygon: F64) -> F64:
    """(M, 3) area vectors of polygons (M, n, 3), about their first corners, so that far positions keep their digits."""
    local = polygon - polygon[:, :1]
    with np.errstate(invalid="ignore", over="ignore"):
        return np.cross(local, np.roll(local, -1, axis=1)).sum(axis=1)


def _convex(polygon: F64, normal: F64) -> NDArray[np.bool_]:
    """Whether no corner turns the wrong way. Corners that are straight, or not finite, count as convex."""
    with np.errstate(invalid="ignore", over="ignore"):
        edge = np.roll(polygon, -1, axis=1) - polygon
        turn = np.einsum("mni,mi->mn", np.cross(np.roll(edge, 1, axis=1), edge), normal)
        limit = -1e-6 * np.einsum("mi,mi->m", normal, normal)  # corners that rounding bends belong to a convex polygon
        return ~np.any(turn < limit[:, None], axis=1)


def _clip_ears(polygon: F64, normal: F64) -> I64:
    """(n - 2, 3) corners of one polygon (n, 3)."""
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, drop, axis=1)
    if (normal[drop] < 0.0) != (drop == 1):  # dropping y swaps the handedness of the other two axes
        flat = flat * (1.0, -1.0)
    left = list(range(len(polygon)))
    triangles = []
    at, misses = 0, 0
    while len(left) > 3:
        a, b, c = left[at - 1], left[at], left[(at + 1) % len(left)]
        others = flat[[v for v in left if v not in (a, b, c)]]
        if misses < len(left) and not _is_ear(flat[a], flat[b], flat[c], others):
            at, misses = (at + 1) % len(left), misses + 1
            continue
        triangles.append((a, b, c))
        del left[at]
        at, misses = at % len(left), 0
    return np.array([*triangles, tuple(left)], np.int64)


def _is_ear(a: F64, b: F64, c: F64, others: F64) -> bool:
    """Whether a, b, c turn left and hold none of the other corners."""

    def side(p: F64, q: F64, r: F64) -> F64:
        return (q[0] - p[0]) * (r[..., 1] - p[1]) - (q[1] - p[1]) * (r[..., 0] - p[0])

    if side(a, b, c) <= 0.0:
        return False
    inside = (side(a, b, others) >= 0.0) & (side(b, c, others) >= 0.0) & (side(c, a, others) >= 0.0)
    touching = np.any([np.all(others == p, axis=1) for p in (a, b, c)], axis=0)  # a seam's two sides share corners
    return not bool(np.any(inside & ~touching))
