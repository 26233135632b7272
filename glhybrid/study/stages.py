"""Small scenes with one number that can be turned, for curves of error over it."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glhybrid.load.shapes import box
from glhybrid.scene import (
    F64,
    Animation,
    Camera,
    Channel,
    Environment,
    Instance,
    Light,
    Material,
    Mesh,
    Node,
    Scene,
    Sphere,
    Triangles,
)

STONE = Material("stone", (0.6, 0.55, 0.5, 1), double_sided=True)
CLAY = Material("clay", (0.7, 0.3, 0.2, 1), double_sided=True)
Part = tuple[Triangles | Sphere, int, tuple[float, float, float]]  # shape, material, place


def posts(elevation_deg: float = 25.0, *, scale: float = 1.0, offset: float = 0.0) -> tuple[Scene, Camera]:
    """Posts, a thin wall and a ball on a floor under a sun; all of it scaled, then moved by `offset` metres, by the
    objects' own transforms."""
    angle = np.radians(elevation_deg)
    sun = Light("directional", intensity=3.0, direction=(-0.8 * np.cos(angle), -np.sin(angle), -0.6 * np.cos(angle)))
    parts: list[Part] = [
        (box(size=(60, 0.2, 60)), 0, (0, -0.1, 0)), (box(size=(4, 1.5, 0.02)), 1, (0, 0.75, -2.5)),
        (Sphere(0.8), 1, (2.5, 0.8, 2)),
    ]  # fmt: skip
    post = box(size=(0.3, 1.2, 0.3))
    parts += [(post, 1, (x, 0.6, z)) for x in (-6.1, -3.3, -0.4, 4.6) for z in (-5.2, 0.3, 3.7)]
    camera = Camera.look_at((5, 3, 8), (0, 0.3, 0), fov_y=0.75)
    return placed("posts", parts, (STONE, CLAY), camera, scale, offset, lights=(sun,))


def room(thickness: float) -> tuple[Scene, Camera]:
    """A sealed room on a floor under a sun, seen from inside; its walls are so thick (metres)."""
    size, high, t = 3.0, 2.0, thickness
    side, end, lid = box(size=(t, high, size)), box(size=(size, high, t)), box(size=(size, t, size))
    half = size / 2 - t / 2
    parts: list[Part] = [
        (box(size=(60, 0.2, 60)), 0, (0, -0.1, 0)), (lid, 0, (0, high - t / 2, 0)), (side, 1, (half, high / 2, 0)),
        (side, 1, (-half, high / 2, 0)), (end, 1, (0, high / 2, half)), (end, 1, (0, high / 2, -half)),
    ]  # fmt: skip
    sun = Light("directional", intensity=3.0, direction=(-0.68, -0.6, -0.43))
    camera = Camera.look_at((-1.2, 1.4, -1.0), (1.4, 0, 0.6), fov_y=1.0)
    return placed("room", parts, (STONE, CLAY), camera, lights=(sun,))


def mirror_floor(roughness: float) -> tuple[Scene, Camera]:
    """A metal floor of that roughness with a box, a thin post and a ball, under a smooth bright sky.

    The bodies are unlit, so all that differs between ways to draw them is what the floor makes of them."""
    floor = Material("floor", (0.95, 0.95, 0.95, 1), metallic=1.0, roughness=roughness, double_sided=True)
    parts: list[Part] = [
        (box(size=(8, 0.2, 8)), 0, (0, -0.1, 0)), (box(size=(1.2, 1.4, 0.9)), 1, (-0.9, 0.7, -0.6)),
        (box(size=(0.08, 1.6, 0.08)), 2, (0.5, 0.8, 0.3)), (Sphere(0.45), 2, (1.1, 0.45, -0.7)),
    ]  # fmt: skip
    rise = np.linspace(1, -1, 32)[:, None, None]
    sky = np.broadcast_to(np.where(rise > 0, 0.6 + 0.5 * rise, 0.35) * np.array([0.9, 1.0, 1.15]), (32, 64, 3))
    camera = Camera.look_at((0.3, 1.0, 3.2), (0, 0.25, 0), fov_y=0.7)
    environment = Environment(np.ascontiguousarray(sky, np.float32), name="dusk")
    bodies = tuple(
        replace(m, unlit=True, base_color=c) for m, c in ((CLAY, (0.3, 0.09, 0.05, 1)), (STONE, (0.14, 0.13, 0.12, 1)))
    )
    return placed(f"mirror floor {roughness:g}", parts, (floor, *bodies), camera, environment=environment)


def leaving(at_s: float) -> tuple[Scene, Camera]:
    """A box that stands on a glossy floor under a sun of some size until a time in seconds, and is gone then."""
    scene, camera = mirror_floor(0.25)
    materials = (replace(scene.materials[0], metallic=0.5), *scene.materials[1:])  # shows shadows too
    sun = Light("directional", intensity=2.0, direction=(-0.5, -0.8, -0.3), angular_diameter=np.radians(4))
    places = np.array([(0, 0, 0), (0, 500, 0)], np.float32)
    channel = Channel(0, "translation", "STEP", np.array([0, at_s], np.float32), places)
    still = scene.instances
    box_first = Instance(still[1].mesh, still[1].world_from_object, "box", still[1].materials, node=1)
    pose = still[1].world_from_object[:3, 3]
    nodes = (Node("lift", -1), Node("box", 0, translation=tuple(pose.tolist())))
    instances = (still[0], box_first, *still[2:])
    animation = Animation("leave", (channel,))
    return scene.replace(
        name="leaving", materials=materials, instances=instances, nodes=nodes, animations=(animation,), lights=(sun,)
    ), camera


def placed(
    name: str, parts: Sequence[Part], materials: tuple[Material, ...], camera: Camera, scale: float = 1.0,
    offset: float = 0.0, **extra: object,
) -> tuple[Scene, Camera]:  # fmt: skip
    """A scene of parts, and the camera that sees it: scaled about the origin, then moved along a slanted line."""
    way = np.array([0.6, 0.48, 0.64]) * offset
    meshes: dict[int, int] = {}
    shapes: list[Mesh] = []
    instances = []
    for shape, material, at in parts:
        if id(shape) not in meshes:
            meshes[id(shape)] = len(shapes)
            shapes.append(Mesh(f"{name} {len(shapes)}", (shape,)))
        pose: F64 = np.diag([scale, scale, scale, 1.0])
        pose[:3, 3] = scale * np.asarray(at, np.float64) + way
        instances.append(Instance(meshes[id(shape)], pose, materials=(material,)))
    view = camera.world_from_view.copy()
    view[:3, 3] = scale * view[:3, 3] + way
    camera = Camera("main", view, fov_y=camera.fov_y, near=camera.near * scale)
    scene = Scene(name, tuple(shapes), tuple(instances), materials, cameras=(camera,), **extra)  # type: ignore[arg-type]
    return scene.replace(sha256=_digest(scene)), camera


def _digest(scene: Scene) -> str:
    """Of the content, as files have one of theirs."""
    digest = hashlib.sha256(repr((scene.materials, scene.lights)).encode())
    for mesh in scene.meshes:
        for piece in mesh.primitives:
            digest.update(repr(piece).encode() if isinstance(piece, Sphere) else piece.position.tobytes())
    for instance in scene.instances:
        digest.update(instance.world_from_object.tobytes() + repr((instance.mesh, instance.materials)).encode())
    if scene.environment is not None:
        digest.update(scene.environment.radiance.tobytes())
    return digest.hexdigest()
