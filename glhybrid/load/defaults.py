"""What a file without a camera or without any light is looked at with."""

from dataclasses import replace

import numpy as np

from glhybrid.load.sky import sky_map, sun_light
from glhybrid.scene import F64, Camera, Environment, Light, Mesh, Scene, Sphere

FOV_Y = np.radians(40.0)  # long enough to keep a model's proportions
VIEW_FROM = (0.45, 0.36, 1.0)  # from the front, a bit to the right and above
SUN_ELEVATION, SUN_AZIMUTH, TURBIDITY = np.radians(42.0), np.radians(218.0), 4.0  # over the viewer's left shoulder
GROUND = (0.19, 0.20, 0.215)  # albedo: a neutral grey under the warm sun, darker than most things shown on it
SUN_SHARE = 2.4  # lux from the sun on a surface that faces it
SKY_SHARE = 1.0  # lux from the sky on a surface that faces up: with the sun, white comes out near radiance 1


def default_camera(scene: Scene) -> Camera:
    """A camera that sees the bounding sphere of all that is drawn whole, whatever the image's shape."""
    center, radius = bounding_sphere(scene)
    way = np.array(VIEW_FROM) / np.linalg.norm(VIEW_FROM)
    eye = center + way * (radius / np.sin(FOV_Y / 2) * 1.02)
    camera = Camera.look_at(tuple(eye), tuple(center), fov_y=FOV_Y, near=radius * 1e-3, name="default")
    return replace(camera, fov_short=True)


def default_light(scene: Scene) -> tuple[Environment, Light]:
    """A soft clear sky and its sun, scaled so that a white surface in the sun has a radiance near 1.

    At that scale unlit and emissive materials of usual strength keep their place in the picture.
    """
    radiance = sky_map(SUN_ELEVATION, SUN_AZIMUTH, TURBIDITY, GROUND)
    sun = sun_light(SUN_ELEVATION, SUN_AZIMUTH, TURBIDITY)
    height = len(radiance)
    polar = (np.arange(height // 2) + 0.5) / height * np.pi
    up = (radiance[: height // 2].mean((1, 2)) * np.cos(polar) * np.sin(polar)).sum() * (np.pi / height) * 2 * np.pi
    environment = Environment(radiance, intensity=float(SKY_SHARE / up), name="default sky")
    return environment, Light(
        kind="directional", color=sun.color, intensity=SUN_SHARE, direction=sun.direction, name="default sun"
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
