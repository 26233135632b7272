"""Compiled poses and refitted top-level trees against what NumPy and the builder make of the same."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from tree_oracle import sah_cost

from glhybrid import bvh, keys, motion, pose, swarm
from glhybrid.bvh.top import LOOK_EVERY, MovingTop
from glhybrid.errors import GeometryError
from glhybrid.gpu_trees import NEAR_NODES, runs
from glhybrid.kernels import MOTION
from glhybrid.load.shapes import box
from glhybrid.scene import Animation, Channel, Instance, Mesh, Node, Scene, Triangles

COUNT = 1500
WIDTH = {"translation": 3, "rotation": 4, "scale": 3, "weights": 2}


def crowd(seed: int = 0, count: int = COUNT) -> Scene:
    """A forest of nodes moved in every way there is: each path and interpolation, keys at other times for each, some
    nodes with a matrix, some instances beside their node, one that is flattened at 0.5 s."""
    rng = np.random.default_rng(seed)
    nodes, channels = [], []
    for i in range(count):
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
        for node in range(i % 7, count, 2):
            if nodes[node].matrix is None:
                key_count = int(rng.integers(1, 6))
                times = np.sort(rng.choice(40, key_count, replace=False) / 20).astype(np.float32)
                shape = (key_count, 3, WIDTH[path]) if kind == "CUBICSPLINE" else (key_count, WIDTH[path])
                values = rng.normal(1, 0.3, shape).astype(np.float32)
                channels.append(Channel(node, path, kind, times, values))  # type: ignore[arg-type]
    flat = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.float32)
    channels.append(Channel(3, "scale", "LINEAR", np.array([0, 0.5, 1], np.float32), flat))
    world = pose.world_matrices(tuple(nodes))
    beside = np.eye(4)
    beside[:3, 3] = 0.5, 0, 0
    instances = [Instance(0, world[i] @ beside if i % 3 == 0 else world[i], node=i) for i in range(count)]
    piece = box()
    mesh = Mesh("box", (piece,)) if isinstance(piece, Triangles) else piece
    return Scene("crowd", meshes=(mesh,), nodes=tuple(nodes), instances=tuple(instances),
                 animations=(Animation("all", tuple(channels)),))  # fmt: skip


def test_compiled_poses_are_those_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crowd()
    times = (-1.0, 0.0, 0.31, 0.5, 1.0, 1.234, 9.0)
    clip = scene.animations[0]
    player, made = pose.Player(scene, clip), motion.Motion(scene, clip)
    monkeypatch.setattr(keys, "MANY", 10**9)
    world = made.resting()
    for t in times:
        want = player.at(t)  # NumPy
        expected = np.array([i.world_from_object for i in pose.place(scene, want, player.rest).instances])
        fresh, before = made.at(t), world.copy()
        moment = made.at(t, world)
        now = made._player.run(t)
        np.testing.assert_allclose(now.world, want.world, rtol=1e-12, atol=1e-10)
        np.testing.assert_array_equal(world, fresh.world_from_object)
        differ = np.flatnonzero((world != before).any((1, 2)))
        assert moment.moved is not None and np.isin(differ, moment.moved).all() and len(moment.moved) <= len(differ) + 1
        # A flattened one is given 1e-6 of its size on a side that rounding chooses.
        np.testing.assert_allclose(world, expected, rtol=1e-9, atol=1e-5)
        assert (np.abs(world - expected).max((1, 2)) > 1e-9).mean() < 0.05
        assert now.weights.keys() == want.weights.keys() and len(now.weights) > 100
        for node, weights in now.weights.items():
            np.testing.assert_allclose(weights, want.weights[node], atol=1e-12)
    at_half = made.at(0.5).world_from_object[3]
    assert abs(np.linalg.det(at_half[:3, :3])) > 0  # thin, not flat: it can be inverted


@pytest.fixture
def doubled(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Has every kernel run as plain Python too, on copies, and compared to the bit. Calls by kernel."""
    MOTION.load()
    calls: dict[str, int] = {}

    def twice(kernel: Any) -> Any:
        compiled, name = kernel._compiled, kernel.plain.__name__

        def call(*args: Any) -> Any:
            copies = [a.copy() if isinstance(a, np.ndarray) and a.flags.writeable else a for a in args]
            plain, result = kernel._run(*copies), compiled(*args)
            assert plain == result, name
            for a, b in zip(args, copies, strict=True):
                assert not isinstance(a, np.ndarray) or a.tobytes() == b.tobytes(), name
            calls[name] = calls.get(name, 0) + 1
            return result

        return call

    for kernel in MOTION._kernels:
        monkeypatch.setattr(kernel, "_compiled", twice(kernel))
    return calls


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kernels_give_the_bits_of_plain_python(seed: int, doubled: dict[str, int]) -> None:
    """Small scenes begin as plain Python and may go on compiled; frame N is the same either way."""
    scene, rng = crowd(seed, 70), np.random.default_rng(seed)
    made = motion.Motion(scene, scene.animations[0])
    world = made.resting()
    for t in (-1.0, *rng.uniform(0, 2, 6).tolist(), 0.5, 9.0):
        made.at(t, world)
        made._player.run(t)
    count = len(world)
    words = np.zeros((count, swarm.layout.dtype("Instance").itemsize // 4), np.float32)
    ids, meshes = rng.permutation(count), np.zeros(count, np.uint32)
    world[rng.integers(0, count, 20), 0] *= -1
    inverse, flipped, boxes = np.zeros((count, 3, 3)), np.zeros(count, np.uint8), np.zeros((count, 2, 3))
    bounds, origin, every = np.sort(rng.normal(size=(1, 2, 3)), axis=1), rng.normal(size=3), np.arange(count)
    args = (world, ids, bounds, meshes, every, 0, count, origin, swarm.FLAG, np.zeros(words.shape, np.uint32), words)
    assert swarm.place(*args, inverse, flipped, boxes) == flipped.sum() > 0
    swarm.rebase(world, ids, inverse, origin * 1e5, 0, count, words)
    top = MovingTop(bvh.build_tlas(boxes, moving=True), 9)
    for step in range(2 * LOOK_EVERY):
        moved = np.sort(rng.choice(count, 1 + step % 5, replace=False))
        boxes[moved] += rng.normal(0, 100 if step % 20 == 19 else 0.1, (len(moved), 1, 3))
        top.refit(boxes, moved)
    assert doubled.keys() == {kernel.plain.__name__ for kernel in MOTION._kernels}


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


def tree_of(top: MovingTop, boxes: Any) -> bvh.Tlas:
    """The tree as it stands, to be validated; boxes as it sees them."""
    assert top._on is not None
    zero = top._on[0]
    corner = (top.grid[0] - zero).astype(np.float32)
    return bvh.Tlas(top.rows, corner, top.grid[1], boxes - zero, top.built.depth, top.sah_cost, 0.0)


@pytest.mark.parametrize(("count", "offset"), [(2, 0.0), (3, 5.0), (1500, 0.0), (1500, 4e5)])
def test_a_refitted_tree_holds_everything(count: int, offset: float) -> None:
    rng = np.random.default_rng(count)
    middle, half = rng.uniform(-50, 50, (count, 3)) + offset, rng.uniform(0, 2, (count, 3))
    boxes = np.stack([middle - half, middle + half], axis=1)
    tree = bvh.build_tlas(boxes - offset, moving=True)
    top = MovingTop(tree, 0)
    assert top.refit(boxes) is None
    tree_of(top, boxes).validate()
    assert top.sah_cost == pytest.approx(tree.sah_cost, rel=1e-3)
    for _ in range(5):
        boxes = boxes + rng.normal(0, 10, (count, 1, 3))
        assert top.refit(boxes) is None
        tree_of(top, boxes).validate()
        assert top.sah_cost == pytest.approx(sah_cost(top.rows, top.grid[1].astype(np.float64)), rel=1e-9)
    new = bvh.build_tlas(boxes - offset, moving=True)
    assert top.sah_cost >= 0.99 * new.sah_cost and (count < 9 or top.sah_cost > 2 * new.sah_cost)
    with pytest.raises(GeometryError, match="instance 1"):
        top.refit(np.where(np.arange(count)[:, None, None] == 1, np.inf, boxes))


@pytest.mark.parametrize(("count", "first"), [(1, 0), (2, 7), (40, 1000), (1500, 123)])
def test_a_tree_refitted_along_paths_is_the_one_refitted_whole(count: int, first: int) -> None:
    """Node by node, on one grid; and the rows said to have changed are all that did."""
    rng = np.random.default_rng(count)
    middle, half = rng.uniform(-50, 50, (count, 3)), rng.uniform(0, 2, (count, 3))
    boxes = np.stack([middle - half, middle + half], axis=1)
    tree = bvh.build_tlas(boxes, moving=True)
    top = MovingTop(tree, first)
    top.refit(boxes)
    paths = 0
    for step in range(3 * LOOK_EVERY):
        moved = np.sort(rng.choice(count, rng.integers(1, max(min(count // 16, 20), 1) + 1), replace=False))
        reach = 200 if step % 10 == 9 else 3  # out of the grid, at times
        boxes[moved] += rng.normal(0, reach, (len(moved), 1, 3))
        before, grid = top.rows.copy(), top.grid
        changed = top.refit(boxes, moved)
        if changed is not None:
            paths += 1
            assert top.grid is grid and np.array_equal(changed, np.flatnonzero((top.rows != before).any(1)))
        if step % 7 == 0 or changed is None:
            whole = MovingTop(tree, first)
            whole._on, whole.grid = top._on, top.grid
            whole.refit(boxes)
            np.testing.assert_array_equal(top.rows, whole.rows)
            assert top.sah_cost == pytest.approx(whole.sah_cost, rel=1e-9, abs=1e-9, nan_ok=True)
    assert count < 3 or paths > LOOK_EVERY
    for row in rng.choice(count, min(count, 20), replace=False):  # what is written for one: a treelet for six levels
        changed = top.refit(boxes + (np.arange(count) == row)[:, None, None] * 1e-3, np.array([row]))
        if changed is not None and len(changed):
            assert len(runs(changed, NEAR_NODES, 99)) <= -(-tree.depth // 6)
        top.refit(boxes, np.array([row]))
    boxes[:] = boxes[0]  # all in one place: the grid follows
    spread, top._age = float(top.grid[1].max()), -1
    top.refit(boxes, np.arange(count))
    assert count == 1 or float(top.grid[1].max()) < spread / 4
