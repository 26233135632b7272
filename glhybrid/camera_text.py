"""A camera in one line, as the viewer copies it and `--camera` takes it:

    eye=1.5,1.2,4;target=0,0.5,0;fov=45          perspective; up=0,1,0 and near=0.01 where they are not given
    eye=0,9,0;target=0,0,0;up=0,0,-1;height=4    orthographic: half the height in metres (width= likewise)

fov is vertical, in degrees; `short=1` has it span the shorter side of the image. What is written reads back as the
same camera to the last bit, so that a copied command gives the same picture.
"""

from dataclasses import dataclass, replace

import numpy as np

from glhybrid.errors import SettingError, unknown
from glhybrid.scene import Camera

Point = tuple[float, float, float]
_POINTS, _NUMBERS = ("eye", "target", "up"), ("fov", "near", "height", "width", "short")


@dataclass(frozen=True)
class Pose:
    """Where a camera is and what it looks at. Metres; fov in degrees, 0 = orthographic with half extents in metres."""

    eye: Point
    target: Point
    up: Point = (0.0, 1.0, 0.0)
    fov: float = 45.0
    near: float = 0.01
    short: bool = False
    height: float = 0.0
    width: float = 0.0

    def write(self) -> str:
        """The line, with all the digits that a number has: it reads back to the last bit."""
        words = [f"{name}={','.join(map(_number, getattr(self, name)))}" for name in ("eye", "target")]
        if self.up != (0.0, 1.0, 0.0):
            words.append(f"up={','.join(map(_number, self.up))}")
        if self.fov:
            words += [f"fov={_number(self.fov)}", *(["short=1"] if self.short else [])]
        else:
            words += [f"height={_number(self.height)}", *([f"width={_number(self.width)}"] if self.width else [])]
        return ";".join([*words, *([f"near={_number(self.near)}"] if self.near != 0.01 else [])])

    def rounded(self) -> "Pose":
        """With no more digits than can be seen: points to a ten-millionth of the distance, other numbers to nine."""
        arm = float(np.linalg.norm(np.subtract(self.eye, self.target)))
        places = 7 - int(np.floor(np.log10(arm))) if arm > 0 else 9
        eye, target = (_point(np.round(np.asarray(p, np.float64), places)) for p in (self.eye, self.target))
        fov, near, height, width = (float(f"{v:.9g}") for v in (self.fov, self.near, self.height, self.width))
        up = _point(np.round(np.asarray(self.up, np.float64), 9))
        return Pose(eye, target, up, fov, near, self.short, height, width)

    def camera(self) -> Camera:
        """The camera that the line stands for."""
        camera = Camera.look_at(self.eye, self.target, self.up, float(np.deg2rad(self.fov)), self.near, "view")
        flat = self.fov == 0
        return replace(camera, fov_short=self.short, ymag=self.height * flat, xmag=self.width * flat)


def _number(value: float) -> str:
    return repr(float(value)).removesuffix(".0")


def is_pose(text: str) -> bool:
    """Whether a text is meant for a line as above, not a camera's name."""
    return text.lstrip().startswith(("eye=", "target="))


def read(text: str) -> Pose:
    """Raises SettingError for a line that is not as above."""
    points: dict[str, Point] = {"up": (0.0, 1.0, 0.0)}
    numbers = {"near": 0.01}
    for word in filter(None, (w.strip() for w in text.split(";"))):
        key, _, value = word.partition("=")
        key = key.strip()
        if key not in _POINTS + _NUMBERS:
            raise SettingError(f'--camera "{text}": {unknown("key", key, _POINTS + _NUMBERS)}')
        try:
            parts = [float(v) for v in value.split(",")]
        except ValueError:
            parts = []
        count = 3 if key in _POINTS else 1
        if len(parts) != count or not np.isfinite(parts).all():
            raise SettingError(f'--camera "{text}": {key}={value}: expected {count} number{"s" if count > 1 else ""}')
        if count == 3:
            points[key] = (parts[0], parts[1], parts[2])
        else:
            numbers[key] = parts[0]
    if "eye" not in points or "target" not in points:
        raise SettingError(f'--camera "{text}": expected eye=X,Y,Z;target=X,Y,Z and more, see the help')
    eye, target = points["eye"], points["target"]
    if np.linalg.norm(np.subtract(eye, target)) < 1e-12 * max(1.0, float(np.abs(eye).max())):
        raise SettingError(f'--camera "{text}": eye and target are one point')
    fov, height = numbers.get("fov", 0.0 if "height" in numbers else 45.0), numbers.get("height", 0.0)
    if not (0 < fov < 180 or (fov == 0 and height > 0)) or numbers["near"] <= 0 or numbers.get("width", 0.0) < 0:
        raise SettingError(f'--camera "{text}": expected fov within 0 to 180 or height > 0, and near > 0')
    short, width = bool(numbers.get("short", 0.0)), numbers.get("width", 0.0)
    return Pose(eye, target, points["up"], fov, numbers["near"], short, height, width)


def parse(text: str) -> Camera:
    """The camera of a line. Raises SettingError for one that is not as above."""
    return read(text).camera()


def pose_of(camera: Camera, distance: float) -> Pose:
    """The pose of a camera whose interest is `distance` metres ahead of it."""
    m = camera.world_from_view
    eye, right, up, forward = m[:3, 3], m[:3, 0], m[:3, 1], -m[:3, 2]
    level = abs(right[1]) < 1e-6 and up[1] > 1e-6  # no roll: the world's up does, and stays while it turns
    return Pose(
        _point(eye), _point(eye + forward * distance), (0.0, 1.0, 0.0) if level else _point(up),
        float(np.rad2deg(max(camera.fov_y, 0.0))), camera.near, camera.fov_short,
        camera.ymag if camera.fov_y <= 0 else 0.0, camera.xmag if camera.fov_y <= 0 else 0.0,
    )  # fmt: skip


def _point(values: np.ndarray) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z
