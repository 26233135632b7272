"""Seams of light maps: points where two charts meet on a surface, and values there made to agree. No OpenGL.

A penumbra is sampled by other rays on either side of a seam, so lookups of one point from both differ by their noise,
and such a step is a line on the surface. Texels are moved as little as makes lookups agree: least squares over all
points of all seams. After Iwanicki, "Lighting Technology of The Last of Us", SIGGRAPH 2013.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from glhybrid.geometry import Geometry
from glhybrid.lightmap import Lightmap
from glhybrid.scene import F32, F64

SMALLEST, LARGEST = 0.5 / 255, 0.15  # steps that count: what 8 bits show, up to what noise makes; others are real
FACING = 0.07  # N.L from which on all of a light's disc is above both surfaces
STIFF = 0.02  # of a texel, against a step of one
ROUNDS = 30


def points(corners: F32, uv: F32) -> F32:
    """(J, 2, 2) a texel apart along seams: x, y on both sides. corners (T, 3, 3); uv (T, 3, 2) in texels."""
    count = len(corners)
    words = np.ascontiguousarray(corners + np.float32(0), np.float32).reshape(-1, 3).view(np.uint32)  # no -0
    place = np.unique(words.view([("", np.uint32)] * 3)[:, 0], return_inverse=True)[1].reshape(count, 3)
    ends = np.stack([place, np.roll(place, -1, 1)], -1).reshape(-1, 2)
    at = np.stack([uv, np.roll(uv, -1, 1)], 2).reshape(-1, 2, 2)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], at[turned] = ends[turned, ::-1], at[turned, ::-1]
    key = ends[:, 0].astype(np.int64) * (int(place.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    sorted_ = key[order]
    first = np.flatnonzero(np.concatenate([[True], sorted_[1:] != sorted_[:-1]]) if len(sorted_) else [])
    two = first[np.diff(np.append(first, len(sorted_))) == 2]  # edges of more, or fewer, triangles are none
    sides = np.stack([at[order[two]], at[order[two + 1]]], 1)  # seam, side, end, xy
    sides = sides[np.abs(sides[:, 0] - sides[:, 1]).max((1, 2), initial=0) > 1e-3]
    length = np.linalg.norm(sides[:, :, 1] - sides[:, :, 0], axis=-1).max(1, initial=0)
    samples = np.ceil(length).astype(np.int64).clip(1)
    row = np.repeat(np.arange(len(sides)), samples)
    number = np.arange(len(row)) - np.repeat(np.cumsum(samples) - samples, samples)
    share = ((number + 0.5) / samples[row])[:, None, None]
    return ((1 - share) * sides[row, :, 0] + share * sides[row, :, 1]).astype(np.float32)


def lookups(geometry: Geometry, map_: Lightmap) -> Iterator[tuple[np.ndarray, F32]]:
    """Of each place with seams: (J, 2, 4) int64 texels of all pages that a bilinear lookup reads on both sides, and
    their weights."""
    _, height, width = map_.pages
    known: dict[tuple[int, int], F32] = {}
    for i, mesh in enumerate(geometry.instance_mesh.tolist()):
        spheres = {s[1] for s in geometry.meshes[mesh].spheres}
        for number, (first, count) in enumerate(geometry.meshes[mesh].geometries):
            if number in spheres or not count:
                continue
            x, y, page, shift = map_.places[map_.places[i, 0] + number].tolist()
            if (first, shift) not in known:
                corners = geometry.vertices[geometry.triangles[first : first + count, :3], :3]
                rows = map_.uv[first + shift : first + shift + count, :6].reshape(-1, 3, 2)
                known[first, shift] = points(corners, rows)
            at = known[first, shift]
            if len(at):
                p = at.astype(np.float64) + np.array([x - 0.5, y - 0.5])
                low = np.floor(p).astype(np.int64)
                f = p - low
                texel = (page * height + low[..., 1]) * width + low[..., 0]
                weight = [(1 - f[..., 0]) * (1 - f[..., 1]), f[..., 0] * (1 - f[..., 1]), (1 - f[..., 0]) * f[..., 1],
                          f[..., 0] * f[..., 1]]  # fmt: skip
                index = np.stack([texel, texel + 1, texel + width, texel + width + 1], -1)
                yield index, np.stack(weight, -1).astype(np.float32)


def stitch(values: F32, facing: F32, seams: Iterator[tuple[np.ndarray, F32]]) -> None:
    """Makes lookups on both sides agree, in place. values (N, C) of all texels; facing (N,): N.L of their fronts."""
    indices, weights = [], []
    for index, weight in seams:
        sides = (values[index] * weight[..., None]).sum(2)
        step = np.abs(sides[:, 0] - sides[:, 1]).max(-1)
        kept = (step > SMALLEST) & (step < LARGEST) & (facing[index].min((1, 2)) > FACING)
        indices.append(index[kept].reshape(-1, 8))
        weights.append((weight[kept] * np.array([1, -1], np.float32)[:, None]).reshape(-1, 8))
    if not sum(map(len, indices)):
        return
    used, at = np.unique(np.concatenate(indices), return_inverse=True)
    signed: Any = np.concatenate(weights).astype(np.float64)
    for channel in range(values.shape[1]):
        x: Any = values[used, channel].astype(np.float64)
        values[used, channel] = x + _least_squares(at.reshape(-1, 8), signed, x)


def _least_squares(at: np.ndarray, weight: F64, x: F64) -> F64:
    """The change of x (N,) that makes sums of weight (J, 8) times x[at] vanish, STIFF: by conjugate gradients."""

    def steps(v: F64) -> F64:
        return np.asarray((weight * v[at]).sum(1))

    def back(s: F64) -> F64:
        return np.asarray(np.bincount(at.ravel(), (weight * s[:, None]).ravel(), len(x)), np.float64)

    change = np.zeros_like(x)
    residual = -back(steps(x))
    way, size = residual.copy(), float(residual @ residual)
    for _ in range(ROUNDS):
        if size < 1e-12:
            break
        image = back(steps(way)) + STIFF * way
        length = size / float(way @ image)
        change += length * way
        residual -= length * image
        new = float(residual @ residual)
        way, size = residual + new / size * way, new
    return change
