"""Scenes built in code: arrays that fit make a scene, those that do not are refused by name."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import glhybrid as gh
from glhybrid.checks import check_scene
from glhybrid.errors import GeometryError, SettingError
from glhybrid.scene import F32, MorphTarget

POSITION = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], np.float32)
INDEX = np.array([[0, 1, 2], [2, 1, 3]], np.uint32)
NORMAL = np.tile(np.float32([0, 0, 1]), (4, 1))


def scene_of(piece: Any, **changes: Any) -> gh.Scene:
    meshes = (gh.Mesh("m", (piece,)),)
    return gh.Scene("code", meshes, (gh.Instance(0, np.eye(4)),)).replace(**changes)


GOOD = gh.Triangles(POSITION, INDEX, NORMAL)
ROWS: list[tuple[dict[str, Any], str]] = [
    ({"position": POSITION.tolist()}, "position: is a list: must be a NumPy array of shape (N, 3)"),
    ({"position": POSITION[:, :2]}, "position: is of shape (4, 2): must be (N, 3)"),
    ({"position": POSITION.astype("U")}, "position: is of <U"),
    ({"index": INDEX.ravel()}, "index: is of shape (6,): must be (N, 3)"),
    ({"index": INDEX.astype(np.float32)}, "index: is of float32: must be of whole numbers"),
    ({"index": INDEX + 1}, "index 4 names no vertex: there are 4"),
    ({"index": INDEX.astype(np.int64) - 1}, "index -1 names no vertex"),
    ({"normal": None}, "normal: is None"),
    ({"normal": NORMAL[:2]}, "normal: is of shape (2, 3): must be (4, 3)"),
    ({"uv0": NORMAL}, "uv0: is of shape (4, 3): must be (4, 2)"),
    ({"color": NORMAL}, "color: is of shape (4, 3): must be (4, 4)"),
    ({"tangent": NORMAL}, "tangent: is of shape (4, 3): must be (4, 4)"),
    ({"joints": np.zeros((4, 4), np.uint16)}, "joints are (4, 4) and weights None"),
    ({"weights": np.zeros((4, 5), np.float32)}, "weights: is of shape (4, 5): must be (4, 4) or (4, 8)"),
    ({"morph_targets": (MorphTarget(position=POSITION[:3]),)}, "morph target 0: position: is of shape (3, 3)"),
    ({"material": 1}, "material = 1: there are 1"),
    ({"material": -1}, "material = -1"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "says"), ROWS, ids=[says for _, says in ROWS])
def test_arrays_that_do_not_fit(changes: dict[str, Any], says: str) -> None:
    check_scene(scene_of(GOOD))
    with pytest.raises(GeometryError) as error:
        check_scene(scene_of(replace(GOOD, **changes)))
    assert 'code: mesh 0 "m", primitive 0' in str(error.value) and says in str(error.value)


def test_what_is_no_primitive_or_matrix() -> None:
    with pytest.raises(GeometryError, match="is a ndarray, not Triangles or Sphere"):
        check_scene(scene_of(POSITION))
    flat: Any = np.eye(4).tolist()
    with pytest.raises(SettingError, match="not a NumPy array of shape"):
        check_scene(scene_of(GOOD, instances=(gh.Instance(0, flat),)))
    with pytest.raises(SettingError, match="must be two places, apart and finite"):
        gh.Camera.look_at((1, 2, 3), (1, 2, 3))


def area(mesh: gh.Mesh) -> F32:
    (piece,) = mesh.primitives
    assert isinstance(piece, gh.Triangles)
    corner = piece.position[piece.index]
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def test_meshes_of_lists_and_arrays() -> None:
    for mesh in (
        gh.mesh(POSITION.tolist(), INDEX.tolist()),
        gh.mesh(POSITION.astype(np.float64), INDEX.astype(np.int64)),
        gh.mesh(np.asfortranarray(POSITION), INDEX),
        gh.mesh(POSITION[INDEX].reshape(-1, 3)),
    ):
        check_scene(gh.Scene("code", (mesh,)))
        (piece,) = mesh.primitives
        assert isinstance(piece, gh.Triangles)
        assert piece.position.dtype == piece.normal.dtype == np.float32 and piece.index.dtype == np.uint32
        np.testing.assert_array_equal(area(mesh), area(gh.Mesh("", (GOOD,))))
        want = area(mesh) / np.linalg.norm(area(mesh), axis=1, keepdims=True)
        np.testing.assert_allclose(piece.normal[piece.index], want[:, None].repeat(3, 1), atol=1e-6)
    (piece,) = gh.mesh(POSITION, INDEX, smooth=True).primitives
    assert isinstance(piece, gh.Triangles) and len(piece.position) == 4
    (piece,) = gh.mesh(POSITION, INDEX, normal=5 * NORMAL, color=NORMAL, uv0=POSITION[:, :2], tangents=True).primitives
    assert isinstance(piece, gh.Triangles) and piece.color is not None and piece.tangent is not None
    np.testing.assert_allclose(piece.normal, NORMAL)
    np.testing.assert_array_equal(piece.color, [[0, 0, 1, 1]] * 4)
    np.testing.assert_allclose(piece.tangent, [[1, 0, 0, -1]] * 4, atol=1e-6)
    for empty in (gh.mesh(np.zeros((0, 3))), gh.mesh(POSITION, [])):
        check_scene(gh.Scene("code", (empty,)))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"position": [[0, 1], [2, 3], [4, 5]]}, "position: is of shape (3, 2)"), ({"position": "abc"}, "position"),
        ({"position": POSITION}, "no multiple of 3"), ({"position": POSITION, "index": [[0, 1, 9]]}, "index 9"),
        ({"position": POSITION, "index": INDEX, "uv0": [[0, 0]]}, "uv0: is of shape (1, 2): must be (4, 2)"),
        ({"position": POSITION, "index": [[0.5, 1, 2]]}, "of whole numbers"),
    ],
)  # fmt: skip
def test_meshes_that_are_none(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(GeometryError) as error:
        gh.mesh(**arguments, name="mine")
    assert str(error.value).startswith('mesh "mine"') and says in str(error.value)


def test_defaults_for_scenes_in_code() -> None:
    bare = scene_of(GOOD)
    full = gh.with_defaults(bare)
    assert len(full.lights) == len(full.cameras) == 1 and full.environment is not None and len(full.warnings) == 2
    assert gh.with_defaults(full) is full
