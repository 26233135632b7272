"""Moving a camera by hand: orbit, pan, dolly, fly, look around, frame. NumPy in and out, no state.

Every function takes a Pose and returns another. Angles in radians, lengths in metres, image offsets in pixels with y
down.
"""

from dataclasses import replace

import numpy as np

from glhybrid.camera_text import Point, Pose
from glhybrid.scene import F64

STEEPEST = np.deg2rad(89.8)  # of the view against the horizon of `up`
WHEEL = 0.88  # of the distance that a step of the wheel leaves


def axes(pose: Pose) -> tuple[F64, F64, F64]:
    """(right, up, forward), unit."""
    forward = np.subtract(pose.target, pose.eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, pose.up)
    if np.linalg.norm(right) < 1e-9:  # as Camera.look_at
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right = right / np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def distance(pose: Pose) -> float:
    """From the eye to the target, m."""
    return float(np.linalg.norm(np.subtract(pose.target, pose.eye)))


def metres_per_pixel(pose: Pose, size: tuple[int, int]) -> float:
    """At the target."""
    width, height = size
    if pose.fov == 0:
        return 2 * pose.height / height
    half = np.tan(np.deg2rad(pose.fov) / 2) * (max(1.0, height / width) if pose.short else 1.0)
    return float(2 * half * distance(pose) / height)


def orbit(pose: Pose, yaw: float, pitch: float) -> Pose:
    """The eye turns about the target: yaw to the right about `up`, pitch upwards."""
    return replace(pose, eye=_point(np.add(pose.target, _turn(pose, np.subtract(pose.eye, pose.target), -yaw, pitch))))


def look(pose: Pose, yaw: float, pitch: float) -> Pose:
    """The target turns about the eye: the view goes right by yaw and up by pitch."""
    return replace(pose, target=_point(np.add(pose.eye, _turn(pose, np.subtract(pose.target, pose.eye), -yaw, pitch))))


def pan(pose: Pose, dx: float, dy: float, size: tuple[int, int]) -> Pose:
    """What is at the target follows the pointer."""
    right, up, _ = axes(pose)
    step = (-dx * right + dy * up) * metres_per_pixel(pose, size)
    return replace(pose, eye=_point(pose.eye + step), target=_point(pose.target + step))


def dolly(pose: Pose, steps: float, at: tuple[float, float] = (0.0, 0.0), size: tuple[int, int] = (1, 1)) -> Pose:
    """Nearer by steps of the wheel, towards what is under `at`: pixels from the image's centre, at target's depth."""
    factor = WHEEL**steps
    right, up, _ = axes(pose)
    point = pose.target + (at[0] * right - at[1] * up) * metres_per_pixel(pose, size)
    eye, target = (_point(point + (np.asarray(p) - point) * factor) for p in (pose.eye, pose.target))
    if pose.fov == 0:
        shift = np.subtract(target, pose.target)  # parallel rays: the eye keeps its distance, the image shrinks
        eye = _point(np.asarray(pose.eye) + shift)
        return replace(pose, eye=eye, target=target, height=pose.height * factor, width=pose.width * factor)
    return replace(pose, eye=eye, target=target)


def fly(pose: Pose, sideways: float, upwards: float, ahead: float) -> Pose:
    """Eye and target move, metres along the camera's axes; `upwards` along the world's up."""
    right, _, forward = axes(pose)
    step = sideways * right + upwards * np.asarray(pose.up) / np.linalg.norm(pose.up) + ahead * forward
    return replace(pose, eye=_point(pose.eye + step), target=_point(pose.target + step))


def frame(pose: Pose, bounds: F64, size: tuple[int, int]) -> Pose:
    """Looks the same way at a box (2, 3), which then fills the image. A box without extent is looked at from 1 m."""
    centre, radius = bounds.mean(0), float(np.linalg.norm(bounds[1] - bounds[0])) / 2
    radius = radius if radius > 0 else 0.5
    _, _, forward = axes(pose)
    width, height = size
    if pose.fov == 0:
        half_y = radius * max(1.0, height / width)
        away = max(distance(pose), 2 * radius)
        shape = pose.width / pose.height if pose.width else 0.0
        framed = replace(pose, eye=_point(centre - forward * away), target=_point(centre))
        return replace(framed, height=half_y, width=half_y * shape)
    half_y = np.tan(np.deg2rad(pose.fov) / 2) * (max(1.0, height / width) if pose.short else 1.0)
    half = float(np.arctan(half_y * min(1.0, width / height)))
    away = 1.05 * radius / np.sin(half)
    near = min(pose.near, float(f"{away * 1e-3:.2g}"))
    return replace(pose, eye=_point(centre - forward * away), target=_point(centre), near=near)


def _turn(pose: Pose, arm: F64, yaw: float, pitch: float) -> F64:
    """An arm from eye to target or back, turned about up by yaw, and against the horizon by pitch, within limits.

    The pitch raises the arm's own end: an orbiting eye, or the target that is looked at.
    """
    up = np.asarray(pose.up, np.float64) / np.linalg.norm(pose.up)
    length = float(np.linalg.norm(arm))
    height = float(arm @ up)
    flat = arm - height * up
    if np.linalg.norm(flat) < 1e-9 * length:  # straight up or down: the image's own up says where ahead is
        _, image_up, _ = axes(pose)
        flat = image_up - (image_up @ up) * up
    flat = flat / np.linalg.norm(flat)
    elevation = np.clip(np.arcsin(np.clip(height / length, -1, 1)) + pitch, -STEEPEST, STEEPEST)
    turned = flat * np.cos(yaw) + np.cross(up, flat) * np.sin(yaw)
    return np.asarray(length * (np.cos(elevation) * turned + np.sin(elevation) * up))


def _point(values: F64) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z
