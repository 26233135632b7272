"""Scenes in motion that the bench makes itself: a ring that joints wring out of shape, and a swarm of rigid bodies."""

from typing import Any

import numpy as np

from glhybrid.load.shapes import box, plane, torus
from glhybrid.scene import Animation, Camera, Channel, Instance, Light, Material, Mesh, Node, Scene, Skin, Triangles

SPAN_S = 4.0  # of both clips
JOINTS = 12
FLOOR = Material("floor", (0.7, 0.7, 0.7, 1.0), double_sided=True)
BODY = Material("body", (0.9, 0.5, 0.3, 1.0), metallic=0.8, roughness=0.2, double_sided=True)
SUN = Light("directional", intensity=3.0, direction=(-0.48, -0.8, -0.36))


def ring(triangles: int) -> Scene:
    """A torus of about that many triangles on joints that each turn and wander as they please: its tree, built at rest,
    gets worse and worse."""
    sides = max(int(np.sqrt(triangles / 8)), 8)
    body = torus(radius=1.0, tube=0.3, segments=min(max(triangles // (2 * sides), 8), 4096), sides=min(sides, 4096))
    angle = np.arctan2(body.position[:, 0], body.position[:, 2]) / (2 * np.pi) * JOINTS
    first = np.floor(angle).astype(np.int64)
    part = (angle - first).astype(np.float32)
    near = np.stack([first, first + 1, first * 0, first * 0], axis=1) % JOINTS
    weights = np.stack([1 - part, part, 0 * part, 0 * part], axis=1)
    skinned = Triangles(
        body.position, body.index, body.normal, 1, joints=near.astype(np.uint16), weights=weights.astype(np.float32)
    )
    rng = np.random.default_rng(12)
    turn = np.arange(JOINTS) / JOINTS * 2 * np.pi
    places = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
    nodes = [Node(f"joint {j}", -1, translation=tuple(places[j].tolist())) for j in range(JOINTS)]
    bind = np.tile(np.eye(4), (JOINTS, 1, 1))
    bind[:, :3, 3] = -places
    times = np.linspace(0, SPAN_S, 9)
    channels: list[Channel] = []
    for j in range(JOINTS):
        way = places[j] + rng.normal(0, 0.5, (9, 3)) * (times / SPAN_S)[:, None]
        spin = rng.uniform(0.8, 1.6) * times[:, None] / 2 * rng.choice([-1, 1])
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        quaternion = np.concatenate([np.sin(spin) * axis, np.cos(spin)], axis=1)
        channels += [_channel(j, "translation", times, way), _channel(j, "rotation", times, quaternion)]
    floor = np.eye(4)
    floor[1, 3] = -1.6
    return Scene(
        "ring", meshes=(Mesh("ring", (skinned,)), Mesh("floor", (plane(size=(12.0, 12.0)),))), materials=(FLOOR, BODY),
        instances=(Instance(0, np.eye(4), "ring", skin=0), Instance(1, floor, "floor")), lights=(SUN,),
        cameras=(Camera.look_at((2.6, 2.4, 3.6), (0, -0.3, 0)),), nodes=tuple(nodes),
        skins=(Skin(tuple(range(JOINTS)), bind),), animations=(Animation("wring", tuple(channels)),),
    )  # fmt: skip


def swarm(count: int) -> Scene:
    """That many boxes of 12 triangles on a lattice, each wandering about its place and tumbling."""
    rng = np.random.default_rng(count)
    side = int(np.ceil(count ** (1 / 3)))
    place = (np.stack(np.unravel_index(np.arange(count), (side,) * 3), axis=1) - (side - 1) / 2) * 3.0
    way = place[:, None] + rng.normal(0, 1.0, (count, 3, 3)) * np.array([0, 1, 0])[:, None]
    spin = rng.normal(size=(count, 3, 4))
    spin /= np.linalg.norm(spin, axis=2, keepdims=True)
    times = np.array([0, SPAN_S / 2, SPAN_S])
    nodes, instances, channels = [], [], []
    for i in range(count):
        world = np.eye(4)
        world[:3, 3] = place[i]
        nodes.append(Node("", -1, translation=tuple(place[i].tolist())))
        instances.append(Instance(0, world, node=i))
        channels += [_channel(i, "translation", times, way[i]), _channel(i, "rotation", times, spin[i])]
    return Scene(
        "swarm", meshes=(Mesh("box", (box(),)),), materials=(BODY,), instances=tuple(instances), lights=(SUN,),
        cameras=(Camera.look_at((0, 0, 4.5 * side), (0, 0, 0)),), nodes=tuple(nodes),
        animations=(Animation("wander", tuple(channels)),),
    )  # fmt: skip


def _channel(node: int, path: Any, times: Any, values: Any) -> Channel:
    return Channel(node, path, "LINEAR", np.asarray(times, np.float32), np.asarray(values, np.float32))
