"""Every row of the AOV table holds for a rendered frame: shape, type, the value of a miss, what the numbers mean."""

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

import glhybrid as gh
from glhybrid.image import AOVS
from glhybrid.scene import Camera

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (96, 54)
EYE, TARGET = (0.2, 1.1, 4.5), (0.0, 0.9, 0.0)


@pytest.fixture(scope="module")
def frame(_shared_context: "Context") -> gh.Frame:
    from glhybrid.renderer import Renderer

    _shared_context.make_current()
    scene = gh.load("cornell")
    camera = Camera.look_at(EYE, TARGET)
    with Renderer(context=_shared_context) as renderer:
        result = renderer.render(scene, camera=camera, size=SIZE, settings=gh.Settings(aa=1), aovs=tuple(AOVS))
    result.receipt["scene"]["materials_total"] = len(scene.materials)
    return result


def _hit(frame: gh.Frame) -> np.ndarray:
    hit = np.isfinite(frame["depth"])
    assert 0.2 < hit.mean() < 0.98  # the scene shows both surfaces and what is behind them
    return hit


@pytest.mark.parametrize("name", [n for n in AOVS if n != "visibility"])
def test_shape_type_and_miss(frame: gh.Frame, name: str) -> None:
    aov, array = AOVS[name], frame[name]
    assert array.shape == aov.shape(SIZE[1], SIZE[0]) and array.dtype == aov.dtype
    assert array.flags.c_contiguous
    missed = array[~_hit(frame)]
    if aov.miss is not None:
        assert (missed == aov.miss).all(), np.unique(missed)[:5]
    if name not in ("depth", "distance", "reflection_hit"):
        assert np.isfinite(array).all()


def test_visibility_has_one_plane_per_light(frame: gh.Frame) -> None:
    visibility = frame["visibility"]
    assert visibility.shape == (SIZE[1], SIZE[0], frame.receipt["scene"]["lights"]) and visibility.dtype == np.float32
    assert (visibility[~_hit(frame)] == 0).all()
    assert set(np.unique(visibility)) <= {0.0, 1.0}  # hard shadows, opaque surfaces
    assert 0.02 < visibility.mean() < 0.98


def test_geometry_is_what_the_camera_saw(frame: gh.Frame) -> None:
    hit = _hit(frame)
    eye, forward = np.array(EYE), np.subtract(TARGET, EYE)
    forward = forward / np.linalg.norm(forward)
    to_surface = frame["position"].astype(np.float64) - eye
    np.testing.assert_allclose(np.linalg.norm(to_surface, axis=-1)[hit], frame["distance"][hit], rtol=1e-5)
    np.testing.assert_allclose((to_surface @ forward)[hit], frame["depth"][hit], rtol=1e-5)
    # Row 0 is the top and column 0 the left: rays through pixel centres of a 45 degree camera.
    right = np.cross(forward, (0, 1, 0))
    right /= np.linalg.norm(right)
    half = np.tan(np.pi / 8)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    px = (2 * x / SIZE[0] - 1) * half * SIZE[0] / SIZE[1]
    py = (1 - 2 * y / SIZE[1]) * half
    ray = forward + px[..., None] * right + py[..., None] * np.cross(right, forward)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    off = np.linalg.norm(to_surface - ray * frame["distance"][..., None], axis=-1)[hit]
    pixel = 2 * half / SIZE[1] * frame["depth"][hit]  # its width on the surface, metres
    assert (off < pixel / 128).all()  # at an edge the rasteriser's 8-bit grid takes in points that the ray just misses
    assert (off < 2e-5).mean() > 0.99  # elsewhere float32
    for name in ("normal", "normal_geometric"):
        normal = frame[name][hit]
        np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, atol=1e-3)
        assert ((normal * ray[hit]).sum(-1) <= 1e-3).all()  # towards the viewer


@pytest.mark.parametrize("kind", ["perspective", "tall", "orthographic", "narrow"])
def test_the_receipt_says_how_points_become_pixels(context: "Context", kind: str) -> None:
    """By what it tells alone, as a data set's reader has it: OpenCV's K, or half extents."""
    shot = Camera.look_at(EYE, TARGET)
    size = (40, 90) if kind in ("tall", "narrow") else SIZE
    shot = replace(shot, fov_short=kind == "tall")
    if kind in ("orthographic", "narrow"):
        shot = replace(shot, fov_y=0.0, ymag=1.3, xmag=0.7 if kind == "narrow" else 0.0)
    with gh.Renderer(context=context) as renderer:
        scene, settings, aovs = gh.load("cornell"), gh.Settings(aa=1), ("position", "depth")
        single = renderer.render(scene, shot, size, settings, aovs)
        (streamed,) = renderer.frames(scene, [gh.Shot(camera=shot)], size, settings, aovs)
    for frame in (single, streamed):
        told = json.loads(json.dumps(frame.receipt["camera"]))
        hit = np.isfinite(frame["depth"])
        point = np.concatenate([frame["position"][hit], np.ones((hit.sum(), 1))], 1)
        x, y, z = (point @ np.linalg.inv(told["world_from_view"]).T)[:, :3].T * np.array([[1], [-1], [-1]])  # OpenCV's
        np.testing.assert_allclose(z, frame["depth"][hit], rtol=1e-5)
        if told["projection"] == "perspective":
            u, v, w = np.array(told["intrinsics"]) @ (x, y, z)
            u, v = u / w, v / w
        else:
            u, v = ((1 + a / b) * n / 2 for a, b, n in zip((x, y), told["half_extents"], size, strict=True))
        rows, columns = np.nonzero(hit)
        np.testing.assert_allclose(u, columns + 0.5, atol=0.01)
        np.testing.assert_allclose(v, rows + 0.5, atol=0.01)


def test_surfaces_are_in_range(frame: gh.Frame) -> None:
    hit, scene = _hit(frame), frame.receipt["scene"]
    for name in ("albedo", "roughness", "metallic"):
        assert frame[name].min() >= 0 and frame[name].max() <= 1
    assert frame["instance_id"][hit].max() < scene["instances"]
    assert frame["material_id"][hit].max() < scene["materials_total"]
    assert (frame["triangle_id"][hit] != AOVS["triangle_id"].miss).all()
    assert (frame["motion"] == 0).all()  # nothing moved
    assert (frame["bvh_steps"][frame["visibility"].any(-1)] > 0).all()  # light was found to arrive by tracing
    assert (frame["radiance"] >= 0).all()
