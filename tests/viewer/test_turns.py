"""While something long runs the viewer looks at its input: it drops what is not wanted any more, and shows what it does."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glhybrid import Renderer, Settings, content_cache
from glhybrid.context import Context
from glhybrid.errors import LoadError
from glhybrid.scene import Scene
from glhybrid.viewer import pictures, turns
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.events import LEFT, Button, Close, Event, Key, Move
from glhybrid.viewer.panels import WIDTH

Open = Callable[..., Viewer]
SIZE = (120, 90)
DRAG = (Move(50, 50), Button(LEFT, True), Move(60, 55), Move(70, 60))


@pytest.fixture
def slow(open_viewer: Open, monkeypatch: pytest.MonkeyPatch) -> Open:
    """open_viewer on a device that seems so slow that every row of tiles is a band, with the first frame shown."""
    monkeypatch.setattr(pictures, "SLICE_MS", 0.0)  # a turn of the loop draws one sample, or a part of one

    def open_(**state: Any) -> Viewer:
        viewer = open_viewer("yard", size=SIZE, **state)
        viewer.renderer.shaders.pace.band_ms = 1e-6
        viewer.pictures._software = True
        viewer.settle()
        viewer.pictures.restart()
        return viewer

    return open_


def later(viewer: Viewer, looks: int, *events: Event) -> None:
    """The events come at that look at the input: the first is the loop's, others are between bands."""
    surface: Any = viewer.surface
    poll = surface.poll

    def give(timeout: float) -> list[Event]:
        nonlocal looks
        looks -= 1
        if looks > 0:
            return list(poll(timeout))
        surface.poll = poll
        return [*poll(timeout), *events]

    surface.poll = give


def at_rest(viewer: Viewer) -> None:
    """Up to where the next turn of the loop draws the first sample in full."""
    while viewer.pictures.moving or viewer.pictures.sides["a"].size != SIZE:
        viewer.tick()
    viewer.pictures.restart()
    viewer.pictures._drawn, viewer.pictures._moving = viewer.pictures._key(), False


def rendered(viewer: Viewer, context: Context, settings: Settings) -> np.ndarray:
    with Renderer(context=context) as renderer:
        return renderer.render(viewer.session.lit_scene(), viewer.session.camera(), SIZE, settings).rgb


def plain(viewer: Viewer, side: Any = "a") -> np.ndarray:
    return np.asarray(viewer.pictures.picture(side).rgb())


@pytest.mark.parametrize("looks", [2, 7, 20])
def test_a_drag_ends_the_sample_that_is_being_drawn(slow: Open, context: Context, looks: int) -> None:
    viewer = slow()
    at_rest(viewer)
    before = plain(viewer).copy()
    later(viewer, looks, *DRAG)
    viewer.tick()
    picture = viewer.pictures.sides["a"]
    assert picture.done == 0 and viewer.turns.pending == list(DRAG[1:]) and viewer.session.pose is None
    assert np.array_equal(plain(viewer), before)  # what was shown is shown
    viewer.tick()
    assert viewer.session.pose is not None and viewer.pictures.moving and picture.done == 1
    viewer.surface.feed(Button(LEFT, False))  # type: ignore[attr-defined]
    viewer.settle()
    assert np.array_equal(plain(viewer), rendered(viewer, context, viewer.session.a))


def test_a_pointer_that_passes_and_one_over_the_panel_end_nothing(slow: Open) -> None:
    viewer = slow()
    at_rest(viewer)
    frames = viewer.frames
    later(viewer, 3, Move(10, 20), Move(SIZE[0] + WIDTH / 2, 20), Button(LEFT, True), Button(LEFT, False))
    viewer.tick()
    assert viewer.pictures.sides["a"].done >= 1 and viewer.controls.pointer == (SIZE[0] + WIDTH / 2, 20)
    assert viewer.frames >= frames + 2  # one of them in the middle of the sample


def test_closing_does_not_wait_for_the_sample(slow: Open) -> None:
    viewer = slow()
    at_rest(viewer)
    later(viewer, 2, Close())
    viewer.tick()
    assert viewer.running and viewer.pictures.sides["a"].done == 0
    viewer.tick()
    assert not viewer.running


def test_a_setting_that_the_panel_changes_ends_the_sample(slow: Open) -> None:
    viewer = slow()
    at_rest(viewer)
    real = viewer.panels.draw

    def draw(size: tuple[int, int]) -> None:
        real(size)
        viewer.panels.draw = real  # type: ignore[method-assign]
        viewer.session.set("a", shadows="none")

    viewer.panels.draw = draw  # type: ignore[method-assign]
    later(viewer, 3, Move(10, 20))
    viewer.tick()
    assert viewer.pictures.sides["a"].done == 0
    viewer.tick()
    assert viewer.pictures.moving and viewer.pictures.sides["a"].done == 1


@pytest.mark.parametrize("chosen", [Settings(), Settings(shadows="ray-soft", reflections="ray-glossy")])
def test_what_is_drawn_between_samples_leaves_renders_picture(slow: Open, context: Context, chosen: Settings) -> None:
    """A pick and an AOV after the second of four samples; for random techniques the picture has to begin anew."""
    viewer = slow(a=chosen)
    at_rest(viewer)
    while viewer.pictures.sides["a"].done != 2:
        viewer.tick()
    assert viewer.pick((60, 60)) is not None
    assert viewer.pictures.sides["a"].array("depth").shape == SIZE[::-1]
    viewer.settle()
    assert np.array_equal(plain(viewer), rendered(viewer, context, chosen))


def test_the_reference_goes_on_where_it_was(slow: Open, context: Context) -> None:
    """Parts of its paths are drawn between turns of the loop: input in between takes none of them away."""
    viewer = slow(a=Settings(samples=3), reference=True)
    reference = viewer.pictures.sides["reference"]
    while reference.done != 2:
        viewer.tick()
    viewer.surface.feed(Move(10, 20), Key("h", True), Key("h", False))  # type: ignore[attr-defined]
    viewer.tick()
    assert reference.done == 2 and viewer.session.help
    viewer.settle()
    assert reference.done == 3
    want = rendered(viewer, context, Settings(reflections="reference", samples=3, exposure=reference_ev(viewer)))
    assert np.array_equal(plain(viewer, "reference"), want)


def reference_ev(viewer: Viewer) -> float:
    """The reference is shown at the exposure of side A."""
    return float(viewer.pictures.sides["a"].exposure_ev())


# Preparations


def test_a_file_is_read_while_the_window_lives(open_viewer: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "PATIENCE_S", 0.0)
    viewer = open_viewer("yard", size=SIZE)
    viewer.settle()
    seen, shown = threading.Event(), []
    present = viewer.turns._present

    def watch() -> None:
        present()
        shown.append(viewer.turns.job)
        seen.set()

    viewer.turns._present = watch
    scene = viewer.session.scene

    def load(source: str) -> Scene:
        assert seen.wait(20) and threading.current_thread() is not threading.main_thread()
        return scene

    viewer._load = load
    viewer.surface.feed(Key("tab", True))  # type: ignore[attr-defined]
    viewer.open("other.glb")
    assert shown and shown[0] is not None and shown[0].what == "reading other.glb"
    assert viewer.session.source == "other.glb" and viewer.turns.job is None
    viewer.tick()
    assert not viewer.session.panel  # the key was not lost


def test_what_is_compiled_for_a_frame_does_not_ask_for_another(open_viewer: Open) -> None:
    viewer = open_viewer("yard", size=SIZE)
    viewer.settle()
    real, job = viewer.overlay.draw, []

    def draw(*about: Any) -> None:
        viewer.surface.feed(Key("escape", True))  # type: ignore[attr-defined]
        viewer.turns.progress("compiling exposure", 0, 0)
        job.append(viewer.turns.job)
        real(*about)

    viewer.overlay.draw = draw  # type: ignore[method-assign]
    viewer.turns._software = False  # where compiling is shown at once
    viewer.tick()
    viewer.act("bookmark")
    viewer.tick()
    assert job and set(job) == {None}


def test_escape_ends_reading_a_file(open_viewer: Open) -> None:
    viewer = open_viewer("yard", size=SIZE)
    viewer.settle()
    kept, ended = viewer.session.scene, threading.Event()

    def load(source: str) -> Scene:
        ended.wait(20)
        raise LoadError("too late to be heard")

    viewer._load = load
    viewer.surface.feed(Key("escape", True))  # type: ignore[attr-defined]
    viewer.open("other.glb")
    ended.set()
    assert viewer.session.scene is kept and viewer.session.source == "yard"
    assert [s.text for s in viewer.session.said] == ["reading other.glb: ended"]


def test_escape_ends_a_staging_and_leaves_nothing(
    open_viewer: Open, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    from test_viewer_leaks import objects

    monkeypatch.setattr(content_cache, "read", lambda *_: None)  # it is to be baked each time
    monkeypatch.setattr(turns, "LOOK_S", 0.0)
    viewer = open_viewer("yard", size=SIZE)
    viewer.settle()
    real, told = viewer.turns.progress, []

    def progress(what: str, done: int, total: int) -> None:
        told.append(what)
        if what.startswith("baking light"):
            viewer.surface.feed(Key("escape", True))  # type: ignore[attr-defined]
        real(what, done, total)

    for picture in viewer.pictures.sides.values():
        picture._progress = progress
    counts = []
    for _ in range(2):  # programs are compiled by the second
        viewer.session.set("a", shadows="baked", parameters={"shadows.baked.texels": 2.0})
        viewer.tick()
        assert viewer.session.a.shadows == "ray" and any("ended" in s.text for s in viewer.session.said)
        viewer.settle()
        counts.append(objects(context))
    assert counts[0] == counts[1]
    assert any(w.startswith("baking light") for w in told)
    viewer.session.set("a", shadows="baked", parameters={"shadows.baked.texels": 2.0})
    for picture in viewer.pictures.sides.values():
        picture._progress = real
    viewer.settle()
    assert viewer.session.a.shadows == "baked" and viewer.pictures.sides["a"].finished
