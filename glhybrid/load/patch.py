"""Surfaces as curved rectangles: positions in rows and columns become indexed triangles with normals, UVs and tangents.

Seen from its front a patch has u to the right along its columns and v down along its rows, as glTF's texture space, so
triangles are counter-clockwise and the tangent's handedness is always +1.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glhybrid.scene import F64, Triangles


def patch(
    position: F64,
    normal: F64 | None = None,
    uv: tuple[ArrayLike, ArrayLike] | None = None,
    closed_u: bool = False,
    closed_v: bool = False,
) -> Triangles:
    """Triangles over position (R, C, 3), R, C >= 2, metres; those with two corners in one place are left out.

    normal: (R, C, 3) unit; None = from the positions. uv: u (C,) and v (R,) or (R, C) each; None = 0 to 1.
    closed_u, closed_v: the last column or row is the first one again; it is copied, so the seam is exactly closed.
    """
    p = np.array(position, np.float64)
    if closed_u:
        p[:, -1] = p[:, 0]
    if closed_v:
        p[-1] = p[0]
    rows, columns = p.shape[:2]
    along_u = _slope(p, 1, closed_u)
    poles = [(row, beside) for row, beside in ((0, 1), (-1, -2)) if (p[row] == p[row, 0]).all()]
    for row, beside in poles:  # a row that is one point has no direction of its own
        along_u[row] = along_u[beside]
    if normal is None:
        normal = _unit(np.cross(along_u, -_slope(p, 0, closed_v)))
        for row, _ in poles:
            mean = _unit(normal[row].mean(0))
            if (normal[row] @ mean).min() > 0.9:  # round, not the point of a cone
                normal[row] = mean
    tangent = np.ones((rows, columns, 4))
    tangent[..., :3] = _tangent(along_u, normal)
    u, v = uv if uv is not None else (np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    u, v = np.asarray(u, np.float64), np.asarray(v, np.float64)
    texcoord = np.empty((rows, columns, 2))
    texcoord[..., 0] = u
    texcoord[..., 1] = v if v.ndim == 2 else v[:, None]
    corner = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
    a, b, c, d = (q.ravel() for q in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    index = np.stack([np.stack([a, c, d], 1), np.stack([a, d, b], 1)], 1).reshape(-1, 3)
    return _triangles(p, index, normal, texcoord, tangent)


def quad(corners: ArrayLike, uv: ArrayLike | None = None) -> Triangles:
    """One flat rectangle or a batch: corners (..., 4, 3) top left, top right, bottom right, bottom left from its front.

    uv: (..., 4, 2), by default 0 to 1 on each.
    """
    p = np.asarray(corners, np.float64).reshape(-1, 4, 3)
    right = p[:, 1] - p[:, 0] + p[:, 2] - p[:, 3]
    up = p[:, 0] - p[:, 3] + p[:, 1] - p[:, 2]
    normal = np.repeat(_unit(np.cross(right, up))[:, None], 4, 1)
    tangent = np.ones((*normal.shape[:2], 4))
    tangent[..., :3] = _tangent(np.repeat(right[:, None], 4, 1), normal)
    if uv is None:
        uv = np.broadcast_to(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float), (len(p), 4, 2))
    first = 4 * np.arange(len(p), dtype=np.uint32)[:, None, None]
    index = (first + np.array([[0, 3, 2], [0, 2, 1]], np.uint32)).reshape(-1, 3)
    return _triangles(p, index, normal, np.asarray(uv, np.float64), tangent)


def fan(rim: F64, normal: Sequence[float]) -> Triangles:
    """A flat convex polygon: rim (N, 3), counter-clockwise from its front; UVs fill 0 to 1."""
    n = np.asarray(normal, np.float64)
    right = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.9 else np.array([0.0, 0.0, -np.sign(n[0])])
    right = _unit(right - n * (right @ n))
    down = np.cross(right, n)
    p = np.concatenate([rim.mean(0)[None], rim])
    flat = np.stack([p @ right, p @ down], 1)
    low, span = flat.min(0), np.ptp(flat, axis=0)
    i = np.arange(len(rim), dtype=np.uint32)
    index = np.stack([np.zeros_like(i), i + 1, (i + 1) % len(rim) + 1], 1).astype(np.uint32)
    tangent = np.tile([*right, 1.0], (len(p), 1))
    return _triangles(p, index, np.tile(n, (len(p), 1)), (flat - low) / span, tangent)


def around(segments: int) -> F64:
    """(segments,) angles of a full turn, evenly spaced from 0."""
    return np.arange(segments) / segments * 2 * np.pi


def lathe(profile: ArrayLike, angle: F64, radius_scale: F64 | None = None, crease_deg: float = 35.0) -> Triangles:
    """A profile (N, 2) of (radius, y), from the top down, turned about +Y. Corners sharper than crease_deg stay sharp.

    angle: (A,) ascending within one turn, 0 is +Z. radius_scale: (N, A) multiplies the radius by profile point and
    angle (flutes). A profile that starts and ends on the axis makes a closed body.
    """
    points = np.asarray(profile, np.float64)
    radius = points[:, :1] * (np.ones((1, len(angle))) if radius_scale is None else radius_scale)
    p = np.empty((len(points), len(angle) + 1, 3))
    p[:, :-1, 0] = radius * np.sin(angle)
    p[:, :-1, 1] = points[:, 1:]
    p[:, :-1, 2] = radius * np.cos(angle)
    p[:, -1] = p[:, 0]
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    v = np.concatenate([[0.0], np.cumsum(step)])
    v /= v[-1]
    way = np.diff(points, axis=0) / step[:, None]
    sharp = np.flatnonzero((way[1:] * way[:-1]).sum(1) < np.cos(np.radians(crease_deg))) + 1
    cuts = [0, *sharp.tolist(), len(points) - 1]
    u = np.append(angle, angle[0] + 2 * np.pi) / (2 * np.pi)
    bands = [slice(a, b + 1) for a, b in pairwise(cuts)]
    return join([patch(p[band], uv=(u, v[band]), closed_u=True) for band in bands])


def tube(curve: F64, radius: float, sides: int) -> Triangles:
    """A round tube along a closed curve (N, 3), its end not repeated; frames are turned evenly so that they meet."""
    n = len(curve)
    along = _unit(np.roll(curve, -1, 0) - np.roll(curve, 1, 0))
    side = np.empty((n + 1, 3))
    side[0] = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    for i in range(1, n + 1):  # parallel transport: the frame that turns least
        side[i] = side[i - 1] - along[i % n] * (side[i - 1] @ along[i % n])
    side = _unit(side)
    binormal = np.cross(along[0], side[0])
    twist = np.arctan2(side[n] @ binormal, side[n] @ side[0])  # what is left after one round, spread over it
    turn = np.linspace(0, 2 * np.pi, sides + 1)[None, :] - (np.arange(n + 1) / n * twist)[:, None]
    forward = np.concatenate([along, along[:1]])
    other = np.cross(forward, side)
    normal = np.cos(turn)[..., None] * side[:, None] + np.sin(turn)[..., None] * other[:, None]
    normal[-1], normal[:, -1] = normal[0], normal[:, 0]
    points = np.concatenate([curve, curve[:1]])[:, None] + radius * normal
    return patch(points[::-1], normal[::-1], closed_u=True, closed_v=True)


def join(parts: Sequence[Triangles]) -> Triangles:
    """One piece out of several of this module's making."""
    first = np.cumsum([0] + [len(p.position) for p in parts])
    return Triangles(
        position=np.concatenate([p.position for p in parts]),
        index=np.concatenate([p.index + np.uint32(f) for p, f in zip(parts, first, strict=False)]),
        normal=np.concatenate([p.normal for p in parts]),
        uv0=np.concatenate([p.uv0 for p in parts if p.uv0 is not None]),
        tangent=np.concatenate([p.tangent for p in parts if p.tangent is not None]),
    )


def moved(part: Triangles, offset: ArrayLike) -> Triangles:
    """The part, shifted by offset (3,) metres."""
    position = (part.position.astype(np.float64) + np.asarray(offset, np.float64)).astype(np.float32)
    return Triangles(position, part.index, part.normal, part.material, part.tangent, part.uv0)


def _triangles(p: F64, index: NDArray[np.uint32], normal: F64, uv: F64, tangent: F64) -> Triangles:
    position = np.ascontiguousarray(p.reshape(-1, 3), np.float32) + np.float32(
        0
    )  # -0 + 0 = 0: equal places, equal bits
    a, b, c = position[index[:, 0]], position[index[:, 1]], position[index[:, 2]]
    kept = ~((a == b).all(1) | (b == c).all(1) | (c == a).all(1))
    return Triangles(
        position=position,
        index=np.ascontiguousarray(index[kept], np.uint32),
        normal=np.ascontiguousarray(normal.reshape(-1, 3), np.float32),
        uv0=np.ascontiguousarray(uv.reshape(-1, 2), np.float32),
        tangent=np.ascontiguousarray(tangent.reshape(-1, 4), np.float32),
    )


def _slope(p: F64, axis: int, closed: bool) -> F64:
    """Central differences along an axis, through the seam where it is closed."""
    if not closed:
        return np.asarray(np.gradient(p, axis=axis))
    ring = np.delete(p, -1, axis)
    slope = np.roll(ring, -1, axis) - np.roll(ring, 1, axis)
    return np.concatenate([slope, np.take(slope, [0], axis)], axis)


def _unit(v: F64) -> F64:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.where(length > 0, length, 1))


def _tangent(along_u: F64, normal: F64) -> F64:
    """Unit, along +u, at right angles to the normal; any such direction where u has no direction (poles)."""
    tangent = along_u - normal * (along_u * normal).sum(-1, keepdims=True)
    lost = np.linalg.norm(tangent, axis=-1) < 1e-12
    if lost.any():
        n = normal[lost]
        tangent[lost] = np.cross(n, np.eye(3)[np.argmin(np.abs(n), axis=-1)])
    return _unit(tangent)
