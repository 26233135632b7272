"""Which depth maps are allocated, when they are drawn and with what, and what is refused."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, say, scene_of
from shadow_scenes import LAMPS, WHITE, posts, seen, settings, stage

import glhybrid as gh
from glhybrid import shadow_cull
from glhybrid.errors import SettingError
from glhybrid.load.shapes import box
from glhybrid.passes import shadow_map
from glhybrid.passes.shadow_map import ShadowMap
from glhybrid.scene import (
    Animation,
    Camera,
    Channel,
    Instance,
    Light,
    Node,
)
from glhybrid.study import metrics

if TYPE_CHECKING:
    from glhybrid.context import Context


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
        frame = renderer.render(scene, camera, (64, 48), settings("map", resolution=256))
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
            chosen = settings(technique, resolution=256).replace(aa=3)
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
        settings("map", resolution=1)


@pytest.mark.parametrize("levels", [1, 2])
def test_what_lies_beside_a_cascade_is_not_drawn(
    context: "Context", monkeypatch: pytest.MonkeyPatch, levels: int
) -> None:
    """And nobody sees a difference: not between fewer draws and all, near the middle of the posts and turned away."""
    scene, _, _ = posts()
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene = scene.replace(instances=(*scene.instances, Instance(1, moved(np.array((1.5, 0.6, 1.0))) @ mirrored)))
    chosen = settings("csm", resolution=256).replace(levels=levels)
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
