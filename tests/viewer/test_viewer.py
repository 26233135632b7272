"""The viewer's pictures are `render`'s, and every input does what it says."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import glhybrid
from glhybrid import Renderer, Settings, cli, relight
from glhybrid.context import Context
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.events import LEFT, MIDDLE, RIGHT, Button, Key, Move, Wheel
from glhybrid.viewer.panels import WIDTH

PICTURE_SIZE = (96, 64)
COMMON = cli.Common()
Open = Callable[..., Viewer]


def shown(viewer: Viewer) -> np.ndarray:
    """The picture region of what was presented."""
    width, height = viewer.picture_size
    return viewer.canvas_rgb()[:height, :width]


def press(viewer: Viewer, *names: str) -> None:
    for name in names:
        viewer.surface.feed(Key(name, True), Key(name, False))  # type: ignore[attr-defined]
    viewer.tick()


def drag(viewer: Viewer, button: int, start: tuple[float, float], end: tuple[float, float], held: str = "") -> None:
    keys = [Key(held, True)] if held else []
    viewer.surface.feed(*keys, Move(*start))  # type: ignore[attr-defined]
    viewer.tick()
    viewer.surface.feed(Button(button, True), Move(*start), Move((start[0] + end[0]) / 2, (start[1] + end[1]) / 2))  # type: ignore[attr-defined]
    viewer.tick()
    viewer.surface.feed(Move(*end), Button(button, False), *(Key(k.name, False) for k in keys))  # type: ignore[attr-defined]
    viewer.tick()


def rendered(viewer: Viewer, context: Context, command: str) -> np.ndarray:
    """What the copied command line gives."""
    words = shlex.split(command)
    assert words[:3] == ["glhybrid", "render", viewer.session.source]
    found: dict[str, Any] = {}

    def take(scene: str, /, *, output: str, common: cli.Common = COMMON) -> None:
        with Renderer(context=context) as renderer:
            settings = common.settings()
            loaded = relight.apply(viewer._load(scene), common.light, common.environment_rotation)
            frame = renderer.render(
                loaded, common.camera_key(), common.pixels(), settings.replace(aa=settings.aa_frames(False))
            )
        found["rgb"] = frame.rgb

    from cyclopts import App, Parameter

    app = App(default_parameter=Parameter(negative=()))
    words[words.index("-o")] = "--output"
    app.default(take)
    app(words[2:], result_action="return_value")
    rgb: np.ndarray = found["rgb"]
    return rgb


def plain(viewer: Viewer) -> np.ndarray:
    """The picture region without labels: they cover its corners."""
    return np.asarray(viewer.pictures.picture(viewer.pictures.shown()[0]).rgb())


def test_a_finished_picture_is_what_render_makes(open_viewer: Open, context: Context) -> None:
    viewer = open_viewer()
    viewer.settle()
    with Renderer(context=context) as renderer:
        want = renderer.render(viewer.session.scene, size=PICTURE_SIZE).rgb
    assert np.array_equal(plain(viewer), want)
    # On the canvas too, but for the label in the corner.
    assert np.array_equal(shown(viewer)[-8:], want[-8:])


@pytest.mark.parametrize("scene", ["cornell", "yard"])
def test_the_copied_command_makes_the_same_picture(open_viewer: Open, context: Context, scene: str) -> None:
    viewer = open_viewer(scene)
    viewer.settle()
    drag(viewer, LEFT, (40, 30), (63, 22))
    drag(viewer, MIDDLE, (40, 30), (45, 36))
    viewer.surface.feed(Move(50, 20), Wheel(0, 1.5))  # type: ignore[attr-defined]
    viewer.tick()
    viewer.session.set("a", shadows="pcf", exposure=0.5, tone="aces", parameters={"shadows.pcf.radius": 2.5})
    sun = viewer.session.sun()
    if sun >= 0:
        viewer.session.turn_light(sun, 31.4159, 47.11)
    if viewer.session.scene.environment is not None:
        viewer.session.turn_environment(-123.456)
    viewer.settle()
    press(viewer, "c")
    command = viewer.surface.get_clipboard()
    assert "--camera" in command and "shadows.pcf.radius=2.5" in command
    assert np.array_equal(plain(viewer), rendered(viewer, context, command))


def test_reference_and_animation_are_renders_too(open_viewer: Open, context: Context) -> None:
    viewer = open_viewer(a=Settings(reflections="reference", samples=3))
    viewer.settle()
    with Renderer(context=context) as renderer:
        want = renderer.render(
            viewer.session.scene, size=PICTURE_SIZE, settings=Settings(reflections="reference", samples=3)
        )
    assert np.array_equal(plain(viewer), want.rgb)


def test_motion_is_answered_small_and_rest_in_full(open_viewer: Open) -> None:
    viewer = open_viewer("yard", size=(320, 200))
    viewer.settle()
    viewer.pictures.budget.target_ms = viewer.pictures.sides["a"].last_ms / 4
    drag(viewer, LEFT, (100, 100), (140, 90))
    assert viewer.pictures.moving and viewer.pictures.scale <= 0.5
    assert viewer.pictures.sides["a"].size == tuple(round(v * viewer.pictures.scale) for v in (320, 200))
    viewer.settle()
    assert not viewer.pictures.moving and viewer.pictures.sides["a"].size == (320, 200)
    assert viewer.pictures.sides["a"].done == viewer.pictures.sides["a"].total == 4


def test_pointer_moves_the_camera(open_viewer: Open) -> None:
    viewer = open_viewer()
    viewer.settle()
    session = viewer.session
    drag(viewer, LEFT, (40, 30), (60, 30))
    orbited = session.pose
    assert orbited is not None
    drag(viewer, RIGHT, (40, 30), (60, 30))
    looked = session.pose
    assert looked is not None and looked.eye == orbited.eye and looked.target != orbited.target
    drag(viewer, LEFT, (40, 30), (60, 30), held="left_shift")
    panned = session.pose
    assert panned is not None
    assert np.allclose(np.subtract(panned.eye, looked.eye), np.subtract(panned.target, looked.target))
    press(viewer, "home")
    assert session.pose is None


def test_input_over_the_panel_leaves_the_picture_alone(open_viewer: Open) -> None:
    viewer = open_viewer(size=(96, 300))
    viewer.settle()
    drag(viewer, LEFT, (200, 250), (260, 250))
    assert viewer.session.pose is None and viewer.session.picked is None


def test_keys(open_viewer: Open) -> None:
    viewer = open_viewer()
    session = viewer.session
    press(viewer, "m")
    assert session.mode == "split"
    press(viewer, "x")
    assert session.flipped
    press(viewer, "x", "t")
    assert session.a.shadows != "ray"
    press(viewer, "r")
    assert session.reference
    press(viewer, "v")
    assert session.show != "picture"
    press(viewer, "equal", "equal")
    assert session.a.exposure == session.b.exposure == 0.5
    press(viewer, "tab")
    assert not session.panel and viewer.picture_size == viewer.surface.size
    press(viewer, "tab", "h", "b")
    assert session.help and [n for n, _ in viewer.bookmarks.of("cornell")] == ["view 1"]
    viewer.surface.feed(Key("left_ctrl", True), Key("q", True))  # type: ignore[attr-defined]
    viewer.tick()
    assert not viewer.running


def test_a_drag_of_the_divider_moves_it_and_not_the_camera(open_viewer: Open) -> None:
    viewer = open_viewer(mode="split")
    viewer.settle()
    left, right = (np.asarray(viewer.pictures.sides[s].rgb()) for s in ("a", "b"))
    assert np.array_equal(shown(viewer)[-8:, :40], left[-8:, :40]) and np.array_equal(
        shown(viewer)[-8:, -40:], right[-8:, -40:]
    )
    drag(viewer, LEFT, (48, 40), (24, 40))
    assert viewer.session.pose is None and viewer.session.divider == pytest.approx(0.25)
    drag(viewer, LEFT, (24, 40), (-300, 40))  # over the border: the handle stays where it can be taken
    assert viewer.session.divider == pytest.approx(0.02)
    drag(viewer, LEFT, (2, 40), (48, 40))
    assert viewer.session.divider == pytest.approx(0.5)


def test_picking_reads_the_aovs_of_that_pixel(open_viewer: Open, context: Context) -> None:
    viewer = open_viewer("yard", size=(160, 100))
    viewer.settle()
    names = ("instance_id", "material_id", "triangle_id", "position", "normal", "distance", "depth", "bvh_steps")
    with Renderer(context=context) as renderer:
        frame = renderer.render(viewer.session.scene, size=(160, 100), aovs=names)
    for x, y in ((80, 60), (55, 60), (100, 50), (120, 88), (10, 80)):
        picked = viewer.pick((x, y))
        assert picked.instance == frame["instance_id"][y, x] and picked.material == frame["material_id"][y, x]
        assert picked.triangle == frame["triangle_id"][y, x]
        assert np.allclose(picked.position, frame["position"][y, x], atol=1e-4 * viewer.session.extent())
        assert np.allclose(picked.normal, frame["normal"][y, x], atol=2e-3)  # normal maps: the footprint is the same
        assert picked.distance == pytest.approx(frame["distance"][y, x], rel=1e-4)
        assert picked.depth == pytest.approx(frame["depth"][y, x], rel=1e-4)
        assert viewer.pick((5, 5)).instance == -1  # the sky
        assert picked.steps == pytest.approx(int(frame["bvh_steps"][y, x]), abs=3)
    before = plain(viewer)
    viewer.settle()
    assert np.array_equal(plain(viewer), before)


def test_every_view_is_shown(open_viewer: Open) -> None:
    viewer = open_viewer(size=(48, 32))
    viewer.settle()
    for name in viewer.panels.views():
        viewer.session.show = name
        viewer.session.edited()
        viewer.settle()
        assert not [s for s in viewer.session.said if s.error], name
        found = viewer.pictures.image("a")
        assert found is not None and found[0].size == (48, 32), name


def test_errors_fall_as_sides_are_the_reference(open_viewer: Open) -> None:
    """Against the reference: the reference's own error is 0, another technique's is not."""
    viewer = open_viewer(a=Settings(reflections="reference", samples=4), mode="flip", reference=True)
    viewer.settle()
    error = viewer.pictures.measure.errors["a"]
    assert error.rel_mse == 0 and error.psnr == float("inf")
    viewer.session.set("a", reflections="env", shadows="none")
    viewer.settle()
    error = viewer.pictures.measure.errors["a"]
    assert error.rel_mse > 1e-3 and error.psnr < 40


def test_a_technique_that_fails_leaves_the_last_good_one(open_viewer: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = open_viewer()
    viewer.settle()
    before = plain(viewer)
    real = viewer.renderer.stage

    def stage(scene: Any, settings: Settings, *rest: Any) -> Any:
        if settings.shadows == "csm":
            raise glhybrid.ShaderError("shadow_map: does not compile")
        return real(scene, settings, *rest)

    monkeypatch.setattr(viewer.renderer, "stage", stage)
    viewer.session.set("a", shadows="csm")
    viewer.settle()
    assert viewer.session.a.shadows == "ray" and any("does not compile" in s.text for s in viewer.session.said)
    assert np.array_equal(plain(viewer), before)


@pytest.mark.parametrize("made_ahead", ["baked", "probe"])
def test_what_is_made_ahead_of_light_waits_until_it_rests(open_viewer: Open, context: Context, made_ahead: str) -> None:
    """In motion something quicker stands for it, and says so; at rest it is `render`'s picture under the new light."""
    chosen = Settings(shadows="baked", parameters={"shadows.baked.texels": 2.0}, aa=1)
    viewer = open_viewer("yard", a=chosen if made_ahead == "baked" else Settings(reflections="probe", aa=1))
    viewer.settle()
    before = viewer.pictures.sides["a"].staged
    press(viewer, "x", "x")
    assert not viewer.pictures.stands_in("a")
    viewer.session.turn_light(0, 75.0, 30.0)
    viewer.tick()
    assert made_ahead in viewer.pictures.stands_in("a") and made_ahead in str(viewer.session.a)
    viewer.settle()
    assert not viewer.pictures.stands_in("a") and viewer.pictures.sides["a"].staged is not before
    assert np.array_equal(plain(viewer), rendered(viewer, context, viewer.session.command(viewer.picture_size)))


def test_a_clip_plays_and_stops_at_renders_picture(open_viewer: Open, context: Context, models: Path) -> None:
    """A skinned model in a split view: both sides move, and where it stops it is `render --time`'s picture."""
    source = str(models / "Fox" / "Fox.glb")
    viewer = open_viewer(source, mode="split")
    viewer.settle()
    still = plain(viewer).copy()
    press(viewer, "space")
    for _ in range(6):
        viewer.tick()
    assert viewer.session.transport.playing and viewer.session.transport.time > 0
    press(viewer, "space")
    viewer.settle()
    assert not viewer.session.transport.playing and not np.array_equal(plain(viewer), still)
    command = viewer.session.command(viewer.picture_size)
    assert "--time" in command and "--clip 0" in command
    assert np.array_equal(plain(viewer), rendered(viewer, context, command))


def test_on_a_display_of_two_pixels_a_point(open_viewer: Open, context: Context) -> None:
    """Text and panel are twice as large, the picture is still `render`'s, and the pointer picks what is under it."""
    viewer = open_viewer("yard", size=(3 * WIDTH, 200))
    viewer.settle()
    assert viewer.picture_size == (3 * WIDTH, 200)
    before = viewer.gui.imgui.get_style().frame_padding.x
    viewer.surface.scale = 2.0  # type: ignore[attr-defined]  # the window is moved to another display
    viewer.settle()
    style = viewer.gui.imgui.get_style()
    assert style.frame_padding.x == 2 * before and style.font_scale_dpi == 2
    assert viewer.picture_size == (2 * WIDTH, 200)
    with Renderer(context=context) as renderer:
        want = renderer.render(viewer.session.scene, size=viewer.picture_size, aovs=("instance_id",))
    assert np.array_equal(plain(viewer), want.rgb)
    width = viewer.picture_size[0]
    for x in (width // 2 - 30, width // 2 + 30):
        drag(viewer, LEFT, (x, 120), (x, 120))
        assert viewer.session.picked.instance == want["instance_id"][120, x]
    viewer.surface.feed(Move(width + 40, 60))  # type: ignore[attr-defined]
    viewer.tick()
    assert viewer.gui.wants_pointer  # that is the panel there
