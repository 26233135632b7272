"""Meshes that change shape, put into a pose on the CPU: morph targets, then skins. The oracle of the `skin` pass.

A Scene keeps vertices, targets and joints apart, for animation. `posed` puts them together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from glhybrid import pose as posing
from glhybrid.errors import GeometryError
from glhybrid.load.tangents import face_normals
from glhybrid.pose import Pose
from glhybrid.scene import F32, F64, Animation, Instance, Mesh, Scene, Triangles


@dataclass(frozen=True)
class Deformer:
    """One shape that a clip changes: mesh, skin (-1: none) and node (with its morph weights, -1: none) of the scene.

    instances: rows of Scene.instances that show it.
    """

    mesh: int
    skin: int
    node: int
    instances: tuple[int, ...]


def deformers(scene: Scene, clip: Animation | None) -> tuple[Deformer, ...]:
    """What a clip deforms: skins with a joint that it moves, and meshes whose morph weights it sets."""
    if clip is None:
        return ()
    moving = posing.moving_nodes(scene, clip)
    morphed = {c.node for c in clip.channels if c.path == "weights"}
    found: dict[tuple[int, int, int], list[int]] = {}
    for number, instance in enumerate(scene.instances):
        skinned = instance.skin >= 0 and bool(moving & set(scene.skins[instance.skin].joints))
        targets = any(isinstance(p, Triangles) and p.morph_targets for p in scene.meshes[instance.mesh].primitives)
        if skinned or (targets and instance.node in morphed):
            node = instance.node if targets else -1
            found.setdefault((instance.mesh, instance.skin, node), []).append(number)
    return tuple(Deformer(*key, tuple(rows)) for key, rows in found.items())


def posed(scene: Scene, pose: Pose, live: Sequence[Deformer] = ()) -> Scene:
    """The scene at rest in that pose: every morphed or skinned mesh replaced by a still one; itself if nothing changes.

    Posed instances have skin -1 and meshes of their own, shared where the pose is the same. live: deformers that get a
    mesh each, not shared, so that they can be moved later on.
    """
    owner = {i: d for d in live for i in d.instances}
    meshes = list(scene.meshes)
    made: dict[object, int] = {}
    placed = posing.place(scene, pose)
    weighted = pose.weights or any(n.morph_weights for n in scene.nodes) or any(m.morph_weights for m in scene.meshes)

    def still(number: int, instance: Instance) -> Instance:
        if instance.skin < 0 and not weighted and number not in owner:
            return instance  # of a million, nearly all
        weights = morph_weights(scene, pose, instance.mesh, instance.node)
        source = owner.get(number)
        if source is None and instance.skin < 0 and not np.any(weights):
            return instance
        key = source or (instance.mesh, instance.skin, weights.tobytes())
        if key not in made:
            made[key] = len(meshes)
            joints = posing.joint_matrices(scene, pose, instance.skin) if instance.skin >= 0 else None
            meshes.append(_posed_mesh(scene.meshes[instance.mesh], weights, joints, source is not None))
        return replace(instance, mesh=made[key], skin=-1)

    instances = tuple(still(i, instance) for i, instance in enumerate(placed.instances))
    if not made:
        return placed if any(a is not b for a, b in zip(placed.instances, scene.instances, strict=True)) else scene
    used = sorted({i.mesh for i in instances})
    slots = {mesh: slot for slot, mesh in enumerate(used)}
    return replace(
        placed,
        meshes=tuple(meshes[m] for m in used),
        instances=tuple(replace(i, mesh=slots[i.mesh]) for i in instances),
    )


def at_rest(scene: Scene) -> Scene:
    """The scene as its file poses it."""
    return posed(scene, posing.rest(scene))


def at_time(scene: Scene, time: float | None, clip: str | None = None) -> Scene:
    """The scene at a time of a clip in seconds. No clip: the first one. No time: 0 of a clip that is named, else the
    pose that the file rests in."""
    if time is None and clip is None:
        return at_rest(scene)
    return posed(scene, posing.evaluate(scene, time or 0.0, posing.find_clip(scene, clip)))


def morph_weights(scene: Scene, pose: Pose, mesh: int, node: int) -> F64:
    """(W,) float64: the clip's, else the node's, else the mesh's; all three may be none."""
    if node in pose.weights:
        return pose.weights[node]
    given = scene.nodes[node].morph_weights if node >= 0 else ()
    return np.array(given or scene.meshes[mesh].morph_weights, np.float64)


def _posed_mesh(mesh: Mesh, weights: F64, joint_matrices: F64 | None, live: bool) -> Mesh:
    pieces = []
    for piece in mesh.primitives:
        if isinstance(piece, Triangles):
            still = morphed(piece, weights)
            if joint_matrices is not None and piece.joints is not None:
                still = skinned(still, joint_matrices)
            if live:
                still = replace(still, position=still.position.copy())
            piece = still
        pieces.append(piece)
    return Mesh(mesh.name, tuple(pieces))


def stays_flat(piece: Triangles) -> bool:
    """Whether its normals follow the faces: it shares no vertex, as made for a file without normals, and no target
    says how normals move."""
    unshared = np.array_equal(piece.index.ravel(), np.arange(len(piece.position)))
    return bool(piece.morph_targets) and unshared and all(t.normal is None for t in piece.morph_targets)


def morphed(piece: Triangles, weights: F64) -> Triangles:
    """The piece displaced by its targets, and then without them."""
    if not piece.morph_targets:
        return piece
    sums = {"position": piece.position.astype(np.float64), "normal": piece.normal.astype(np.float64)}
    if piece.tangent is not None:
        sums["tangent"] = piece.tangent[:, :3].astype(np.float64)
    for name in sums:
        for weight, target in zip(weights, piece.morph_targets, strict=False):
            delta = getattr(target, name)
            if weight and delta is not None:
                sums[name] = sums[name] + weight * delta.astype(np.float64)
    position, normal = sums["position"].astype(np.float32), _unit(sums["normal"])
    if stays_flat(piece):
        normal[piece.index] = face_normals(position, piece.index)[:, None]
    tangent = None
    if piece.tangent is not None:
        tangent = np.concatenate([_unit(sums["tangent"]), piece.tangent[:, 3:]], axis=1)
    return replace(piece, position=position, normal=normal, tangent=tangent, morph_targets=())


def influences(piece: Triangles, joint_count: int) -> tuple[np.ndarray, F64]:
    """(V, K) joints and weights that add up to 1. Without any weight a vertex follows joint `joint_count`, which stays.

    Raises GeometryError for a joint past the skin's last.
    """
    assert piece.joints is not None and piece.weights is not None
    weights = piece.weights.astype(np.float64)
    joints = np.where(weights > 0.0, piece.joints, 0).astype(np.int64)  # without weight it may name none that exists
    if joints.max(initial=0) >= joint_count:
        raise GeometryError(f"a vertex follows joint {joints.max()}, its skin has {joint_count}: the file is broken")
    total = weights.sum(1, keepdims=True)
    alone = total[:, 0] <= 0.0
    weights = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0.0)
    joints[alone, 0], weights[alone, 0] = joint_count, 1.0
    return joints, weights


def skinned(piece: Triangles, joint_matrices: F64) -> Triangles:
    """Linear blend skinning (glTF 2.0, 3.7.3.3), and then without joints. joint_matrices: as pose.joint_matrices."""
    joints, weights = influences(piece, len(joint_matrices) - 1)
    blend = np.zeros((len(piece.position), 3, 4))
    for k in range(joints.shape[1]):
        blend += weights[:, k, None, None] * joint_matrices[joints[:, k], :3]
    linear = blend[:, :, :3]
    position = np.einsum("vij,vj->vi", linear, piece.position.astype(np.float64)) + blend[:, :, 3]
    # Normals go by the cofactors, the inverse transpose but for its length: a flattened limb divides by nothing.
    cofactor = np.stack([np.cross(linear[:, (i + 1) % 3], linear[:, (i + 2) % 3]) for i in range(3)], axis=1)
    normal = np.einsum("vij,vj->vi", cofactor, piece.normal.astype(np.float64))
    tangent = None
    if piece.tangent is not None:
        along = np.einsum("vij,vj->vi", linear, piece.tangent[:, :3].astype(np.float64))
        tangent = np.concatenate([_unit(along), piece.tangent[:, 3:]], axis=1)
    return replace(
        piece, position=position.astype(np.float32), normal=_unit(normal), tangent=tangent, joints=None, weights=None
    )


def _unit(v: F32 | F64) -> F32:
    """Rows of length 1; +Z for rows without direction."""
    length = np.sqrt(np.einsum("ij,ij->i", v, v, dtype=np.float64))[:, None]
    good = np.isfinite(length) & (length > 0.0)
    return np.asarray(np.where(good, v / np.where(good, length, 1.0), (0.0, 0.0, 1.0)), np.float32)
