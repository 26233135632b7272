"""Shapes that break tracers: a tree as deep as its triangles are many, and triangles that are none."""

import numpy as np

from glhybrid.load.require import ShapeError, counts
from glhybrid.scene import F32, Triangles

GOLDEN = 2.39996323  # rad: no two blades of a few hundred come to lie over each other


def blades(*, number: int = 240, ratio: float = 1.224, width: float = 0.12) -> Triangles:
    """Triangles each `ratio` times as large and as far up as the one before, tips on the Y axis; 1 m in the middle.

    Seen from the origin upwards they are a fan of equal blades. Halving space separates one or two at a time, so a tree
    that does is nearly as deep as they are many. width: rad that a blade spans.
    """
    counts(4096, low=2, number=number)
    if not 1 < ratio <= 16:
        raise ShapeError("ratio", ratio, "must be greater than 1 and at most 16")
    if not 0 < width < 3:
        raise ShapeError("width", width, "must be greater than 0 and less than 3")
    if (reach := number / 2 * np.log10(ratio)) > 11:
        raise ShapeError("ratio", ratio, f"{number} blades would span 1e-{reach:.0f} to 1e{reach:.0f} m; at most 1e11")
    size = ratio ** (np.arange(number) - number / 2)
    turn = np.arange(number) * GOLDEN
    rim = [np.stack([np.cos(a), np.ones(number), np.sin(a)], axis=1) for a in (turn, turn + width)]
    corners = size[:, None, None] * np.stack([np.tile([0.0, 1.0, 0.0], (number, 1)), *rim], axis=1)
    return _soup(corners.astype(np.float32))


def debris(*, number: int = 100, size: float = 1.0, seed: int = 1) -> Triangles:
    """Triangles that nothing may be seen of, in a cube: with a NaN, with an infinity, three equal corners, a line.

    size: metres of the cube's side.
    """
    counts(100_000, number=number)
    if not 0 < size <= 1e6:
        raise ShapeError("size", size, "must be greater than 0 and at most 1e6")
    random = np.random.default_rng(seed)
    corners = random.uniform(-size / 2, size / 2, (number, 3, 3)).astype(np.float32)
    kind = np.arange(number) % 4
    where = np.arange(number), random.integers(0, 3, number), random.integers(0, 3, number)
    for k, value in ((0, np.nan), (1, np.inf)):
        corners[tuple(w[kind == k] for w in where)] = value
    corners[kind == 2] = corners[kind == 2, :1]
    steps = np.array([0, 1, 2], np.float32)[:, None] * np.float32(
        size / 64
    )  # along an axis: exactly a line in any arithmetic
    corners[kind == 3] = corners[kind == 3, :1] + steps * np.array([1, 0, 0], np.float32)
    return _soup(corners)


def _soup(corners: F32) -> Triangles:
    """(T, 3, 3) corners as flat triangles. Normals of those without area are up."""
    with np.errstate(invalid="ignore", over="ignore"):
        edges = corners[:, 1:].astype(np.float64) - corners[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        fine = np.isfinite(length) & (length > 0)
        normal = np.where(fine, np.divide(normal, length, where=fine, out=np.zeros_like(normal)), (0.0, 1.0, 0.0))
    index = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    uv = np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (len(corners), 1))
    return Triangles(corners.reshape(-1, 3), index, np.repeat(normal, 3, 0).astype(np.float32), uv0=uv)
