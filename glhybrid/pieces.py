"""One primitive as rows of the shared arrays: moved, its directions made unit, without what cannot be traced."""

from dataclasses import dataclass

import numpy as np

from glhybrid.scene import F32, F64, U32, Triangles

SMALLEST_AREA = 1e-24  # m2, of the parallelogram: below it, products of three lengths underflow float32 in the ray test


@dataclass(frozen=True, eq=False)
class Piece:
    """vertices, tangents and attributes as in Geometry, the latter None where there are none or none are wanted.

    index (T, 3): rows of vertices, from 0. source (T,): which triangles of the primitive these are.
    """

    vertices: F32
    index: U32
    source: U32
    tangents: F32 | None = None
    attributes: U32 | None = None
    dropped: int = 0
    flattened_away: int = 0  # of those dropped, triangles that are solid where they were made


def triangles(piece: Triangles, to_mesh: F64 | None, attributes: bool = True, deforms: bool = False) -> Piece:
    """Moved by to_mesh (4, 4). deforms: triangles without area are kept, they may get one."""
    position, normal, tangent = piece.position, _unit(piece.normal), piece.tangent
    if tangent is not None:
        tangent = np.concatenate([_unit(tangent[:, :3]), np.sign(_sane(tangent[:, 3:]))], axis=1)
    index = piece.index
    if to_mesh is not None:
        position, normal, tangent, index = _moved(to_mesh, position, normal, tangent, index)
    keep = np.isfinite(position[index]).all((1, 2)) if deforms else solid(position, index)
    dropped, flattened_away = int(len(index) - keep.sum()), 0
    if dropped:
        if to_mesh is not None:
            flattened_away = int(solid(piece.position, index[~keep]).sum())
        index = index[keep]
        position = np.where(np.isfinite(position).all(1, keepdims=True), position, 0)
    count = len(position)
    uv0 = _sane(piece.uv0) if piece.uv0 is not None else np.zeros((count, 2), np.float32)
    vertices = np.column_stack([position, uv0[:, :1], normal, uv0[:, 1:]]).astype(np.float32)
    packed = pack_attributes(piece, count) if attributes else None
    return Piece(vertices, index, np.flatnonzero(keep).astype(np.uint32), tangent, packed, dropped, flattened_away)


def sphere(centre: F64, radius: float) -> Piece:
    """One vertex, and one row of triangles that names it three times."""
    vertices = np.array([[*centre, 0, radius, 0, 0, 0]], np.float32)
    return Piece(vertices, np.zeros((1, 3), np.uint32), np.zeros(1, np.uint32))


def _moved(
    to_mesh: F64, position: F32, normal: F32, tangent: F32 | None, index: U32
) -> tuple[F32, F32, F32 | None, U32]:
    linear = to_mesh[:3, :3]
    with np.errstate(invalid="ignore", over="ignore"):  # vertices that are not finite are dropped later
        position = (position.astype(np.float64) @ linear.T + to_mesh[:3, 3]).astype(np.float32)
    # Not made unit again: interpolated, they must turn as those of an instance, which is moved as a whole.
    linear = linear / np.cbrt(np.abs(np.linalg.det(linear)))
    normal = normal @ np.linalg.inv(linear).astype(np.float32)
    mirrored = np.linalg.det(linear) < 0
    if tangent is not None:
        direction = tangent[:, :3] @ linear.T.astype(np.float32)
        tangent = np.concatenate([direction, tangent[:, 3:] * (-1 if mirrored else 1)], axis=1, dtype=np.float32)
    return position, normal, tangent, index[:, ::-1] if mirrored else index  # front faces stay counter-clockwise


def solid(position: F32 | F64, index: U32) -> np.ndarray:
    """(T,) bool: triangles whose vertices are finite and whose area does not vanish in products of float32 lengths."""
    corner = position[index].astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(np.isfinite(corner).all((1, 2)) & (np.abs(normal) > SMALLEST_AREA).any(1))


def _unit(v: F32) -> F32:
    """(V, 3) made unit; zero, for which shaders have a fallback, where a vector is not finite or has no length."""
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        length = np.linalg.norm(v, axis=1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=(length > 0) & np.isfinite(length))


def _sane(values: F32) -> F32:
    """Texture coordinates, with zero for what is not finite or so large (2^24) that float32 holds no fraction of it."""
    fine = np.abs(values) < 2.0**24  # False for NaN
    return values if fine.all() else np.where(fine, values, np.float32(0))


def pack_attributes(piece: Triangles | None, count: int) -> U32:
    """(count, 4): the second UV as floats, the colour as halves; white where there is none."""
    packed = np.zeros((count, 4), np.uint32)
    color = np.ones((count, 4), np.float16)
    if piece is not None:
        if piece.uv1 is not None:
            packed[:, :2] = np.ascontiguousarray(_sane(piece.uv1), np.float32).view(np.uint32)
        if piece.color is not None:
            color = np.clip(np.nan_to_num(piece.color, nan=1.0), 0, 65504).astype(np.float16)
    packed[:, 2:] = np.ascontiguousarray(color).view(np.uint32)
    return packed
