"""The scene as its file poses it: morph targets at their default weights, skins on their joints' resting places.

A Scene keeps vertices, targets and joints apart, for animation. A picture of a file that nobody animates is one of
`rest_pose(scene)`, in which they are put together once, on the CPU.
"""

from dataclasses import replace

import numpy as np

from glhybrid.load.tangents import face_normals
from glhybrid.scene import F32, F64, Instance, Mesh, Node, Scene, Skin, Triangles


def rest_pose(scene: Scene) -> Scene:
    """The scene with morphed and skinned meshes replaced by still ones; itself if it has none.

    Posed instances have skin -1 and meshes of their own, shared where the pose is the same. Nodes, skins and
    animations stay, so that the scene says what it was made from.
    """
    world = world_matrices(scene.nodes)
    meshes = list(scene.meshes)
    posed: dict[tuple[int, int, tuple[float, ...]], int] = {}

    def still(instance: Instance) -> Instance:
        mesh = scene.meshes[instance.mesh]
        given = scene.nodes[instance.node].morph_weights if instance.node >= 0 else ()
        weights = tuple(given or mesh.morph_weights)
        if instance.skin < 0 and not any(weights):
            return instance
        key = (instance.mesh, instance.skin, weights)
        if key not in posed:
            posed[key] = len(meshes)
            skin = scene.skins[instance.skin] if instance.skin >= 0 else None
            meshes.append(_posed_mesh(mesh, weights, skin, world))
        return replace(instance, mesh=posed[key], skin=-1)

    instances = tuple(still(i) for i in scene.instances)
    if not posed:
        return scene
    used = sorted({i.mesh for i in instances})
    slots = {mesh: slot for slot, mesh in enumerate(used)}
    return replace(
        scene,
        meshes=tuple(meshes[m] for m in used),
        instances=tuple(replace(i, mesh=slots[i.mesh]) for i in instances),
    )


def world_matrices(nodes: tuple[Node, ...]) -> F64:
    """(N, 4, 4) world_from_node of a hierarchy without loops, level by level from the roots."""
    if not nodes:
        return np.zeros((0, 4, 4))
    local = trs_matrices(
        np.array([n.translation for n in nodes]),
        np.array([n.rotation for n in nodes]),
        np.array([n.scale for n in nodes]),
    )
    for i, node in enumerate(nodes):
        if node.matrix is not None:
            local[i] = node.matrix
    parent = np.array([n.parent for n in nodes])
    world = local.copy()
    placed = parent == -1
    while True:
        ready = np.flatnonzero(~placed & placed[parent])
        if not len(ready):
            return world
        world[ready] = world[parent[ready]] @ local[ready]
        placed[ready] = True


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


def _posed_mesh(mesh: Mesh, weights: tuple[float, ...], skin: Skin | None, world: F64) -> Mesh:
    pieces = []
    for piece in mesh.primitives:
        if isinstance(piece, Triangles):
            piece = _morphed(piece, weights)
            if skin is not None and piece.joints is not None:
                piece = _skinned(piece, world[list(skin.joints)] @ skin.inverse_bind)
        pieces.append(piece)
    return Mesh(mesh.name, tuple(pieces))


def _morphed(piece: Triangles, weights: tuple[float, ...]) -> Triangles:
    """The piece displaced by its targets, and then without them."""
    sums = {"position": piece.position, "normal": piece.normal}
    if piece.tangent is not None:
        sums["tangent"] = piece.tangent[:, :3]
    for name in sums:
        for weight, target in zip(weights, piece.morph_targets, strict=False):
            delta = getattr(target, name)
            if weight and delta is not None:
                sums[name] = sums[name] + np.float32(weight) * delta
    normal = _unit(sums["normal"])
    unshared = len(piece.position) == piece.index.size  # as made for a file without normals: flat stays flat
    if unshared and all(t.normal is None for t in piece.morph_targets) and sums["position"] is not piece.position:
        normal[piece.index] = face_normals(sums["position"], piece.index)[:, None]
    tangent = None
    if piece.tangent is not None:
        tangent = np.concatenate([_unit(sums["tangent"]), piece.tangent[:, 3:]], axis=1)
    return replace(piece, position=sums["position"], normal=normal, tangent=tangent, morph_targets=())


def _skinned(piece: Triangles, joint_matrices: F64) -> Triangles:
    """Linear blend skinning (glTF 2.0, 3.7.3.3): the piece in world space, and then without joints.

    joint_matrices: (J, 4, 4) world_from_bind. Vertices without any weight stay where they are.
    """
    assert piece.joints is not None and piece.weights is not None
    blend = np.zeros((len(piece.position), 4, 4))
    for k in range(piece.joints.shape[1]):
        weight = piece.weights[:, k].astype(np.float64)
        joint = np.where(weight > 0.0, piece.joints[:, k], 0)  # a joint without weight may name none that exists
        blend += weight[:, None, None] * joint_matrices[joint]
    blend[~np.any(piece.weights, axis=1)] = np.eye(4)
    linear = blend[:, :3, :3]
    position = np.einsum("vij,vj->vi", linear, piece.position.astype(np.float64)) + blend[:, :3, 3]
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
