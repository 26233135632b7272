"""What a clip moves, prepared once, so that a frame costs what moves in it: matrices, joints, weights, boxes. No GL.

Boxes of deformed meshes are found without looking at a vertex: one that follows several joints lies between the places
that each alone would bring it to, so the boxes of every joint's vertices, moved by the joint, hold the whole mesh.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glhybrid import pose as posing
from glhybrid.deform import Deformer, deformers, influences, morph_weights, posed
from glhybrid.errors import GeometryError
from glhybrid.pose import Pose
from glhybrid.scene import F64, Animation, Camera, Light, Scene, Sphere, Triangles
from glhybrid.settings import Settings

SLACK = 1e-4  # of a box's size, that deformed vertices computed in float32 may lie outside


@dataclass(frozen=True, eq=False)
class Shape:
    """A deformer at a moment. joints: (J + 1, 4, 4) float64 anchored_from_bind, or (1, 4, 4) identity without a skin.

    weights: (W,) float64 of its morph targets. bounds: (2, 3) float64, object space, sure to hold every vertex.
    """

    joints: F64
    weights: F64
    bounds: F64


@dataclass(frozen=True, eq=False)
class Moment:
    """A scene at a time. world_from_object: (I, 4, 4) float64 by row of Scene.instances.

    moved: rising rows of it that differ from what was in the array before; None: that is not known.
    """

    time: float
    world_from_object: F64
    lights: tuple[Light, ...]
    cameras: tuple[Camera, ...]
    shapes: tuple[Shape, ...]
    moved: np.ndarray | None = None


def animated(settings: Settings) -> bool:
    """Whether a clip is to be played, if there is one."""
    return (settings.time is not None or settings.clip is not None) and settings.reflections != "reference"


def wanted(scene: Scene, settings: Settings) -> "Motion | None":
    """The motion of a scene under these settings; None where nothing moves or all has to stand still.

    The path tracer gathers its light sources once a scene: it gets a still scene for each time.
    """
    if not animated(settings):
        return None
    clip = posing.find_clip(scene, settings.clip)
    return Motion(scene, clip) if clip is not None and clip.channels else None


class Motion:
    """A scene and the clip that plays in it.

    start: the scene at rest with a mesh of its own for each deformer, instances in the same order: what is uploaded.
    """

    def __init__(self, scene: Scene, clip: Animation) -> None:
        self.scene, self.clip = scene, clip
        self.deformers = deformers(scene, clip)
        for mesh in (scene.meshes[d.mesh] for d in self.deformers):
            if any(isinstance(p, Sphere) for p in mesh.primitives):
                raise GeometryError(
                    f'{scene.name}: clip "{clip.name}" deforms mesh "{mesh.name}", which holds an analytic sphere, and '
                    "spheres do not bend: give it a mesh of its own, or make triangles of it"
                )
        self._player = posing.Player(scene, clip)
        rest = posing.Pose(self._player.rest, {})
        self._lists = scene.replace(instances=())  # what place() moves object by object: lights and cameras
        moving = posing.moving_nodes(scene, clip)
        self._lists_move = not moving.isdisjoint([*(p.node for p in scene.lights), *(c.node for c in scene.cameras)])
        rows = [i for i, p in enumerate(scene.instances) if p.skin < 0 and p.node in moving]
        self._rows = np.array(rows, np.int64)
        self._nodes = np.array([scene.instances[i].node for i in rows], np.int64)
        self._local = _local(scene, self._rows, self._nodes, rest.world)
        self._plain = (self._local == np.eye(4)).all((1, 2)).view(np.uint8)
        self._flat, self._moved = (np.zeros(len(rows), np.uint8) for _ in range(2))
        self._skinned = [(i, p.skin) for i, p in enumerate(scene.instances) if p.skin >= 0]
        start = posed(scene, rest, self.deformers)
        self._still = np.array([p.world_from_object for p in start.instances]).reshape(-1, 4, 4)
        self._still[self._rows] = _invertible(self._still[self._rows])
        instances = zip(start.instances, self._still, strict=True)
        self.start = start.replace(instances=tuple(replace(p, world_from_object=m) for p, m in instances))
        self._boxes = [_JointBoxes(scene, d) for d in self.deformers]
        lit = any(light.node in moving for light in scene.lights)
        self.still = not (rows or self._skinned or self.deformers or lit)  # but for cameras

    @property
    def moving(self) -> frozenset[int]:
        """Rows of Scene.instances that may be elsewhere, or of another shape, at another time."""
        skinned = (row for row, _ in self._skinned)
        return frozenset([*self._rows.tolist(), *skinned, *(i for d in self.deformers for i in d.instances)])

    @property
    def deforming(self) -> frozenset[int]:
        """Rows of start.meshes whose vertices move."""
        return frozenset(self.start.instances[d.instances[0]].mesh for d in self.deformers)

    @cached_property
    def largest(self) -> int:
        """Triangles of the largest mesh whose vertices move; 0 if none do."""
        meshes = [self.start.meshes[m].primitives for m in self.deforming]
        return max((sum(len(p.index) for p in m if isinstance(p, Triangles)) for m in meshes), default=0)

    def at(self, time: float, world: F64 | None = None) -> Moment:
        """Everything that moves, at a time in seconds.

        world: (I, 4, 4) of an earlier moment, to be changed into this one's.
        """
        pose = self._player.run(time)
        rows = None
        if world is None:
            world = self.resting()
            self._carry(pose.world, world)
        else:
            rows = self._carry(pose.world, world)
        for row, skin in self._skinned:
            world[row, :3, 3] = posing.anchor(self.scene, pose, skin)
        if rows is not None and self._skinned:
            rows = np.union1d(rows, [row for row, _ in self._skinned])
        placed = posing.place(self._lists, pose, self._player.rest) if self._lists_move else self._lists
        shapes = tuple(self._shape(d, b, pose) for d, b in zip(self.deformers, self._boxes, strict=True))
        return Moment(time, world, placed.lights, placed.cameras, shapes, rows)

    def resting(self) -> F64:
        """(I, 4, 4) float64: where instances are in `start`."""
        return self._still.copy()

    def _carry(self, nodes: F64, world: F64) -> np.ndarray:
        """Puts what moves rigidly where its nodes are; returns the rows where it was not before."""
        from glhybrid import swarm

        flat, moved, rows = self._flat, self._moved, self._rows
        if not len(rows):
            return rows
        given = (nodes, self._nodes, self._local, self._plain, rows)
        counts = swarm.spread(lambda first, last: swarm.carry(*given, first, last, world, flat, moved), 0, len(rows))
        if any(counts):
            for row in rows[np.flatnonzero(flat)]:
                world[row] = posing.invertible(world[row])
        return rows[np.flatnonzero(moved)]

    @cached_property
    def bounds(self) -> F64:
        """(2, 3) float64, world: what the scene fills over the whole clip, about."""
        start, end = posing.clip_span(self.clip)
        rows = [self.start.instances[d.instances[0]].mesh for d in self.deformers]
        mesh = [p.mesh for p in self.start.instances]
        own = np.array([m.bounds for m in self.start.meshes]).reshape(-1, 2, 3)
        corners = []
        for time in np.linspace(start, end, 9):
            moment = self.at(float(time))
            own[rows] = np.array([s.bounds for s in moment.shapes]).reshape(-1, 2, 3)
            boxes, world = own[mesh], moment.world_from_object
            middle, half = boxes.mean(1), (boxes[:, 1] - boxes[:, 0]) / 2
            middle = np.einsum("iab,ib->ia", world[:, :3, :3], middle) + world[:, :3, 3]
            half = np.einsum("iab,ib->ia", np.abs(world[:, :3, :3]), half)
            corners += [middle - half, middle + half]
        points = np.concatenate([np.zeros((0, 3)), *corners])
        points = points[np.isfinite(points).all(1)]
        return np.stack([points.min(0), points.max(0)]) if len(points) else np.zeros((2, 3))

    def _shape(self, deformer: Deformer, boxes: "_JointBoxes", pose: Pose) -> Shape:
        weights = morph_weights(self.scene, pose, deformer.mesh, deformer.node)
        joints = np.eye(4)[None]
        if deformer.skin >= 0:
            joints = posing.joint_matrices(self.scene, pose, deformer.skin)
        bounds = boxes.bounds(joints, weights)
        if not np.isfinite(bounds).all():
            name = self.scene.meshes[deformer.mesh].name
            raise GeometryError(f'{self.scene.name}: clip "{self.clip.name}" puts vertices of mesh "{name}" nowhere')
        return Shape(joints, weights, bounds)


class _JointBoxes:
    """By joint, the box of the vertices that follow it, and of what each morph target adds to them."""

    def __init__(self, scene: Scene, deformer: Deformer) -> None:
        mesh = scene.meshes[deformer.mesh]
        joint_count = len(scene.skins[deformer.skin].joints) if deformer.skin >= 0 else 0
        targets = max((len(p.morph_targets) for p in mesh.primitives if isinstance(p, Triangles)), default=0)
        self._base = np.stack([np.full((joint_count + 1, 3), np.inf), np.full((joint_count + 1, 3), -np.inf)])
        self._delta = np.zeros((targets, 2, joint_count + 1, 3))
        for piece in mesh.primitives:
            if not isinstance(piece, Triangles):
                continue
            vertex = np.unique(piece.index)
            joint = np.zeros(len(vertex), np.int64)
            if deformer.skin >= 0 and piece.joints is not None:
                joints, weights = influences(piece, joint_count)
                column, row = np.nonzero(weights[vertex].T > 0)
                joint, vertex = joints[vertex[row], column], vertex[row]
            _grow(self._base, joint, piece.position[vertex])
            for number, target in enumerate(piece.morph_targets):
                if target.position is not None:
                    _grow(self._delta[number], joint, target.position[vertex])
        self._used = np.flatnonzero(np.isfinite(self._base[0]).all(1))

    def bounds(self, joints: F64, weights: F64) -> F64:
        low, high = self._base[:, self._used]
        for weight, delta in zip(weights, self._delta, strict=False):
            ends = weight * delta[:, self._used]
            low, high = low + ends.min(0), high + ends.max(0)
        centre, half = (low + high) / 2, (high - low) / 2
        matrix = joints[self._used]
        centre = np.einsum("jab,jb->ja", matrix[:, :3, :3], centre) + matrix[:, :3, 3]
        half = np.einsum("jab,jb->ja", np.abs(matrix[:, :3, :3]), half)
        box = np.stack([(centre - half).min(0), (centre + half).max(0)])
        slack = SLACK * float((box[1] - box[0]).max()) + 1e-6 * float(np.abs(box).max())
        return box + np.array([[-slack], [slack]])


def _grow(boxes: F64, joint: np.ndarray, position: np.ndarray) -> None:
    """boxes (2, J, 3) grow by positions (P, 3) of joints (P,)."""
    np.minimum.at(boxes[0], joint, position)
    np.maximum.at(boxes[1], joint, position)


def _local(scene: Scene, rows: np.ndarray, nodes: np.ndarray, rest: F64) -> F64:
    """(R, 4, 4) node_from_object of instances: identity but where one node has several of its own places."""
    local = np.tile(np.eye(4), (len(rows), 1, 1))
    given = np.array([scene.instances[i].world_from_object for i in rows]).reshape(-1, 4, 4)
    old = rest[nodes]
    apart = (np.abs(given - old) > 1e-12 + 1e-9 * np.abs(old)).any((1, 2))
    for k in np.flatnonzero(apart):
        if abs(np.linalg.det(old[k])) < 1e-30:
            posing.refuse_flat(scene, scene.instances[rows[k]])
        local[k] = np.linalg.inv(old[k]) @ given[k]
    return local


def _invertible(world: F64) -> F64:
    """pose.invertible of many."""
    size = np.linalg.norm(world[:, :3, :3], axis=(1, 2))
    doubtful = np.abs(np.linalg.det(world[:, :3, :3])) <= 1e-6 * size**3
    for row in np.flatnonzero(doubtful):
        world[row] = posing.invertible(world[row])
    return world
