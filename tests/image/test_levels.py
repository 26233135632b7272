"""A scene whose parts range from 1e-11 to 1e11 m shows every one of them: levels=auto takes what float32 can hold."""

from collections.abc import Callable

import numpy as np
import pytest
from scene_kit import camera_rays, matte, scene, soup, sun

import glhybrid as gh
from glhybrid import reference
from glhybrid.levels import choose_levels
from glhybrid.load.hostile import blades
from glhybrid.scene import F64, Camera, Scene, Sphere, Triangles

SIZE = (96, 72)


def fan() -> Scene:
    """240 blades, each 1.224 times as large and as far as the one before, in one mesh: 3e-11 to 6e10 m."""
    return scene([(blades(), matte())], Camera.look_at((0, 0, 0), (0, 1, 0), up=(0, 0, 1), near=1e-14), lights=(sun(),))


def pebbles(ground: float = 1e5) -> Scene:
    """Triangles of a millimetre about the origin, over a ground far below of 2e5 m in the same mesh."""
    rng = np.random.default_rng(5)
    small = rng.uniform(-0.01, 0.01, (60, 1, 3)) + 1e-3 * rng.normal(size=(60, 3, 3))
    plane = ground * np.array([[[-1, 0, 1], [1, 0, 1], [1, 0, -1]], [[-1, 0, 1], [1, 0, -1], [-1, 0, -1]]])
    plane[..., 1] = -ground
    camera = Camera.look_at((0.01, 0.03, 0.04), (0, 0, 0), near=1e-4)
    return scene([(soup(np.concatenate([small, plane])), matte())], camera, lights=(sun(),))


def triangles(made: Scene) -> F64:
    piece = made.meshes[0].primitives[0]
    assert isinstance(piece, Triangles)
    return piece.position[piece.index].astype(np.float64)


@pytest.mark.parametrize("primary", ["raster", "trace"])
@pytest.mark.parametrize("make", [fan, pebbles])
def test_parts_of_all_sizes_are_where_they_are(renderer: gh.Renderer, make: Callable[[], Scene], primary: str) -> None:
    """Every pixel's triangle and distance against brute force in float64.

    0.5 % of pixels: those whose centre float32 puts on the other side of an edge. One level shows a tenth of the fan.
    """
    made = make()
    settings = gh.Settings(shadows="none", reflections="none", primary=primary, aa=1)
    frame = renderer.render(made, size=SIZE, settings=settings, aovs=("triangle_id", "distance"))
    assert frame.receipt["plan"]["levels"] == 2 and not frame.receipt["scene"]["dropped_triangles"]
    rays = camera_rays(made, SIZE)
    want = reference.closest_hit(triangles(made), rays.origin.reshape(-1, 3), rays.direction.reshape(-1, 3))
    got, distance = frame["triangle_id"].ravel(), frame["distance"].ravel()
    same = got == want.triangle
    assert (~same).mean() < 0.005, (~same).mean()
    hit = same & want.hit
    assert len(np.unique(got[hit])) > 40 and hit.mean() > 0.1
    assert (np.abs(distance[hit] - want.t[hit]) <= 1e-5 * want.t[hit]).all()


def test_one_level_that_was_asked_for_says_what_it_lost(renderer: gh.Renderer) -> None:
    settings = gh.Settings(shadows="none", reflections="none", levels=1, aa=1)
    told = renderer.render(fan(), size=(8, 8), settings=settings).receipt["scene"]
    lost = told["dropped_triangles"]
    assert lost > 100
    assert told["warnings"] == [
        f"{lost} triangles dropped: too small for one level of trees over all; --set levels=2 shows them"
    ]


def test_triangles_without_area_are_not_taken_for_small_ones(renderer: gh.Renderer) -> None:
    # Turned, three points of a line are not quite on one any more; two levels would not show them either.
    line = [[4.12, 9.11, -17.0 - 0.1 * k * k] for k in range(12)]
    piece = gh.mesh([*line, [1, 0, 0], [0, 1, 0]], [*([k, k + 1, k + 2] for k in range(10)), [0, 12, 13]])
    turn = np.eye(4)
    turn[1:3, 1:3] = [[-1.34e-7, -1], [1, -1.34e-7]]  # a quarter, as files in float32 have it
    scene = gh.with_defaults(gh.Scene("s", (piece,), (gh.Instance(0, turn),)))
    settings = gh.Settings(shadows="none", reflections="none", aa=1)
    for levels in (1, 2):
        told = renderer.render(scene, size=(8, 8), settings=settings.replace(levels=levels)).receipt["scene"]
        assert told["dropped_triangles"] and not any("too small" in w for w in told["warnings"]), told


def test_two_levels_only_where_they_hold_more() -> None:
    """Not for small triangles far from their mesh's origin, where its float32 is as coarse."""
    assert choose_levels(fan(), "auto")[1].startswith("triangles of 2.9e-11 m would lose their shape")
    assert choose_levels(pebbles(), "auto")[0] == 2
    assert choose_levels(pebbles(10), "auto")[0] == 1
    far = triangles(pebbles())
    far[:60, :, 0] += 5e4
    assert choose_levels(scene([(soup(far), matte())]), "auto") == (1, "no mesh is repeated")
    assert choose_levels(scene([(soup(far), matte()), (Sphere(1e-3), matte())]), "auto")[0] == 2
