"""Camera -> what a frame needs of it: the world's origin, matrices, and the basis of primary rays. No OpenGL."""

import math
from dataclasses import dataclass

import numpy as np

from glhybrid import camera_text
from glhybrid.errors import SettingError, unknown
from glhybrid.scene import F64, Camera, Scene


@dataclass(frozen=True, eq=False)
class View:
    """A camera on an image of a given size. All float64; world_from_* are relative to `origin`.

    origin: the point of the world that is zero this frame. It is the eye, snapped to a coarse grid: coordinates near
    it keep float32's full precision however far from zero the scene lies, and do not change under small motion.
    """

    camera: Camera
    size: tuple[int, int]
    origin: F64
    eye: F64
    right: F64  # ray direction per unit of ndc x (orthographic: half extent)
    up: F64
    rays: F64  # (3, 3): eye, right and up, which rays are made of
    forward: F64
    clip_from_world: F64
    orthographic: bool
    pixel_angle: float


def make_view(
    camera: Camera, size: tuple[int, int], scene: Scene, clip_control: bool = True, bounds: F64 | None = None
) -> View:
    """Reversed, infinite depth (1 at the near plane); NDC depth is 0 to 1 with clip_control, else -1 to 1.

    bounds: (2, 3) of all that the scene may reach; default: of where it is.
    """
    width, height = size
    low, high = (scene.bounds() if bounds is None else bounds).tolist()
    extent = math.dist(low, high) or 1.0
    pose = camera.world_from_view
    right, up, back, position = pose[:3].T.tolist()
    grid = 2.0 ** math.floor(math.log2(extent / 64))
    origin = [round(x / grid) * grid for x in position]
    eye = [x - y for x, y in zip(position, origin, strict=True)]
    # Rows of view_from_world, times the determinant.
    rows = _cross(up, back), _cross(back, right), _cross(right, up)
    det = _dot(right, rows[0])
    orthographic = camera.fov_y <= 0
    if orthographic:
        half_y = camera.ymag
        half_x = camera.xmag or half_y * width / height
        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        reach = math.dist(middle, position) + extent
        scale, depth = 1 / (reach - camera.near), reach / (reach - camera.near)
        clip = [_row(rows[0], eye, det * half_x), _row(rows[1], eye, det * half_y),
                _row(rows[2], eye, det / scale), [0.0, 0.0, 0.0, 1.0]]  # fmt: skip
        clip[2][3] += depth
    else:
        half_y = math.tan(camera.fov_y / 2) * (max(1.0, height / width) if camera.fov_short else 1.0)
        half_x = half_y * width / height
        clip = [_row(rows[0], eye, det * half_x), _row(rows[1], eye, det * half_y),
                [0.0, 0.0, 0.0, camera.near], _row(rows[2], eye, -det)]  # fmt: skip
    if not clip_control:
        clip[2] = [2 * z - w for z, w in zip(clip[2], clip[3], strict=True)]
    # One array, in parts: an array each would take five times as long.
    (a, b, c), (d, e, f), (g, h, i) = right, up, back
    parts = np.array([
        *origin, *eye, half_x * a, half_x * b, half_x * c, half_y * d, half_y * e, half_y * f, -g, -h, -i,
        *clip[0], *clip[1], *clip[2], *clip[3],
    ])  # fmt: skip
    view = View.__new__(View)  # a frozen dataclass sets its fields one by one, which takes thrice as long
    view.__dict__.update(
        camera=camera, size=size, origin=parts[:3], eye=parts[3:6], right=parts[6:9], up=parts[9:12],
        rays=parts[3:12].reshape(3, 3), forward=parts[12:15], clip_from_world=parts[15:].reshape(4, 4),
        orthographic=orthographic, pixel_angle=2 * half_y / height,
    )  # fmt: skip
    return view


# A frame in motion makes a view: these on three numbers each take a tenth of what NumPy would.
def _cross(a: list[float], b: list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _row(direction: list[float], eye: list[float], divisor: float) -> list[float]:
    """What a point has of a direction, from the eye on, over a divisor: one row of a matrix."""
    x, y, z = direction[0] / divisor, direction[1] / divisor, direction[2] / divisor
    return [x, y, z, -(x * eye[0] + y * eye[1] + z * eye[2])]


def choose_camera(scene: Scene, camera: int | str | Camera | None) -> Camera:
    """A camera of the scene by index or name; None = the first. Raises SettingError with the nearest name."""
    if isinstance(camera, Camera):
        return camera
    if isinstance(camera, str) and camera_text.is_pose(camera):
        return camera_text.parse(camera)
    if camera is None:
        camera = 0
    if isinstance(camera, int) or (
        isinstance(camera, str) and camera.lstrip("-").isdigit() and not any(c.name == camera for c in scene.cameras)
    ):
        index = int(camera)
        if 0 <= index < len(scene.cameras):
            return scene.cameras[index]
        if not scene.cameras:
            raise SettingError(
                f"{scene.name}: has no camera: give one, such as Camera.look_at(eye, target), or draw "
                "glhybrid.with_defaults(scene), whose camera frames it"
            )
        raise SettingError(f"camera {index}: {scene.name} has {len(scene.cameras)}, numbered from 0")
    for candidate in scene.cameras:
        if candidate.name == camera:
            return candidate
    raise SettingError(f"{scene.name}: {unknown('camera', camera, [c.name for c in scene.cameras])}")
