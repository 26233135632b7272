"""What a camera sees and what light reaches it, ray by ray on the CPU in float64: no tree, no OpenGL, no offset that
matters. Small opaque scenes only; every triangle is tried for every ray (reference.py).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glhybrid import reference
from glhybrid.scene import F64, Camera, Light, Scene, Sphere
from glhybrid.view import make_view

I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Hit:
    """One row a ray. t in lengths of the direction, +inf = miss; instance and material -1 then.

    normal: unit, geometric, towards the origin of the ray; 0 for a miss.
    """

    t: F64
    instance: I64
    material: I64
    normal: F64


@dataclass(frozen=True, eq=False)
class Seen:
    """What the pixels of a picture see, (H, W, ...): rays through their centres, and the first surface."""

    origin: F64
    direction: F64  # unit
    position: F64  # 0 for a miss
    hit: Hit

    @property
    def covered(self) -> Mask:
        """(H, W): where the camera ray meets something."""
        return np.isfinite(self.hit.t)


class Oracle:
    """The surfaces of a scene at rest, both sides solid, in world space."""

    def __init__(self, scene: Scene, precision: type = np.float64) -> None:
        """precision: that of the world-space vertices; float32 is for controls that fail by it."""
        triangles, instances, materials, spheres = [], [], [], []
        for number, instance in enumerate(scene.instances):
            mesh, pose = scene.meshes[instance.mesh], instance.world_from_object
            for k, piece in enumerate(mesh.primitives):
                material = instance.materials[k] if instance.materials else piece.material
                if isinstance(piece, Sphere):
                    radius = piece.radius * abs(np.linalg.det(pose[:3, :3])) ** (1 / 3)
                    spheres.append((pose[:3, 3], radius, number, material))
                    continue
                with np.errstate(invalid="ignore", over="ignore"):
                    placed = piece.position.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
                    corners = placed.astype(precision).astype(np.float64)[piece.index]
                corners = corners[np.isfinite(corners).all((1, 2))]
                triangles.append(corners)
                instances.append(np.full(len(corners), number))
                materials.append(np.full(len(corners), material))
        self.scene, self.spheres = scene, spheres
        self.triangles: F64 = np.concatenate([np.zeros((0, 3, 3)), *triangles])
        self.instance: I64 = np.concatenate([np.zeros(0, np.int64), *instances])
        self.material: I64 = np.concatenate([np.zeros(0, np.int64), *materials])
        normal = np.cross(self.triangles[:, 1] - self.triangles[:, 0], self.triangles[:, 2] - self.triangles[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        self.normal: F64 = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
        bounds = scene.bounds()
        self.offset = 1e-7 * float(np.linalg.norm(bounds[1] - bounds[0]))  # m; doubles hold 1e-16 of a place

    def closest(self, origins: F64, directions: F64) -> Hit:
        """The nearest surface along each ray, (R, 3)."""
        found = reference.closest_hit(self.triangles, origins, directions)
        miss = ~found.hit
        row = np.where(miss, 0, found.triangle).astype(np.int64)
        t = found.t.copy()
        if len(self.triangles):
            instance, material = np.where(miss, -1, self.instance[row]), np.where(miss, -1, self.material[row])
            normal = np.where(miss[:, None], 0.0, self.normal[row])
        else:
            instance = material = np.full(len(t), -1)
            normal = np.zeros((len(t), 3))
        for centre, radius, number, paint in self.spheres:
            near, far = _sphere(centre, radius, origins, directions)
            distance = np.where(near >= 0, near, far)
            closer = (distance >= 0) & (distance < t)
            t = np.where(closer, distance, t)
            instance, material = np.where(closer, number, instance), np.where(closer, paint, material)
            point = origins + np.where(closer, distance, 0.0)[:, None] * directions
            normal = np.where(closer[:, None], (point - centre) / radius, normal)
        away = (normal * directions).sum(1) > 0
        return Hit(t, instance, material, np.where(away[:, None], -normal, normal))

    def blocked(self, origins: F64, directions: F64, t_max: F64 | float = np.inf) -> Mask:
        """(R,): whether anything is nearer than t_max along each ray."""
        blocked = reference.any_hit(self.triangles, origins, directions, 0.0, t_max)
        for centre, radius, _, _ in self.spheres:
            near, far = _sphere(centre, radius, origins, directions)
            distance = np.where(near >= 0, near, far)
            blocked |= (distance >= 0) & (distance < t_max)
        return blocked

    def seen(self, camera: Camera, size: tuple[int, int]) -> Seen:
        """What the pixels' centres see."""
        origin, direction = camera_rays(camera, size, self.scene)
        hit = self.closest(origin, direction)
        depth = np.where(np.isfinite(hit.t), hit.t, 0.0)[:, None]
        point = np.where(depth > 0, origin + depth * direction, 0.0)
        shape = (size[1], size[0])
        ids = hit.instance.reshape(shape), hit.material.reshape(shape)
        parts = Hit(hit.t.reshape(shape), *ids, normal=hit.normal.reshape(*shape, 3))
        o, d, p = (a.reshape(*shape, 3) for a in (origin, direction, point))
        return Seen(o, d, p, parts)

    def facing(self, seen: Seen, light: Light) -> Mask:
        """(H, W): pixels whose surface faces the light by more than a grazing hair."""
        return seen.covered & ((seen.hit.normal * _to_light(seen.position, light)[0]).sum(-1) > 1e-3)

    def visibility(self, seen: Seen, light: Light) -> F64:
        """(H, W), 0 or 1: whether the light's middle reaches the surface; 0 where it faces away."""
        counted = seen.covered & ((seen.hit.normal * _to_light(seen.position, light)[0]).sum(-1) > 0)
        start = seen.position[counted] + self.offset * seen.hit.normal[counted]
        toward, distance = _to_light(start, light)
        out = np.zeros(counted.shape)
        out[counted] = ~self.blocked(start, np.ascontiguousarray(toward), distance)
        return out

    def mirrored(self, seen: Seen, counted: Mask) -> Hit:
        """What the mirror rays of some pixels meet, a row for each."""
        normal, direction = seen.hit.normal[counted], seen.direction[counted]
        mirror = direction - 2 * (direction * normal).sum(1, keepdims=True) * normal
        return self.closest(seen.position[counted] + self.offset * normal, mirror)


def camera_rays(camera: Camera, size: tuple[int, int], scene: Scene) -> tuple[F64, F64]:
    """(H * W, 3) origins and unit directions through the pixels' centres, world space."""
    view = make_view(camera, size, scene)
    x = (np.arange(size[0]) + 0.5) / size[0] * 2 - 1
    y = 1 - (np.arange(size[1]) + 0.5) / size[1] * 2
    across = (x[None, :, None] * view.right + y[:, None, None] * view.up).reshape(-1, 3)
    eye = view.eye + view.origin
    if view.orthographic:
        return eye + across, np.broadcast_to(view.forward, across.shape).copy()
    direction = view.forward + across
    return np.broadcast_to(eye, across.shape).copy(), direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _to_light(points: F64, light: Light) -> tuple[F64, F64]:
    """Unit directions and distances from points (..., 3) to the middle of a light."""
    if light.kind == "directional":
        toward = -np.asarray(light.direction, np.float64)
        shape = points.shape[:-1]
        return np.broadcast_to(toward / np.linalg.norm(toward), points.shape), np.full(shape, np.inf)
    away = np.asarray(light.position, np.float64) - points
    distance = np.linalg.norm(away, axis=-1)
    return away / distance[..., None], distance


def _sphere(centre: F64, radius: float, origins: F64, directions: F64) -> tuple[F64, F64]:
    """Where rays of unit direction enter and leave a sphere; NaN where they miss it."""
    away = origins - centre
    along = (away * directions).sum(1)
    nearest = away - along[:, None] * directions  # better conditioned than the discriminant of b and c
    with np.errstate(invalid="ignore"):
        root = np.sqrt(radius**2 - (nearest * nearest).sum(1))
    return -along - root, -along + root
