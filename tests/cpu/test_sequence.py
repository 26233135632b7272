"""Frame ranges, file names, turntables, and what is refused before any work is done."""

import re
from pathlib import Path

import numpy as np
import pytest
from test_pose import channel, quad, scene_of

from glhybrid import cli, sequence
from glhybrid.camera_path import Turntable
from glhybrid.errors import OutputError, SettingError
from glhybrid.scene import Camera, Instance, Node, Scene
from glhybrid.settings import Settings


def moving() -> Scene:
    """2 s long, 49 frames at 24 a second."""
    camera = Camera.look_at((0.5, 0.5, 4), (0.5, 0.5, 0))
    return scene_of(
        quad(), (Node("n", -1),), channel("translation", [[0] * 3, [1, 0, 0]], (0, 2)),
        instances=(Instance(0, np.eye(4), node=0),), cameras=(camera,),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("0:4", [0, 1, 2, 3]), ("2:9:3", [2, 5, 8]), (":", list(range(10))), ("7:", [7, 8, 9]), (":3", [0, 1, 2]),
        ("-2:", [8, 9]), ("5:-3", [5, 6]), ("::4", [0, 4, 8]), ("8:12", [8, 9, 10, 11]), ("-99:2", [0, 1]),
    ],
)  # fmt: skip
def test_frames_are_a_python_slice(text: str, want: list[int]) -> None:
    assert list(sequence.parse_frames(text, 10)) == want


@pytest.mark.parametrize("text", ["", "3", "a:b", "3:3", "5:2", "0:9:0", "0:9:-1", "0:1e3", "0:2000000"])
def test_frames_that_are_none(text: str) -> None:
    with pytest.raises(SettingError, match="--frames"):
        sequence.parse_frames(text, 10)


def test_times_are_those_of_the_numbers() -> None:
    made = sequence.make(moving(), Settings(), ":", 24)
    assert made.numbers == range(49)
    assert made.settings_at(30).time == 30 / 24
    assert list(sequence.make(moving(), Settings(), "-1:", 24).numbers) == [48]
    still = sequence.make(moving().replace(animations=()), Settings(), move=Turntable(8, (0, 0, 0)))
    assert still.numbers == range(8) and still.settings_at(3).time is None


def test_refused_before_any_work() -> None:
    scene = moving()
    with pytest.raises(SettingError, match="nothing moves"):
        sequence.make(scene.replace(animations=()), Settings(), "0:4", 24)
    for fps in (0, -1, float("nan"), 1e9):
        with pytest.raises(SettingError, match="--fps"):
            sequence.make(scene, Settings(), "0:4", fps)
    with pytest.raises(SettingError, match="give one"):
        sequence.make(scene, Settings(time=1), "0:4", 24)
    with pytest.raises(SettingError, match="did you mean"):
        sequence.make(scene, Settings(clip="wlak"), "0:4", 24)
    with pytest.raises(SettingError, match="turntable -1"):
        sequence.turntable(scene, -1)


def test_names_of_files() -> None:
    assert sequence.frame_path("a/b_{frame:04d}.png", 7) == Path("a/b_0007.png")
    for pattern in ("out.png", "x_{{frame}}.png", "{other}.png", "{frame:zz}.png", "{.png"):
        with pytest.raises(OutputError):
            sequence.frame_path(pattern, 7)


def test_a_turntable_goes_round() -> None:
    still = moving().replace(animations=())
    made = sequence.make(still, Settings(), move=sequence.turntable(still, 4))
    middle = np.array([0.5, 0.5, 0])
    for number, eye in enumerate([(0.5, 0.5, 4), (4.5, 0.5, 0), (0.5, 0.5, -4), (-3.5, 0.5, 0), (0.5, 0.5, 4)]):
        camera = made.camera_at(number)
        assert isinstance(camera, Camera)
        np.testing.assert_allclose(camera.world_from_view[:3, 3], eye, atol=1e-12)
        towards = middle - camera.world_from_view[:3, 3]
        np.testing.assert_allclose(-camera.world_from_view[:3, 2], towards / 4, atol=1e-12)
        np.testing.assert_allclose(camera.world_from_view[:3, 1], [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--turn", "90"), "--turn is for turntables"),
        (("--about", "0,0,0"), "--about is for turntables"),
        (("--turntable", "4", "--path", "a.toml"), "give one"),
        (("--turntable", "4", "--about", "1,2"), "expected X,Y,Z"),
        (("--turntable", "-4"), "expected how many frames"),
        (("--path", "gone.toml"), "No such file"),
        (("--overwrite",), "give --frames"),
        (("-o", "a.mp4"), "made of --frames"),
        (("--frames", "0:2", "-o", "a.gif", "--fps", "99"), "at most 50"),
        (("--frames", "0:2", "-o", "a.webp", "--aov", "depth"), "a movie holds no AOVs"),
        (("--frames", "0:2", "-o", "gone/a.webp"), "there is no folder"),
        (("--frames", "0:2", "-o", "a.avi"), "not a pattern|every frame would have this name"),
        (("--frames", "0:2"), "nothing moves"),
    ],
)  # fmt: skip
def test_flags_that_mean_nothing(
    arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Refused with one line and exit status 2, and nothing written."""
    monkeypatch.chdir(tmp_path)
    Path("t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    before = sorted(tmp_path.iterdir())
    assert cli.main(["render", "t.obj", "--size", "32x32", *arguments]) == 2
    out, err = capsys.readouterr()
    assert not out and re.search(says, err) and "Traceback" not in err
    assert sorted(tmp_path.iterdir()) == before
