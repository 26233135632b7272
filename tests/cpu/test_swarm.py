"""Compiled poses and refitted top-level trees against what NumPy and the builder make of the same."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from tree_oracle import sah_cost

from glhybrid import bvh, keys, motion, pose
from glhybrid.errors import GeometryError
from glhybrid.load.shapes import box
from glhybrid.scene import Animation, Channel, Instance, Mesh, Node, Scene, Triangles

COUNT = 1500
WIDTH = {"translation": 3, "rotation": 4, "scale": 3, "weights": 2}


def crowd(seed: int = 0) -> Scene:
    """A forest of nodes moved in every way there is: each path and interpolation, keys at other times for each, some
    nodes with a matrix, some instances beside their node, one that is flattened at 0.5 s."""
    rng = np.random.default_rng(seed)
    nodes, channels = [], []
    for i in range(COUNT):
        parent = int(rng.integers(0, i)) if i > 9 and rng.uniform() < 0.6 else -1
        matrix = None
        if i % 50 == 49:
            matrix = np.eye(4)
            matrix[:3] += rng.normal(0, 0.1, (3, 4))
        turn = rng.normal(size=4)
        nodes.append(
            Node(f"n{i}", parent, tuple(rng.normal(size=3)), tuple(turn / np.linalg.norm(turn)), (1, 1.1, 0.9), matrix)
        )
    for i, (path, kind) in enumerate(product(WIDTH, ("STEP", "LINEAR", "CUBICSPLINE"))):
        for node in range(i % 7, COUNT, 2):
            if nodes[node].matrix is None:
                count = int(rng.integers(1, 6))
                times = np.sort(rng.choice(40, count, replace=False) / 20).astype(np.float32)
                shape = (count, 3, WIDTH[path]) if kind == "CUBICSPLINE" else (count, WIDTH[path])
                values = rng.normal(1, 0.3, shape).astype(np.float32)
                channels.append(Channel(node, path, kind, times, values))  # type: ignore[arg-type]
    flat = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.float32)
    channels.append(Channel(3, "scale", "LINEAR", np.array([0, 0.5, 1], np.float32), flat))
    world = pose.world_matrices(tuple(nodes))
    beside = np.eye(4)
    beside[:3, 3] = 0.5, 0, 0
    instances = [Instance(0, world[i] @ beside if i % 3 == 0 else world[i], node=i) for i in range(COUNT)]
    piece = box()
    mesh = Mesh("box", (piece,)) if isinstance(piece, Triangles) else piece
    return Scene("crowd", meshes=(mesh,), nodes=tuple(nodes), instances=tuple(instances),
                 animations=(Animation("all", tuple(channels)),))  # fmt: skip


def test_compiled_poses_are_those_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crowd()
    times = (-1.0, 0.0, 0.31, 0.5, 1.0, 1.234, 9.0)
    found: list[list[Any]] = []
    for many in (1, 10**9):
        for module in (keys, motion):
            monkeypatch.setattr(module, "MANY", many)
        made = motion.Motion(scene, scene.animations[0])
        player = pose.Player(scene, scene.animations[0])
        found.append([(player.at(t), made.at(t).world_from_object) for t in times])
    for (a, carried), (b, expected) in zip(*found, strict=True):
        np.testing.assert_allclose(a.world, b.world, rtol=1e-12, atol=1e-10)
        # A flattened one is given 1e-6 of its size on a side that rounding chooses.
        np.testing.assert_allclose(carried, expected, rtol=1e-9, atol=1e-5)
        assert (np.abs(carried - expected).max((1, 2)) > 1e-9).mean() < 0.05
        assert a.weights.keys() == b.weights.keys() and len(a.weights) > 100
        for node, weights in a.weights.items():
            np.testing.assert_allclose(weights, b.weights[node], atol=1e-12)
    at_half = found[0][3][1][3]
    assert abs(np.linalg.det(at_half[:3, :3])) > 0  # thin, not flat: it can be inverted


def test_a_node_that_is_nowhere_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crowd()
    far = Channel(77, "translation", "STEP", np.zeros(1, np.float32), np.full((1, 3), np.inf, np.float32))
    clip = Animation("lost", (*scene.animations[0].channels, far))
    lost = {77} | {i for i, n in enumerate(scene.nodes) if below(scene, i, 77)}
    for many in (1, 10**9):
        monkeypatch.setattr(keys, "MANY", many)
        with pytest.raises(GeometryError, match="nowhere") as caught:
            pose.evaluate(scene, 0.2, clip)
        assert any(f'"n{i}"' in str(caught.value) for i in lost)


def below(scene: Scene, node: int, top: int) -> bool:
    while node >= 0:
        if node == top:
            return True
        node = scene.nodes[node].parent
    return False


@pytest.mark.parametrize(("count", "offset"), [(2, 0.0), (3, 5.0), (1500, 0.0), (1500, 4e5)])
def test_a_refitted_tree_holds_everything(count: int, offset: float) -> None:
    rng = np.random.default_rng(count)
    middle, half = rng.uniform(-50, 50, (count, 3)) + offset, rng.uniform(0, 2, (count, 3))
    boxes = np.stack([middle - half, middle + half], axis=1)
    tree = bvh.build_tlas(boxes, moving=True)
    still = bvh.refit_tlas(tree, boxes)
    still.validate()
    assert still.sah_cost == pytest.approx(tree.sah_cost, rel=1e-3)
    for _ in range(5):
        boxes = boxes + rng.normal(0, 10, (count, 1, 3))
        tree = bvh.refit_tlas(tree, boxes)
        tree.validate()
        assert tree.sah_cost == pytest.approx(sah_cost(tree.nodes, tree.grid_step.astype(np.float64)), rel=1e-9)
    new = bvh.build_tlas(boxes, moving=True)
    assert tree.sah_cost >= 0.99 * new.sah_cost and (count < 9 or tree.sah_cost > 2 * new.sah_cost)
    with pytest.raises(GeometryError, match="instance 1"):
        bvh.refit_tlas(tree, np.where(np.arange(count)[:, None, None] == 1, np.inf, boxes))
