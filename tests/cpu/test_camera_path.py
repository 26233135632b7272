"""Camera paths: through their keys, smooth as each interpolation promises, exact round the loop; every bad file refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glhybrid import camera_path, sequence
from glhybrid.camera_path import INTERPOLATIONS, CameraPath, Turntable
from glhybrid.errors import GlhybridError, SettingError
from glhybrid.scene import Camera
from glhybrid.settings import Settings

ANY = Camera("scene's", np.eye(4))
UP = (0.0, 1.0, 0.0)


def path_of(times: Any, eye: Any, **more: Any) -> CameraPath:
    count = len(times)
    more = {
        "target": np.tile([0.0, 0, -9], (count, 1)),
        "up": np.tile(UP, (count, 1)),
        "zoom": np.full(count, 0.8),
    } | more
    return CameraPath(np.array(times, float), np.array(eye, float), **more)


def eye(path: CameraPath, time: float) -> Any:
    return path.at(time, 0, ANY).world_from_view[:3, 3]


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_a_path_goes_through_its_keys_and_holds_its_ends(interpolation: Any) -> None:
    rng = np.random.default_rng(1)
    times, keys = [0.5, 1, 3, 3.2, 5], rng.normal(size=(5, 3))
    path = path_of(times, keys, interpolation=interpolation)
    for time, key in zip(times, keys, strict=True):
        np.testing.assert_allclose(eye(path, time), key, atol=1e-12)
    np.testing.assert_array_equal(eye(path, 0), keys[0])
    np.testing.assert_array_equal(eye(path, 99), keys[-1])
    view = path.at(2.2, 0, ANY).world_from_view
    np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-12)
    to_target = np.array([0, 0, -9]) - view[:3, 3]
    np.testing.assert_allclose(-view[:3, 2], to_target / np.linalg.norm(to_target), atol=1e-12)
    assert path.length(24) == 121


def derivatives(path: CameraPath, time: float, h: float = 1e-4) -> tuple[Any, Any]:
    """Second-order differences from one side: first and second derivative just before (h < 0) or after a time."""
    p = [eye(path, time + k * h) for k in range(4)]
    return (-1.5 * p[0] + 2 * p[1] - 0.5 * p[2]) / h, (2 * p[0] - 5 * p[1] + 4 * p[2] - p[3]) / h**2


def test_smoothness_at_the_keys() -> None:
    """Catmull-Rom: slopes meet. Cubic: curvatures meet too, and vanish at the ends. Linear: neither."""
    rng = np.random.default_rng(2)
    times, keys = [0, 1, 3, 3.5, 5, 6], rng.normal(size=(6, 3))
    jump: dict[str, tuple[float, float]] = {}
    for interpolation in INTERPOLATIONS:
        path = path_of(times, keys, interpolation=interpolation)
        sides = [(derivatives(path, t, -1e-4), derivatives(path, t)) for t in times[1:-1]]
        jump[interpolation] = tuple(max(np.abs(a[k] - b[k]).max() for a, b in sides) for k in (0, 1))  # type: ignore[assignment]
    assert jump["linear"][0] > 0.5 and jump["catmull-rom"][0] < 1e-5 < 0.5 < jump["catmull-rom"][1]
    assert jump["cubic"][0] < 1e-5 and jump["cubic"][1] < 0.01
    natural = path_of(times, keys, interpolation="cubic")
    assert np.abs(derivatives(natural, 0)[1]).max() < 0.01


def test_catmull_rom_is_exact_for_parabolas_whatever_the_times() -> None:
    times = np.array([0, 0.3, 1, 2.5, 3])
    path = path_of(times, np.column_stack([times, times**2, 1 - 2 * times**2]))
    for t in np.linspace(0, 3, 17):
        np.testing.assert_allclose(eye(path, t), [t, t * t, 1 - 2 * t * t], atol=1e-12)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_a_loop_has_no_seam(interpolation: Any) -> None:
    angle = np.radians([0, 90, 180, 270, 360])
    ring = np.column_stack([np.cos(angle), np.zeros(5), np.sin(angle)])
    ring[-1] = ring[0]
    path = path_of([1, 2, 3, 4, 5], ring, interpolation=interpolation, loop=True)
    np.testing.assert_array_equal(eye(path, 5.5), eye(path, 1.5))
    np.testing.assert_allclose(eye(path, 0.75), eye(path, 4.75), atol=1e-12)
    if interpolation != "linear":
        before, after = derivatives(path, 5, -1e-4), derivatives(path, 5)
        np.testing.assert_allclose(before[0], after[0], atol=1e-5)
        np.testing.assert_allclose(eye(path, 1.5)[[0, 2]], eye(path, 2.5)[[2, 0]] * [1, -1], atol=1e-12)
    if interpolation == "cubic":
        np.testing.assert_allclose(before[1], after[1], atol=1e-3)
    assert path.length(10) == 50  # frame 50 is frame 10 again


def test_zoom_is_a_field_of_view_or_a_height() -> None:
    turn = path_of([0, 1], [[0, 0, 0]] * 2, zoom=np.array([0.5, 1.0]), interpolation="linear")
    assert turn.at(0.5, 0, ANY).fov_y == pytest.approx(0.75)
    flat = path_of([0, 1], [[0, 0, 0]] * 2, zoom=np.array([2.0, 4.0]), orthographic=True, interpolation="linear")
    made = flat.at(0.5, 0, ANY)
    assert made.fov_y == 0 and made.ymag == pytest.approx(3)


FILE = """
interpolation = "cubic"
[[key]]
time = 0
eye = [0, 1, 5]
target = [0, 1, 0]
[[key]]
time = 2
eye = [5, 1, 0]
target = [0, 1, 0]
fov_y_deg = 60
"""


def test_a_path_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "path.toml"
    file.write_text(FILE)
    path = camera_path.read(file)
    assert isinstance(path, CameraPath) and path.interpolation == "cubic" and path.length(24) == 49
    first, last = path.at(0, 0, ANY), path.at(2, 0, ANY)
    np.testing.assert_array_equal(first.world_from_view, Camera.look_at((0, 1, 5), (0, 1, 0)).world_from_view)
    assert (first.fov_y, last.fov_y) == (pytest.approx(np.pi / 4), pytest.approx(np.pi / 3))
    still = sequence.make(model_scene(), Settings(), fps=10, move=path)
    assert still.numbers == range(21)
    camera = still.camera_at(20)
    assert isinstance(camera, Camera)
    np.testing.assert_allclose(camera.world_from_view[:3, 3], [5, 1, 0], atol=1e-12)


def model_scene() -> Any:
    from test_sequence import moving

    return moving().replace(animations=())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("time = 2", "time = 0"), "times must rise"),
        (("time = 2", "time = -2"), "must not be negative"),
        (("time = 2\n", ""), "time is missing"),
        (("eye = [5, 1, 0]", "eye = [0, 1, 0]"), "is where the eye is"),
        (("eye = [5, 1, 0]", "eye = [5, 1]"), "list of 3 numbers"),
        (("eye = [5, 1, 0]", "eyes = [5, 1, 0]"), 'did you mean "eye"'),
        (("cubic", "cubik"), 'did you mean "cubic"'),
        (("fov_y_deg = 60", "fov_y_deg = 190"), "between"),
        (("fov_y_deg = 60", "height = 2"), "fov_y_deg or height"),
        (("fov_y_deg = 60", "up = [0, 0, 0]"), "must not be zero"),
        (("fov_y_deg = 60", "roll = 1"), "unknown key"),
        (('interpolation = "cubic"', "loop = true"), "3 keys or more"),
        (('interpolation = "cubic"', "nearest = 1"), "unknown key"),
    ],
)
def test_bad_files(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    file = tmp_path / "path.toml"
    text = FILE.replace(*change)
    assert text != FILE
    file.write_text(text)
    with pytest.raises(GlhybridError, match=says) as caught:
        camera_path.read(file)
    assert "path.toml" in str(caught.value)


def test_files_that_are_no_path(tmp_path: Path, models: Path) -> None:
    (tmp_path / "empty.toml").write_text("")
    for name, says in (
        ("gone.toml", "No such file"), ("empty.toml", "no .*key"), ("a.txt", "camera path is a"), ("gone.glb", "no such file"),
        (str(models / "Fox/Fox.glb"), "no camera that a clip moves"),
    ):  # fmt: skip
        with pytest.raises(GlhybridError, match=says):
            camera_path.read(tmp_path / name)


def test_an_eye_that_meets_its_target_is_refused() -> None:
    path = path_of([0, 2], [[0, 0, 1], [0, 0, -1]], target=np.array([[0, 0, -1.0], [0, 0, 1]]), interpolation="linear")
    with pytest.raises(SettingError, match="at 1 s the eye is at its target"):
        path.at(1.0, 0, ANY)


def test_the_moving_camera_of_another_scene() -> None:
    from test_pose import channel

    from glhybrid.scene import Animation, Node, Scene

    nodes = (Node("still", -1), Node("rig", -1))
    carry = channel("translation", [[0, 0, 0], [4, 0, 0]], (0, 2), node=1)
    cameras = (Camera("a", np.eye(4), node=0), Camera("b", np.eye(4), node=1, fov_y=1.0))
    other = Scene("other", nodes=nodes, cameras=cameras, animations=(Animation("fly", (carry,)),))
    clip = camera_path.CameraClip(other)
    assert clip.length(24) == 49
    made = clip.at(0.5, 12, ANY)
    assert made.name == "b" and made.fov_y == 1.0
    np.testing.assert_allclose(made.world_from_view[:3, 3], [1, 0, 0], atol=1e-12)
    with pytest.raises(SettingError, match="no camera that a clip moves"):
        camera_path.CameraClip(other, camera=0)
    with pytest.raises(SettingError, match="did you mean"):
        camera_path.CameraClip(other, clip="flu")


def test_turntables() -> None:
    camera = Camera.look_at((0, 1, 4), (0, 1, 0))
    whole = Turntable(12, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(whole.at(0, 12, camera).world_from_view, whole.at(0, 0, camera).world_from_view)
    quarter = Turntable(12, (0.0, 0.0, 2.0), -90.0)
    np.testing.assert_allclose(quarter.at(0, 12, camera).world_from_view[:3, 3], [-2, 1, 2], atol=1e-12)
    np.testing.assert_allclose(quarter.at(0, 24, camera).world_from_view[:3, 3], [0, 1, 0], atol=1e-12)
    for bad in ((0, (0, 0, 0)), (5, (0, np.nan, 0))):
        with pytest.raises(SettingError):
            Turntable(*bad)  # type: ignore[arg-type]
    with pytest.raises(SettingError):
        Turntable(5, (0, 0, 0), np.inf)
