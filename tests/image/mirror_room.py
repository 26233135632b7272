"""A room with a mirror for a floor in which every colour is a place, and what its mirror shows, in float64 from scratch."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scene_kit import F64, Camera, Light, Scene, Triangles, box, camera_rays, constant_sky, floor, matte, metal, scene

from glhybrid.scene import Material

REACH = 8.0  # m: places from -REACH to REACH are colours from 0 to 1
FLOOR = 1  # instance of the mirror
EPSILON = 1e-9
# low, high, seen from inside: the room, a floating block, a column, a thin post, a block in the corner
BOXES = (
    ((-5, 0, -5), (5, 4, 5), True),
    ((-1, 0.6, -2), (0.2, 1.4, -1), False),
    ((2, 0.01, -3), (2.3, 4, -2.7), False),
    ((0.9, 0.01, -1.52), (0.94, 1.6, -1.48), False),
    ((-3, 0.01, -3.5), (-2, 1, -2.5), False),
)
CAMERA = Camera.look_at((0, 2, 4.5), (0, 1.0, -2), fov_y=np.radians(55))
Bools = NDArray[np.bool_]


def placed(part: Triangles) -> Triangles:
    """The same with its places as colours."""
    color = np.concatenate([part.position / (2 * REACH) + 0.5, np.ones((len(part.position), 1))], 1)
    return Triangles(part.position, part.index, part.normal, part.material, color=color.astype(np.float32))


def room(camera: Camera = CAMERA) -> Scene:
    """No light: what the mirror shows is where it looks."""
    place = Material("place", unlit=True)
    parts = [(placed(box(*b)), place) for b in BOXES]
    parts.insert(FLOOR, (floor(4.99, 0.01), metal()))
    return scene(parts, camera, environment=constant_sky(0.0))


def lit_room(camera: Camera = CAMERA) -> Scene:
    """The same in plain colours, under a lamp beside which the sky, that no shadow keeps out, is nothing."""
    colors = ((0.6, 0.6, 0.7), (0.8, 0.2, 0.1), (0.1, 0.7, 0.2), (0.7, 0.7, 0.1), (0.2, 0.2, 0.9))
    parts: list[Any] = [(box(*b), matte(color)) for b, color in zip(BOXES, colors, strict=True)]
    parts.insert(FLOOR, (floor(4.99, 0.01), metal()))
    lamp = Light("point", (1, 1, 1), 2000.0, position=(1, 3.5, 1))
    return scene(parts, camera, lights=(lamp,), environment=constant_sky(0.03))


def first_hit(origin: F64, direction: F64) -> tuple[F64, NDArray[np.int64]]:
    """Distance to the first face met, and whose, -1 = the mirror's height from above. Faces seen from behind are glass."""
    best = np.full(origin.shape[:-1], np.inf)
    who = np.full(origin.shape[:-1], -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, (low, high, inside) in enumerate(BOXES):
            a, b = (np.array(low) - origin) / direction, (np.array(high) - origin) / direction
            near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
            t = far if inside else near
            ok = (near <= far) & (t > EPSILON) & (t < best)
            best, who = np.where(ok, t, best), np.where(ok, i, who)
        down = (0.01 - origin[..., 1]) / direction[..., 1]
        ok = (down > EPSILON) & (down < best) & (direction[..., 1] < 0)
    return np.where(ok, down, best), np.where(ok, -1, who)


@dataclass(frozen=True)
class Truth:
    """Of the pixels that show the mirror. point: (H, W, 3) what each shows; shown: that is in the picture, facing us."""

    mirror: Bools
    origin: F64
    direction: F64
    point: F64
    on_screen: Bools
    shown: Bools
    pixel: float  # rad


def truth(size: tuple[int, int], camera: Camera = CAMERA) -> Truth:
    """From the definition of the camera and the boxes alone."""
    rays = camera_rays(room(camera), size, camera)
    t, who = first_hit(rays.origin, rays.direction)
    mirror = who == -1
    origin = rays.origin + t[..., None] * rays.direction
    direction = rays.direction * (1, -1, 1)
    reach = np.where(mirror, first_hit(origin, direction)[0], 0.0)
    point = origin + reach[..., None] * direction
    view = np.linalg.inv(camera.world_from_view)
    seen = point @ view[:3, :3].T + view[:3, 3]
    tan = np.tan(camera.fov_y / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = seen[..., 0] / -seen[..., 2] / tan * size[1] / size[0], seen[..., 1] / -seen[..., 2] / tan
    on_screen = mirror & (seen[..., 2] < 0) & (np.abs(x) < 1) & (np.abs(y) < 1)
    eye = camera.world_from_view[:3, 3]
    to_point = point - eye
    length = np.linalg.norm(to_point, axis=-1)
    nearest = first_hit(np.broadcast_to(eye, point.shape), to_point / length[..., None])[0]
    shown = on_screen & (np.abs(nearest - length) < 1e-6)
    return Truth(mirror, origin, direction, point, on_screen, shown, 2 * float(tan) / size[1])


def places(reflection: NDArray[np.float32]) -> F64:
    """What a picture of the room says each pixel shows, m."""
    return (reflection.astype(np.float64) - 0.5) * 2 * REACH


def error_px(got: F64, true: Truth, camera: Camera = CAMERA) -> F64:
    """Angle at the mirrored eye between the place shown and the true one, in pixels."""
    eye = camera.world_from_view[:3, 3] * (1, -1, 1) + (0, 0.02, 0)
    a, b = got - eye, true.point - eye
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    angle: F64 = np.arctan2(cross, (a * b).sum(-1)) / true.pixel
    return angle
