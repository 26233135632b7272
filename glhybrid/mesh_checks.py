"""Refuses meshes whose arrays do not fit together, by mesh, primitive and array.

Loaders make none such; this is for scenes that are built in code. A wrong index would read another mesh's vertices.
"""

import weakref
from typing import Any

import numpy as np

from glhybrid.errors import GeometryError
from glhybrid.scene import Mesh, Scene, Sphere, Triangles

# Columns of each array by vertex; several widths where it has several forms.
_WIDTHS = {
    "position": (3,), "normal": (3,), "tangent": (4,), "uv0": (2,), "uv1": (2,), "color": (4,), "joints": (4, 8),
    "weights": (4, 8),
}  # fmt: skip
_fine: "weakref.WeakSet[Mesh]" = weakref.WeakSet()  # were looked at: a mesh is never written to


def check_meshes(scene: Scene) -> None:
    """Raises GeometryError naming the first array of a wrong kind or shape, or index that names nothing."""
    materials = len(scene.materials)
    for number, mesh in enumerate(scene.meshes):
        what = f'{scene.name}: mesh {number} "{mesh.name}"'
        if mesh not in _fine:
            for k, piece in enumerate(mesh.primitives):
                if isinstance(piece, Triangles):
                    check_piece(piece, f"{what}, primitive {k}")
                elif not isinstance(piece, Sphere):
                    raise GeometryError(f"{what}, primitive {k}: is a {type(piece).__name__}, not Triangles or Sphere")
            _fine.add(mesh)
        for k, piece in enumerate(mesh.primitives):
            if not 0 <= piece.material < materials:
                raise GeometryError(
                    f"{what}, primitive {k}: material = {piece.material}: there are {materials}, numbered from 0"
                )


def check_piece(piece: Triangles, what: str) -> None:
    """Raises GeometryError, which begins with `what`, where arrays do not fit together."""
    count = _rows(piece.position, f"{what}: position", None, (3,))
    for name, widths in _WIDTHS.items():
        array = getattr(piece, name)
        if array is not None or name == "normal":
            _rows(array, f"{what}: {name}", count, widths)
    joints, weights = (None if a is None else a.shape for a in (piece.joints, piece.weights))
    if joints != weights:
        raise GeometryError(f"{what}: joints are {joints} and weights {weights}: alike, or None both")
    for k, target in enumerate(piece.morph_targets):
        for name in ("position", "normal", "tangent"):
            if (array := getattr(target, name)) is not None:
                _rows(array, f"{what}: morph target {k}: {name}", count, (3,))
    _rows(piece.index, f"{what}: index", None, (3,), whole=True)
    if len(piece.index):
        low, high = int(piece.index.min()), int(piece.index.max())
        if low < 0 or high >= count:
            wrong = low if low < 0 else high
            raise GeometryError(f"{what}: index {wrong} names no vertex: there are {count}, numbered from 0")


def _rows(array: Any, what: str, rows: int | None, widths: tuple[int, ...], whole: bool = False) -> int:
    """The rows of an array, which must be so many, of one of these widths, and of numbers."""
    shape = " or ".join(f"({'N' if rows is None else rows}, {width})" for width in widths)
    if not isinstance(array, np.ndarray):
        given = "None" if array is None else f"a {type(array).__name__}"
        mend = "; glhybrid.mesh makes normals where there are none" if what.endswith("normal") else ""
        raise GeometryError(f"{what}: is {given}: must be a NumPy array of shape {shape}{mend}")
    if array.ndim != 2 or array.shape[1] not in widths or (rows is not None and len(array) != rows):
        raise GeometryError(f"{what}: is of shape {array.shape}: must be {shape}")
    if array.dtype.kind not in ("iu" if whole else "iuf"):
        raise GeometryError(f"{what}: is of {array.dtype}: must be of {'whole ' if whole else ''}numbers")
    return len(array)
