"""Where depth maps look from: everything seen is in a map, cascades keep their grid, refusals say what to do."""

from typing import Any

import numpy as np
import pytest

from glhybrid import shadow_fit
from glhybrid.errors import SettingError
from glhybrid.scene import F64, Camera, Light, Scene
from glhybrid.settings import Settings
from glhybrid.study import metrics
from glhybrid.view import View, make_view

BOXES = np.array([[[-20, -0.2, -20], [20, 0, 20]], [[-3, 0, -3], [-1, 4, -1]], [[5, 0, 9], [6, 2, 10]]], np.float64)
SUN = Light("directional", direction=(0.36, -0.8, 0.48))


def fit(**parameters: Any) -> shadow_fit.Fit:
    dotted = {f"shadows.csm.{key}": value for key, value in parameters.items()}
    return shadow_fit.Fit.of(Settings(shadows="csm", parameters=dotted))


def view_of(eye: Any, target: Any = (0.0, 0.0, 0.0), ortho: float = 0.0) -> View:
    camera = Camera.look_at(eye, target)
    if ortho:
        camera = Camera("ortho", camera.world_from_view, fov_y=0, ymag=ortho)
    return make_view(camera, (640, 480), Scene("empty"))


def on_map(row: Any, points: F64, view: View) -> tuple[F64, F64]:
    """Texels from the tile's corner, and depth, as lib/shadow_map.glsl has them. points: world."""
    f = points - view.origin - row["origin"]
    side = np.stack([f @ row["right"], f @ row["up"]], -1)
    depth = f @ row["axis"] - row["start"]
    if row["near"] > 0:
        side /= depth[:, None]
    return side / row["texel"] - row["first_texel"], depth


def boxes_corners() -> F64:
    return np.array([[b[i, 0], b[j, 1], b[k, 2]] for b in BOXES for i in (0, 1) for j in (0, 1) for k in (0, 1)])


@pytest.mark.parametrize("ortho", [0.0, 3.0])
def test_the_last_cascade_holds_the_scene_and_each_slice_of_the_view_is_in_its_map(ortho: float) -> None:
    chosen, view = fit(resolution=512), view_of((6, 3, 8), ortho=ortho)
    maps, lights = shadow_fit.rows(BOXES, (SUN,), view, chosen, 2)
    assert lights[0]["first_map"] == 0 and 2 <= lights[0]["map_count"] == len(maps) <= 4
    at, depth = on_map(maps[-1], boxes_corners(), view)
    assert (at >= chosen.margin - 1).all() and (at <= 512 - chosen.margin + 1).all()
    assert (depth > 0).all() and (depth < maps[-1]["range"]).all()
    texel = maps["texel"].max(1)
    assert (np.diff(texel) > 0).all()  # finest first
    # Just before the camera the finest map is the one.
    start = view.origin + view.eye + 0.5 * view.forward
    at, _ = on_map(maps[0], start[None], view)
    assert (at > chosen.margin).all() and (at < 512 - chosen.margin).all()
    tiles = {tuple(row["corner"]) for row in maps}
    assert len(tiles) == len(maps)


def test_snapped_cascades_keep_size_and_grid_as_the_camera_moves_and_turns() -> None:
    phase, sizes = [], []
    for k in range(12):
        eye, target = np.array([6 + 0.013 * k, 3, 8 + 0.007 * k]), np.array([0.02 * k, 0, 0])
        view = view_of(tuple(eye), tuple(target))
        maps, _ = shadow_fit.rows(BOXES, (SUN,), view, fit(resolution=512), 2)
        at, _ = on_map(maps[0], np.zeros((1, 3)), view)
        sizes.append(maps[0]["texel"])
        phase.append(at[0])
    assert np.ptp(sizes, axis=0).max() == 0
    moved = np.array(phase) - phase[0]
    assert np.abs(moved).max() > 1 and np.abs(moved - np.round(moved)).max() < 0.01, moved
    loose = shadow_fit.rows(BOXES, (SUN,), view, fit(resolution=512, snap=False), 2)[0]
    assert np.abs(loose[0]["first_texel"] - maps[0]["first_texel"]).max() > 0.01


def test_a_small_scene_needs_no_slices() -> None:
    maps, _ = shadow_fit.rows(BOXES[1:2], (SUN,), view_of((60, 30, 80)), fit(), 2)
    assert len(maps) == 1


def test_a_wide_ground_takes_no_texels_where_nothing_stands_on_it() -> None:
    ground = np.array([[[-2000, 0, -2000], [2000, 0, 2000]]], np.float64)
    chosen, view = fit(cascades=1), view_of((6, 3, 8))
    texel = {
        name: shadow_fit.rows(boxes, (SUN,), view, chosen, 1)[0][0]["texel"].max()
        for name, boxes in (
            ("box", BOXES[1:2]), ("ground", np.concatenate([BOXES[1:2], ground])),
            ("sheets", np.concatenate([ground, [[[-3, 4, -3], [-1, 4, -1]]]])), ("alone", ground),
        )
    }  # fmt: skip
    assert texel["ground"] == texel["box"] and texel["sheets"] < texel["box"] and texel["alone"] > 1


@pytest.mark.parametrize("cone", [0.3, 1.2])
def test_maps_of_spot_lights_cover_their_cone(cone: float) -> None:
    spot = Light("spot", position=(1, 5, 2), direction=(0.6, -0.8, 0.0), outer_cone=cone)
    view = view_of((6, 3, 8))
    maps, lights = shadow_fit.rows(BOXES, (spot,), view, fit(resolution=256), 3)
    assert len(maps) == (6 if cone > 1 else 1) and lights[0]["cube"] == (cone > 1)
    rng = np.random.default_rng(1)
    axis = np.array(spot.direction)
    ray = rng.normal(size=(500, 3))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    ray = ray[ray @ axis > np.cos(cone)]
    if cone > 1:
        face = 2 * np.abs(ray).argmax(1)
        face += np.take_along_axis(ray, np.abs(ray).argmax(1)[:, None], 1)[:, 0] < 0
    else:
        face = np.zeros(len(ray), int)
    for direction, k in zip(ray, face, strict=True):
        at, depth = on_map(maps[k], (np.array(spot.position) + 3 * direction)[None], view)
        assert depth[0] > 0 and (at >= 2).all() and (at <= 254).all()


def test_metrics() -> None:
    want = np.zeros((8, 8))
    want[:, 4:] = 1
    got = want.copy()
    got[0, 0], got[3, 4] = 1.0, 0.2
    counted = np.ones((8, 8), bool)
    wrong = metrics.wrong_shadow_percent(got, want, counted)
    assert (wrong.all, wrong.outside, wrong.inside) == pytest.approx((100 * 2 / 64, 100 / 48, 100 / 16))
    assert (wrong.false_light, wrong.false_shadow) == (100 / 64, 100 / 64)
    assert metrics.visibility_mae(got, want, counted) == pytest.approx(1.8 / 64)
    assert metrics.flip_rate([want, got, got], counted) == 100 * 2 / 64 / 2
    assert metrics.edge_band(want, 1).sum() == 16 and metrics.edge_band(want, 2).sum() == 32
    u = np.linspace(-2, 2, 4001)
    v = metrics.disc_visibility(u)
    assert v[0] == 0 and v[-1] == 1 and v[2000] == pytest.approx(0.5)
    assert metrics.penumbra_width(u, np.clip(u / 2 + 0.5, 0, 1)) == pytest.approx(1.6)
    assert np.isnan(metrics.penumbra_width(u, np.zeros_like(u)))
    assert metrics.wrong_shadow_percent(got, want, np.zeros((8, 8), bool)).all == 0


def test_an_atlas_that_no_texture_holds_is_refused() -> None:
    assert shadow_fit.columns(4, 1024, 16384, "k") == 2
    assert shadow_fit.columns(256, 1024, 16384, "k") == 16
    with pytest.raises(SettingError, match=r"k = 8192: .*need 6 maps.*holds 4 of that size"):
        shadow_fit.columns(6, 8192, 16384, "k")
