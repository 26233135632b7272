"""Depth-map shadows against the traced ones: they fail where theory says, by as much, and hold where they should.

Scenes of shadow_scenes.py. Figures in EXPECTED are of llvmpipe; the bounds leave room for other rasterisers.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, say, scene_of
from shadow_scenes import LAMPS, S1, WHITE, exact_visibility, facing, half_plane, posts, room, seen, settings, stage

import glhybrid as gh
from glhybrid.load.shapes import box
from glhybrid.passes.shadow_map import ShadowMap
from glhybrid.scene import (
    F64,
    Camera,
    Instance,
    Light,
    Material,
    Scene,
)
from glhybrid.study import metrics
from glhybrid.view import make_view

if TYPE_CHECKING:
    from glhybrid.context import Context


MAPPED = ("map", "pcf", "pcss", "csm")
NO_BIAS: dict[str, Any] = {"bias": 0.0, "slope_bias": 0.0, "normal_bias": 0.0}


@dataclass(frozen=True)
class Expected:
    """Wrong shadow per cent of pixels that face the sun, on `posts` at an elevation, 640 x 480."""

    name: str
    technique: str
    parameters: dict[str, Any]
    low: float
    high: float
    reason: str
    elevation: float = 25.0
    outside: float = 100.0  # most of it further than a pixel from the true border


EXPECTED = (
    Expected("acne", "map", NO_BIAS | {"resolution": 1024}, 40, 52, "a texel of a slanted plane hides half of itself"),
    Expected("constant bias", "map", NO_BIAS | {"bias": 0.005, "resolution": 1024}, 25, 42,
             "5 mm against a texel of 39 mm times its slope: still acne"),
    Expected("slope bias", "map", {"resolution": 1024}, 0.05, 0.25, "what is left is the border", outside=0.02),
    Expected("512", "map", {"resolution": 512}, 0.15, 0.6, "borders twice as coarse as 1024", outside=0.1),
    Expected("2048", "map", {"resolution": 2048}, 0.02, 0.15, "half as coarse as 1024", outside=0.01),
    Expected("low sun, constant bias", "map", NO_BIAS | {"bias": 0.005, "resolution": 1024}, 25, 50,
             "the slope grows as 1 / tan of the elevation", elevation=8),
    Expected("low sun, slope bias", "map", {"resolution": 1024}, 0.1, 0.6, "longer borders", elevation=8),
    Expected("pcf", "pcf", {}, 0.02, 0.2, "a blurred border is one half where the sharp one was", outside=0.01),
    Expected("pcf without receiver plane", "pcf", NO_BIAS | {"receiver_plane": False}, 5, 60,
             "taps of a wide filter reach over the slope"),
    Expected("pcss", "pcss", {}, 0.02, 0.25, "a sun without size: its smallest filter", outside=0.02),
    Expected("csm 1024", "csm", {"resolution": 1024}, 0.005, 0.08, "texels a third of one map's, where the camera is",
             outside=0.005),
    Expected("csm", "csm", {}, 0.005, 0.06, "the best that maps do here", outside=0.005),
)  # fmt: skip


@pytest.fixture(scope="module")
def traced(renderer: gh.Renderer) -> dict[float, tuple[Any, Any]]:
    """By elevation: traced visibility, and the pixels that count."""
    found = {}
    for elevation in sorted({row.elevation for row in EXPECTED}):
        scene, camera, _ = posts(elevation)
        frame = seen(renderer, scene, camera, S1, "ray")
        found[elevation] = (frame["visibility"][..., 0], facing(frame, scene))
    return found


def test_traced_shadows_hold_against_the_closed_form(renderer: gh.Renderer, context: "Context") -> None:
    """What the maps are measured against. A pixel or two of a wall's top edge may show its far side, clamped."""
    for elevation in (25.0, 8.0):
        scene, camera, to_sun = posts(elevation)
        frame = seen(renderer, scene, camera, S1, "ray")
        counted = facing(frame, scene)
        points = frame["position"].astype(np.float64) + 1e-5 * frame["normal_geometric"]
        want = np.zeros(counted.shape)
        want[counted] = exact_visibility(scene, points[counted], to_sun)
        wrong = metrics.wrong_shadow_percent(frame["visibility"][..., 0], want, counted)
        say(f"ray at {elevation:g} deg: {wrong}")
        assert wrong.outside <= 0.003 and wrong.inside <= 0.05, wrong


@pytest.mark.parametrize("row", EXPECTED, ids=lambda row: row.name)
def test_wrong_shadow(renderer: gh.Renderer, context: "Context", traced: Any, row: Expected) -> None:
    scene, camera, _ = posts(row.elevation)
    want, counted = traced[row.elevation]
    got = seen(renderer, scene, camera, S1, row.technique, **row.parameters)["visibility"][..., 0]
    wrong = metrics.wrong_shadow_percent(got, want, counted)
    mae = metrics.visibility_mae(got, want, counted)
    say(f"{row.name}: {wrong.all:.3f} %, outside the border {wrong.outside:.4f} %, mae {mae:.4f}")
    assert row.low <= wrong.all <= row.high, (wrong, row.reason)
    assert wrong.outside <= row.outside, (wrong, row.reason)


def test_a_constant_bias_lets_light_in_at_the_foot(renderer: gh.Renderer, context: "Context") -> None:
    """Peter-panning: behind a wall of thickness d the floor is lit as far as bias * cos(elevation) - d reaches."""
    thickness, elevation = 0.02, np.radians(35)
    to_sun = np.array([np.cos(elevation), np.sin(elevation), 0])
    parts = (box(size=(8, 0.2, 8)), box(size=(thickness, 1.5, 6)))
    scene = scene_of(*parts, poses=[moved((0, -0.1, 0)), moved((0, 0.75, 0))], materials=(WHITE,))
    scene = scene.replace(lights=(Light("directional", direction=tuple(-to_sun)),))
    camera = Camera.look_at((-2.5, 2.5, 0), (-0.3, 0, 0), fov_y=0.5)
    for bias in (0.0, 0.1, 0.2, 0.4):
        frame = seen(renderer, scene, camera, (320, 240), "map", bias=bias)
        floor = (np.abs(frame["position"][..., 1]) < 1e-3) & (frame["position"][..., 0] > -1.0)
        lit = floor & (frame["visibility"][..., 0] > 0.5)
        gap = float(-frame["position"][..., 0][lit].min()) - thickness / 2 if lit.any() else 0.0
        expected = max(bias * np.cos(elevation) - thickness, 0)
        say(f"bias {bias:g}: gap {gap:.3f} m, theory {expected:.3f}")
        assert abs(gap - expected) < 0.015, (bias, gap, expected)  # two texels of 5 mm and their slope
    frame = seen(renderer, scene, camera, (320, 240), "ray")
    floor = (np.abs(frame["position"][..., 1]) < 1e-3) & (frame["position"][..., 0] > -1.0)
    assert floor.sum() > 1000 and not frame["visibility"][..., 0][floor].any()


def test_a_sealed_room_leaks_only_through_a_bias_wider_than_its_walls(
    renderer: gh.Renderer, context: "Context"
) -> None:
    scene, camera, _ = room()
    lit = {}
    for technique in ("ray", *MAPPED):
        frame = seen(renderer, scene, camera, (320, 240), technique)
        counted = facing(frame, scene)
        lit[technique] = 100 * float((frame["visibility"][..., 0] > 0.5)[counted].mean())
    frame = seen(renderer, scene, camera, (320, 240), "map", bias=0.1)
    leak = 100 * float((frame["visibility"][..., 0] > 0.5)[facing(frame, scene)].mean())
    say(f"lit in a sealed room: {lit}; map with a bias of 0.1 m {leak:.2f} %")
    assert counted.sum() > 20_000 and lit["ray"] == 0
    assert max(lit.values()) < 0.05, lit
    assert leak > 0.5, leak


def test_penumbrae_widen_with_height_only_for_pcss(renderer: gh.Renderer, context: "Context") -> None:
    """Of a straight edge under a sun of half angle 2 deg: V(u) of a disc. A fixed filter is right at one height."""
    half_angle = np.radians(2.0)
    unit = np.linspace(-1, 1, 20001)
    ideal = metrics.penumbra_width(unit, metrics.disc_visibility(unit))
    ratio: dict[str, list[float]] = {"pcf": [], "pcss": []}
    for height in (0.5, 2.0, 8.0):
        scene, camera = half_plane(height, half_angle)
        scale = height * np.tan(half_angle)
        for technique, ratios in ratio.items():
            frame = seen(renderer, scene, camera, (320, 20), technique)
            x, v = frame["position"][..., 0], frame["visibility"][..., 0]
            ratios.append(metrics.penumbra_width(x.mean(0), v.mean(0)) / (ideal * scale))
            mae = float(np.abs(v - metrics.disc_visibility(x / scale)).mean())
            say(f"{technique} at {height:g} m: width {ratios[-1]:.3f} of the true one, mae {mae:.4f}")
            assert technique == "pcf" or mae < 0.01, mae
    assert all(abs(r - 1) < 0.05 for r in ratio["pcss"]), ratio
    assert ratio["pcf"][0] / ratio["pcf"][2] == pytest.approx(16, rel=0.1), ratio


def test_texel_snapping_stops_the_shimmer(renderer: gh.Renderer, context: "Context") -> None:
    """The same world points while the maps follow a camera: one that turns by a pixel a frame, and one that moves.

    Left with snapping: points that pass from one cascade to the next.
    """
    scene, camera, _ = posts()
    rate: dict[bool, float] = {}
    for snap in (True, False):
        frame = seen(renderer, scene, camera, S1, "csm", resolution=1024, snap=snap)
        counted = facing(frame, scene)
        staged = renderer.stage(scene, settings("csm", resolution=1024, snap=snap), S1)
        ids = staged.targets.get("gbuffer_id")
        maps = staged.passes.shadow
        assert isinstance(maps, ShadowMap)
        seen_frames = []
        for k in range(16):
            angle = min(k, 8) * camera.fov_y / S1[1]
            turn = np.eye(4)
            turn[0, 0] = turn[2, 2] = np.cos(angle)
            turn[0, 2], turn[2, 0] = np.sin(angle), -np.sin(angle)
            pose = camera.world_from_view @ turn
            pose[:3, 3] += max(k - 8, 0) * 0.013 * camera.world_from_view[:3, 0]
            view = make_view(Camera("moved", pose, fov_y=camera.fov_y), S1, scene)
            maps.look(view)
            image = maps.run(staged.targets, ids, staged.constants.choose_lights)
            seen_frames.append(np.frombuffer(image.read(), np.uint8).reshape(S1[1], S1[0])[::-1] / 255)
        rate[snap] = metrics.flip_rate(seen_frames, counted)
    say(f"flips a frame: snapped {rate[True]:.5f} %, not snapped {rate[False]:.4f} %")
    assert rate[True] < 2e-4 and rate[False] > 0.02, rate


@pytest.mark.parametrize("lamp", LAMPS)
def test_every_kind_of_light_and_caster(renderer: gh.Renderer, context: "Context", lamp: str) -> None:
    """Cut-outs, spheres, both sides of single-sided panels: as the rays have it, but for borders."""
    light = LAMPS[lamp]
    direction = np.array(light.direction) / np.linalg.norm(light.direction)
    scene, camera = stage(
        Light(
            light.kind, intensity=light.intensity, position=light.position, direction=tuple(direction),
            outer_cone=light.outer_cone, inner_cone=0.5 * light.outer_cone,
        )
    )  # fmt: skip
    want = seen(renderer, scene, camera, (320, 240), "ray")
    counted = facing(want, scene)
    shadowed = float((want["visibility"][..., 0] == 0)[counted].mean())
    assert counted.sum() > 20_000 and 0.05 < shadowed < 0.9
    for technique in MAPPED:
        got = seen(renderer, scene, camera, (320, 240), technique)
        wrong = metrics.wrong_shadow_percent(got["visibility"][..., 0], want["visibility"][..., 0], counted)
        say(f"{lamp}, {technique}: {wrong}")
        assert wrong.outside < 0.02 and wrong.all < 0.4, (technique, wrong)


def test_hits_of_reflection_rays_look_into_the_same_maps(renderer: gh.Renderer, context: "Context") -> None:
    scene, camera = stage(LAMPS["sun"])
    direction = np.array(scene.lights[0].direction)
    scene = scene.replace(lights=(Light("directional", direction=tuple(direction / np.linalg.norm(direction))),))
    mirror = Material(metallic=1, roughness=0.0, double_sided=True)
    scene = scene.replace(materials=(*scene.materials[:2], mirror))
    frames = {
        name: renderer.render(scene, camera, (320, 240), settings(name, reflections="ray-lerp"), ("reflection",))
        for name in ("none", "ray", *MAPPED)
    }
    want = frames["ray"]["reflection"]
    assert (np.abs(frames["none"]["reflection"] - want) > 1e-3).any(-1).mean() > 0.002  # the mirror shows shadows
    for name in MAPPED:
        off = float((np.abs(frames[name]["reflection"] - want) > 0.5 * want.max()).any(-1).mean())
        say(f"reflected shadows of {name}: {100 * off:.3f} % of pixels differ")
        assert off < 0.001, name


def far_away(offset: F64, size: float) -> tuple[Scene, Camera]:
    scene, camera, _ = posts()
    instances = tuple(
        Instance(i.mesh, moved(offset + size * i.world_from_object[:3, 3], size * np.eye(3))) for i in scene.instances
    )
    pose = camera.world_from_view.copy()
    pose[:3, 3] = offset + size * pose[:3, 3]
    return scene.replace(instances=instances), Camera("far", pose, fov_y=camera.fov_y, near=0.01 * size)


@pytest.mark.parametrize("technique", ["map", "csm"])
def test_maps_hold_at_any_place_and_scale(renderer: gh.Renderer, context: "Context", technique: str) -> None:
    """Their error is in texels: it changes with neither, if nothing is in metres that should not be."""
    home = seen(renderer, *far_away(np.zeros(3), 1.0), (320, 240), technique)["visibility"][..., 0]
    for place, size in ((1e5, 1.0), (0.0, 1e-3), (0.0, 1e3)):
        away = seen(renderer, *far_away(place * np.array([1, -0.3, 0.7]), size), (320, 240), technique)
        change = float((np.abs(away["visibility"][..., 0] - home) > 0.5).mean())
        say(f"{technique} at {place:g} m, scale {size:g}: {100 * change:.4f} % of pixels change")
        assert change < 2e-3, (place, size, change)
