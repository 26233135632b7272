"""The oracles against each other and against Embree, and what watertight means in float32."""

import numpy as np
import pytest
from bvh_shapes import SHAPES, Triangles, rays, soup, sphere
from numpy.typing import NDArray

from glhybrid import reference
from glhybrid.bvh import Blas, build_blas


def camera_rays(triangles: Triangles, width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A pinhole in front of the middle, 60 degrees wide."""
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    x, y = np.meshgrid((np.arange(width) + 0.5) / width - 0.5, 0.5 - (np.arange(height) + 0.5) / height)
    directions = np.stack([x * 1.15, y * 1.15 * height / width, np.full_like(x, -1)], -1).reshape(-1, 3)
    origin = (low + high) / 2 + np.float32([0.1, 0.2, 0.9]) * (high - low)
    return np.repeat(origin[None], len(directions), 0).astype(np.float32), directions.astype(np.float32)


@pytest.mark.parametrize("precision", [np.float64, np.float32], ids=["float64", "float32"])
@pytest.mark.parametrize(("shape", "seed"), [("sphere", 1), ("sphere", 2), ("soup", 3), ("soup", 4)])
def test_tree_agrees_with_embree(shape: str, seed: int, precision: type) -> None:
    """No hit missed, none invented, the same triangle, and t within what float32 can say."""
    mesh = pytest.importorskip("embreex.mesh_construction", reason="embreex is not installed")
    scene_type = pytest.importorskip("embreex.rtcore_scene", reason="embreex is not installed")
    triangles = SHAPES[shape](seed)
    scene = scene_type.EmbreeScene(robust=True)
    mesh.TriangleMesh(scene, triangles)
    anywhere = [part[40_000:] for part in rays(triangles, 80_000, seed)]
    origins, directions = (np.concatenate(p) for p in zip(camera_rays(triangles, 240, 160), anywhere, strict=True))
    want = scene.run(origins, directions, output=1)
    got = reference.traverse(build_blas(triangles), origins, directions, precision=precision)
    hit = want["primID"] >= 0
    assert hit.sum() > 30_000
    assert np.array_equal(got.hit, hit)
    assert np.array_equal(got.triangle[hit], want["primID"][hit])
    vertices = triangles[got.triangle[hit]].astype(np.float64)
    normal = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    slope = np.abs((normal * directions[hit]).sum(1)) / np.linalg.norm(normal, axis=1)
    # Embree's own t is float32: an ulp of the coordinates, more at a grazing angle.
    ulp = np.spacing(np.abs(triangles).max()) / np.minimum(slope, 1)
    assert (np.abs(got.t[hit] - want["tfar"][hit]) <= 1e-5 * got.t[hit] + ulp).all()


def test_brute_force_knows_bounds_and_ties() -> None:
    quad = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float64)
    stack = np.concatenate([quad + np.array([0, 0, z]) for z in (-1, -2, -2, -3)])
    origin, down = np.array([0.25, 0.25, 0.0]), np.array([[0.0, 0.0, -1.0]])
    for t_min, t_max, t, triangle in (
        (0, np.inf, 1, 0), (1, 1, 1, 0), (1.5, np.inf, 2, 1),
        (0, 0.5, np.inf, reference.NO_HIT), (2.5, 2.9, np.inf, reference.NO_HIT),
    ):  # fmt: skip
        hits = reference.closest_hit(stack, origin, down, t_min, t_max)
        assert (hits.t[0], hits.triangle[0]) == (t, triangle)
        walked = reference.traverse(build_blas(stack), origin, down, t_min, t_max)
        assert (walked.t[0], walked.triangle[0]) == (t, triangle)
        assert reference.any_hit(stack, origin, down, t_min, t_max)[0] == (t < np.inf)
    hits = reference.closest_hit(quad, [0.5, 0.25, 1], down)
    np.testing.assert_allclose(hits.bary, [[0.5, 0.25]], atol=1e-15)
    assert not reference.any_hit(quad, [0.6, 0.6, 1], down)[0]


def test_counts_are_of_the_walk() -> None:
    triangles = soup(2000, 5)
    tree = build_blas(triangles)
    origins, directions = rays(triangles, 2000, 6)
    closest, any_ = (reference.traverse(tree, origins, directions, any_hit=flag) for flag in (False, True))
    assert closest.nodes_visited is not None and any_.nodes_visited is not None
    assert closest.nodes_visited.min() >= 1
    assert any_.nodes_visited.sum() < closest.nodes_visited.sum() < len(origins) * len(tree.nodes) / 4
    away = reference.traverse(tree, tree.bounds[1] + 1, np.ones((1, 3)))
    assert not away.hit[0] and away.nodes_visited[0] == 1 and away.triangles_tested[0] == 0


def leaks(tree: Blas, triangles: Triangles, where: str, test: reference.Test) -> float:
    """Share of float32 rays from inside a closed mesh, aimed at its vertices or edges, that find no triangle."""
    if where == "vertex":
        target = triangles.reshape(-1, 3).astype(np.float64)
    else:
        share = np.random.default_rng(1).random((len(triangles), 3, 1))
        target = (triangles * share + np.roll(triangles, 1, axis=1).astype(np.float64) * (1 - share)).reshape(-1, 3)
    origin = (tree.bounds.mean(0) + np.random.default_rng(2).uniform(-0.3, 0.3, target.shape)).astype(np.float32)
    hits = reference.traverse(tree, origin, target - origin, precision=np.float32, test=test)
    return float((~hits.hit).mean())


@pytest.mark.parametrize("where", ["vertex", "edge"])
@pytest.mark.parametrize("centre", [(0, 0, 0), (300, -200, 100), (148376, 1234, -223423)], ids=["near", "away", "far"])
def test_woop_does_not_leak_and_moeller_trumbore_does(where: str, centre: tuple[float, float, float]) -> None:
    parts = 20 if centre[0] > 1e5 else 120  # far away float32 has no room for small triangles
    triangles = sphere(parts, centre=centre)
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    tree = build_blas(triangles[area > 0])
    assert leaks(tree, triangles, where, "woop") == 0
    if centre[0] < 1e5:
        assert leaks(tree, triangles, where, "moller-trumbore") > 0.01
