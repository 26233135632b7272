"""Reflections marched in the G-buffer: right where the picture has the answer, wrong where it has not, and it says so.

The oracle is a room of boxes over a mirror, intersected in float64. Every colour there is a place, so a reflection tells
which point it shows: its error is an angle at the mirrored eye, and a distance in metres.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import mirror_room
import numpy as np
import pytest
from scene_kit import Camera, box, constant_sky, floor, metal, plastic, quad, scene, sun, texture

import glhybrid as gh
from glhybrid.layout import CONSTANTS
from glhybrid.passes.screen_depth import level_sizes
from glhybrid.scene import Material, Scene, Sphere

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (200, 150)
AOVS = ("reflection", "reflection_hit", "reason", "instance_id")
NONE, OFF, HIDDEN, BACK, FACING, STEPS, GUESS, SKY = (
    CONSTANTS[f"REASON_{n}"]
    for n in ("NONE", "OFF_SCREEN", "HIDDEN", "BACK_FACE", "FACING", "STEPS", "THICKNESS", "ENVIRONMENT")
)
OTHER = ("primary", "levels", "aa", "shadows")  # settings that are not the technique's
HALF_FLOAT = 0.02  # m: colours of vertices are half floats, 16 m over 2^11 steps, and a pixel of a wall is as wide


@pytest.fixture(scope="module")
def renderer(_shared_context: "Context") -> Iterator[gh.Renderer]:
    with gh.Renderer(context=_shared_context) as made:
        yield made


def shot(
    renderer: gh.Renderer, made: Scene, technique: str, size: tuple[int, int] = SIZE, **parameters: Any
) -> gh.Frame:
    own = {f"reflections.{technique}.{k}": v for k, v in parameters.items() if k not in OTHER}
    rest = {k: v for k, v in parameters.items() if k in OTHER}
    settings = gh.Settings(reflections=technique, exposure=0.0, parameters=own, **{"aa": 1} | rest)
    return renderer.render(made, size=size, settings=settings, aovs=AOVS)


def right(frame: gh.Frame, true: mirror_room.Truth) -> np.ndarray:
    """Pixels whose reflection shows the true point: within half a pixel, and near it."""
    got = mirror_room.places(frame["reflection"])
    near = np.linalg.norm(got - true.point, axis=-1) < 0.05
    return true.mirror & near & (mirror_room.error_px(got, true) < 0.5 + HALF_FLOAT / 4 / true.pixel / 4)


def percent(mask: np.ndarray, of: np.ndarray) -> float:
    return 100 * float(mask[of].mean())


def test_what_is_in_the_picture_is_found(context: "Context", renderer: gh.Renderer) -> None:
    """And what is not, is not: the shares are those of geometry, about a third here (accuracy of SSR at its best)."""
    true = mirror_room.truth(SIZE)
    frame = shot(renderer, mirror_room.room(), "ssr", fade=0.0)
    same = true.mirror & (frame["instance_id"] == mirror_room.FLOOR)
    assert percent(same, true.mirror) > 99.5  # outlines
    ok, shown, gone = right(frame, true), true.shown & same, true.mirror & ~true.shown & same
    assert percent(ok, shown) > 98.0  # a thin post hides some of it: 0.04 m against 0.1 m of thickness
    assert percent(ok, gone) < 1.0
    assert 10 < percent(gone, same) < 50
    exact = shown & (frame["reason"] == NONE)
    assert percent(exact, shown) > 97.0
    assert np.percentile(mirror_room.error_px(mirror_room.places(frame["reflection"]), true)[exact & ok], 99) < 0.5
    away = true.mirror & ~true.on_screen & same
    assert percent(np.isin(frame["reason"], (OFF, HIDDEN, BACK, GUESS)), away) > 99.0
    assert percent(frame["reason"] == OFF, away) > 80.0
    hidden = true.on_screen & ~true.shown & same
    assert hidden.any() and percent(np.isin(frame["reason"], (HIDDEN, BACK, GUESS, NONE)), hidden) > 90.0
    assert np.isinf(frame["reflection_hit"][same & np.isin(frame["reason"], (OFF, HIDDEN, BACK))]).all()


def test_with_rays_everything_is_found(context: "Context", renderer: gh.Renderer) -> None:
    true = mirror_room.truth(SIZE)
    frame = shot(renderer, mirror_room.room(), "ssr-ray")
    same = true.mirror & (frame["instance_id"] == mirror_room.FLOOR)
    assert percent(right(frame, true), same) > 99.8
    saved = frame["reason"] == NONE
    assert percent(saved, same) > 50  # those that needed no ray
    assert percent(right(frame, true), same & saved) > 99.8


def test_thickness_is_a_guess(context: "Context", renderer: gh.Renderer) -> None:
    """With more, more is guessed, more is found, and more of it is wrong."""
    true = mirror_room.truth(SIZE)
    wrong, found, guessed = [], [], []
    for thickness in (0.0, 0.05, 1e6):
        frame = shot(renderer, mirror_room.room(), "ssr", fade=0.0, thickness=thickness)
        hit = true.mirror & np.isfinite(frame["reflection_hit"]) & (frame["instance_id"] == mirror_room.FLOOR)
        found.append(int(hit.sum()))
        wrong.append(percent(~right(frame, true), hit))
        guessed.append(percent(frame["reason"] == GUESS, hit))
    assert found[0] < found[1] < found[2]
    assert guessed[0] < 1.5 < guessed[2]  # without any: planes crossed in the last pixel before an edge
    # Wrong without any: rays that went on behind the floating block, and truly meet its underside.
    assert wrong[0] < 4.0 and wrong[0] < wrong[1] < wrong[2] and wrong[2] > 6.0


def test_answers_pop_when_the_camera_turns(context: "Context", renderer: gh.Renderer) -> None:
    """The same points of the mirror, found in one picture and not in the next; with rays they never change."""
    flips = {"ssr": 0, "ssr-ray": 0}
    for technique in flips:
        held: list[np.ndarray] = []
        for step in range(3):
            tilt = 1.0 - 7.0 * np.tan(step * 2 * np.tan(np.radians(27.5)) / SIZE[1])
            camera = Camera.look_at((0, 2, 4.5), (0, float(tilt), -2), fov_y=np.radians(55))
            true = mirror_room.truth(SIZE, camera)
            frame = shot(renderer, mirror_room.room(camera), technique)
            # The answer for points of the mirror on a lattice of 5 cm: a share of right pixels in each cell.
            cell = np.floor(true.origin[..., (0, 2)] / 0.05).astype(int) + 200
            use = true.mirror & (cell >= 0).all(-1) & (cell < 400).all(-1) & (frame["instance_id"] == mirror_room.FLOOR)
            got = mirror_room.places(frame["reflection"])
            wrong = np.linalg.norm(got - true.point, axis=-1) > 0.15
            grid = np.zeros((400, 400))
            np.add.at(grid, tuple(cell[use].T), np.where(wrong[use], -1, 1))
            held.append(np.sign(grid))
        for a, b in pairwise(held):
            flips[technique] += int((a * b < 0).sum())
    assert flips["ssr"] > 10 and flips["ssr-ray"] <= 2, flips


def gallery() -> dict[str, tuple[Scene, dict[str, Any]]]:
    """Scenes and settings that a march may trip over."""
    camera = Camera.look_at((0, 2, 4.5), (0, 1.0, -2), fov_y=np.radians(55))
    world: dict[str, Any] = {"camera": camera, "lights": (sun(),), "environment": constant_sky(0.3)}
    ground = (floor(4.9, 0.01), metal())
    mirrored = np.diag([-1.0, 1, 1, 1])
    mirrored[:3, 3] = (-1.2, 0.8, -1)
    turned = scene(
        [
            ground, (Sphere(0.6), metal((0.9, 0.7, 0.5), 0.05), (1, 0.7, -1)),
            (box((-0.5,) * 3, (0.5, 0.5, 0.2)), plastic(roughness=0.3, double_sided=False), mirrored),
        ],
        **world,
    )  # fmt: skip
    holes = np.full((8, 8, 4), 255, np.uint8)
    holes[::2, 1::2, 3] = holes[1::2, ::2, 3] = 0
    card = quad([(-1, 0.1, -1), (1, 0.1, -1), (1, 2, -1), (-1, 2, -1)])
    cut = Material(
        "cut", alpha_mode="MASK", double_sided=True, textures={"base_color": texture(holes, nearest=True)}
    )  # fmt: skip
    glass = plastic(alpha=0.5, alpha_mode="BLEND")
    layered = scene(
        [ground, (box((-1, 0.3, -2), (0, 1.3, -1)), glass), (box((0.3, 0.3, -2), (1, 1.3, -1)), plastic())], **world
    )
    parallel = mirror_room.room(replace(camera, fov_y=0.0, ymag=2.0))
    return {
        "turned": (turned, {}),
        "two levels": (turned, {"levels": 2}),
        "traced": (turned, {"primary": "trace"}),
        "jittered": (turned, {"aa": 2}),
        "cut out": (scene([ground, (card, cut)], **world), {}),
        "blended": (layered, {}),
        "blended, depth maps": (layered, {"shadows": "pcf"}),
        "depth maps": (turned, {"shadows": "csm"}),
        "soft": (turned.replace(lights=(replace(turned.lights[0], angular_diameter=0.02),)), {"shadows": "ray-soft"}),
        "no shadows": (turned, {"shadows": "none"}),
        "orthographic": (parallel, {}),
        "lit room": (mirror_room.lit_room(), {}),
        "empty": (scene([], **world), {}),
    }


@pytest.mark.parametrize("name", list(gallery()))
def test_with_rays_it_is_the_ray_traced_picture(context: "Context", renderer: gh.Renderer, name: str) -> None:
    made, more = gallery()[name]
    size = (121, 87)  # cells of the pyramid overhang
    want, got = (shot(renderer, made, t, size, **more) for t in ("ray-lerp", "ssr-ray"))
    scale = want["radiance"].mean() + 1e-6
    differs = np.abs(got["radiance"] - want["radiance"]).max(-1) > 0.02 * scale
    # Edges of shadows in reflections are as sharp as the picture's pixels; corners within one may be stepped over.
    assert differs.mean() < 0.003, differs.mean()
    same = np.isclose(want["reflection_hit"], got["reflection_hit"], rtol=1e-4) | ~(want["reflection_hit"] > 0)
    assert same.mean() > 0.998


def test_without_rays_the_sky_stands_in(context: "Context", renderer: gh.Renderer) -> None:
    """Where the march fails, `ssr` is `env`."""
    made, _ = gallery()["turned"]
    sky, marched = shot(renderer, made, "env"), shot(renderer, made, "ssr")
    failed = np.isin(marched["reason"], (OFF, HIDDEN, BACK, FACING, STEPS, SKY))
    assert failed.mean() > 0.3 and np.allclose(sky["radiance"][failed], marched["radiance"][failed], rtol=1e-5)


def test_reasons(context: "Context", renderer: gh.Renderer) -> None:
    made = mirror_room.room()
    short = shot(renderer, made, "ssr", steps=2)
    floor_px = short["instance_id"] == mirror_room.FLOOR
    assert percent(short["reason"] == STEPS, floor_px) > 80
    assert (short["reason"][~floor_px] != STEPS).all()
    low = Camera.look_at((0, 1, 2), (0, 1, -2), fov_y=np.radians(55), near=3.0)
    wall = scene(
        [(quad([(-2, 0, -2), (2, 0, -2), (2, 2, -2), (-2, 2, -2)]), metal())], low, environment=constant_sky(0.4)
    )
    facing = shot(renderer, wall, "ssr")
    assert percent(facing["reason"] == FACING, facing["instance_id"] == 0) > 20
    assert percent(np.isin(facing["reason"], (FACING, OFF)), facing["instance_id"] == 0) > 99


def test_the_pyramid_holds_the_nearest(context: "Context", renderer: gh.Renderer) -> None:
    """Every level, also where cells overhang, against NumPy over the planes."""
    size = (37, 22)
    made, settings = mirror_room.room(), gh.Settings(reflections="ssr", aa=1, exposure=0.0)
    renderer.render(made, size=size, settings=settings)
    staged = renderer.stage(made, settings, size)
    plane = np.frombuffer(staged.targets.get("screen_plane").read(), np.float32).reshape(size[1], size[0], 4)
    half = 0.5 * np.abs(plane[..., 1:3]).sum(-1)
    near, far = plane[..., 0] + half, plane[..., 0] - half
    pyramid = staged.targets.get("screen_span")
    texels = np.frombuffer(pyramid.read(), np.float32).reshape(pyramid.height, pyramid.width, 2)
    row, padded = 0, 32
    for level, (width, height) in enumerate(level_sizes(size), start=1):
        got = texels[row : row + height, :width]
        for y in range(height):
            for x in range(width):
                cells = slice(y << level, (y + 1) << level), slice(x << level, (x + 1) << level)
                want = near[cells].max(), far[cells].min()  # which drivers may round another way
                assert np.allclose(got[y, x], want, rtol=1e-6, atol=1e-9), (level, x, y)
        row += padded >> level
    assert (width, height) == (1, 1)
    # The planes themselves: 1 / distance along the view axis, exact from pixel to pixel on a wall.
    depth = renderer.render(made, size=size, settings=settings, aovs=("depth",))["depth"][::-1]
    assert np.allclose(1 / plane[..., 0], depth, rtol=1e-5)
    ids = renderer.render(made, size=size, settings=settings, aovs=("normal_geometric",))["normal_geometric"][::-1]
    flat = (ids[:, 1:] == ids[:, :-1]).all(-1) & (np.abs(np.diff(plane[..., 0], axis=1)) < 0.01)
    step = plane[:, :-1, 0] + plane[:, :-1, 1]
    assert flat.mean() > 0.7 and np.percentile(np.abs(step - plane[:, 1:, 0])[flat], 90) < 1e-5


def test_only_what_marches_has_planes(context: "Context") -> None:
    made = mirror_room.room()
    matt = made.replace(materials=tuple(replace(m, roughness=1.0) for m in made.materials))
    with gh.Renderer(context=context) as fresh:
        plan = shot(fresh, matt, "ssr").receipt["plan"]
        assert "ssr" not in plan["passes"] and "screen_depth" not in plan["passes"]
        assert not any(p.startswith(("ssr", "screen")) for p in plan["programs"])
        plain = shot(fresh, made, "ray-lerp").receipt["plan"]
        assert not any(p.startswith(("ssr", "screen")) for p in plain["programs"])
        rays = shot(fresh, made, "ssr-ray").receipt["plan"]
        march = shot(fresh, made, "ssr").receipt["plan"]
        assert {"screen_depth", "ssr"} < set(march["passes"]) and "reflect" not in march["passes"]
        width, rows = (SIZE[0] + 1) // 2, 256
        planes, level = 16 * SIZE[0] * SIZE[1], 4 * width * rows
        parts = {p.split()[0] for p in plain["programs"]}
        handed_on = (24 * ("reflect_ray" in parts) + 4 * ("reflect_shadow" in parts)) * SIZE[0] * SIZE[1]
        plain_bytes = plain["image_bytes"] - handed_on  # of reflections in three programs
        assert rays["image_bytes"] - plain_bytes == planes + level
        assert march["image_bytes"] - plain_bytes == planes + 2 * level
