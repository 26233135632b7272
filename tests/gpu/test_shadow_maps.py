"""Depth-map shadows against the traced ones: they fail where theory says, by as much, and hold where they should.

Scenes of shadow_scenes.py. Figures in EXPECTED are of llvmpipe; the bounds leave room for other rasterisers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, piece, say, scene_of
from shadow_scenes import FACING, WHITE, exact_visibility, facing, half_plane, posts, room

import glhybrid as gh
from glhybrid import shadow_cull
from glhybrid.errors import SettingError
from glhybrid.image import Frame
from glhybrid.layout import CONSTANTS
from glhybrid.load.shapes import box
from glhybrid.passes import shadow_map
from glhybrid.passes.shadow_map import ShadowMap
from glhybrid.scene import (
    F64,
    Animation,
    Camera,
    Channel,
    Image,
    Instance,
    Light,
    Material,
    Node,
    Scene,
    Sphere,
    Texture,
)
from glhybrid.study import metrics
from glhybrid.view import make_view

if TYPE_CHECKING:
    from glhybrid.context import Context

MAPPED = ("map", "pcf", "pcss", "csm")
NO_BIAS: dict[str, Any] = {"bias": 0.0, "slope_bias": 0.0, "normal_bias": 0.0}
S1 = (640, 480)


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
def renderer(_shared_context: "Context") -> Iterator[gh.Renderer]:
    _shared_context.make_current()
    with gh.Renderer(context=_shared_context) as made:
        yield made


def settings(technique: str, parameters: dict[str, Any] | None = None, reflections: str = "none") -> gh.Settings:
    dotted = {f"shadows.{technique}.{key}": value for key, value in (parameters or {}).items()}
    return gh.Settings(aa=1, exposure=0.0, shadows=technique, reflections=reflections, parameters=dotted)


def seen(renderer: gh.Renderer, scene: Scene, camera: Camera, size: Any, technique: str, **parameters: Any) -> Frame:
    return renderer.render(scene, camera, size, settings(technique, parameters), ("visibility", *FACING))


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
        staged = renderer.stage(scene, settings("csm", {"resolution": 1024, "snap": snap}), S1)
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


def cut_out() -> Material:
    """A chequer of 8 x 8 holes."""
    texels = np.full((8, 8, 4), 255, np.uint8)
    texels[(np.indices((8, 8)).sum(0) % 2).astype(bool), 3] = 0
    return Material(
        alpha_mode="MASK",
        double_sided=True,
        textures={"base_color": Texture(Image(texels), nearest=True, mipmap=False)},
    )


def stage(light: Light) -> tuple[Scene, Camera]:
    """A cut-out panel, a sphere, a box and a single-sided panel on a floor."""
    quad, index = np.array([[-1, 0, 0], [1, 0, 0], [1, 1.6, 0], [-1, 1.6, 0]]), [[0, 1, 2], [0, 2, 3]]
    uv = [[0, 1], [1, 1], [1, 0], [0, 0]]
    parts = (
        box(size=(9, 0.2, 9)), piece(quad, index, uv=uv), Sphere(0.5), box(size=(0.3, 1.2, 0.3)), piece(quad, index),
    )  # fmt: skip
    at = ((0, -0.1, 0), (-0.6, 0.05, -0.5), (1.5, 0.5, 1), (-1.8, 0.6, 1.2), (2, 0, -1.2))
    scene = scene_of(*parts, poses=[moved(p) for p in at], materials=(WHITE, cut_out(), Material()))
    instances = tuple(
        Instance(i.mesh, i.world_from_object, materials=(slot,))
        for i, slot in zip(scene.instances, (0, 1, 0, 0, 2), strict=True)
    )
    scene = scene.replace(instances=instances, lights=(light,))
    return scene, Camera.look_at((3.5, 4, 5), (0, 0.3, 0), fov_y=0.75)


LAMPS = {
    "sun": Light("directional", direction=(-0.5, -0.7, 0.51)),
    "spot": Light("spot", intensity=40, position=(2.5, 3.5, -2.5), direction=(-0.5, -0.7, 0.51), outer_cone=0.55),
    "wide spot": Light("spot", intensity=20, position=(0.4, 2.5, -1.6), direction=(0, -1, 0), outer_cone=1.2),
    "point": Light("point", intensity=15, position=(0.4, 2.1, 0.8)),
}


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


def test_only_what_is_asked_for_is_compiled_and_allocated(context: "Context") -> None:
    scene, camera, _ = posts()
    with gh.Renderer(context=context) as renderer:
        frame = renderer.render(scene, camera, (64, 48), settings("ray"))
        programs = frame.receipt["plan"]["programs"]
        assert not any("shadow_map" in name or "MAPS" in name or "MAP_FILTER" in name for name in programs), programs
        assert not any(
            "shadow_atlas" in program.resources or "ShadowMaps" in program.resources
            for program in renderer.shaders._programs.values()
        )
        plain = frame.receipt["plan"]["image_bytes"]
    with gh.Renderer(context=context) as renderer:
        frame = renderer.render(scene, camera, (64, 48), settings("map", {"resolution": 256}))
        plan = frame.receipt["plan"]
        assert plan["passes"] == ["gbuffer", "shadow_map", "composite", "display"]
        assert {p["name"] for p in frame.receipt["passes"]} >= {"shadow_map"}
        assert not any(name.split()[0] == "shadow" for name in plan["programs"]), plan["programs"]
        assert plan["image_bytes"] - plain == 4 * 256**2
        dark = scene.replace(lights=())
        frame = renderer.render(dark, camera, (64, 48), settings("map"))
        assert "shadow_map" not in frame.receipt["plan"]["passes"]
        assert frame.receipt["plan"]["image_bytes"] == plain - 64 * 48  # no atlas, no visibility
        empty = renderer.render(scene.replace(instances=()), camera, (64, 48), settings("pcss"), ("visibility",))
        assert empty["visibility"].shape == (48, 64, 1)


def test_maps_are_drawn_once_cascades_every_frame(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    """Only what follows the camera is drawn for it: not the sun's map of the whole scene, nor a lamp's."""
    from glhybrid.passes.shadow_map import ShadowMap

    drawn: list[int] = []
    make = ShadowMap._make_batches

    class Counted:
        def __init__(self, program: Any) -> None:
            self._program = program

        def bind(self, resources: dict[str, Any]) -> None:
            drawn.append(resources["map_index"])
            self._program.bind(resources)

    def counted(self: ShadowMap, *given: Any) -> Any:
        (program, *first), *others = make(self, *given)  # triangles, spheres
        return [(Counted(program), *first), *others]

    monkeypatch.setattr(ShadowMap, "_make_batches", counted)
    scene, camera, _ = posts()
    lamp = Light("point", position=(0.0, 3.0, 0.0), intensity=20.0)
    both = scene.replace(lights=(*scene.lights, lamp))
    elsewhere = Camera.look_at((9.01, 7.01, 13.01), (0, 0.3, 0), fov_y=0.75)  # of the same grid point
    with gh.Renderer(context=context) as renderer:
        for technique, first, again in (("map", 7, 0), ("csm", 10, 3)):
            chosen = settings(technique, {"resolution": 256}).replace(aa=3)
            for expected, seen_by in ((first + 2 * again, camera), (3 * again, camera), (3 * again, elsewhere)):
                drawn.clear()
                renderer.render(both, seen_by, (64, 48), chosen)
                assert len(drawn) == expected, (technique, drawn)


@pytest.mark.parametrize("technique", ["map", "csm"])
def test_maps_follow_what_moves(renderer: gh.Renderer, context: "Context", technique: str) -> None:
    """A box and a lamp that a clip moves: at any time the shadow is that of the rays, forwards and back."""
    parts = (box(size=(9, 0.2, 9)), box(size=(0.6, 1.2, 0.6)))
    scene = scene_of(*parts, poses=[moved((0, -0.1, 0)), moved((-2, 0.6, 0))], materials=(WHITE,))
    still, mover = scene.instances
    lamp = Light("spot", intensity=40, position=(2, 4, -2), direction=(0, -1, 0), outer_cone=1.0, node=1)
    down = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # glTF: a light looks along -Z of its node
    keys, box_at, lamp_at = (0, 1), ((-2, 0.6, 0), (2, 0.6, 1)), ((2, 4, -2), (0, 3, 1))
    paths = (np.array(at, np.float32) for at in (box_at, lamp_at))
    clip = Animation(
        "go",
        tuple(Channel(k, "translation", "LINEAR", np.array(keys, np.float32), at) for k, at in enumerate(paths)),
    )
    scene = scene.replace(
        instances=(still, Instance(mover.mesh, mover.world_from_object, node=0)), lights=(lamp,), animations=(clip,),
        nodes=(Node("box", -1, translation=(-2, 0.6, 0)), Node("lamp", -1, translation=(2, 4, -2), rotation=down)),
    )  # fmt: skip
    camera = Camera.look_at((3.5, 4, 5), (0, 0.3, 0), fov_y=0.8)
    times, names = (0.0, 0.6, 1.0, 0.3), ("visibility", "distance")
    shadows = {
        name: [renderer.render(scene, camera, (320, 240), settings(name).replace(time=t), names) for t in times]
        for name in ("ray", technique)
    }
    first = shadows["ray"][0]["visibility"][..., 0]
    for t, want, got in zip(times, shadows["ray"], shadows[technique], strict=True):
        counted = np.isfinite(want["distance"])
        wrong = metrics.wrong_shadow_percent(got["visibility"][..., 0], want["visibility"][..., 0], counted)
        say(f"{technique} at {t} s: {wrong}")
        assert wrong.all < 0.4 and wrong.outside < 0.05, (t, wrong)
        assert t == 0 or (want["visibility"][..., 0] != first).mean() > 0.01  # something moved


def test_many_lights_share_the_atlas(renderer: gh.Renderer, context: "Context") -> None:
    """Each layer is its own light's: 12 lights, three kinds, as each alone."""
    scene, camera = stage(LAMPS["point"])
    lamps = [
        Light("point", intensity=15, position=(np.cos(k), 2.5, np.sin(k))) if k % 3 else
        Light("spot", intensity=15, position=(np.cos(k), 3.0, np.sin(k)), direction=(0.0, -1.0, 0.0), outer_cone=0.9)
        for k in range(12)
    ]  # fmt: skip
    many = seen(renderer, scene.replace(lights=tuple(lamps)), camera, (160, 120), "map", resolution=256)
    for k in (0, 4, 11):
        alone = seen(renderer, scene.replace(lights=(lamps[k],)), camera, (160, 120), "map", resolution=256)
        assert (alone["visibility"][..., 0] == many["visibility"][..., k]).all(), k


def test_what_does_not_fit_is_refused(renderer: gh.Renderer, context: "Context") -> None:
    scene, camera = stage(LAMPS["point"])
    with pytest.raises(SettingError, match=r"shadows\.map\.resolution = 16384: .*lower the resolution"):
        seen(renderer, scene, camera, (64, 48), "map", resolution=16384)
    with pytest.raises(SettingError, match=r"shadows\.pcss\.resolution = 64: .*raise the resolution"):
        seen(renderer, scene, camera, (64, 48), "pcss", resolution=64)
    with pytest.raises(SettingError, match="from 64 to 16384"):
        settings("map", {"resolution": 1})


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


@pytest.mark.parametrize(("technique", "told"), [("map", 0.95), ("pcf", 0.95), ("csm", 0.4)])
def test_a_coarse_border_is_said(renderer: gh.Renderer, context: "Context", technique: str, told: float) -> None:
    """Where texels are larger than pixels nearly all that is wrong has a reason, and little else; else nothing has.

    csm: half of its few wrong pixels lie where texels are as fine as pixels.
    """
    scene, camera, _ = posts()
    right = seen(renderer, scene, camera, S1, "ray")["visibility"][..., 0] > 0.5

    def reasons(resolution: int) -> tuple[Any, Any]:
        chosen = settings(technique, {"resolution": resolution})
        frame = renderer.render(scene, camera, S1, chosen, ("visibility", "reason_shadows"))
        return frame["reason_shadows"], (frame["visibility"][..., 0] > 0.5) != right

    code, wrong = reasons(512)
    coarse = code == CONSTANTS["REASON_COARSE"]
    assert ((code == 0) | coarse).all() and wrong.sum() > 200
    assert coarse[wrong].mean() > told and coarse.mean() < 0.12, (coarse[wrong].mean(), coarse.mean())
    assert not reasons(4096)[0].any()
    for other in ("none", "ray"):
        frame = renderer.render(scene, camera, (64, 48), settings(other), ("reason_shadows",))
        assert not frame["reason_shadows"].any()


def test_a_cut_search_is_said(renderer: gh.Renderer, context: "Context") -> None:
    """In the penumbra alone, and only where the light is wider than what is searched."""
    scene, camera = half_plane(4.0, 0.05)
    for search, cut in ((4.0, True), (64.0, False)):
        chosen = settings("pcss", {"search": search, "resolution": 512})
        frame = renderer.render(scene, camera, (64, 16), chosen, ("visibility", "reason_shadows"))
        penumbra = (frame["visibility"][..., 0] > 0) & (frame["visibility"][..., 0] < 1)
        assert penumbra.any()
        assert ((frame["reason_shadows"] == CONSTANTS["REASON_SEARCH"]) == (penumbra & cut)).all()


@pytest.mark.parametrize("levels", [1, 2])
def test_what_lies_beside_a_cascade_is_not_drawn(
    context: "Context", monkeypatch: pytest.MonkeyPatch, levels: int
) -> None:
    """And nobody sees a difference: not between fewer draws and all, near the middle of the posts and turned away."""
    scene, _, _ = posts()
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene = scene.replace(instances=(*scene.instances, Instance(1, moved(np.array((1.5, 0.6, 1.0))) @ mirrored)))
    chosen = settings("csm", {"resolution": 256}).replace(levels=levels)
    cameras = [Camera.look_at(eye, at, fov_y=0.5) for eye, at in (((1, 1, 4), (0, 0, 0)), ((1, 1, 4), (1, 0.5, 9)))]
    found = []
    for most in (0, shadow_map.MOST_CULLED):
        monkeypatch.setattr(shadow_map, "MOST_CULLED", most)
        with gh.Renderer(context=context) as renderer:
            for camera in cameras:
                found.append(renderer.render(scene, camera, (160, 120), chosen, ("visibility",))["visibility"])
            maps = renderer._staged.passes.shadow  # type: ignore[union-attr]
            assert isinstance(maps, ShadowMap)
            some = [count for _, count in maps._culled.values()]
            assert bool(some) == (most > 0 and levels == 2)
            assert not some or min(some) < 5
    for all_drawn, few_drawn in zip(found[:2], found[2:], strict=True):
        assert np.array_equal(all_drawn, few_drawn) and 0 < all_drawn.mean() < 1


def test_draws_without_some_instances() -> None:
    """Every pair that stays is drawn once by its command, and no other."""
    rng = np.random.default_rng(3)
    pairs = [(int(i), 0) for i in rng.permutation(40)]
    rows = [(3, 7, 0, 0, 20), (6, 1, 3, 0, 0), (9, 12, 9, 0, 5), (3, 0, 0, 0, 4)]
    commands = shadow_cull.Commands(rows, pairs)
    for share in (0.0, 0.3, 0.7, 1.0):
        out = rng.random(40) < share
        got = commands.without(out)
        drawn = [(c, i, pairs[b + k]) for c, n, i, _, b in got.tolist() for k in range(n)]
        want = [(c, i, pairs[b + k]) for c, n, i, _, b in rows for k in range(n) if not out[pairs[b + k][0]]]
        assert drawn == want and len(got) <= commands.most
