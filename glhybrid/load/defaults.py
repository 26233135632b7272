"""What a file without a camera or without any light is looked at with."""

from dataclasses import replace

import numpy as np

from glhybrid.load.sky import sky_map, sun_light
from glhybrid.scene import F64, Camera, Environment, Light, Mesh, Scene, Sphere

FOV_Y = np.radians(40.0)  # long enough to keep a model's proportions
VIEW_FROM = (0.45, 0.36, 1.0)  # from the front, a bit to the right and above
BEHIND = (-0.45, 0.36, -1.0)
UNSEEN = 0.02  # of the front faces that are seen from behind: with fewer seen from the front, that is the wrong side
LOOKED_AT = 256, 10_000  # instances, triangles of a primitive, evenly spread: enough to tell the sides
SUN_ELEVATION, SUN_AZIMUTH, TURBIDITY = np.radians(42.0), np.radians(218.0), 4.0  # over the viewer's left shoulder
GROUND = (0.19, 0.20, 0.215)  # albedo: a neutral grey under the warm sun, darker than most things shown on it
SUN_SHARE = 2.4  # lux from the sun on a surface that faces it
SKY_SHARE = 1.0  # lux from the sky on a surface that faces up: with the sun, white comes out near radiance 1


def default_camera(scene: Scene) -> Camera:
    """A camera that sees the bounding sphere of all that is drawn whole, whatever the image's shape.

    It looks from the front, or from behind where all front faces look that way: nothing else would be seen.
    """
    center, radius = bounding_sphere(scene)
    way = _unit(BEHIND if faces_away(scene) else VIEW_FROM)
    eye = center + way * (radius / np.sin(FOV_Y / 2) * 1.02)
    camera = Camera.look_at(tuple(eye), tuple(center), fov_y=FOV_Y, near=radius * 1e-3, name="default")
    return replace(camera, fov_short=True)


def default_light(behind: bool = False) -> tuple[Environment, Light]:
    """A soft clear sky and its sun, scaled so that a white surface in the sun has a radiance near 1.

    behind: turned half round, for who looks from there.

    At that scale unlit and emissive materials of usual strength keep their place in the picture.
    """
    radiance = sky_map(SUN_ELEVATION, SUN_AZIMUTH, TURBIDITY, GROUND)
    sun = sun_light(SUN_ELEVATION, SUN_AZIMUTH, TURBIDITY)
    height = len(radiance)
    polar = (np.arange(height // 2) + 0.5) / height * np.pi
    up = (radiance[: height // 2].mean((1, 2)) * np.cos(polar) * np.sin(polar)).sum() * (np.pi / height) * 2 * np.pi
    turn = np.pi if behind else 0.0
    environment = Environment(radiance, intensity=float(SKY_SHARE / up), rotation=turn, name="default sky")
    x, y, z = sun.direction
    way = (-x, y, -z) if behind else (x, y, z)
    return environment, Light(
        kind="directional", color=sun.color, intensity=SUN_SHARE, direction=way, name="default sun"
    )


def bounding_sphere(scene: Scene) -> tuple[F64, float]:
    """Centre (3,) of the world bounds and the distance of the farthest point from it; radius 1 if nothing is drawn."""
    low, high = scene.bounds()
    center = (low + high) / 2
    points = [_outline(mesh) for mesh in scene.meshes]
    farthest = 0.0
    for instance in scene.instances:
        world = instance.world_from_object
        for p, grown in points[instance.mesh]:
            reach = np.linalg.norm(p @ world[:3, :3].T + world[:3, 3] - center, axis=1).max()
            farthest = max(farthest, float(reach) + grown * float(np.linalg.norm(world[:3, :3], 2)))
    return center, farthest if farthest > 0 else 1.0


def faces_away(scene: Scene) -> bool:
    """Whether nearly all that has a front shows it to who looks from behind, so that from the front nothing is seen."""
    return _faces(scene, _unit(VIEW_FROM)) < UNSEEN * _faces(scene, _unit(BEHIND))


def _unit(way: tuple[float, float, float]) -> F64:
    return np.array(way) / np.linalg.norm(way)


@np.errstate(all="ignore")
def _faces(scene: Scene, way: F64) -> float:
    """m2 of front faces that a camera far off that way looks at, hidden ones included; any of double-sided ones."""
    total = 0.0
    instances, triangles = LOOKED_AT
    for instance in scene.instances[:: len(scene.instances) // instances + 1]:
        world = instance.world_from_object[:3, :3]
        toward = np.linalg.pinv(world) @ way * abs(np.linalg.det(world))  # fronts stay fronts where it mirrors
        for k, p in enumerate(scene.meshes[instance.mesh].primitives):
            if isinstance(p, Sphere):
                total += np.pi * (p.radius * float(np.linalg.norm(world, 2))) ** 2
                continue
            index = p.index[:: len(p.index) // triangles + 1]
            a, b, c = (p.position[index[:, n]].astype(np.float64) for n in range(3))
            area = np.nan_to_num(np.cross(b - a, c - a) @ toward, posinf=0, neginf=0) / 2
            material = scene.materials[instance.materials[k] if instance.materials else p.material]
            seen = np.abs(area) if material.double_sided else np.maximum(area, 0)
            total += float(seen.sum()) * len(p.index) / max(len(index), 1)
    return total


def _outline(mesh: Mesh) -> list[tuple[F64, float]]:
    """Per primitive: its points and a radius about them; of many points only those extreme in 26 directions."""
    ways = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], np.float64)
    spans: list[tuple[F64, float]] = []
    for p in mesh.primitives:
        if isinstance(p, Sphere):
            spans.append((np.zeros((1, 3)), p.radius))
        elif len(p.index):
            used = p.position[np.unique(p.index)]
            points: F64 = used[np.isfinite(used).all(1)].astype(np.float64)
            if len(points):
                spans.append((points[(points @ ways.T).argmax(0)] if len(points) > 5000 else points, 0.0))
    return spans
