"""A scene at a moment: where a clip's keys put nodes, joints, cameras and lights, and what morph weights it sets.

A pose is a function of the time alone: frame N is the same whether it was played to or sought. Times outside a
channel's keys are clamped to its first and last, as glTF 2.0 (3.11, appendix C) has it, so a clip of no length has one
pose. Everything is float64: what is float32 on the GPU is rounded once.

Skinned meshes are posed in a space of their own, the world moved so that the skin's first joint is its origin: a figure
that walks 100 km away from zero keeps its fingers.
"""

from dataclasses import dataclass, replace

import numpy as np

from glhybrid.errors import GeometryError, SettingError, unknown
from glhybrid.scene import F64, Animation, Camera, Channel, Instance, Light, Node, Scene


@dataclass(frozen=True, eq=False)
class Pose:
    """world: (N, 4, 4) float64 world_from_node. weights: (W,) float64 morph weights of the nodes that a clip morphs."""

    world: F64
    weights: dict[int, F64]


def find_clip(scene: Scene, name: str | None = None) -> Animation | None:
    """The clip of that name or number; the first if no name is given, None if there is none.

    Raises SettingError with the nearest name.
    """
    clips = scene.animations
    if name is None:
        return clips[0] if clips else None
    for clip in clips:
        if clip.name == name:
            return clip
    if name.isdecimal() and int(name) < len(clips):
        return clips[int(name)]
    names = [clip.name or str(i) for i, clip in enumerate(clips)]
    raise SettingError(f"{scene.path or scene.name}: {unknown('clip', name, names)}")


def clip_span(clip: Animation) -> tuple[float, float]:
    """First and last key of all its channels, seconds; (0, 0) if it moves nothing."""
    if not clip.channels:
        return 0.0, 0.0
    return float(min(c.times[0] for c in clip.channels)), float(max(c.times[-1] for c in clip.channels))


def notes(scene: Scene, time: float | None, clip_name: str | None) -> list[str]:
    """What a user should know of a time and a clip that were asked for, one sentence each."""
    clip = find_clip(scene, clip_name)
    if clip is None:
        return [] if time is None else [f"time {time:g} s: the scene has no animation, it looks the same at any time"]
    start, end = clip_span(clip)
    what = f'clip "{clip.name or scene.animations.index(clip)}"'
    if not clip.channels:
        return [f"{what} moves nothing that is drawn"]
    if time is not None and not start <= time <= end:
        return [f"time {time:g} s is outside {what} ({start:g} to {end:g} s): its nearest keys hold"]
    return []


def rest(scene: Scene) -> Pose:
    """The pose of a file that nobody animates: nodes as they stand."""
    return Pose(world_matrices(scene.nodes), {})


def evaluate(scene: Scene, time: float, clip: Animation | None) -> Pose:
    """Nodes and morph weights of a clip at a time in seconds. Of two channels for one property the last one wins.

    Raises GeometryError for a channel that names no node and for a pose that is not finite.
    """
    if clip is None:
        return rest(scene)
    translation, rotation, scale = _resting(scene.nodes)
    place = {"translation": translation, "rotation": rotation, "scale": scale}
    weights: dict[int, F64] = {}
    for channel in clip.channels:
        if not 0 <= channel.node < len(scene.nodes):
            raise GeometryError(
                f'{scene.name}: clip "{clip.name}" moves node {channel.node}, the scene has {len(scene.nodes)}'
            )
        value = sample(channel, time)
        if channel.path == "weights":
            weights[channel.node] = value
        else:
            place[channel.path][channel.node] = value
    world = _world(scene.nodes, trs_matrices(translation, rotation, scale))
    bad = ~np.isfinite(world).all((1, 2))
    if bad.any():
        node = int(np.argmax(bad))
        raise GeometryError(
            f'{scene.name}: clip "{clip.name}" at {time:g} s puts node {node} "{scene.nodes[node].name}" nowhere: '
            "its matrix is not finite"
        )
    return Pose(world, weights)


def sample(channel: Channel, time: float) -> F64:
    """(W,) float64 value of a channel; rotations come out as unit quaternions."""
    times, values = channel.times, channel.values
    after = int(np.searchsorted(times, time, side="right"))
    before = max(after - 1, 0)
    cubic = channel.interpolation == "CUBICSPLINE"
    first = (values[before, 1] if cubic else values[before]).astype(np.float64)
    turn = channel.path == "rotation"
    if after in (0, len(times)) or channel.interpolation == "STEP":
        return _unit_quaternion(first) if turn else first
    start, step = float(times[before]), float(times[after]) - float(times[before])
    u = (float(time) - start) / step
    if cubic:
        second = values[after, 1].astype(np.float64)
        leave, arrive = step * values[before, 2].astype(np.float64), step * values[after, 0].astype(np.float64)
        value = (
            (2 * u**3 - 3 * u**2 + 1) * first + (u**3 - 2 * u**2 + u) * leave
            + (3 * u**2 - 2 * u**3) * second + (u**3 - u**2) * arrive
        )  # fmt: skip
        return _unit_quaternion(value) if turn else value
    second = values[after].astype(np.float64)
    if turn:
        return slerp(_unit_quaternion(first), _unit_quaternion(second), u)
    return np.asarray((1 - u) * first + u * second)


def slerp(a: F64, b: F64, u: float) -> F64:
    """The quaternion u of the shorter way from a to b, both unit; exact at both ends, and for nearly equal ones."""
    if a @ b < 0:
        b = -b
    angle = 2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))  # acos of the product loses small angles
    if angle < 1e-9:
        return _unit_quaternion((1 - u) * a + u * b)
    return _unit_quaternion((np.sin((1 - u) * angle) * a + np.sin(u * angle) * b) / np.sin(angle))


def moving_nodes(scene: Scene, clip: Animation) -> frozenset[int]:
    """Nodes whose world matrix a clip may change: what it moves, and all below."""
    moved = {c.node for c in clip.channels if c.path != "weights"}
    parent = [n.parent for n in scene.nodes]
    known = {-1: False} | {n: True for n in moved}
    for node in range(len(parent)):
        way = []
        while node not in known:
            way.append(node)
            node = parent[node]
        known |= dict.fromkeys(way, known[node])
    return frozenset(n for n, moves in known.items() if moves)


def place(scene: Scene, pose: Pose, resting: F64 | None = None) -> Scene:
    """The scene with instances, lights and cameras where the pose has them. Skinned instances stand on their anchor.

    resting: (N, 4, 4) world_from_node at rest, if it is known.
    """
    resting = rest(scene).world if resting is None else resting
    moved = (pose.world != resting).any((1, 2))
    instances = scene.instances
    if scene.skins or moved.any():
        instances = tuple(_placed(scene, i, pose, resting, moved) for i in scene.instances)
    if not moved.any():
        return replace(scene, instances=instances)
    lights = tuple(
        _light(light, pose.world[light.node]) if _moves(light.node, moved) else light for light in scene.lights
    )
    cameras = tuple(_camera(c, pose.world[c.node]) if _moves(c.node, moved) else c for c in scene.cameras)
    return replace(scene, instances=instances, lights=lights, cameras=cameras)


def anchor(scene: Scene, pose: Pose, skin: int) -> F64:
    """(3,) float64, world: the origin of the space that a skin's vertices are posed in, its first joint."""
    return np.asarray(pose.world[_joints(scene, skin)[0], :3, 3])


def joint_matrices(scene: Scene, pose: Pose, skin: int) -> F64:
    """(J + 1, 4, 4) float64 anchored_from_bind; the last leaves vertices without weights where the file has them."""
    rows = np.concatenate([pose.world[_joints(scene, skin)] @ scene.skins[skin].inverse_bind, np.eye(4)[None]])
    rows[:, :3, 3] -= anchor(scene, pose, skin)
    return rows


def _joints(scene: Scene, skin: int) -> list[int]:
    joints = list(scene.skins[skin].joints)
    if bad := [j for j in joints if not 0 <= j < len(scene.nodes)]:
        raise GeometryError(
            f"{scene.name}: skin {skin} has joint node {bad[0]}, the scene has {len(scene.nodes)} nodes"
        )
    return joints


def _moves(node: int, moved: np.ndarray) -> bool:
    return node >= 0 and bool(moved[node])


def _placed(scene: Scene, instance: Instance, pose: Pose, resting: F64, moved: np.ndarray) -> Instance:
    if instance.skin >= 0:
        return replace(instance, world_from_object=translation_matrix(anchor(scene, pose, instance.skin)))
    if not _moves(instance.node, moved):
        return instance
    world, old = pose.world[instance.node], resting[instance.node]
    given = instance.world_from_object
    if not np.allclose(given, old, rtol=1e-9, atol=1e-12):  # one of many at a node: EXT_mesh_gpu_instancing
        if abs(np.linalg.det(old)) < 1e-30:
            refuse_flat(scene, instance)
        world = world @ np.linalg.inv(old) @ given
    return replace(instance, world_from_object=invertible(world))


def refuse_flat(scene: Scene, instance: Instance) -> None:
    """Raises GeometryError: a node without size at rest does not tell where its instances lie in it."""
    raise GeometryError(
        f'{scene.name}: node "{scene.nodes[instance.node].name}" has scale 0 at rest, so where its instances lie in it '
        "is lost and they cannot be animated"
    )


def invertible(world: F64) -> F64:
    """The matrix; where it flattens an object, with a thickness of 1e-6 of its size instead of none."""
    u, s, v = np.linalg.svd(world[:3, :3])
    if s[2] > 1e-7 * s[0]:
        return world
    thick = world.copy()
    thick[:3, :3] = (u * np.maximum(s, max(1e-6 * s[0], 1e-7))) @ v
    return thick


def _light(light: Light, world: F64) -> Light:
    axis = -world[:3, 2]
    length = float(np.linalg.norm(axis))
    x, y, z = (axis / length).tolist() if length > 0 else light.direction
    px, py, pz = world[:3, 3].tolist()
    return replace(light, position=(px, py, pz), direction=(x, y, z))


def _camera(camera: Camera, world: F64) -> Camera:
    pose = rigid(world)
    return camera if pose is None else replace(camera, world_from_view=pose)


def rigid(world: F64) -> F64 | None:
    """The pose with the Z axis of the matrix and its Y axis as far as square to that; None without a direction."""
    back, up = world[:3, 2], world[:3, 1]
    if np.linalg.norm(back) < 1e-30:
        return None
    back = back / np.linalg.norm(back)
    right = np.cross(up, back)
    if np.linalg.norm(right) < 1e-12 * (1.0 + np.linalg.norm(up)):
        right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, world[:3, 3]
    return pose


def world_matrices(nodes: tuple[Node, ...]) -> F64:
    """(N, 4, 4) world_from_node of a hierarchy without loops, level by level from the roots."""
    return _world(nodes, trs_matrices(*_resting(nodes)))


def trs_matrices(translation: F64, rotation: F64, scale: F64) -> F64:
    """(N, 4, 4) T R S of (N, 3) translations, (N, 4) unit quaternions x y z w and (N, 3) scales."""
    x, y, z, w = np.moveaxis(np.asarray(rotation, np.float64), 1, 0)
    m = np.zeros((len(x), 4, 4))
    m[:, 0, 0], m[:, 0, 1], m[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    m[:, 1, 0], m[:, 1, 1], m[:, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    m[:, 2, 0], m[:, 2, 1], m[:, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    m[:, :3, :3] *= np.asarray(scale)[:, None, :]
    m[:, :3, 3] = translation
    m[:, 3, 3] = 1.0
    return m


def translation_matrix(offset: F64) -> F64:
    """(4, 4) float64."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def _resting(nodes: tuple[Node, ...]) -> tuple[F64, F64, F64]:
    return (
        np.array([n.translation for n in nodes], np.float64).reshape(-1, 3),
        np.array([n.rotation for n in nodes], np.float64).reshape(-1, 4),
        np.array([n.scale for n in nodes], np.float64).reshape(-1, 3),
    )


def _world(nodes: tuple[Node, ...], local: F64) -> F64:
    for i, node in enumerate(nodes):
        if node.matrix is not None:
            local[i] = node.matrix
    parent = np.array([n.parent for n in nodes], np.int64)
    world = local.copy()
    placed = parent == -1
    while True:
        ready = np.flatnonzero(~placed & placed[parent])
        if not len(ready):
            return world
        world[ready] = world[parent[ready]] @ local[ready]
        placed[ready] = True


def _unit_quaternion(q: F64) -> F64:
    length = float(np.linalg.norm(q))
    return np.asarray(q / length) if length > 1e-30 else np.array([0.0, 0.0, 0.0, 1.0])
