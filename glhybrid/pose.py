"""A scene at a moment: where a clip's keys put nodes, joints, cameras and lights, and what morph weights it sets.

A pose is a function of the time alone: frame N is the same whether it was played to or sought. Times outside a
channel's keys are clamped (keys.py), so a clip of no length has one pose. Everything is float64: what is float32 on the
GPU is rounded once.

Skinned meshes are posed in a space of their own, the world moved so that the skin's first joint is its origin: a figure
that walks 100 km away from zero keeps its fingers.
"""

from dataclasses import dataclass, replace

import numpy as np

from glhybrid import keys
from glhybrid.errors import GeometryError, SettingError, unknown
from glhybrid.scene import F64, Animation, Camera, Instance, Light, Node, Scene

ALL = "all"  # clips at once


@dataclass(frozen=True, eq=False)
class Pose:
    """world: (N, 4, 4) float64 world_from_node. weights: (W,) float64 morph weights of the nodes that a clip morphs."""

    world: F64
    weights: dict[int, F64]


def find_clip(scene: Scene, name: str | None = None) -> Animation | None:
    """The clip of that name or number; the first if no name is given, None if there is none.

    Of clips with one name the first is meant; numbers tell them apart. `all`, where no clip is called so, is every clip
    of the file at once: of two that move the same thing the last one wins. Raises SettingError with the nearest name.
    """
    clips = scene.animations
    if name is None:
        return clips[0] if clips else None
    for clip in clips:
        if clip.name == name:
            return clip
    if name.isdecimal() and int(name) < len(clips):
        return clips[int(name)]
    if name == ALL and clips:
        return Animation(ALL, tuple(channel for clip in clips for channel in clip.channels))
    names = [*(clip.name or str(i) for i, clip in enumerate(clips)), *([ALL] if clips else [])]
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
    what = f'clip "{clip.name or scene.animations.index(clip)}"' if clip.name != ALL else "all clips"
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
    return rest(scene) if clip is None else Player(scene, clip).at(time)


class Player:
    """A clip made ready to be posed many times: keys by kind, nodes by level, and at rest whatever it does not move."""

    def __init__(self, scene: Scene, clip: Animation) -> None:
        self._scene, self._clip = scene, clip
        for channel in clip.channels:
            if not 0 <= channel.node < len(scene.nodes):
                raise GeometryError(
                    f'{scene.name}: clip "{clip.name}" moves node {channel.node}, the scene has {len(scene.nodes)}'
                )
        self._tracks = keys.tracks(clip.channels)
        translation, rotation, scale = _resting(scene.nodes)
        self._place = {"translation": translation, "rotation": rotation, "scale": scale}
        self._local = _local(scene.nodes)
        self.rest = _world(scene.nodes, self._local)
        moved = {c.node for c in clip.channels if c.path != "weights"}
        self._posed = np.array(sorted(n for n in moved if scene.nodes[n].matrix is None), np.int64)
        self._is_posed = np.zeros(len(scene.nodes), np.uint8)
        self._is_posed[self._posed] = 1
        moving = np.zeros(len(scene.nodes), bool)
        moving[list(moving_nodes(scene, clip))] = True
        parent = _parents(scene.nodes)
        levels = [level[moving[level]] for level in _levels(parent)]
        self._levels = [(level, parent[level]) for level in levels if len(level)]
        nothing = [np.zeros(0, np.int64)]
        in_order = (np.concatenate(nothing + [level[k] for level in self._levels]) for k in (0, 1))
        self._in_order = next(in_order), next(in_order)
        self._all_move = bool(moving.all())
        self._now: Pose | None = None  # of run()

    def at(self, time: float) -> Pose:
        """The pose at a time in seconds. Raises GeometryError where it is not finite."""
        moved = {group.path for group in self._tracks}
        place = {path: values.copy() if path in moved else values for path, values in self._place.items()}
        weights: dict[int, F64] = {}
        for path, nodes, values in keys.sampled(self._tracks, time):
            if path == "weights":
                weights |= zip(nodes.tolist(), values, strict=True)
            else:
                place[path][nodes] = values
        world = np.empty_like(self.rest) if self._all_move else self.rest.copy()
        bad = (self._chain_compiled if len(self._posed) >= keys.MANY else self._chain)(place, world)
        self._refuse(bad, time)
        return Pose(world, weights)

    def run(self, time: float) -> Pose:
        """The same, compiled, for who looks again and again: the next call changes what this one returned."""
        if self._now is None:
            self._place = {path: np.array(values, np.float64, order="C") for path, values in self._place.items()}
            self._now = Pose(self.rest.copy(), {})
        weights = self._now.weights
        for group in self._tracks:
            if group.path == "weights":
                weights.update(zip(group.nodes.tolist(), group.at(time), strict=True))
            else:
                group.into(self._place[group.path], time)
        self._refuse(self._chain_compiled(self._place, self._now.world), time)
        return self._now

    def _refuse(self, bad: int, time: float) -> None:
        if bad >= 0:
            raise GeometryError(
                f'{self._scene.name}: clip "{self._clip.name}" at {time:g} s puts node {bad} '
                f'"{self._scene.nodes[bad].name}" nowhere: its matrix is not finite'
            )

    def _chain(self, place: dict[str, F64], world: F64) -> int:
        """Fills world (N, 4, 4) from translations, rotations and scales; returns a node that is nowhere, or -1."""
        local, posed = self._local.copy(), self._posed
        local[posed] = trs_matrices(*(place[path][posed] for path in ("translation", "rotation", "scale")))
        with np.errstate(invalid="ignore"):  # what is nowhere is found below
            for nodes, parents in self._levels:
                world[nodes] = local[nodes] if parents[0] < 0 else world[parents] @ local[nodes]
        fine = np.isfinite(world).all((1, 2))
        return -1 if fine.all() else int(np.argmin(fine))

    def _chain_compiled(self, place: dict[str, F64], world: F64) -> int:
        """The same for thousands of nodes."""
        from glhybrid import swarm

        placed = (place["translation"], place["rotation"], place["scale"], self._is_posed, self._local)
        bad = -1
        levels = self._levels
        if levels and len(self._posed) < swarm.TASK:  # one core does it all: parents come first
            levels = [self._in_order]
        for nodes, parents in levels:
            parts = swarm.spread(
                lambda first, last: swarm.pose_level(*placed, nodes, parents, first, last, world),  # noqa: B023
                0, len(nodes),
            )  # fmt: skip
            bad = max(bad, *parts)
        return bad


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
    """The matrix (4, 4); where it flattens an object, with a thickness of 1e-6 of its size instead of none."""
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
    return _world(nodes, _local(nodes))


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


def _local(nodes: tuple[Node, ...]) -> F64:
    """(N, 4, 4) parent_from_node."""
    local = trs_matrices(*_resting(nodes))
    for i, node in enumerate(nodes):
        if node.matrix is not None:
            local[i] = node.matrix
    return local


def _parents(nodes: tuple[Node, ...]) -> np.ndarray:
    return np.array([n.parent for n in nodes], np.int64)


def _levels(parent: np.ndarray) -> list[np.ndarray]:
    """Rows of nodes, the roots first and then each level below."""
    levels = [np.flatnonzero(parent == -1)]
    placed = parent == -1
    while len(levels[-1]):
        levels.append(np.flatnonzero(~placed & placed[parent]))
        placed[levels[-1]] = True
    return levels[:-1]


def _world(nodes: tuple[Node, ...], local: F64) -> F64:
    parent, world = _parents(nodes), local.copy()
    for level in _levels(parent)[1:]:
        world[level] = world[parent[level]] @ local[level]
    return world
