"""Meshes from arrays: scenes that are built in code."""

from typing import Any

import numpy as np

from glhybrid.errors import GeometryError
from glhybrid.load import tangents as made
from glhybrid.scene import Mesh, Triangles


def mesh(
    position: Any,
    index: Any = None,
    *,
    normal: Any = None,
    uv0: Any = None,
    color: Any = None,
    material: int = 0,
    smooth: bool = False,
    tangents: bool = False,
    name: str = "mesh",
) -> Mesh:
    """A mesh of one material, from arrays or lists, checked and brought to the types that `Triangles` has.

    position: (V, 3) metres, object space. index: (T, 3) rows of it, front faces counter-clockwise; None: each three
    rows are a triangle. normal: (V, 3) of any length; None: one for each triangle, or smooth ones. uv0: (V, 2), v down.
    color: (V, 3) or (V, 4), linear, multiplies the base colour. material: index into Scene.materials. tangents: make
    them too, for a material with a normal map (MikkTSpace; vertices may be doubled).
    Raises GeometryError naming the array that does not fit.
    """
    from glhybrid.mesh_checks import check_piece

    what = f'mesh "{name}"'
    points = _floats(position, f"{what}: position")
    corners: Any
    if index is None:
        if points.ndim == 2 and len(points) % 3:
            raise GeometryError(f"{what}: position has {len(points)} rows, no multiple of 3, and there is no index")
        corners = np.arange(len(points) if points.ndim == 2 else 0).reshape(-1, 3)
    else:
        corners = np.asarray(index)
        if corners.size == 0:
            corners = corners.reshape(-1, 3).astype(np.uint32)
    tint = None if color is None else _floats(color, f"{what}: color")
    if tint is not None and tint.ndim == 2 and tint.shape[1] == 3:
        tint = np.concatenate([tint, np.ones((len(tint), 1), np.float32)], axis=1)
    given = np.zeros_like(points) if normal is None else _floats(normal, f"{what}: normal")
    piece = Triangles(
        points, corners, given, material, uv0=None if uv0 is None else _floats(uv0, f"{what}: uv0"), color=tint
    )
    check_piece(piece, what)
    piece = Triangles(points, np.ascontiguousarray(corners, np.uint32), given, material, uv0=piece.uv0, color=tint)
    if normal is not None:
        piece = made.with_normals(piece, given)
    else:
        piece = made.smooth(piece) if smooth else made.flat(piece)
    return Mesh(name, (made.with_tangents(piece) if tangents else piece,))


def _floats(values: Any, what: str) -> Any:
    try:
        return np.ascontiguousarray(values, np.float32)
    except (TypeError, ValueError) as error:
        raise GeometryError(f"{what}: is not an array of numbers: {error}") from None
