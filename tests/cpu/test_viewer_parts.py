"""The viewer's parts that need neither OpenGL nor its libraries: cameras, budget, clips, views, input, what is kept."""

import json
import logging
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glhybrid import camera_text, relight
from glhybrid.camera_text import Pose
from glhybrid.errors import SettingError
from glhybrid.image import AOVS, NO_ID
from glhybrid.layout import CONSTANTS
from glhybrid.scene import Animation, Camera, Channel, Environment, Light, Scene
from glhybrid.settings import Settings
from glhybrid.techniques import SHADOWS
from glhybrid.viewer import camera_control as control
from glhybrid.viewer import store, views
from glhybrid.viewer.budget import SCALES, Budget, scaled
from glhybrid.viewer.controls import Controls
from glhybrid.viewer.events import LEFT, Button, Focus, Key, Move, Wheel
from glhybrid.viewer.session import Session
from glhybrid.viewer.transport import Transport

SIZE = (400, 300)
POSES = {
    "front": Pose((0.3, 0.5, 4.0), (0.1, 0.2, -0.3)),
    "far": Pose((1e5 + 3, 20.0, -2e5), (1e5, 21.0, -2e5 + 7), fov=20.0),
    "tilted": Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), up=(0.5, 0.8, 0.1), fov=70.0, short=True, near=0.2),
    "flat": Pose((0.0, 9.0, 0.1), (0.0, 0.0, 0.0), up=(0.0, 0.0, -1.0), fov=0.0, height=3.0, width=5.0),
}


def project(pose: Pose, point: tuple[float, float, float], size: tuple[int, int] = SIZE) -> np.ndarray:
    """Pixels from the image's centre, y down: an oracle of its own."""
    right, up, forward = control.axes(pose)
    arm = np.subtract(point, pose.eye)
    if pose.fov == 0:
        scale = size[1] / (2 * pose.height)
    else:
        half = np.tan(np.deg2rad(pose.fov) / 2) * (max(1.0, size[1] / size[0]) if pose.short else 1.0)
        scale = size[1] / (2 * half * float(arm @ forward))
    return np.array([arm @ right, -(arm @ up)]) * scale


@pytest.mark.parametrize("name", POSES)
def test_a_camera_reads_back_to_the_last_bit(name: str) -> None:
    line = POSES[name].write()
    camera, again = camera_text.parse(line), camera_text.parse(camera_text.read(line).write())
    assert np.array_equal(camera.world_from_view, again.world_from_view) and camera.fov_y == again.fov_y
    assert (camera.ymag, camera.xmag, camera.near, camera.fov_short) == (
        again.ymag,
        again.xmag,
        again.near,
        again.fov_short,
    )
    assert np.allclose(camera.world_from_view[:3, 3], POSES[name].eye, rtol=1e-8)


@pytest.mark.parametrize("name", POSES)
def test_a_pose_of_a_camera_is_that_camera(name: str) -> None:
    camera = POSES[name].camera()
    again = camera_text.pose_of(camera, 5.0).camera()
    assert np.allclose(again.world_from_view, camera.world_from_view, atol=1e-7, rtol=1e-8)
    assert again.fov_y == pytest.approx(camera.fov_y) and again.ymag == pytest.approx(camera.ymag)


@pytest.mark.parametrize(
    "line", ["eye=1,2,3", "eye=1,2;target=0,0,0", "eye=1,2,3;target=1,2,3", "eye=1,2,3;target=0,0,0;fow=3",
             "eye=1,2,3;target=0,0,0;fov=190", "eye=1,2,nan;target=0,0,0", "eye=1,2,3;target=0,0,0;fov=0"],
)  # fmt: skip
def test_bad_lines_are_refused(line: str) -> None:
    with pytest.raises(SettingError, match="--camera"):
        camera_text.parse(line)


@pytest.mark.parametrize("name", POSES)
def test_orbit_keeps_target_and_distance_and_look_keeps_the_eye(name: str) -> None:
    pose = POSES[name]
    orbited, looked = control.orbit(pose, 0.4, 0.2), control.look(pose, 0.4, 0.2)
    assert orbited.target == pose.target and control.distance(orbited) == pytest.approx(control.distance(pose))
    assert looked.eye == pose.eye and control.distance(looked) == pytest.approx(control.distance(pose))
    back = control.orbit(control.orbit(pose, 0.4, 0.0), -0.4, 0.0)
    assert np.allclose(back.eye, pose.eye, rtol=1e-9, atol=1e-9)


def test_turning_goes_the_way_of_the_pointer() -> None:
    """Dragging right: what is looked at moves right. Dragging down in an orbit raises the eye."""
    pose = POSES["front"]
    nearer = tuple(np.asarray(pose.target) + 0.3 * np.subtract(pose.eye, pose.target))
    assert project(control.orbit(pose, 0.05, 0.0), nearer)[0] > project(pose, nearer)[0] + 1
    assert control.orbit(pose, 0.0, 0.1).eye[1] > pose.eye[1]
    assert control.look(pose, 0.1, 0.0).target[0] > pose.target[0]
    assert control.look(pose, 0.0, 0.1).target[1] > pose.target[1]


def test_the_poles_are_not_crossed() -> None:
    pose = POSES["front"]
    for pitch in (10.0, -10.0):
        top = control.orbit(pose, 0.0, pitch)
        _, up, forward = control.axes(top)
        assert abs(forward[1]) < 1 and up[1] > 0
        assert control.distance(control.orbit(top, 1.0, 0.0)) == pytest.approx(control.distance(pose))
    straight = Pose((0.0, 5.0, 0.0), (0.0, 0.0, 0.0))
    assert np.isfinite(control.orbit(straight, 0.3, -0.2).eye).all()


@pytest.mark.parametrize("name", POSES)
def test_what_is_dragged_follows_the_pointer(name: str) -> None:
    pose = POSES[name]
    moved = control.pan(pose, 30, -20, SIZE)
    assert np.allclose(project(moved, pose.target), (30, -20), atol=1e-3)


@pytest.mark.parametrize("name", POSES)
def test_what_is_under_the_pointer_stays_there(name: str) -> None:
    pose, at = POSES[name], (80.0, -45.0)
    right, up, _ = control.axes(pose)
    scale = control.metres_per_pixel(pose, SIZE)
    point = np.asarray(pose.target) + (at[0] * right - at[1] * up) * scale
    nearer = control.dolly(pose, 3.0, at, SIZE)
    assert np.allclose(project(nearer, tuple(point)), at, atol=1e-3)
    assert control.metres_per_pixel(nearer, SIZE) == pytest.approx(scale * control.WHEEL**3)
    back = control.dolly(nearer, -3.0, at, SIZE)
    assert np.allclose(back.eye, pose.eye, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("size", [(400, 300), (200, 500)])
@pytest.mark.parametrize("name", POSES)
def test_a_framed_box_fills_the_image_and_is_inside(name: str, size: tuple[int, int]) -> None:
    box = np.array([[1.0, -2.0, 3.0], [2.0, 0.0, 3.5]])
    pose = control.frame(replace(POSES[name], width=0.0), box, size)
    corners = np.array([[box[i & 1, 0], box[i >> 1 & 1, 1], box[i >> 2 & 1, 2]] for i in range(8)])
    pixels = np.array([project(pose, tuple(c), size) for c in corners])
    assert (np.abs(pixels) <= np.array(size) / 2).all()
    assert np.linalg.norm(np.ptp(pixels, axis=0)) > 0.25 * min(size)


def test_flying_is_along_the_view() -> None:
    pose = POSES["front"]
    right, _, forward = control.axes(pose)
    moved = control.fly(pose, 1.0, 0.0, 2.0)
    assert np.allclose(np.subtract(moved.eye, pose.eye), right + 2 * forward)
    assert np.allclose(np.subtract(moved.target, pose.target), right + 2 * forward)


def test_light_comes_from_where_it_is_put() -> None:
    scene = Scene(
        "s", lights=(Light("directional"), Light("point")), environment=Environment(np.ones((1, 1, 3), np.float32))
    )
    turned = relight.apply(scene, ("0:90,30",), 45.0)
    assert np.allclose(turned.lights[0].direction, (-np.cos(np.pi / 6), -0.5, 0.0))
    assert relight.angles(turned.lights[0]) == pytest.approx((90, 30)) and turned.lights[1] is scene.lights[1]
    assert turned.environment is not None and turned.environment.rotation == pytest.approx(np.pi / 4)
    for bad in ("1:0,0", "2:0,0", "0:x,1", "0:1", "0", "0:1e999,0"):
        with pytest.raises(SettingError):
            relight.apply(scene, (bad,))
    for other, angle in ((Scene("bare"), 10.0), (scene, np.nan), (scene, np.inf)):
        with pytest.raises(SettingError):
            relight.apply(other, (), angle)


def test_the_budget_shrinks_at_once_and_grows_with_room() -> None:
    budget = Budget(100.0)
    assert budget.next() == 1.0
    budget.note(1600.0, 1.0)
    assert budget.next() == 0.25
    budget.note(6.0, 0.25)  # much cheaper than thought
    for _ in range(12):
        budget.note(6.0, 0.25)
        grown = budget.next()
    assert grown == max(s for s in SCALES if 96 * s**2 <= 75)
    budget.note(1e6, 1.0)
    assert budget.next() == SCALES[-1]
    assert scaled((1000, 3), 0.125) == (125, 2) and scaled((512, 300), 0.125) == (65, 38)  # no powers of two


def _clip(seconds: float) -> Animation:
    return Animation("walk", (Channel(0, "translation", "LINEAR", np.array([0, seconds], np.float32), np.zeros((2, 3), np.float32)),))  # fmt: skip


def test_a_clip_plays_loops_and_stops() -> None:
    scene = Scene("s", animations=(_clip(2.0),))
    transport = Transport()
    transport.toggle()
    assert not transport.playing and not transport.advance(1.0)  # at rest there is nothing to play
    transport.choose(scene, 0)
    transport.toggle()
    assert transport.advance(1.5) and transport.advance(1.0) and transport.time == pytest.approx(0.5)
    transport.loop = False
    assert transport.advance(5.0) and transport.time == 2.0 and not transport.playing
    transport.toggle()
    assert transport.time == 0.0 and transport.playing
    transport.step(3)
    assert not transport.playing and transport.time == pytest.approx(3 / 24)


def test_every_aov_has_colours_and_a_legend() -> None:
    rng = np.random.default_rng(1)
    for name, row in AOVS.items():
        shape = row.shape(6, 5, lights=2)
        array = (
            rng.integers(0, 4, shape).astype(row.dtype) if row.dtype != "float32" else rng.random(shape).astype("f4")
        )
        array.reshape(-1)[0] = row.miss if row.miss is not None else 0
        rgb, legend = views.colour(name, array, views.Look(bounds=np.array([[0, 0, 0], [1, 1, 1.0]])))
        assert rgb.shape == (6, 5, 3) and rgb.dtype == np.uint8 and legend is not None, name


def test_views_mean_what_their_legends_say() -> None:
    depth = np.linspace(2, 12, 200, dtype=np.float32).reshape(10, 20)
    depth[0, 0] = np.inf
    rgb, legend = views.colour("depth", depth, views.Look())
    assert isinstance(legend, views.Scale) and 2 < legend.low < 2.3 and 11.7 < legend.high < 12 and legend.unit == "m"
    assert tuple(rgb[0, 0]) == views.MISS and tuple(rgb[-1, -1]) == tuple(views.palette("viridis")[-1])
    reason = np.full((4, 4), CONSTANTS["REASON_ENVIRONMENT"], np.uint8)
    reason[0] = CONSTANTS["REASON_ROUGH"]
    rgb, legend = views.colour("reason", reason, views.Look())
    assert isinstance(legend, views.Swatches) and [r[0] for r in legend.rows] == ["environment", "rough"]
    assert legend.rows[0][2] == 0.75 and tuple(rgb[1, 1]) == legend.rows[0][1]
    ids = np.array([[0, 1], [1, NO_ID]], np.uint32)
    rgb, legend = views.colour("instance_id", ids, views.Look(names={"instance_id": ["floor", "lamp"]}))
    assert isinstance(legend, views.Swatches) and legend.rows[0][0] == "lamp" and tuple(rgb[1, 1]) == views.MISS
    grey = np.full((1, 1, 3), 0.5, np.float32)
    assert views.colour("albedo", grey, views.Look(exposure=3.0))[0][0, 0, 0] == 188
    grey[0, 0, 0] = np.nan
    assert tuple(views.colour("radiance", grey, views.Look())[0][0, 0]) == views.NON_FINITE


def make_controls() -> tuple[Controls, list[str]]:
    scene = Scene("s", cameras=(Camera.look_at((0, 0, 5), (0, 0, 0)), Camera.look_at((5, 0, 0), (0, 0, 0))))
    said: list[str] = []
    session = Session(scene, "s.glb")
    controls = Controls(session, lambda name, at: said.append(name), lambda: 5.0, lambda: ("picture", "normal"), SIZE)
    return controls, said


def feed(controls: Controls, *events: object, free: bool = True) -> None:
    for event in events:
        controls.feed(event, free, free)  # type: ignore[arg-type]


def test_a_click_picks_and_a_drag_does_not() -> None:
    controls, said = make_controls()
    feed(controls, Move(100, 100), Button(LEFT, True), Move(101, 101), Button(LEFT, False))
    assert said == ["pick"] and controls.session.pose is None
    feed(controls, Button(LEFT, True), Button(LEFT, False))
    assert said == ["pick", "look_at"]
    feed(controls, Button(LEFT, True), Move(160, 100), Button(LEFT, False))
    assert len(said) == 2 and controls.session.pose is not None
    feed(controls, Button(LEFT, True), free=False)
    assert controls.dragging == ""


def test_a_lost_window_lets_go_of_all_keys() -> None:
    controls, _ = make_controls()
    feed(controls, Move(10, 10), Button(1, True), Key("w", True))
    assert controls.flying
    feed(controls, Focus(False))
    assert not controls.flying and controls.dragging == ""


def test_cameras_wheel_and_techniques() -> None:
    controls, _ = make_controls()
    session = controls.session
    feed(controls, Key("2", True), Key("2", False))
    assert session.camera_index == 1 and session.pose is None
    feed(controls, Move(200, 150), Wheel(0, 2.0))
    assert session.pose is not None and control.distance(session.pose) == pytest.approx(5 * control.WHEEL**2)
    for _ in SHADOWS:
        feed(controls, Key("t", True), Key("t", False))
    assert session.a.shadows == Settings().shadows and len(SHADOWS) > 5


def test_the_command_line_holds_what_differs() -> None:
    controls, _ = make_controls()
    session = controls.session
    session.source = "my scene.glb"
    session.set("a", shadows="pcf", terminator=True, samples=9, parameters={"shadows.pcf.radius": 2.0})
    words = shlex.split(session.command((64, 48)))
    assert words[:5] == ["glhybrid", "render", "my scene.glb", "--size", "64x48"]
    assert {"terminator=true", "shadows.pcf.radius=2.0"} <= set(words) and words[words.index("--samples") + 1] == "9"
    assert "--camera" not in words and "--light" not in words
    assert session.b.samples == 9 and not session.b.terminator  # counts are of both sides, the rest is not


def test_kept_settings_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CONFIG", str(tmp_path))
    controls, _ = make_controls()
    session = controls.session
    session.set("a", shadows="csm", parameters={"shadows.csm.cascades": 2})
    session.mode, session.show, session.divider = "split", "normal", 0.25
    marks = store.Bookmarks({})
    marks.add("s.glb", "corner", POSES["tilted"])
    store.write(store.snapshot(session) | marks.to_dict())
    fresh = make_controls()[0].session
    saved = store.read()
    store.restore(fresh, saved)
    assert fresh.a == session.a and (fresh.mode, fresh.show, fresh.divider) == ("split", "normal", 0.25)
    assert store.Bookmarks(saved).of("s.glb") == [("corner", POSES["tilted"])]


@pytest.mark.parametrize(
    "content", ["", "{", "[1]", "\x00\xff", '{"version": 99}', json.dumps({"version": 1, "a": {"shadows": "magic", "aa": -5},
    "mode": 7, "divider": "x", "bookmarks": {"s": [{"name": "n", "pose": {"eye": [1]}}, 5]}, "show": None})],
)  # fmt: skip
def test_a_bad_file_is_ignored_with_a_warning(
    content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("GLHYBRID_CONFIG", str(tmp_path))
    monkeypatch.setattr(logging.getLogger("glhybrid"), "propagate", True)
    (tmp_path / "viewer.json").write_text(content, encoding="latin-1")
    session = make_controls()[0].session
    with caplog.at_level(logging.WARNING, "glhybrid"):
        saved = store.read()
        store.restore(session, saved)
        assert store.Bookmarks(saved).of("s") == []
    assert "viewer.json" in caplog.text and session.a == Settings() and session.mode == "single"


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("GLHYBRID_CONFIG", str(tmp_path / "file" / "sub"))
    store.write({})


def test_a_missing_library_is_named_with_what_installs_it() -> None:
    from glhybrid.errors import DeviceError
    from glhybrid.viewer import need

    with pytest.raises(DeviceError, match=r"no_such_library.*pip install 'glhybrid\[viewer\]'") as caught:
        need("no_such_library", "viewer")
    assert caught.value.exit_code == 3


def test_escape_goes_back_to_the_picture() -> None:
    controls, _ = make_controls()
    feed(controls, Key("v", True), Key("v", False))
    assert controls.session.show == "normal"
    feed(controls, Key("escape", True))
    assert controls.session.show == "picture"


def test_the_command_says_how_the_file_is_read() -> None:
    camera = Camera.look_at((0, 0, 3), (0, 0, 0))
    session = Session(Scene("scan", cameras=(camera,)), "scan.stl", ("--smooth", "--allow-outside"))
    assert {"--smooth", "--allow-outside"} <= set(shlex.split(session.command((64, 48))))
    assert "--smooth" not in Session(session.scene, "scan.stl").command((64, 48))
