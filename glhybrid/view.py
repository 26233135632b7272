"""Camera -> what a frame needs of it: the world's origin, matrices, and the basis of primary rays. No OpenGL."""

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
    bounds = scene.bounds() if bounds is None else bounds
    extent = float(np.linalg.norm(bounds[1] - bounds[0])) or 1.0
    pose = camera.world_from_view
    grid = 2.0 ** np.floor(np.log2(extent / 64))
    origin = np.round(pose[:3, 3] / grid) * grid
    eye = pose[:3, 3] - origin
    right, up, forward = pose[:3, 0], pose[:3, 1], -pose[:3, 2]
    orthographic = camera.fov_y <= 0
    clip = np.zeros((4, 4))
    if orthographic:
        half_y = camera.ymag
        half_x = camera.xmag or half_y * width / height
        reach = float(np.linalg.norm(bounds.mean(0) - pose[:3, 3])) + extent
        clip[0, 0], clip[1, 1], clip[3, 3] = 1 / half_x, 1 / half_y, 1
        clip[2, 2], clip[2, 3] = 1 / (reach - camera.near), reach / (reach - camera.near)
        pixel_angle = 2 * half_y / height
    else:
        half_y = float(np.tan(camera.fov_y / 2)) * (max(1.0, height / width) if camera.fov_short else 1.0)
        half_x = half_y * width / height
        clip[0, 0], clip[1, 1], clip[3, 2] = 1 / half_x, 1 / half_y, -1
        clip[2, 3] = camera.near
        pixel_angle = 2 * half_y / height
    if not clip_control:
        clip[2] = 2 * clip[2] - clip[3]
    world_from_view = pose.copy()
    world_from_view[:3, 3] = eye
    return View(
        camera, size, origin, eye, right * half_x, up * half_y, forward,
        clip @ np.linalg.inv(world_from_view), orthographic, pixel_angle,
    )  # fmt: skip


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
        raise SettingError(f"camera {index}: {scene.name} has {len(scene.cameras)}, numbered from 0")
    for candidate in scene.cameras:
        if candidate.name == camera:
            return candidate
    raise SettingError(f"{scene.name}: {unknown('camera', camera, [c.name for c in scene.cameras])}")
