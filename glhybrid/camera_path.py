"""Cameras that move by themselves: turntables, keyframes of a TOML file, and the animated camera of another model.

Each has `at(time, frame, camera)`: the camera of a frame from the scene's own there. None looks at the frame before.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from glhybrid import pose as posing
from glhybrid.errors import LoadError, SettingError, unknown
from glhybrid.scene import F64, Camera, Scene

Interpolation = Literal["catmull-rom", "cubic", "linear"]
INTERPOLATIONS: tuple[Interpolation, ...] = ("catmull-rom", "cubic", "linear")
FOV_Y, NEAR = 45.0, 0.01


class CameraMove(Protocol):
    """How a camera moves through a sequence of frames."""

    def length(self, fps: float) -> int:
        """Frames from start to end."""

    def at(self, time: float, frame: int, camera: Camera) -> Camera:
        """The camera of a frame, at a time in seconds. camera: the scene's, where the clip has it then."""


@dataclass(frozen=True)
class Turntable:
    """The scene's camera turned about a vertical axis, `degrees` in `frames` frames, counter-clockwise from above.

    about: a point on the axis, world, metres. Whole turns join up: frame `frames` is frame 0 again, to the bit.
    """

    frames: int
    about: tuple[float, float, float]
    degrees: float = 360.0

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise SettingError(f"turntable {self.frames}: expected how many frames the turn takes, 1 or more")
        if not (np.isfinite(self.degrees) and abs(self.degrees) <= 360_000):
            raise SettingError(f"turn {self.degrees:g}: expected degrees, up to 360000 either way")
        if not np.isfinite(self.about).all():
            raise SettingError(f"about {self.about}: expected three finite numbers, metres")

    def length(self, fps: float) -> int:
        """Frames of the turn, whatever fps is."""
        return self.frames

    def at(self, time: float, frame: int, camera: Camera) -> Camera:
        """The scene's camera, turned for a frame; the time plays no part."""
        whole = self.degrees % 360 == 0
        angle = np.radians(self.degrees * ((frame % self.frames if whole else frame) / self.frames))
        turn = np.eye(4)
        turn[0, 0] = turn[2, 2] = np.cos(angle)
        turn[0, 2], turn[2, 0] = np.sin(angle), -np.sin(angle)
        about = np.asarray(self.about, np.float64)
        there, back = posing.translation_matrix(about), posing.translation_matrix(-about)
        return replace(camera, world_from_view=there @ turn @ back @ camera.world_from_view)


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Keyframes. times (K,) seconds, rising; eye, target, up (K, 3), world, metres; zoom (K,): vertical field of view
    in radians, or the half height in metres if `orthographic`.

    catmull-rom: through every key with the slope of its neighbours, each key's influence ending two keys on. cubic: the
    natural spline, whose acceleration is continuous too. linear: straight. loop: the last key is the first one again
    and the path goes round for ever; otherwise its ends are held.
    Between keys the eye, the target and the up direction each go their own way, so that the target stays in view.
    """

    times: F64
    eye: F64
    target: F64
    up: F64
    zoom: F64
    orthographic: bool = False
    interpolation: Interpolation = "catmull-rom"
    loop: bool = False
    near: float = NEAR
    name: str = "path"

    def __post_init__(self) -> None:
        for name in ("times", "eye", "target", "up", "zoom"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64))
        count, values = len(self.times), self._values
        if self.interpolation not in INTERPOLATIONS:
            raise SettingError(f"{self.name}: {unknown('interpolation', self.interpolation, INTERPOLATIONS)}")
        if not count or values.shape != (count, 10):
            raise SettingError(f"{self.name}: expected as many eyes, targets, ups and zooms as times, 1 or more")
        if not (np.isfinite(self.times).all() and np.isfinite(values).all()):
            raise SettingError(f"{self.name}: a key is not finite")
        if (back := np.flatnonzero(np.diff(self.times) <= 0)).size:
            raise SettingError(
                f"{self.name}: key {back[0] + 2} is at {self.times[back[0] + 1]:g} s, the one before it at "
                f"{self.times[back[0]]:g} s: times must rise"
            )
        if self.loop and (count < 3 or not np.array_equal(values[0], values[-1])):
            raise SettingError(f"{self.name}: loop: needs 3 keys or more, the last one with the values of the first")

    @property
    def _values(self) -> F64:
        return np.column_stack([self.eye, self.target, self.up, self.zoom])

    @cached_property
    def _slopes(self) -> F64:
        """(K, 10), per second, at the keys."""
        values = self._values
        if self.interpolation == "linear" or len(values) == 1:
            return np.zeros_like(values)
        if self.loop:  # a key of the round before and after
            span = self.times[-1] - self.times[0]
            times = np.array([self.times[-2] - span, *self.times, self.times[1] + span])
            values = np.concatenate([values[-2:-1], values, values[1:2]])
            return _round_slopes(times, values) if self.interpolation == "cubic" else _inner_slopes(times, values)
        return (_natural_slopes if self.interpolation == "cubic" else _neighbour_slopes)(self.times, values)

    def length(self, fps: float) -> int:
        """Frames at fps up to the last key; a loop leaves out the one that is its first again."""
        frames = float(self.times[-1] * fps)
        return max(int(np.floor(frames + 1e-6)) + (0 if self.loop and frames == round(frames) else 1), 1)

    def at(self, time: float, frame: int, camera: Camera) -> Camera:
        """The scene's camera has no say."""
        value = self._at(time)
        eye, target, up, zoom = value[:3], value[3:6], value[6:9], float(value[9])
        apart = float(np.linalg.norm(target - eye))
        if not apart > 1e-9 * (1 + float(np.abs(eye).max())):
            raise SettingError(f"{self.name}: at {time:g} s the eye is at its target, {eye.tolist()}: move one of them")
        x, y, z = eye.tolist()
        made = Camera.look_at((x, y, z), tuple(target), tuple(up), near=self.near, name=self.name)
        if self.orthographic:
            return replace(made, fov_y=0.0, ymag=max(zoom, 1e-9))
        return replace(made, fov_y=float(np.clip(zoom, np.radians(0.01), np.radians(179))))  # splines overshoot

    def _at(self, time: float) -> F64:
        times, values = self.times, self._values
        if self.loop:
            time = times[0] + (time - times[0]) % (times[-1] - times[0])
        after = int(np.searchsorted(times, time, side="right"))
        if after in (0, len(times)):
            return np.asarray(values[min(after, len(times) - 1)])
        first, second = values[after - 1], values[after]
        step = times[after] - times[after - 1]
        u = (time - times[after - 1]) / step
        if self.interpolation == "linear":
            return np.asarray((1 - u) * first + u * second)
        leave, arrive = step * self._slopes[after - 1], step * self._slopes[after]
        return np.asarray(
            (2 * u**3 - 3 * u**2 + 1) * first + (u**3 - 2 * u**2 + u) * leave
            + (3 * u**2 - 2 * u**3) * second + (u**3 - u**2) * arrive
        )  # fmt: skip


def _inner_slopes(times: F64, values: F64) -> F64:
    """Catmull-Rom over uneven times, at all keys but the ends: the slope of the parabola through a key and its two
    neighbours (Barry & Goldman 1988, "A recursive evaluation algorithm for a class of Catmull-Rom splines")."""
    step = np.diff(times)[:, None]
    secant = np.diff(values, axis=0) / step
    return np.asarray((step[1:] * secant[:-1] + step[:-1] * secant[1:]) / (step[1:] + step[:-1]))


def _neighbour_slopes(times: F64, values: F64) -> F64:
    """The same, and at the ends that of the first and last parabola."""
    secant = np.diff(values, axis=0) / np.diff(times)[:, None]
    if len(secant) == 1:
        return np.repeat(secant, 2, axis=0)
    inner = _inner_slopes(times, values)
    return np.concatenate([2 * secant[:1] - inner[:1], inner, 2 * secant[-1:] - inner[-1:]])


def _natural_slopes(times: F64, values: F64) -> F64:
    """Slopes that make the second derivative continuous, and zero at both ends."""
    count, step = len(times), np.diff(times)
    secant = np.diff(values, axis=0) / step[:, None]
    system, right = np.zeros((count, count)), np.zeros_like(values)
    system[0, :2], right[0] = (2, 1), 3 * secant[0]
    system[-1, -2:], right[-1] = (1, 2), 3 * secant[-1]
    for i in range(1, count - 1):
        system[i, i - 1 : i + 2] = step[i], 2 * (step[i - 1] + step[i]), step[i - 1]
        right[i] = 3 * (step[i] * secant[i - 1] + step[i - 1] * secant[i])
    return np.asarray(np.linalg.solve(system, right))


def _round_slopes(times: F64, values: F64) -> F64:
    """Slopes that make the second derivative continuous all the way round; one more key than the round at both ends."""
    count, step = len(times) - 3, np.diff(times)
    secant = np.diff(values, axis=0) / step[:, None]
    system, right = np.zeros((count, count)), np.zeros((count, values.shape[1]))
    for i in range(count):
        for neighbour, weight in ((i - 1, step[i + 1]), (i, 2 * (step[i] + step[i + 1])), (i + 1, step[i])):
            system[i, neighbour % count] += weight
        right[i] = 3 * (step[i + 1] * secant[i] + step[i] * secant[i + 1])
    slopes = np.linalg.solve(system, right)
    return np.concatenate([slopes, slopes[:1]])


class CameraClip:
    """The camera of a scene that a clip of that scene moves."""

    def __init__(self, scene: Scene, clip: str | None = None, camera: int | None = None) -> None:
        """camera: the first that moves if not said. Raises SettingError where there is none."""
        found = posing.find_clip(scene, clip)
        moving = posing.moving_nodes(scene, found) if found is not None else frozenset()
        moved = [i for i, c in enumerate(scene.cameras) if c.node in moving]
        if found is None or not moved or (camera is not None and camera not in moved):
            raise SettingError(f"{scene.path or scene.name}: holds no camera that a clip moves")
        self._bare = scene.replace(
            instances=(), lights=(), cameras=(scene.cameras[moved[0] if camera is None else camera],)
        )
        self._player, self._end = posing.Player(scene, found), posing.clip_span(found)[1]

    def length(self, fps: float) -> int:
        """Frames at fps until the clip of the other file ends."""
        return int(np.floor(self._end * fps + 1e-6)) + 1

    def at(self, time: float, frame: int, camera: Camera) -> Camera:
        """The scene's own camera has no say."""
        return posing.place(self._bare, self._player.at(time), self._player.rest).cameras[0]


def read(file: str | Path) -> CameraPath | CameraClip:
    """A path from a file: keyframes of a TOML, or the first animated camera of a glTF or GLB.

        interpolation = "catmull-rom"            # the default; or "cubic", "linear"
        loop = false
        near = 0.01                              # m
        [[key]]
        time = 0.0                               # seconds; times must rise
        eye = [0, 1, 5]                          # world, metres
        target = [0, 1, 0]
        up = [0, 1, 0]                           # the default
        fov_y_deg = 45                           # the default; or height in metres in every key: orthographic

    Raises LoadError or SettingError naming file, key and value.
    """
    path = Path(file).expanduser()
    if path.suffix.lower() in (".gltf", ".glb"):
        from glhybrid.load import read_model

        if not path.is_file():
            raise LoadError(f"{path}: there is no such file")
        return CameraClip(read_model(path))
    if path.suffix.lower() != ".toml":
        raise LoadError(
            f"{path}: a camera path is a .toml with [[key]] tables, or a .gltf or .glb with a moving camera"
        )
    from glhybrid.load.tables import NOT_NEGATIVE, PLACE, POSITIVE, between, parse

    try:
        root = parse(path.read_bytes(), path)
    except OSError as error:
        raise LoadError(f"{path}: cannot be read: {error.strerror or error}") from error
    interpolation = root.string("interpolation", INTERPOLATIONS[0], INTERPOLATIONS)
    loop, near = root.boolean("loop", False), root.number("near", NEAR, POSITIVE)
    tables = root.tables("key")
    root.finish()
    if not tables:
        raise LoadError(f"{path}: has no [[key]]: write one for each place of the camera, with time, eye and target")
    rows, flat = [], "height" in tables[0]
    for table in tables:
        for key in ("time", "eye", "target"):
            table.need(key, f"{key} is missing")
        if ("height" in table) != flat or (flat and "fov_y_deg" in table):
            table.fail("a camera has fov_y_deg or height, the same in every key: it cannot change its kind")
        zoom = (
            table.number("height", 1.0, POSITIVE) / 2 if flat
            else float(np.radians(table.number("fov_y_deg", FOV_Y, between(0.01, 179))))
        )  # fmt: skip
        up = table.vector("up", (0.0, 1.0, 0.0))
        if not np.any(up):
            table.fail("must not be zero", "up")
        eye, target = table.vector("eye", (0.0,) * 3, PLACE), table.vector("target", (0.0,) * 3, PLACE)
        if eye == target:
            table.fail("is where the eye is: a camera must look somewhere", "target")
        rows.append((table.number("time", 0.0, NOT_NEGATIVE), eye, target, up, zoom))
        table.finish()
    times, eyes, targets, ups, zooms = (np.array(column, np.float64) for column in zip(*rows, strict=True))
    return CameraPath(
        times, eyes, targets, ups, zooms, orthographic=flat, interpolation=interpolation,  # type: ignore[arg-type]
        loop=loop, near=near, name=str(path),
    )  # fmt: skip
