"""The node hierarchy of a glTF asset: world matrices, and what its nodes place: meshes, cameras and lights."""

from dataclasses import dataclass

import numpy as np

from glhybrid.load.gltf_accessors import AccessorReader
from glhybrid.load.gltf_document import Document, Item
from glhybrid.pose import rigid, trs_matrices, world_matrices
from glhybrid.scene import F64, Camera, Light, Node

MAX_INSTANCES = 1 << 22  # each is an object of some hundred bytes
KINDS = {name: name for name in ("directional", "point", "spot")}


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """nodes: all of the file's. world: (N, 4, 4) float64 world_from_node. drawn: nodes of the scene, parents first,
    but for those that are hidden."""

    nodes: tuple[Node, ...]
    world: F64
    drawn: tuple[int, ...]


def read_hierarchy(doc: Document) -> Hierarchy:
    """Raises LoadError for loops, a node with two parents, a matrix that is not affine or not finite."""
    items = doc.items("nodes")
    children = [item.indices("children", "nodes") for item in items]
    parent = _parents(items, children)
    nodes = tuple(_node(item, p) for item, p in zip(items, parent, strict=True))
    _check_loops(items, parent, children)
    world = world_matrices(nodes)
    bad = ~np.isfinite(world).all(axis=(1, 2))
    if bad.any():
        raise items[int(np.argmax(bad))].fail("its world matrix is not finite: scales or positions are too large")
    return Hierarchy(nodes, world, _drawn(doc, parent, children))


def _parents(items: list[Item], children: list[tuple[int, ...]]) -> list[int]:
    parent = [-1] * len(items)
    for i, ours in enumerate(children):
        for child in ours:
            if parent[child] not in (-1, i):
                raise items[child].fail(f"is a child of both node {parent[child]} and node {i}; a node has one parent")
            parent[child] = i
    return parent


def _check_loops(items: list[Item], parent: list[int], children: list[tuple[int, ...]]) -> None:
    """A node in a loop, or under one, has no root above it, so a walk from the roots never meets it."""
    met = set(stack := [i for i, p in enumerate(parent) if p == -1])
    while stack:
        below = set(children[stack.pop()]) - met
        met |= below
        stack += below
    if len(met) < len(items):
        first = next(i for i in range(len(items)) if i not in met)
        raise items[first].fail("is its own ancestor or under a node that is: the node hierarchy has a loop")


def _node(item: Item, parent: int) -> Node:
    weights = item.numbers("weights", None, ())
    if "matrix" in item.data:
        values = item.numbers("matrix", 16)
        if any(key in item.data for key in ("translation", "rotation", "scale")):
            item.warn("has a matrix and translation, rotation or scale, which are ignored")
        matrix = np.array(values).reshape(4, 4).T.copy()
        if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
            raise item.fail(f"the last row of its matrix is {matrix[3].tolist()}, must be [0, 0, 0, 1] (affine)")
        return Node(item.name, parent, matrix=matrix, morph_weights=weights)
    rotation = item.numbers("rotation", 4, (0.0, 0.0, 0.0, 1.0))
    length = float(np.linalg.norm(rotation))
    if length < 1e-12:
        raise item.fail("its rotation is [0, 0, 0, 0], must be a unit quaternion")
    if abs(length - 1.0) > 1e-3:
        item.warn("rotation is not a unit quaternion and was normalised")
    if abs(length - 1.0) > 1e-7:
        rotation = tuple(float(r) / length for r in rotation)
    translation, scale = item.numbers("translation", 3, (0.0,) * 3), item.numbers("scale", 3, (1.0,) * 3)
    return Node(item.name, parent, translation=translation, rotation=rotation, scale=scale, morph_weights=weights)


def _drawn(doc: Document, parent: list[int], children: list[tuple[int, ...]]) -> tuple[int, ...]:
    """Nodes of the default scene; of the first if none is named; all if there are no scenes."""
    scenes = doc.items("scenes")
    if not scenes:
        roots = [i for i, p in enumerate(parent) if p == -1]
    else:
        chosen = doc.root.index("scene", "scenes", 0)
        for i, other in enumerate(scenes):
            other.indices("nodes", "nodes")
            if i != chosen:
                other.warn("not loaded: it is not the default scene")
        roots = list(scenes[chosen].indices("nodes", "nodes"))
        for root in roots:
            if parent[root] != -1:
                scenes[chosen].warn(f"lists node {root}, which is no root; it is drawn where its parents place it")
    items = doc.items("nodes")
    drawn: dict[int, None] = {}
    stack = roots[::-1]
    while stack:
        node = stack.pop()
        shown = items[node].extension("KHR_node_visibility")
        if node not in drawn and (shown is None or shown.boolean("visible", True)):  # what is below is hidden with it
            drawn[node] = None
            stack += children[node][::-1]
    return tuple(drawn)


def instance_matrices(item: Item, accessors: AccessorReader, world: F64) -> F64 | None:
    """(N, 4, 4) world matrices of EXT_mesh_gpu_instancing; None where the node does not use it."""
    extension = item.extension("EXT_mesh_gpu_instancing")
    attributes = extension.child("attributes") if extension else None
    if extension is None:
        return None
    if attributes is None or not attributes.data:
        raise extension.fail("has no attributes")
    first = next(iter(attributes.data))
    count = len(accessors.get(attributes.required_index(first, "accessors")).raw)
    if count > MAX_INSTANCES:
        raise attributes.fail(f"has {count} instances, must be <= {MAX_INSTANCES}")
    for name in attributes.data:
        if name not in ("TRANSLATION", "ROTATION", "SCALE"):
            attributes.warn(f"{name} is not used")

    def read(name: str, kind: str, default: tuple[float, ...]) -> F64:
        values = accessors.attribute(attributes, name, kind, count)
        return np.tile(default, (count, 1)) if values is None else values.astype(np.float64)

    rotation = read("ROTATION", "VEC4", (0.0, 0.0, 0.0, 1.0))
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    if not np.all(length > 1e-12):
        raise attributes.fail("a ROTATION is not a quaternion: it has no length")
    local = trs_matrices(read("TRANSLATION", "VEC3", (0.0,) * 3), rotation / length, read("SCALE", "VEC3", (1.0,) * 3))
    placed = world @ local
    if not np.isfinite(placed).all():
        raise attributes.fail("a TRANSLATION, ROTATION or SCALE is not finite")
    return placed


def read_camera(item: Item, node: int, node_name: str, world: F64) -> Camera:
    """item: the camera. The pose keeps the node's view direction and place; scale and shear are dropped."""
    kind = item.choice("type", None, {"perspective": "perspective", "orthographic": "orthographic"})
    data = item.child(kind)
    if data is None:
        raise item.fail(f'"{kind}" is missing')
    pose = rigid(world)
    if pose is None:
        raise item.fail(f'node "{node_name or node}" has scale 0, so its view has no direction')
    name = item.name or node_name or item.label
    near, far = data.number("znear"), data.number("zfar", 0.0)
    if near < 0.0 or (far != 0.0 and far <= near):
        raise data.fail(f"znear {near} and zfar {far} must be 0 <= znear < zfar")
    if kind == "perspective":
        fov_y = data.number("yfov")
        if not 0.0 < fov_y < np.pi:
            raise data.fail(f'"yfov" is {fov_y}, must be between 0 and pi radians')
        if near == 0.0:
            raise data.fail('"znear" is 0, must be > 0')
        return Camera(name, pose, fov_y=fov_y, near=near, far=far, node=node)
    xmag, ymag = data.number("xmag"), data.number("ymag")
    if xmag == 0.0 or ymag == 0.0:
        raise data.fail(f"xmag {xmag} and ymag {ymag} must not be 0")
    if min(xmag, ymag) < 0.0:
        data.warn("negative xmag or ymag: the sign is ignored")
    return Camera(name, pose, fov_y=0.0, near=near, far=far, xmag=abs(xmag), ymag=abs(ymag), node=node)


def read_light(item: Item, node: int, node_name: str, world: F64) -> Light:
    """item: the light of KHR_lights_punctual. It sits at the node's origin and shines along its -Z."""
    kind = item.choice("type", None, KINDS)
    direction = -world[:3, 2]
    length = float(np.linalg.norm(direction))
    if kind != "point" and length < 1e-30:
        raise item.fail(f'node "{node_name or node}" has scale 0, so the light has no direction')
    color, intensity = item.numbers("color", 3, (1.0,) * 3), item.number("intensity", 1.0)
    if intensity < 0.0 or min(color) < 0.0:
        raise item.fail("its color and intensity must not be negative")
    reach = item.number("range", 0.0) if kind != "directional" else 0.0
    if reach < 0.0:
        raise item.fail(f'"range" is {reach}, must be > 0')
    inner, outer = 0.0, float(np.pi / 4)
    if kind == "spot" and (spot := item.child("spot")):
        inner, outer = spot.number("innerConeAngle", inner), spot.number("outerConeAngle", outer)
        if not (0.0 <= inner <= outer and 0.0 < outer <= np.pi / 2 + 1e-6):
            raise spot.fail(f"innerConeAngle {inner} and outerConeAngle {outer} must be 0 <= inner < outer <= pi/2")
    unit = direction / length if length > 0.0 else np.array([0.0, -1.0, 0.0])
    return Light(
        kind,
        color=color,
        intensity=intensity,
        position=tuple(float(v) for v in world[:3, 3]),  # type: ignore[arg-type]
        direction=tuple(float(v) for v in unit),  # type: ignore[arg-type]
        range=reach,
        inner_cone=inner,
        outer_cone=outer,
        name=item.name or node_name,
        node=node,
    )
