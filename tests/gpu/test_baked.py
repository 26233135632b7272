"""Light maps against traced shadows and closed forms: exact at their texels, closer with more of them, and wrong where
theory says: one row of texels beside a thin wall, and a step across a seam.

Scenes of shadow_scenes.py. Figures in comments are of llvmpipe.
"""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import shadow_scenes
from rays import moved, piece, say, scene_of
from shadow_scenes import FACING, WHITE, exact_visibility, facing, posts, room

import glhybrid as gh
from glhybrid import content_cache
from glhybrid.bake import Bake
from glhybrid.errors import SettingError
from glhybrid.image import Frame
from glhybrid.load.shapes import box, torus
from glhybrid.passes.baked import Baked
from glhybrid.scene import (
    F64,
    Animation,
    Camera,
    Channel,
    Environment,
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

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (320, 240)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Charts and bakes of its own for every test; compiled kernels and the like stay where they are."""
    monkeypatch.setattr(content_cache, "cache_dir", lambda: tmp_path)
    return tmp_path


@pytest.fixture
def renderer(context: "Context") -> Iterator[gh.Renderer]:
    with gh.Renderer(context=context) as made:
        yield made


def settings(shadows: str = "baked", **given: Any) -> gh.Settings:
    return shadow_scenes.settings(shadows, **given)


def seen(renderer: gh.Renderer, scene: Scene, camera: Camera, chosen: gh.Settings, size: Any = SIZE) -> Frame:
    return renderer.render(scene, camera, size, chosen, ("visibility", *FACING))


def wrong(renderer: gh.Renderer, scene: Scene, camera: Camera, chosen: gh.Settings) -> metrics.WrongShadow:
    """Against traced shadows."""
    want = seen(renderer, scene, camera, settings("ray", levels=chosen.levels))
    got = seen(renderer, scene, camera, chosen)
    return metrics.wrong_shadow_percent(got["visibility"][..., 0], want["visibility"][..., 0], facing(want, scene))


def baked(renderer: gh.Renderer, scene: Scene, chosen: gh.Settings) -> Baked:
    made = renderer.stage(scene, chosen, (16, 16)).passes.shadow
    assert isinstance(made, Baked)
    return made


def pages(made: Baked) -> np.ndarray:
    """(lights, texels) 0 to 1 of the first component."""
    texels = np.frombuffer(made.resources["lightmap"].read(alignment=1), np.uint8)
    count, height, width = made.layout.pages
    return texels.reshape(-1, count * height * width, made._components)[..., 0] / 255.0


def texel_points(made: Baked) -> tuple[F64, F64]:
    """World points (N, 3) and unit front normals of all texels of triangles, in float64."""
    geometry, map_ = made._scene.geometry, made.layout
    corner = geometry.vertices[geometry.triangles[map_.triangle, :3], :3].astype(np.float64)
    pose = geometry.world_from_object[map_.instance]
    corner = np.einsum("nab,nkb->nka", pose[:, :3, :3], corner) + pose[:, None, :3, 3]
    b = map_.bary.astype(np.float64)
    weight = np.stack([1 - b.sum(1), b[:, 0], b[:, 1]], 1)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)  # 0: a sphere's
    return (corner * weight[..., None]).sum(1), normal / np.where(length > 0, length, 1)


@pytest.mark.parametrize("levels", [1, 2])
def test_texels_hold_what_a_ray_from_their_point_finds(renderer: gh.Renderer, context: "Context", levels: int) -> None:
    """Against float64, past boxes and a sphere; for a sun and a lamp. What differs grazes an edge."""
    scene, _, to_sun = posts()
    lamp = Light("point", position=(1.5, 3.0, -1.0))
    scene = scene.replace(lights=(*scene.lights, lamp))
    made = baked(renderer, scene, settings(levels=levels, texels=8.0, push=False))
    points, normal = texel_points(made)
    flat = normal.any(1)
    got = pages(made)[:, made.layout.index]
    assert len(points) > 30_000 and set(np.unique(got)) == {0.0, 1.0}
    for light, (toward, away) in enumerate(((to_sun, np.inf), _to(lamp, points))):
        side = np.sign((normal * toward).sum(1, keepdims=True))
        want = exact_visibility(scene, points + 2e-5 * side * normal, toward, away)
        counted = flat & ((normal * toward).sum(1) > 1e-3)
        differ = (want != got[light])[counted]
        say(f"light {light}: {differ.sum()} of {differ.size} texels differ, lit {want.mean():.2f}")
        assert differ.mean() < 5e-4 and 0.05 < want.mean() < 0.95


def _to(lamp: Light, points: F64) -> tuple[F64, F64]:
    toward = np.array(lamp.position) - points
    away = np.linalg.norm(toward, axis=1)
    return toward / away[:, None], away


def test_the_error_falls_with_texels(renderer: gh.Renderer, context: "Context") -> None:
    """A border is a texel wide: half the texels, twice the error (0.92, 0.43, 0.22 % at 4, 8, 16 a metre)."""
    scene, camera, _ = posts()
    found = [wrong(renderer, scene, camera, settings(texels=t)).all for t in (4.0, 8.0, 16.0)]
    say(f"wrong shadow, %: {found}")
    assert found[0] < 2 and found[2] < 0.4
    assert all(1.5 < a / b < 3 for a, b in itertools.pairwise(found)), found


def test_light_leaks_by_a_row_of_texels_and_no_more(renderer: gh.Renderer, context: "Context") -> None:
    """Walls of 2 cm, texels of 25 and 5 cm: floor texels outside are neighbours of those inside."""
    scene, camera, _ = room()
    rows = {}
    for texels in (4.0, 20.0):
        frame = seen(renderer, scene, camera, settings(texels=texels))
        lit = facing(frame, scene) & (frame["visibility"][..., 0] > 0.02)
        reach = 1.48 - np.abs(frame["position"][..., [0, 2]]).max(-1)  # m from the nearest wall
        rows[texels] = float(reach[lit].max(initial=0)) * texels
        say(f"{texels:g} texels a metre: {100 * lit.mean():.2f} % lit, up to {rows[texels]:.2f} texels inside")
    assert 0.2 < rows[4.0] <= 1.42 and rows[20.0] <= 1.42, rows
    assert not seen(renderer, scene, camera, settings("ray"))["visibility"][facing(frame, scene)].any()


def test_points_inside_solids_are_pushed_out(renderer: gh.Renderer, context: "Context") -> None:
    """A block on a floor under a sun overhead: the floor is lit up to the block, but where texels inside it are dark."""
    scene = scene_of(
        box(size=(6, 0.2, 6)), box(size=(1.9, 1.0, 1.9)), poses=[moved((0, -0.1, 0)), moved((0.03, 0.5, 0.03))]
    )
    scene = scene.replace(lights=(Light("directional", direction=(0.0, -1.0, 0.0)),), materials=(WHITE,))
    camera = Camera.look_at((2.5, 3, 3.5), (0, 0, 0))
    dark = {}
    for push in (False, True):
        frame = seen(renderer, scene, camera, settings(texels=4.0, push=push, dilation=8 if push else 0))
        floor = np.isfinite(frame["distance"]) & (np.abs(frame["position"][..., 1]) < 1e-3)
        dark[push] = 100 * float((frame["visibility"][..., 0] < 0.9)[floor].mean())
    say(f"floor in false shadow: {dark[False]:.2f} %, pushed {dark[True]:.3f} %")
    assert dark[False] > 1 and dark[True] < 0.1, dark


def test_seams_hardly_show(renderer: gh.Renderer, context: "Context") -> None:
    """A tube half in a penumbra, where charts meet: the step across, of two lookups at one point of two triangles.

    64 rays a texel leave a noise of 1.9 % between them, 4 % at 95 % of them, where texels are not made to agree."""
    tube = torus(radius=1.0, tube=0.4, segments=32, sides=16)
    slab = box(size=(4, 0.05, 4))
    scene = scene_of(tube, slab, poses=[np.eye(4), moved((2.0, 2.5, 0))], materials=(WHITE,))
    sun = Light("directional", direction=(0.0, -1.0, 0.0), angular_diameter=0.5)
    made = baked(renderer, scene.replace(lights=(sun,)), settings(levels=2, texels=12.0, samples=64))
    steps, means = seam_steps(made, 0)
    say(f"step across seams: mean {steps.mean():.4f} of {means.mean():.2f}, 95 % {np.quantile(steps, 0.95):.4f}")
    assert len(steps) > 60 and steps.mean() / means.mean() < 0.006 and np.quantile(steps, 0.95) < 0.015
    got = pages(made)[0]
    truth = pages(baked(renderer, scene.replace(lights=(sun,)), settings(levels=2, texels=12.0, samples=1024)))[0]
    off = np.abs(got - truth)[(truth > 0) & (truth < 1)].mean()
    say(f"texels in the penumbra are off by {off:.4f}")
    assert off < 0.016, "no more than the noise of their rays"


def seam_steps(made: Baked, mesh: int) -> tuple[F64, F64]:
    """|a - b| and the mean of lookups from both triangles at points of edges whose two sides lie in different charts.

    Edges of faces whose fronts see the first light at more than 17 degrees: all of its disc is above them."""
    geometry, map_ = made._scene.geometry, made.layout
    first, count = geometry.meshes[mesh].geometries[0]
    rows = np.arange(first, first + count)
    corner = geometry.vertices[geometry.triangles[rows, :3], :3].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    lit = (normal @ -np.array(made._scene.lights[0].direction)) / np.linalg.norm(normal, axis=1) > 0.3
    place = map_.places[map_.places[int(np.flatnonzero(geometry.instance_mesh == mesh)[0]), 0]]
    uv = map_.uv[rows + place[3], :6].reshape(-1, 3, 2).astype(np.float64) + place[:2]
    image = pages(made)[0].reshape(map_.pages)[place[2]]
    edges: dict[Any, list[Any]] = {}
    for t in np.flatnonzero(lit):
        for k in range(3):
            a, b = k, (k + 1) % 3
            ends = sorted(
                ((tuple(corner[t, a].round(5)), tuple(uv[t, a])), (tuple(corner[t, b].round(5)), tuple(uv[t, b])))
            )
            edges.setdefault((ends[0][0], ends[1][0]), []).append((ends[0][1], ends[1][1]))
    steps, means = [], []
    for pair in edges.values():
        if len(pair) == 2 and not np.allclose(pair[0], pair[1], atol=1e-3):
            for s in (0.1, 0.5, 0.9):
                a, b = (bilinear(image, (1 - s) * np.array(side[0]) + s * np.array(side[1])) for side in pair)
                steps.append(abs(a - b))
                means.append((a + b) / 2)
    return np.array(steps), np.array(means)


def bilinear(image: F64, at: F64) -> float:
    x, y = np.floor(at - 0.5).astype(int)
    fx, fy = at - 0.5 - (x, y)
    top = image[y, x] * (1 - fx) + image[y, x + 1] * fx
    return float(top * (1 - fy) + (image[y + 1, x] * (1 - fx) + image[y + 1, x + 1] * fx) * fy)


def test_penumbrae_are_those_of_the_disc(renderer: gh.Renderer, context: "Context") -> None:
    """Of a straight edge under a sun of half angle 2 degrees, at three heights: 128 stratified rays a texel."""
    half_angle = np.radians(2.0)
    for height in (0.5, 2.0, 8.0):
        wide = height * float(np.tan(half_angle))  # half the penumbra
        slab, floor = box(size=(4 * wide, 0.1 * wide, 8 * wide)), box(size=(6 * wide, 0.1 * wide, 2 * wide))
        at = np.array([[-2 * wide, height + 0.05 * wide, 0], [0, -0.05 * wide, 0]])
        scene = scene_of(slab, floor, poses=[moved(p) for p in at], materials=(WHITE,))
        sun = Light("directional", direction=(0.0, -1.0, 0.0), angular_diameter=2 * half_angle)
        view = Camera.look_at((0, 0.9 * height, 0), (0, 0, 0), up=(0, 0, -1)).world_from_view
        camera = Camera("down", view, fov_y=0.0, near=1e-3, ymag=wide / 8, xmag=2 * wide)
        chosen = settings(texels=24 / wide, samples=128)
        frame = seen(renderer, scene.replace(lights=(sun,)), camera, chosen, (160, 10))
        x, v = frame["position"][..., 0], frame["visibility"][..., 0]
        mae = float(np.abs(v - metrics.disc_visibility(x / wide)).mean())
        say(f"penumbra at {height:g} m: mae {mae:.4f}")
        assert mae < 0.02 and (v.max(), v.min()) == (1, 0)


def test_bakes_come_back_bit_equal_and_damaged_ones_are_made_anew(
    renderer: gh.Renderer, context: "Context", cache: Path
) -> None:
    scene, _, _ = posts()
    chosen = settings(texels=4.0)
    fresh = baked(renderer, scene, chosen)
    want = pages(fresh)
    assert not fresh.from_cache and len(list((cache / "bake").iterdir())) == 1
    brighter = scene.replace(
        lights=tuple(Light("directional", (1, 0.5, 0.2), 9.0, direction=x.direction) for x in scene.lights)
    )
    for same in (scene.replace(), brighter):  # colours and intensities are no part of a bake
        again = baked(renderer, same, chosen)
        assert again.from_cache and np.array_equal(pages(again), want)
    for folder in ("bake", "unwrap"):
        file = next((cache / folder).iterdir())
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        for damaged in (bytes(data), bytes(data[:100]), b""):
            file.write_bytes(damaged)
            remade = baked(renderer, scene.replace(), chosen)
            assert remade.from_cache == (folder == "unwrap") and np.array_equal(pages(remade), want)
    turned = scene.replace(lights=(Light("directional", direction=(0.0, -1.0, 0.0)),))
    moved_box = scene.replace(instances=scene.instances[:-1])
    for other in (turned, moved_box):
        assert not baked(renderer, other, chosen).from_cache
    assert not baked(renderer, scene.replace(), settings(texels=4.0, push=False)).from_cache


def test_many_lights_are_as_each_alone_and_kept_apart(
    renderer: gh.Renderer, context: "Context", cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than a batch of them, one with a size in between; and a light that is added is all that is baked."""
    scene, _, _ = posts()
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    lamps = [Light("point", position=(3 * float(np.cos(a)), 2.0, 3 * float(np.sin(a)))) for a in turn]
    lamps[7] = replace(lamps[7], radius=0.2)
    chosen = settings(texels=3.0, samples=4)
    many = pages(baked(renderer, scene.replace(lights=tuple(lamps)), chosen))
    assert len(list((cache / "bake").iterdir())) == 40
    monkeypatch.setenv("GLHYBRID_CACHE", "off")
    for file in (cache / "bake").iterdir():
        file.rename(file.with_suffix(".away"))
    for k in (0, 7, 31, 32, 39):
        assert np.array_equal(pages(baked(renderer, scene.replace(lights=(lamps[k],)), chosen))[0], many[k]), k
    assert len({plane.tobytes() for plane in many}) == 40  # and each is another
    for file in (cache / "bake").iterdir():
        file.rename(file.with_suffix(".bake"))
    asked: list[int] = []
    lights = Bake.lights
    monkeypatch.setattr(
        Bake, "lights", lambda self, numbers, done: asked.extend(numbers) or lights(self, numbers, done)
    )
    lamps.insert(3, Light("point", position=(0.1, 3.0, 0.2)))
    more = baked(renderer, scene.replace(lights=tuple(lamps)), chosen)
    assert asked == [3] and not more.from_cache and np.array_equal(np.delete(pages(more), 3, 0), many)


def test_a_shorter_file_that_adds_up_is_not_trusted(renderer: gh.Renderer, context: "Context", cache: Path) -> None:
    """Whole by its own hash, but of another size: as after a change of this program."""
    import zlib

    scene, _, _ = posts()
    want = pages(baked(renderer, scene, settings(texels=2.0)))
    name = next((cache / "bake").iterdir()).stem
    for data in (zlib.compress(b"short"), b"no zlib"):
        content_cache.write("bake", name, data)
        remade = baked(renderer, scene.replace(), settings(texels=2.0))
        assert not remade.from_cache and np.array_equal(pages(remade), want)


def instanced() -> tuple[Scene, Camera]:
    """One mesh placed four times, mirrored, stretched and small, on a floor; a sun and a lamp."""
    ring = torus(radius=0.5, tube=0.15, segments=24, sides=12)
    poses = [
        moved((-1.2, 0.5, 0), np.diag([1.0, 1.0, -1.0])), moved((0.6, 0.6, 0.5), np.diag([1.4, 0.7, 1.0])),
        moved((0.2, 0.3, -1.5), 0.4 * np.eye(3)), moved((-0.4, 1.6, 0.2), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])),
    ]  # fmt: skip
    scene = scene_of(box(size=(6, 0.2, 6)), ring, poses=[moved((0, -0.1, 0)), np.eye(4)], materials=(WHITE,))
    scene = scene.replace(instances=(scene.instances[0], *(Instance(1, p) for p in poses)))
    lights = (Light("directional", direction=(-0.5, -0.8, -0.33)), Light("point", position=(2, 3, 2), intensity=20.0))
    return scene.replace(lights=lights), Camera.look_at((2, 3, 4), (0, 0.3, 0))


@pytest.mark.parametrize("levels", [1, 2])
def test_every_instance_has_its_own_visibility(renderer: gh.Renderer, context: "Context", levels: int) -> None:
    scene, camera = instanced()
    want = seen(renderer, scene, camera, settings("ray", levels=levels))
    got = seen(renderer, scene, camera, settings(levels=levels, texels=40.0))
    for light in range(2):
        found = metrics.wrong_shadow_percent(
            got["visibility"][..., light], want["visibility"][..., light], facing(want, scene, light)
        )
        say(f"levels {levels}, light {light}: {found}")
        assert found.all < 1.5, found  # coarse tori end in facets, and shadows along them: 0.6 %


def test_spheres_have_octahedral_maps(renderer: gh.Renderer, context: "Context") -> None:
    """An analytic sphere, stretched too, shaded by a bar; no seam and no ray at run time."""
    bar = box(size=(0.2, 0.2, 4))
    poses = [moved((-1.1, 0, 0)), moved((1.1, 0, 0), np.diag([1.2, 0.7, -1.0])), moved((0, 1.6, 0))]
    scene = scene_of(Sphere(1.0), bar, poses=[np.eye(4)] * 2, materials=(WHITE,))
    scene = scene.replace(instances=tuple(Instance(k, p) for k, p in zip((0, 0, 1), poses, strict=True)))
    scene = scene.replace(lights=(Light("directional", direction=(0.55, -0.8, -0.2)),))
    found = wrong(renderer, scene, Camera.look_at((0, 2, 5), (0, 0, 0)), settings(texels=60.0))
    say(f"spheres: {found}")
    assert found.all < 0.6 and found.outside < 0.3, found


def test_cut_outs_and_tints_pass_light(renderer: gh.Renderer, context: "Context") -> None:
    alpha = np.where(np.indices((4, 4)).sum(0) % 2 == 0, 255, 0)
    texels = np.dstack([np.full((4, 4, 3), 255), alpha]).astype(np.uint8)
    holes = Material(
        alpha_mode="MASK", double_sided=True, textures={"base_color": Texture(Image(texels), nearest=True)}
    )
    glass = Material(base_color=(0.9, 0.3, 0.3, 0.5), alpha_mode="BLEND", double_sided=True)
    corners = [[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]]
    sheet = piece(corners, [[0, 1, 2], [0, 2, 3]], uv=[(0, 1), (1, 1), (1, 0), (0, 0)])
    sun = Light("directional", direction=(0.0, -1.0, 0.0))
    camera = Camera.look_at((0, 3, 4.5), (0, 0, 0))
    for cover in (holes, glass):
        scene = scene_of(
            box(size=(5, 0.2, 5)), sheet, poses=[moved((0, -0.1, 0)), moved((0, 0.8, 0))], materials=(WHITE, cover)
        )
        scene = scene.replace(
            instances=(scene.instances[0], Instance(1, scene.instances[1].world_from_object, materials=(1,))),
            lights=(sun,),
        )
        want, got = (seen(renderer, scene, camera, s) for s in (settings("ray"), settings(texels=40.0)))
        apart = np.abs(want["visibility"] - got["visibility"])[facing(want, scene)]
        say(f"{cover.alpha_mode}: {apart.mean():.4f}, half way {np.mean(apart > 0.5):.4f}")
        assert apart.mean() < 0.02 and 0.1 < want["visibility"].mean() < 1
        assert cover is holes or np.isclose(np.median(got["visibility"][want["visibility"] == 0.5]), 0.5, atol=0.01)


def test_hits_of_mirror_rays_read_the_maps(renderer: gh.Renderer, context: "Context") -> None:
    """A shadow seen in a mirror: the same as traced, but for its border; and no shadow ray is sent for it."""
    mirror = Material(metallic=1.0, roughness=0.0, double_sided=True)
    scene = scene_of(box(size=(6, 0.2, 6)), box(size=(0.6, 1.2, 0.6)), box(size=(6, 3, 0.1)), materials=(WHITE, mirror))
    poses = [moved((0, -0.1, 0)), moved((0, 0.6, 0)), moved((0, 1.5, -3))]
    scene = scene.replace(
        instances=tuple(Instance(k, p, materials=(int(k == 2),)) for k, p in enumerate(poses)),
        lights=(Light("directional", direction=(0.5, -0.8, 0.1)),),
    )
    camera = Camera.look_at((0, 1.2, 4), (0, 0.9, -3))
    pictures = {}
    for name in ("ray", "baked", "none"):
        chosen = settings(name, reflections="ray-lerp", **({"texels": 30.0} if name == "baked" else {}))
        pictures[name] = renderer.render(scene, camera, SIZE, chosen, ("reflection", "instance_id", "bvh_steps"))
    on = pictures["ray"]["instance_id"] == 2
    truth, got, unshadowed = (pictures[n]["reflection"][on] for n in ("ray", "baked", "none"))
    error, without = np.abs(got - truth).mean(), np.abs(unshadowed - truth).mean()
    say(f"reflected light: off by {error:.5f}, without shadows {without:.5f}")
    assert on.sum() > 5000 and error < 0.1 * without and without > 0.001
    assert pictures["baked"]["bvh_steps"][on].sum() < pictures["ray"]["bvh_steps"][on].sum()


def test_what_moves_is_refused_and_a_moving_camera_is_not(renderer: gh.Renderer, context: "Context") -> None:
    scene, camera, _ = posts()
    nodes = (Node("body", -1), Node("camera", -1))
    scene = scene.replace(
        nodes=nodes, instances=(*scene.instances[:-1], Instance(1, scene.instances[-1].world_from_object, node=0)),
        cameras=(Camera("main", camera.world_from_view, node=1),),
    )  # fmt: skip
    times, values = np.array([0, 1], np.float32), np.array([[0, 0, 0], [1, 0, 0]], np.float32)
    for node, fine in ((0, False), (1, True)):
        clip = Animation("slide", (Channel(node, "translation", "LINEAR", times, values),))
        animated = scene.replace(animations=(clip,))
        chosen = settings(texels=2.0).replace(time=0.5)
        if fine:
            assert np.isfinite(renderer.render(animated, 0, (32, 24), chosen)["radiance"]).all()
        else:
            with pytest.raises(SettingError, match='clip "slide" moves things'):
                renderer.render(animated, 0, (32, 24), chosen)
            renderer.render(animated, 0, (32, 24), settings(texels=2.0))  # at rest


def test_too_much_is_refused_with_what_to_do(renderer: gh.Renderer, context: "Context") -> None:
    scene, _, _ = posts()
    for parameters, words in (
        ({"triangles": 10}, "triangles to unwrap, the limit is 10"),
        ({"texels": 1e5}, "shadows.baked.texels"),
        ({"texels": 250.0}, "texels a light"),
    ):
        with pytest.raises(SettingError, match=words):
            renderer.stage(scene, settings(**parameters), (16, 16))
    with pytest.raises(SettingError, match="layers"):
        renderer.stage(scene.replace(lights=scene.lights * 5000), settings(texels=1.0), (16, 16))


def test_it_costs_nothing_elsewhere_and_only_lookups_here(renderer: gh.Renderer, context: "Context") -> None:
    """No program of it without it; with it no shadow pass, and the budget says how large the maps are."""
    scene, camera, _ = posts()
    plain = renderer.render(scene, camera, (32, 24), settings("ray"))
    assert not any("baked" in p or "LIGHTMAP" in p for p in plain.receipt["plan"]["programs"])
    seen_stages: list[str] = []
    chosen = settings(budget=1 << 17)
    frame = renderer.render(scene, camera, (32, 24), chosen, progress=lambda stage, *_: seen_stages.append(stage))
    assert {p["name"] for p in frame.receipt["passes"]} == {"gbuffer", "baked", "composite", "display"}
    assert {"unwrapping", "placing texels", "baking light 1 of 1"} <= set(seen_stages)
    made = baked(renderer, scene, chosen)
    covered = len(made.layout.index) / (1 << 17)
    say(f"texels with a point over the budget: {covered:.2f}; pages {made.layout.pages}")
    assert 0.9 < covered < 1.4
    empty = renderer.render(Scene("empty", lights=scene.lights, environment=Environment(np.ones((1, 1, 3), np.float32))),
                            camera, (16, 16), settings())  # fmt: skip
    assert np.isfinite(empty["radiance"]).all()
