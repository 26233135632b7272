"""Normals and MikkTSpace tangents, the latter against numbers that the reference implementation gave."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glhybrid.load.tangents import (
    face_normals,
    first_equal_row,
    flat,
    smooth_normals,
    take_vertices,
    tangents,
    with_normals,
    with_tangents,
)
from glhybrid.scene import F32, U32, MorphTarget, Triangles

GOLDEN: dict[str, Any] = json.loads((Path(__file__).parent / "mikktspace.json").read_text())
POSITION, NORMAL = np.float32(GOLDEN["position"]), np.float32(GOLDEN["normal"])
# Corners that may differ: the reference's answer about patches without texture area depends on the order of its walk.
ALLOWED = {"patches without texture area": 0.04}


def has_area(uv: F32, index: U32) -> np.ndarray:
    """Whether each corner's triangle has three different positions and area in the texture."""
    e = uv[index]
    a, b = e[:, 1] - e[:, 0], e[:, 2] - e[:, 0]
    distinct = np.array([len({tuple(POSITION[v]) for v in t}) == 3 for t in index])
    return np.repeat((a[:, 0] * b[:, 1] != a[:, 1] * b[:, 0]) & distinct, 3)


@pytest.mark.parametrize("case", GOLDEN["cases"])
def test_tangents_are_the_references(case: str) -> None:
    data = GOLDEN["cases"][case]
    uv, index = np.float32(data["uv"]), np.uint32(data["index"])
    want = np.array(data["tangent"]) * [1, 1, 1, -1]  # fed with v down as if it were up, it gave the other hand
    tangent, source, new_index = tangents(POSITION, NORMAL, uv, index)
    got = tangent[new_index.ravel()]
    counted = has_area(uv, index)
    wrong = np.any(np.abs(got - want) > 2e-5, axis=1) & counted
    assert counted.sum() > 60 and wrong.sum() <= ALLOWED.get(case, 0.0) * counted.sum()
    # Every corner still shows its vertex, the old vertices keep their numbers, and only what must be is doubled.
    np.testing.assert_array_equal(source[new_index], index)
    np.testing.assert_array_equal(source[: len(POSITION)], np.arange(len(POSITION)))
    pairs = {(int(v), *t) for v, t in zip(source[new_index.ravel()], got.tolist(), strict=True)}
    assert len(source) == len(pairs) + len(POSITION) - len(np.unique(index))
    np.testing.assert_allclose((got[:, :3] * NORMAL[index.ravel()]).sum(1), 0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(got[:, :3], axis=1), 1, atol=1e-5)


def test_order_of_triangles_and_vertices_does_not_matter() -> None:
    data = GOLDEN["cases"]["mirrored"]
    uv, index = np.float32(data["uv"]), np.uint32(data["index"])
    rng = np.random.default_rng(5)
    order, rename = rng.permutation(len(index)), rng.permutation(len(POSITION))
    turned = np.stack([np.roll(t, k) for t, k in zip(index, rng.integers(3, size=len(index)), strict=True)])
    back = np.argsort(rename)
    tangent, _, new_index = tangents(POSITION, NORMAL, uv, index)
    other, _, other_index = tangents(
        POSITION[rename], NORMAL[rename], uv[rename], back[turned[order]].astype(np.uint32)
    )
    for t, o in enumerate(order):
        first = {int(v): tangent[n] for v, n in zip(index[o], new_index[o], strict=True)}
        second = {int(v): other[n] for v, n in zip(turned[o], other_index[t], strict=True)}
        for v in first:
            np.testing.assert_allclose(first[v], second[v], atol=1e-5)


def test_shared_and_unshared_vertices_agree() -> None:
    data = GOLDEN["cases"]["seam"]
    uv, index = np.float32(data["uv"]), np.uint32(data["index"])
    tangent, _, new_index = tangents(POSITION, NORMAL, uv, index)
    soup = np.arange(index.size, dtype=np.uint32).reshape(-1, 3)
    c = index.ravel()
    other, source, other_index = tangents(POSITION[c], NORMAL[c], uv[c], soup)
    assert len(source) == index.size  # nothing to split: each corner has its vertex
    np.testing.assert_allclose(other[other_index], tangent[new_index], atol=1e-6)


def test_a_mirror_seam_doubles_its_vertices() -> None:
    position = np.float32([[-1, 0, 0], [-1, 1, 0], [0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]])
    uv = np.float32([[1, 1], [1, 0], [0, 1], [0, 0], [1, 1], [1, 0]])  # u grows to both sides
    index = np.uint32([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])
    normal = np.tile(np.float32([0, 0, 1]), (6, 1))
    tangent, source, new_index = tangents(position, normal, uv, index)
    assert len(source) == 8 and sorted(source[6:]) == [2, 3]
    got = tangent[new_index]
    np.testing.assert_allclose(got[:2], np.tile([-1, 0, 0, -1], (2, 3, 1)), atol=1e-6)
    np.testing.assert_allclose(got[2:], np.tile([1, 0, 0, 1], (2, 3, 1)), atol=1e-6)
    # In both halves the bitangent is up: the image is not upside down in the mirror.
    bitangent = np.cross(normal[source], tangent[:, :3]) * tangent[:, 3:]
    np.testing.assert_allclose(bitangent, np.tile([0, 1, 0], (8, 1)), atol=1e-6)


@pytest.mark.parametrize("broken", [np.nan, np.inf, 1e38, 0.0])
def test_any_numbers_give_unit_tangents_and_normals(broken: float) -> None:
    rng = np.random.default_rng(1)
    position = rng.normal(size=(30, 3)).astype(np.float32)
    uv = rng.normal(size=(30, 2)).astype(np.float32)
    index = rng.integers(30, size=(60, 3)).astype(np.uint32)
    position[::3], uv[1::3] = broken, broken
    normal = smooth_normals(position, index)
    tangent, source, _ = tangents(position, normal, uv, index)
    for vectors in (normal, tangent[:, :3], face_normals(position, index)):
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose((tangent[:, :3] * normal[source]).sum(1), 0, atol=1e-5)


def test_no_triangles_and_one() -> None:
    none = np.zeros((0, 3), np.uint32)
    tangent, source, index = tangents(POSITION, NORMAL, POSITION[:, :2], none)
    assert len(source) == len(POSITION) and index.shape == (0, 3) and np.isfinite(tangent).all()
    assert smooth_normals(POSITION, none).shape == POSITION.shape
    one = np.uint32([[0, 1, 2]])
    assert tangents(POSITION[:3], NORMAL[:3], POSITION[:3, :2], one)[0].shape == (3, 4)


def test_deep_patch_without_texture_area_ends_soon() -> None:
    """A 60 x 60 grid that shows one texel but for one corner: the walk into it is bounded."""
    x, y = np.meshgrid(np.arange(61), np.arange(61))
    position = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1).astype(np.float32)
    corner = (np.arange(60)[:, None] * 61 + np.arange(60)).ravel()
    index = np.concatenate(
        [np.stack([corner, corner + 1, corner + 62], 1), np.stack([corner, corner + 62, corner + 61], 1)]
    )
    uv = np.zeros((len(position), 2), np.float32)
    uv[:2] = [[0, 1], [1, 1]]
    normal = np.tile(np.float32([0, 0, 1]), (len(position), 1))
    tangent, _, new_index = tangents(position, normal, uv, index.astype(np.uint32))
    np.testing.assert_allclose(tangent[new_index[0]], [[1, 0, 0, 1]] * 3, atol=1e-6)


# --- normals


def test_smooth_normals_weigh_by_angle() -> None:
    """A cube's corner points along its diagonal however its sides are cut into triangles."""
    corner = np.float32([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    rng = np.random.default_rng(2)
    index = []
    for side in sides:
        s = np.roll(side, rng.integers(4))
        index += [[s[0], s[1], s[2]], [s[0], s[2], s[3]]]
    want = (corner * 2 - 1) / np.sqrt(3)
    np.testing.assert_allclose(smooth_normals(corner, np.uint32(index)), want, atol=1e-6)
    # The same as a soup: positions are welded. Without welding each triangle keeps its own.
    soup = np.uint32(index)
    points, own = corner[soup.ravel()], np.arange(soup.size, dtype=np.uint32).reshape(-1, 3)
    np.testing.assert_allclose(smooth_normals(points, own), want[soup.ravel()], atol=1e-6)
    unwelded = smooth_normals(points, own, weld=False)
    np.testing.assert_allclose(unwelded, np.repeat(face_normals(corner, soup), 3, axis=0), atol=1e-6)


def whole_triangles() -> Triangles:
    index = np.uint32([[0, 1, 2], [2, 1, 3]])
    v = np.arange(4, dtype=np.float32)
    position = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])
    return Triangles(
        position, index, position, 0, np.stack([v] * 4, 1), np.stack([v] * 2, 1), np.stack([v + 10] * 2, 1),
        np.stack([v] * 4, 1), np.stack([v] * 4, 1).astype(np.uint16), np.stack([v] * 4, 1),
        (MorphTarget(position * 2, position, position), MorphTarget(normal=position)),
    )  # fmt: skip


def test_flat_un_shares_everything() -> None:
    made, source = flat(whole_triangles()), [0, 1, 2, 2, 1, 3]
    old = whole_triangles()
    for name in ("position", "uv0", "uv1", "color", "joints", "weights"):
        np.testing.assert_array_equal(getattr(made, name), getattr(old, name)[source])
    np.testing.assert_array_equal(made.index, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_allclose(made.normal[:3], [[0, 0, 1]] * 3, atol=1e-7)
    np.testing.assert_array_equal(made.morph_targets[0].position, old.position[source] * 2)
    assert made.tangent is None and made.morph_targets[0].normal is None  # they mean nothing without smooth normals


def test_take_vertices_takes_all_arrays() -> None:
    old, source = whole_triangles(), np.array([3, 0, 0])
    made = take_vertices(old, source)
    for name in ("position", "normal", "tangent", "uv0", "uv1", "color", "joints", "weights"):
        np.testing.assert_array_equal(getattr(made, name), getattr(old, name)[source])
    np.testing.assert_array_equal(made.morph_targets[1].normal, old.position[source])
    assert made.morph_targets[1].position is None


def test_with_tangents_picks_the_uv_set_and_splits_all_arrays() -> None:
    position = np.float32([[-1, 0, 0], [-1, 1, 0], [0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]])
    mirrored = np.float32([[1, 1], [1, 0], [0, 1], [0, 0], [1, 1], [1, 0]])
    index = np.uint32([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])
    normal = np.tile(np.float32([0, 0, 1]), (6, 1))
    color = np.arange(24, dtype=np.float32).reshape(6, 4)
    made = with_tangents(Triangles(position, index, normal, uv0=position[:, :2], uv1=mirrored, color=color), uv_set=1)
    assert made.tangent is not None and made.color is not None and len(made.position) == 8
    np.testing.assert_array_equal(made.position[made.index], position[index])
    np.testing.assert_array_equal(made.color[made.index], color[index])
    assert len(with_tangents(Triangles(position, index, normal, uv0=position[:, :2])).position) == 6
    without = with_tangents(Triangles(position, index, normal))  # no texture coordinates at all
    assert without.tangent is not None and np.isfinite(without.tangent).all()


def test_with_normals_mends_those_without_direction() -> None:
    old = whole_triangles()
    given = np.array([[0, 0, 2], [0, 0, 0], [np.nan, 0, 0], [3, 0, 4]])
    made = with_normals(old, given)
    smooth = smooth_normals(old.position, old.index)
    np.testing.assert_allclose(made.normal, [[0, 0, 1], smooth[1], smooth[2], [0.6, 0, 0.8]], atol=1e-6)


def test_first_equal_row() -> None:
    rows = np.float32([[1, 2], [0.0, 3], [1, 2], [-0.0, 3], [np.nan, 1], [np.nan, 1]])
    np.testing.assert_array_equal(first_equal_row(rows), [0, 1, 0, 1, 4, 4])
    many = np.random.default_rng(0).integers(0, 9, (5000, 3)).astype(np.float32)
    first = first_equal_row(many)
    np.testing.assert_array_equal(many[first], many)
    _, want = np.unique(many, axis=0, return_inverse=True)
    assert len(np.unique(first)) == want.max() + 1
