"""Scenes that shadow techniques are measured on, and their shadows in closed form."""

from typing import Any

import numpy as np
from rays import moved, piece, scene_of, unit

import glhybrid as gh
from glhybrid.image import Frame
from glhybrid.load.shapes import box
from glhybrid.scene import F64, Camera, Image, Instance, Light, Material, Scene, Sphere, Texture

WHITE = Material(double_sided=True)
S1 = (640, 480)  # posts() are seen at
FACING = ("normal_geometric", "distance", "position")  # AOVs that facing() looks at


def settings(technique: str, reflections: str = "none", levels: Any = "auto", **parameters: Any) -> gh.Settings:
    """parameters: of the technique."""
    dotted = {f"shadows.{technique}.{key}": value for key, value in parameters.items()}
    return gh.Settings(aa=1, exposure=0.0, shadows=technique, reflections=reflections, levels=levels, parameters=dotted)


def seen(renderer: gh.Renderer, scene: Scene, camera: Camera, size: Any, technique: str, **parameters: Any) -> Frame:
    """With the visibility, and the AOVs that facing() looks at."""
    return renderer.render(scene, camera, size, settings(technique, **parameters), ("visibility", *FACING))


def facing(frame: Frame, scene: Scene, light: int = 0) -> Any:
    """(H, W) bool: pixels whose surface faces a light."""
    lamp = scene.lights[light]
    to_light: Any = -np.array(lamp.direction)
    if lamp.kind != "directional":
        to_light = np.array(lamp.position) - frame["position"]
        to_light /= np.linalg.norm(to_light, axis=-1, keepdims=True)
    return np.isfinite(frame["distance"]) & ((frame["normal_geometric"] * to_light).sum(-1) > 1e-3)


def posts(elevation_deg: float = 25.0, lamp: Light | None = None) -> tuple[Scene, Camera, F64]:
    """S1 of the failure catalogue: 20 posts (0.3 x 1.2 m), a wall 2 cm thick and a ball on a floor of 28 x 28 m under
    a low sun (or `lamp`). Returns scene, camera and the unit direction to the sun."""
    rng = np.random.default_rng(1)
    foot: list[F64] = []
    while len(foot) < 20:
        at = rng.uniform(-8, 8, 2)
        if all(np.linalg.norm(at - other) > 1.2 for other in foot) and abs(at[1] + 3) > 1:
            foot.append(at)
    shapes = (box(size=(28, 0.2, 28)), box(size=(0.3, 1.2, 0.3)), box(size=(4, 1.5, 0.02)), Sphere(0.8))
    places = [(0, (0, -0.1, 0)), (2, (0, 0.75, -3)), (3, (2.5, 0.8, 2))] + [(1, (x, 0.6, z)) for x, z in foot]
    scene = scene_of(*shapes, materials=(WHITE,))
    scene = scene.replace(instances=tuple(Instance(mesh, moved(np.array(at))) for mesh, at in places))
    angle = np.radians(elevation_deg)
    to_sun = np.array([0.8 * np.cos(angle), np.sin(angle), 0.6 * np.cos(angle)])
    camera = Camera.look_at((9, 7, 13), (0, 0.3, 0), fov_y=0.75)
    return scene.replace(lights=(lamp or Light("directional", direction=tuple(-to_sun)),)), camera, to_sun


def exact_visibility(scene: Scene, points: F64, to_light: F64, distance: Any = np.inf) -> F64:
    """(N,) 0 or 1: whether light reaches points (N, 3) from directions (3,) or (N, 3), in float64, past boxes whose
    poses only move them, and spheres."""
    to_light = np.broadcast_to(to_light, points.shape)
    blocked = np.zeros(len(points), bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        for instance in scene.instances:
            mesh, centre = scene.meshes[instance.mesh], instance.world_from_object[:3, 3]
            shape = mesh.primitives[0]
            if isinstance(shape, Sphere):
                away = points - centre
                b = (away * to_light).sum(1)
                root = b * b - (away * away).sum(1) + shape.radius**2
                near, far = -b - np.sqrt(root), -b + np.sqrt(root)
            else:
                t = (mesh.bounds[:, None] + centre - points) / to_light
                near, far = t.min(0).max(1), t.max(0).min(1)
            blocked |= (far > np.maximum(near, 1e-4)) & (near < distance)
    return (~blocked).astype(np.float64)


def room() -> tuple[Scene, Camera, F64]:
    """A sealed room of walls 2 cm thick on a floor, seen from inside: no light may get in."""
    thin, size, high = 0.02, 3.0, 2.0
    wall_x, wall_z = box(size=(thin, high, size)), box(size=(size, high, thin))
    parts = (box(size=(12, 0.2, 12)), box(size=(size, thin, size)), wall_x, wall_x, wall_z, wall_z)
    half = size / 2 - thin / 2
    at = (
        (0, -0.1, 0),
        (0, high, 0),
        (half, high / 2, 0),
        (-half, high / 2, 0),
        (0, high / 2, half),
        (0, high / 2, -half),
    )
    scene = scene_of(*parts, poses=[moved(np.array(p)) for p in at], materials=(WHITE,))
    to_sun = unit((0.8, 0.7, 0.5))
    camera = Camera.look_at((1.2, 1.6, 1.2), (-1, 0.2, -0.8), fov_y=1.2)
    return scene.replace(lights=(Light("directional", direction=tuple(-to_sun)),)), camera, to_sun


def half_plane(height: float, half_angle: float) -> tuple[Scene, Camera]:
    """The edge of a slab, over x < 0, above a floor under a sun of that half angle straight overhead; the camera
    looks down from under the slab at three times the penumbra."""
    slab, floor = box(size=(6, 0.01, 6)), box(size=(12, 0.2, 12))
    at = np.array([[-3, height + 0.005, 0], [0, -0.1, 0]])
    scene = scene_of(slab, floor, poses=[moved(p) for p in at], materials=(WHITE,))
    sun = Light("directional", direction=(0.0, -1.0, 0.0), angular_diameter=2 * half_angle)
    camera = Camera.look_at((0, 0.9 * height, 0), (0, 0, 0), up=(0, 0, -1))
    wide = 3 * height * float(np.tan(half_angle))
    view = Camera("down", camera.world_from_view, fov_y=0.0, near=1e-3, ymag=wide / 16, xmag=wide)
    return scene.replace(lights=(sun,)), view


def cut_out() -> Material:
    """A chequer of 8 x 8 holes."""
    texels = np.full((8, 8, 4), 255, np.uint8)
    texels[(np.indices((8, 8)).sum(0) % 2).astype(bool), 3] = 0
    return Material(
        alpha_mode="MASK",
        double_sided=True,
        textures={"base_color": Texture(Image(texels), nearest=True, mipmap=False)},
    )


def stage(light: Light) -> tuple[Scene, Camera]:
    """A cut-out panel, a sphere, a box and a single-sided panel on a floor."""
    quad, index = np.array([[-1, 0, 0], [1, 0, 0], [1, 1.6, 0], [-1, 1.6, 0]]), [[0, 1, 2], [0, 2, 3]]
    uv = [[0, 1], [1, 1], [1, 0], [0, 0]]
    parts = (
        box(size=(9, 0.2, 9)), piece(quad, index, uv=uv), Sphere(0.5), box(size=(0.3, 1.2, 0.3)), piece(quad, index),
    )  # fmt: skip
    at = ((0, -0.1, 0), (-0.6, 0.05, -0.5), (1.5, 0.5, 1), (-1.8, 0.6, 1.2), (2, 0, -1.2))
    scene = scene_of(*parts, poses=[moved(p) for p in at], materials=(WHITE, cut_out(), Material()))
    instances = tuple(
        Instance(i.mesh, i.world_from_object, materials=(slot,))
        for i, slot in zip(scene.instances, (0, 1, 0, 0, 2), strict=True)
    )
    scene = scene.replace(instances=instances, lights=(light,))
    return scene, Camera.look_at((3.5, 4, 5), (0, 0.3, 0), fov_y=0.75)


LAMPS = {
    "sun": Light("directional", direction=(-0.5, -0.7, 0.51)),
    "spot": Light("spot", intensity=40, position=(2.5, 3.5, -2.5), direction=(-0.5, -0.7, 0.51), outer_cone=0.55),
    "wide spot": Light("spot", intensity=20, position=(0.4, 2.5, -1.6), direction=(0, -1, 0), outer_cone=1.2),
    "point": Light("point", intensity=15, position=(0.4, 2.1, 0.8)),
}
