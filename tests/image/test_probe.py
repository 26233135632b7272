"""Box-projected probes: exact where theory says, and wrong by its figures elsewhere.

In a box-shaped room whose colours are places, a probe's box is the room: walls are reflected where they are, from any
point; what stands in the room is where the probe saw it. Without the box all is off by the parallax.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mirror_room
import numpy as np
import pytest
from scene_kit import Camera, Light, box, constant_sky, floor, matte, metal, scene, sun

import glhybrid as gh
from glhybrid import content_cache, probe_capture, probe_placement
from glhybrid.layout import CONSTANTS
from glhybrid.scene import Animation, Channel, Environment, Material, Node, Probe, Scene

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (160, 120)
ROOM = Probe((0.3, 1.7, -0.4), (-5, 0, -5), (5, 4, 5))
AOVS = ("reflection", "reflection_hit", "reason", "instance_id")
TEXEL = 2 / 256  # rad: of a face's middle
EDGE = -1.0  # m: where a box ends; the camera is to its right, and all rays there lead to the left


@pytest.fixture(scope="module")
def renderer(_shared_context: "Context") -> Iterator[gh.Renderer]:
    with gh.Renderer(context=_shared_context) as made:
        yield made


def shot(renderer: gh.Renderer, made: Scene, technique: str = "probe", **more: Any) -> gh.Frame:
    own = {f"reflections.probe.{k}": v for k, v in more.items() if k != "shadows"} if technique == "probe" else {}
    rest = {k: v for k, v in more.items() if k == "shadows"}
    settings = gh.Settings(reflections=technique, aa=1, exposure=0.0, parameters=own, **rest)
    return renderer.render(made, size=SIZE, settings=settings, aovs=AOVS)


def probe_shows(true: mirror_room.Truth, probe: Probe) -> Any:
    """The point that theory says is shown: the ray's end on the box, then what lies there as the probe sees it."""
    low, high = np.array(probe.low), np.array(probe.high)
    start = np.clip(true.origin, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(true.direction > 0, (high - start) / true.direction, (low - start) / true.direction)
    t = np.nanmin(np.where(true.direction == 0, np.inf, t), axis=-1)
    eye = np.array(probe.position)
    way = start + t[..., None] * true.direction - eye
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    return eye + mirror_room.first_hit(np.broadcast_to(eye, way.shape), way)[0][..., None] * way, t


def test_it_shows_what_theory_says(context: "Context", renderer: gh.Renderer) -> None:
    """Walls in their place, things where the probe saw them: against float64, to a texel of the cube map."""
    true = mirror_room.truth(SIZE)
    frame = shot(renderer, mirror_room.room().replace(probes=(ROOM,)))
    use = true.mirror & (frame["instance_id"] == mirror_room.FLOOR)
    theory, wall = probe_shows(true, ROOM)
    got = mirror_room.places(frame["reflection"])
    off = np.linalg.norm(got - theory, axis=-1)
    texel = TEXEL * np.linalg.norm(theory - np.array(ROOM.position), axis=-1)
    # A texel, seen at a slant on the floor; edges of things blend into what is behind them over two.
    assert np.percentile((off / texel)[use], 90) < 1.0
    assert np.allclose(frame["reflection_hit"][use], wall[use], rtol=1e-3)
    assert (frame["reason"][use] == CONSTANTS["REASON_NONE"]).all()
    right = np.linalg.norm(got - true.point, axis=-1) < 0.1
    on_wall = (np.abs(np.abs(true.point) - (5, 2, 5)) < 1e-6).any(-1) | (np.abs(true.point[..., 1] - 4) < 1e-6)
    assert right[use & on_wall].mean() > 0.75  # but where things are shown that are not there
    assert right[use & ~on_wall].mean() < 0.25  # things are hardly ever in their place
    # From the probe's own place there is no parallax to correct: the mirror under it shows all of it right.
    near = np.linalg.norm(true.origin - ROOM.position, axis=-1) < 1.9
    assert use[near].any()


def test_without_its_box_it_is_off_by_the_parallax(context: "Context", renderer: gh.Renderer) -> None:
    """A box so large that its walls are as good as infinitely far: the usual cube map, and its large errors."""
    true = mirror_room.truth(SIZE)
    far = replace(ROOM, low=(-5e3,) * 3, high=(5e3,) * 3)
    errors = []
    for probe in (ROOM, far):
        frame = shot(renderer, mirror_room.room().replace(probes=(probe,)))
        use = true.mirror & (frame["instance_id"] == mirror_room.FLOOR)
        errors.append(float(np.median(mirror_room.error_px(mirror_room.places(frame["reflection"]), true)[use])))
    # In theory: the point seen from the probe in the same direction.
    eye = np.array(ROOM.position)
    t = mirror_room.first_hit(np.broadcast_to(eye, true.direction.shape), true.direction)[0]
    theory = eye + np.where(np.isfinite(t), t, 0.0)[..., None] * true.direction
    expected = float(np.median(mirror_room.error_px(theory, true)[use]))
    assert errors[0] < 0.5 and errors[1] > 20 and errors[1] == pytest.approx(expected, rel=0.05)


def test_outside_its_box_there_is_the_sky(context: "Context", renderer: gh.Renderer) -> None:
    made = mirror_room.room().replace(environment=constant_sky(0.25))
    half = Probe((-3, 2, 0), (-5, 0, -5), (EDGE, 4, 5))
    frame = shot(renderer, made.replace(probes=(half,)), blend=0.0)
    true = mirror_room.truth(SIZE)
    use = true.mirror & (frame["instance_id"] == mirror_room.FLOOR)
    left, right = use & (true.origin[..., 0] < EDGE - 1e-3), use & (true.origin[..., 0] > EDGE + 1e-3)
    assert (frame["reason"][left] == CONSTANTS["REASON_NONE"]).all()
    assert (frame["reason"][right] == CONSTANTS["REASON_OUTSIDE_PROBE"]).all()
    assert np.isinf(frame["reflection_hit"][right]).all() and np.allclose(frame["reflection"][right], 0.25)
    assert np.isfinite(frame["reflection_hit"][left]).all()
    # Of two boxes the smaller speaks; over `blend` around it, it gives way to the larger.
    both = shot(renderer, made.replace(probes=(ROOM, half)), blend=1.0)
    whole = shot(renderer, made.replace(probes=(ROOM,)))
    beyond = use & (true.origin[..., 0] > EDGE + 1.0)
    assert np.allclose(both["reflection"][left], frame["reflection"][left], atol=1e-3)
    assert np.allclose(both["reflection"][beyond], whole["reflection"][beyond], atol=1e-3)
    seam = use[:, 1:] & use[:, :-1] & (true.origin[:, 1:, 0] >= EDGE) & (true.origin[:, :-1, 0] < EDGE)
    hard, soft = (np.median(np.abs(np.diff(f["reflection"], axis=1)).max(-1)[seam]) for f in (frame, both))
    assert soft < 0.03 < 0.1 < hard


def test_a_room_gets_one_probe(context: "Context", renderer: gh.Renderer) -> None:
    """Without being told: as high as there is room, and its box is the room, whatever stands in it."""
    frame = shot(renderer, mirror_room.room())
    (placed,) = frame.receipt["probes"]["placed"]
    assert np.allclose(placed["low"], (-5, 0, -5), atol=0.1) and np.allclose(placed["high"], (5, 4, 5), atol=0.1)
    assert (np.array(placed["position"]) > (-5, 0, -5)).all() and (np.array(placed["position"]) < (5, 4, 5)).all()
    # A scene far larger than the room that it is about: the box is what is seen, not all there is.
    outside = scene(
        [(box((-4, 0, -4), (4, 3, 4), inside=True), matte()), (floor(500, -1.0), matte()), (floor(3, 0.01), metal())],
        Camera.look_at((0, 1.5, 3), (0, 1, 0)), lights=(sun(),), environment=constant_sky(),
    )  # fmt: skip
    (placed,) = shot(renderer, outside).receipt["probes"]["placed"]
    assert np.allclose(placed["low"][::2], (-4, -4), atol=0.2) and np.allclose(placed["high"], (4, 3, 4), atol=0.2)


WALL = 0.1  # m: half the width of what is between the two rooms
TALL = (3.0, 2.5)  # of the red and of the blue room


def two_rooms(eye_x: float) -> Scene:
    """A red and a blue room with mirrors for floors, a wall between them, and a camera in one of them."""
    parts: list[Any] = []
    for side, color, high in ((-1, (0.8, 0.1, 0.1), TALL[0]), (1, (0.1, 0.1, 0.8), TALL[1])):
        x = sorted((side * WALL, side * 6.0))
        walls = box((x[0], 0, -3), (x[1], high, 3), inside=True)
        shiny = box((x[0] + 0.05, -0.2, -2.95), (x[1] - 0.05, 0.01, 2.95))
        parts += [(walls, Material("wall", (*color, 1.0), unlit=True)), (shiny, metal(double_sided=False))]
    cameras = [Camera.look_at((x, 1.5, 2.5), (x, 0, -1), fov_y=0.6) for x in (eye_x, -eye_x)]
    return scene(parts, cameras[0], environment=constant_sky(0.5)).replace(cameras=tuple(cameras))


@pytest.mark.parametrize("x", [-3.0, 3.0])
def test_each_of_two_rooms_gets_its_own(context: "Context", renderer: gh.Renderer, x: float) -> None:
    """A probe in each, in the box of its room; each floor shows its own room, up to the wall between them; and only the
    room in view is captured."""
    made = two_rooms(x)
    frame = shot(renderer, made)
    found = frame.receipt["probes"]
    assert len(found["placed"]) == 2 and len(found["captured"]) == 1
    for k, placed in enumerate(sorted(found["placed"], key=lambda p: float(p["position"][0]))):
        low, high = ((-6, 0, -3), (-WALL, TALL[0], 3)) if k == 0 else ((WALL, 0, -3), (6, TALL[1], 3))
        assert (np.array(placed["position"]) > low).all() and (np.array(placed["position"]) < high).all()
        assert np.allclose(placed["low"], low, atol=0.05) and np.allclose(placed["high"], high, atol=0.05)
        assert placed["fade"] <= 2 * WALL
    (captured,) = found["captured"]
    assert np.sign(found["placed"][captured]["position"][0]) == np.sign(x)
    floor_px = frame["reflection_hit"] > 0
    seen = frame["reflection"][floor_px]
    own, other = (0, 2) if x < 0 else (2, 0)
    assert floor_px.mean() > 0.2 and (seen[:, own] > 4 * seen[:, other]).mean() > 0.999
    # Seen from the other room the other one is captured too, and what was captured before is kept.
    settings = gh.Settings(reflections="probe", aa=1, exposure=0.0)
    later = renderer.render(made, 1, SIZE, settings, AOVS)
    assert sorted(later.receipt["probes"]["captured"]) == [0, 1]
    seen = later["reflection"][later["reflection_hit"] > 0]
    assert (seen[:, other] > 4 * seen[:, own]).mean() > 0.999


def test_no_seam_where_one_gives_way_to_the_next(context: "Context", renderer: gh.Renderer) -> None:
    """A long hall whose colours are places, cut in two: along its floor nothing jumps, but without a fade it does."""
    hall = mirror_room.placed(box((-7, 0, -2), (7, 3, 2), inside=True))
    made = scene(
        [(hall, Material("place", unlit=True)), (floor(6.9, 0.01), metal())],
        Camera.look_at((0, 1.5, 1.9), (0, 0, -0.5), fov_y=1.2), environment=constant_sky(0.0),
    )  # fmt: skip
    reach = (((-9, -9, -9), (0.0, 9, 9)), ((0.0, -9, -9), (9, 9, 9)))
    steps = []
    for fade in (0.0, 0.7):
        # Boxes that are not the hall's, each in its own way, so that both are wrong where they meet.
        probes = tuple(
            Probe((x, 1.2, 0.5), (-7, 0, -2), (7, height, 2), reach=r, fade=fade)
            for x, height, r in zip((-4.0, 4.0), (4.0, 2.5), reach, strict=True)
        )
        frame = renderer.render(
            made.replace(probes=probes), 0, SIZE,
            gh.Settings(reflections="probe", aa=1, exposure=0.0), (*AOVS, "position"),
        )  # fmt: skip
        use = (frame["reflection_hit"] > 0)[:, 1:] & (frame["reflection_hit"] > 0)[:, :-1]
        jump = np.abs(np.diff(frame["reflection"], axis=1)).max(-1)
        x = frame["position"][..., 0]
        at = use & (x[:, :-1] < 0) & (x[:, 1:] >= 0)
        assert at.sum() > 20
        steps.append((float(jump[at].mean()), float(jump[use & (np.abs(x[:, 1:]) < 0.7)].mean())))
    assert steps[0][0] > 2 * steps[0][1] and steps[1][0] < 1.2 * steps[1][1], steps


def test_more_are_placed_where_one_is_not_enough(context: "Context", renderer: gh.Renderer) -> None:
    """Five rooms: as many as may be, up to one each; none where nothing is in the sky's way."""
    parts: list[Any] = []
    for k in range(5):
        x = 10.0 * k
        parts.append((box((x - 4, 0, -3), (x + 4, 3, 3), inside=True), matte((0.2 + 0.15 * k, 0.5, 0.5))))
        parts.append((floor(2.9, 0.01), metal(double_sided=False), (x, 0, 0)))
    made = scene(parts, Camera.look_at((20, 1.5, 2.5), (20, 0, -1)), environment=constant_sky(0.5))
    made = made.replace(cameras=(Camera.look_at((20, 1.5, 2.5), (20, 0, -1)),))
    for count in (1, 3, 8):
        placed = shot(renderer, made, count=count, resolution=16).receipt["probes"]["placed"]
        rooms = {round(p["position"][0] / 10) for p in placed}
        assert len(placed) == min(count, 5) and (count < 5 or len(rooms) == 5), (count, rooms)
    alone = scene([(floor(3), metal())], Camera.look_at((0, 1.5, 3), (0, 0, 0)), environment=constant_sky(0.5))
    frame = shot(renderer, alone)
    assert frame.receipt["probes"]["placed"] == [] and frame.receipt["probes"]["bytes"] < 100
    want = shot(renderer, alone, "env")
    assert np.allclose(frame["radiance"], want["radiance"], rtol=1e-5)


def test_places_come_back_from_the_disk(context: "Context", tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(content_cache, "cache_dir", lambda: tmp_path)
    found = []
    looks: list[int] = []
    choose = probe_capture._choose
    monkeypatch.setattr(probe_capture, "_choose", lambda *a: looks.append(1) or choose(*a))
    for _ in range(2):
        with gh.Renderer(context=context) as fresh:
            found.append(shot(fresh, two_rooms(3.0), resolution=16).receipt["probes"]["placed"])
    assert found[0] == found[1] and looks == [1]


def test_blurred_as_the_sky_is(context: "Context", renderer: gh.Renderer) -> None:
    """A probe in the open sees the sky alone, and its lobes are the sky's, but for the detail that its texels lose."""
    y = np.linspace(1, -1, 32)[:, None, None]
    x = np.cos(np.linspace(0, 2 * np.pi, 64, endpoint=False))[None, :, None]
    sky = Environment((1.5 + y + 0.5 * x * np.array([1, 0, -1])).astype(np.float32))
    camera = Camera.look_at((0, 1.5, 3), (0, 0, 0))
    for roughness in (0.0, 0.1, 0.3, 0.8):
        made = scene([(floor(2), metal(roughness=roughness, double_sided=False))], camera, environment=sky)
        # From under the floor, which has no back: nothing but sky, and walls so far away that they move nothing.
        made = made.replace(probes=(Probe((0, -1, 0), (-1e4, -1e4, -1e4), (1e4, 1e4, 1e4)),))
        want, got = shot(renderer, made, "env"), shot(renderer, made)
        assert np.allclose(got["radiance"], want["radiance"], rtol=0.02), roughness


def test_no_occlusion_and_no_inter_reflection(context: "Context", renderer: gh.Renderer) -> None:
    """What a probe cannot know: that a block stands on the mirror, and what mirrors show in mirrors."""
    room = Probe((0, 2, 1), (-3, 0, -3), (3, 4, 3))
    camera = Camera.look_at((0, 1.2, 2.8), (0, 0.3, -1))
    lamp = (Light("point", (1, 1, 1), 20.0, position=(0, 3.5, 0)),)
    block = box((-0.5, 0.001, -1.5), (0.5, 1, -0.5))
    parts: list[Any] = [(box((-3, -0.001, -3), (3, 4, 3), inside=True), matte((0.7, 0.7, 0.7))), (floor(2.9), metal())]
    parts.append((block, matte((0.9, 0.05, 0.05))))
    made = scene(parts, camera, lights=lamp, environment=constant_sky(0.2), probes=(room,))
    want, got = shot(renderer, made, "ray-lerp"), shot(renderer, made)
    # Before the block the floor shows its red front: with a ray; the probe has it elsewhere, if at all.
    height, width = SIZE[1], SIZE[0]
    red = (want["instance_id"] == 1) & (want["reflection"][..., 0] > 3 * want["reflection"][..., 1])
    assert red.mean() > 0.02
    wrong = red & (got["reflection"][..., 0] < 2 * got["reflection"][..., 1])
    foot = red & (np.arange(height)[:, None] < np.nonzero(red.any(1))[0][0] + 4)  # the rows next to the block
    assert wrong[red].mean() > 0.5 and wrong[foot].mean() > 0.8 and width == red.shape[1]
    # Two mirrors that face each other: what stands in the probe's picture of a mirror is sky, not the room.
    parts[2] = (box((-3, 0.001, -2.999), (3, 3, -2.9)), metal())
    mirrors = scene(parts, camera, lights=lamp, environment=constant_sky((5.0, 0.0, 0.0)), probes=(room,))
    seen = shot(renderer, mirrors)
    floor_px = (seen["instance_id"] == 1) & (seen["reflection"][..., 0] > 4.0)
    assert floor_px.mean() > 0.02  # the sky's red, in a room that no sky shines into


def test_captured_once_and_again_when_lights_change(context: "Context", renderer: gh.Renderer) -> None:
    made = mirror_room.room().replace(probes=(ROOM,))
    made = made.replace(
        materials=tuple(replace(m, unlit=False) for m in made.materials), lights=(Light("point", position=(0, 3, 0)),)
    )
    first = shot(renderer, made)
    staged = renderer._staged
    assert staged is not None and staged.probe is not None
    faces = staged.probe.resources["probe_faces"]
    shot(renderer, made)
    assert renderer._staged is staged and staged.probe.resources["probe_faces"] is faces
    brighter = made.replace(lights=(replace(made.lights[0], intensity=4.0),))
    again = shot(renderer, brighter)
    mirror = (first["instance_id"] == mirror_room.FLOOR) & (first["reflection"].max(-1) > 0)
    ratio = again["reflection"][mirror].sum() / first["reflection"][mirror].sum()
    assert ratio == pytest.approx(4.0, rel=0.01)


def test_what_moves_is_captured_where_it_is(context: "Context", renderer: gh.Renderer) -> None:
    """A block and a lamp that a clip carries about: the pictures are those of scenes that stand still there."""
    made = mirror_room.lit_room().replace(probes=(ROOM,))
    block, way = 2, np.array([[0, 0, 0], [1.5, 0.5, 0.5]], np.float32)
    lamp = way + np.array(made.lights[0].position, np.float32)
    nodes = (Node("block", -1), Node("lamp", -1, translation=made.lights[0].position))
    times = np.array([0, 1], np.float32)
    channels = tuple(Channel(i, "translation", "LINEAR", times, v) for i, v in enumerate((way, lamp)))
    instances = tuple(replace(p, node=0) if i == block else p for i, p in enumerate(made.instances))
    clip = made.replace(
        instances=instances, lights=(replace(made.lights[0], node=1),), nodes=nodes,
        animations=(Animation("a", channels),),
    )  # fmt: skip
    for time in (0.0, 1.0, 0.5):
        moved = np.eye(4)
        moved[:3, 3] = time * way[1]
        there = tuple(replace(p, world_from_object=moved) if i == block else p for i, p in enumerate(made.instances))
        at = tuple((np.array(made.lights[0].position) + time * way[1]).tolist())
        still = made.replace(instances=there, lights=(replace(made.lights[0], position=at),))
        settings = gh.Settings(reflections="probe", aa=1, exposure=0.0)
        want = renderer.render(still, size=SIZE, settings=settings)
        got = renderer.render(clip, size=SIZE, settings=settings.replace(time=time))
        assert {p["name"] for p in got.receipt["passes"]} >= {"probe", "gbuffer"}
        far = np.abs(got["radiance"] - want["radiance"]).max(-1) > 0.01 * want["radiance"].mean()
        assert far.mean() < 0.01, time


def test_it_costs_no_pass_and_no_image(context: "Context") -> None:
    made = mirror_room.room().replace(probes=(ROOM,))
    settings = gh.Settings(reflections="probe", aa=1, exposure=0.0, parameters={"reflections.probe.resolution": 16})
    with gh.Renderer(context=context) as fresh:
        matt = made.replace(materials=tuple(replace(m, roughness=1.0) for m in made.materials))
        without = fresh.render(matt, size=SIZE, settings=settings).receipt["plan"]
        assert not any("probe" in p.lower() for p in without["programs"])
        plan = fresh.render(made, size=SIZE, settings=settings).receipt["plan"]
        assert plan["passes"] == ["gbuffer", "composite", "display"]
        staged = fresh._staged
        assert staged is not None and "reflection" not in staged.targets._images
        dfg = 8 * 64 * 64
        maps = staged.probe.bytes if staged.probe is not None else 0
        assert plan["image_bytes"] - without["image_bytes"] == maps + dfg and maps == 8 * 6 * 18 * 18
        assert not any("prefilter" in p for p in plan["programs"])  # only mirrors: nothing is blurred
        rough = made.replace(materials=tuple(replace(m, roughness=0.3) for m in made.materials))
        plan = fresh.render(rough, size=SIZE, settings=settings).receipt["plan"]
        assert plan["image_bytes"] - without["image_bytes"] > maps + dfg


def test_scene_file(tmp_path: Path) -> None:
    text = "[camera.main]\neye = [0, 0, 3]\ntarget = [0, 0, 0]\n\n[[object]]\nshape = 'box'\n\n[[probe]]\n"
    path = tmp_path / "room.toml"
    path.write_text(text + "min = [-1, 0, -2]\nmax = [1, 2, 2]\nname = 'hall'\n")
    assert gh.load(path).probes == (Probe((0, 1, 0), (-1, 0, -2), (1, 2, 2), "hall"),)
    for bad, says in (
        ("min = [0, 0, 0]\n", "needs max"),
        ("min = [0, 0, 0]\nmax = [1, 0, 1]\n", "larger than min"),
        ("min = [0, 0, 0]\nmax = [1, 1, 1]\nposition = [2, 0.5, 0.5]\n", "inside the box"),
        ("min = [0, 0, 0]\nmax = [1, 1, 1]\nposiiton = [2, 0.5, 0.5]\n", "position"),
    ):
        path.write_text(text + bad)
        with pytest.raises(gh.errors.LoadError, match=says):
            gh.load(path)


def test_faces_look_where_they_say() -> None:
    """A field of directions, sampled through the faces' cameras and put together again, is itself."""
    size, texel = 34, 1 + 2 / 32
    edge = (np.arange(size) + 0.5 - size / 2) / (size / 2) * texel
    u, v = np.meshgrid(edge, edge)
    faces = np.zeros((6, size, size, 3))
    for k in range(6):
        pose = probe_placement.face_pose(np.zeros(3), k)
        assert np.allclose(np.linalg.det(pose[:3, :3]), 1)
        d = u[..., None] * pose[:3, 0] + v[..., None] * pose[:3, 1] - pose[:3, 2]
        faces[k] = d / np.linalg.norm(d, axis=-1, keepdims=True)
    got = probe_placement.equirect(faces, 64, 32)
    theta, phi = (np.arange(32) + 0.5) / 32 * np.pi, ((np.arange(64) + 0.5) / 64 - 0.5) * 2 * np.pi
    want = np.stack(
        np.broadcast_arrays(
            np.sin(theta)[:, None] * np.sin(phi), np.cos(theta)[:, None], -np.sin(theta)[:, None] * np.cos(phi)
        ),
        -1,
    )
    assert np.abs(got - want).max() < 2e-3
    assert 6 * probe_placement.solid_angles(size).sum() * (2 / 32) ** 2 == pytest.approx(4 * np.pi, rel=1e-3)


def test_errors_against_the_reference(context: "Context", renderer: gh.Renderer) -> None:
    """A mirror in a lit room, path-traced over the one bounce that all stand for: each is as wrong as it must."""
    made = mirror_room.lit_room().replace(probes=(ROOM,))
    true = mirror_room.truth(SIZE)
    exact = renderer.render(
        made, size=SIZE, settings=gh.Settings(reflections="reference", samples=4, bounces=1, aa=1, exposure=0.0)
    )["radiance"]
    error = {}
    for technique in ("none", "env", "probe", "ssr", "ssr-ray", "ray-lerp"):
        frame = shot(renderer, made, technique)
        use = true.mirror & (frame["instance_id"] == mirror_room.FLOOR)
        inner = use & np.roll(use, 1, 0) & np.roll(use, -1, 0) & np.roll(use, 1, 1) & np.roll(use, -1, 1)
        off = np.abs(frame["radiance"] - exact).mean(-1) / exact[inner].mean()
        error[technique] = float(off[inner].mean())
    assert error["none"] == pytest.approx(1.0, abs=1e-3)
    assert error["ray-lerp"] < 0.01
    assert error["ssr-ray"] < error["ray-lerp"] + 0.003
    assert error["ssr-ray"] < error["ssr"] < 0.5 * error["env"] and error["probe"] < 0.5 * error["env"]
