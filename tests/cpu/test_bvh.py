"""Trees: validity over shapes that break builders, queries against brute force, cost, packing, instances."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bvh_shapes import SHAPES, Triangles, axis_rays, chain, needles, progression, rays, same, soup

from glhybrid import reference
from glhybrid.bvh import Blas, blas, build_blas, build_tlas, pack, presplit, reinsert, sweep, textbook
from glhybrid.bvh.fragments import LEAF, MEDIAN_DEPTH
from glhybrid.errors import GeometryError


@pytest.mark.parametrize("builder", ["numpy", "numba"])
@pytest.mark.parametrize("seed", [1])
@pytest.mark.parametrize("shape", SHAPES)
def test_tree_is_valid_and_finds_what_brute_force_finds(
    shape: str, seed: int, builder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    triangles = SHAPES[shape](seed)
    monkeypatch.setattr(blas, "SMALL", len(triangles) if builder == "numpy" else 0)
    tree = build_blas(triangles)
    tree.validate()
    assert sorted(tree.slots[:, 3]) == list(range(len(triangles)))
    assert np.array_equal(tree.bounds, [triangles.min((0, 1)), triangles.max((0, 1))])

    origins, directions = axis_rays() if shape == "lattice" else rays(triangles, 600, seed)
    want = reference.closest_hit(triangles, origins, directions)
    got = reference.traverse(tree, origins, directions)
    assert np.array_equal(got.hit, want.hit)
    np.testing.assert_allclose(got.t[want.hit], want.t[want.hit], rtol=1e-9)
    other = got.triangle != want.triangle  # only where two are equally far
    np.testing.assert_allclose(got.t[other & want.hit], want.t[other & want.hit], rtol=1e-12)
    assert np.array_equal(reference.traverse(tree, origins, directions, any_hit=True).hit, want.hit)


@pytest.mark.parametrize("shape", ["soup", "needles", "stadium", "lattice", "far", "sphere"])
def test_boxes_hold_in_float32(shape: str) -> None:
    """The shader's arithmetic finds in the tree what it finds when every triangle is tried.

    Tried one by one, triangles smaller than an ulp of their distance are hit by rays that pass far off: their edge
    functions are noise. Only there may the tree, whose boxes such rays miss, find less; it is then right.
    """
    triangles = SHAPES[shape](2)
    origins, directions = axis_rays() if shape == "lattice" else rays(triangles, 1500, 3)
    tree = build_blas(triangles)
    want = reference.traverse(
        Blas(**{**vars(tree), **_flat_list(triangles)}), origins, directions, precision=np.float32
    )
    got = reference.traverse(tree, origins, directions, precision=np.float32)
    true = reference.traverse(tree, origins, directions)
    assert true.hit.sum() > 500
    noise = want.hit & ~true.hit if shape in ("stadium", "far") else np.zeros(len(origins), bool)
    assert np.array_equal(got.hit[~noise], want.hit[~noise])
    assert np.array_equal(got.t[~noise], want.t[~noise])
    assert np.array_equal(got.triangle[~noise], want.triangle[~noise])


def _flat_list(triangles: Triangles) -> dict[str, object]:
    """A chain of nodes whose boxes are all the whole grid: no triangle can be culled."""
    slots = np.zeros((len(triangles), 3, 4), np.uint32)
    slots[:, :, :3] = triangles.view(np.uint32)
    slots[:, 0, 3] = np.arange(len(triangles))
    groups = [(i, min(4, len(triangles) - i)) for i in range(0, len(triangles), 4)]
    whole = [0xFFFF0000] * 3
    nodes = [[*whole, LEAF | first << 4 | count, *whole, i + 1] for i, (first, count) in enumerate(groups)]
    nodes[-1][7] = LEAF
    wide = np.float32(max(1.0, float(np.abs(triangles).max())) * 4)
    grid = {"grid_min": np.full(3, -wide, np.float32), "grid_step": np.full(3, 2 * wide / 65535, np.float32)}
    return {"nodes": np.array(nodes, np.uint32), "slots": slots.reshape(-1, 12), **grid}


def test_reinsertion_gives_a_cheaper_tree_of_the_same_triangles() -> None:
    # Rods across a room of small things, as in architecture.
    triangles = np.concatenate([soup(6000, 8, 0.004), needles(300, 9)])
    origins, directions = rays(triangles, 4000, 6)
    trees = [build_blas(triangles, reinsert=flag) for flag in (False, True)]
    hits = [reference.traverse(tree, origins, directions) for tree in trees]
    trees[1].validate()
    assert sorted(trees[1].slots[:, 3]) == list(range(len(triangles)))
    assert np.array_equal(hits[0].t, hits[1].t) and np.array_equal(hits[0].triangle, hits[1].triangle)
    assert trees[1].sah_cost < 0.95 * trees[0].sah_cost
    assert trees[1].depth <= trees[0].depth + reinsert.DEEPER
    steps = [h.nodes_visited.astype(int).sum() + h.triangles_tested.astype(int).sum() for h in hits]  # type: ignore[union-attr]
    assert steps[1] < 0.95 * steps[0]


def room() -> tuple[np.ndarray, np.ndarray]:
    """A floor and beams of few long triangles, turned, among many small ones; and which of them are long."""
    long = needles(120, 9) * np.float32(2)
    small = soup(9000, 8, 0.01)
    return np.concatenate([small, long]), np.arange(9120) >= 9000


def test_splitting_is_kept_only_where_it_pays() -> None:
    triangles, long = room()
    whole, split = (build_blas(triangles, split=flag) for flag in (False, True))
    split.validate()
    times = np.bincount(split.slots[:, 3], minlength=len(triangles))
    assert (times >= 1).all() and (times[~long] == 1).all() and times.max() > 1
    assert len(split.slots) <= (1 + presplit.SHARE) * len(triangles)
    assert split.sah_cost < presplit.KEPT * whole.sah_cost
    origins, directions = rays(triangles, 4000, 6)
    steps = []
    for precision in (np.float64, np.float32):
        hits = [reference.traverse(tree, origins, directions, precision=precision) for tree in (whole, split)]
        assert np.array_equal(hits[0].t, hits[1].t) and np.array_equal(hits[0].triangle, hits[1].triangle)
        steps = [int(h.nodes_visited.sum()) + int(h.triangles_tested.sum()) for h in hits]  # type: ignore[union-attr]
    assert steps[1] < steps[0]


@pytest.mark.parametrize("shape", SHAPES)
def test_no_tree_is_dearer_for_being_allowed_to_split(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blas, "SMALL", 0)
    monkeypatch.setattr(presplit, "WORTH", 1.0)
    triangles = SHAPES[shape](4)
    whole, split = (build_blas(triangles, split=flag) for flag in (False, True))
    split.validate()
    assert split.sah_cost <= whole.sah_cost and set(split.slots[:, 3]) == set(range(len(triangles)))
    if len(split.slots) == len(triangles):
        assert np.array_equal(split.nodes, whole.nodes) and np.array_equal(split.slots, whole.slots)
    origins, directions = axis_rays() if shape == "lattice" else rays(triangles, 400, 5)
    a, b = (reference.traverse(tree, origins, directions) for tree in (whole, split))
    assert np.array_equal(a.t, b.t) and np.array_equal(a.triangle, b.triangle)


@pytest.mark.parametrize("shape", ["needles", "stadium", "flat", "far", "chain"])
def test_pieces_cover_their_triangles(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the tree is worth: all that may be split is, and kept."""
    monkeypatch.setattr(blas, "SMALL", 0)
    for name, value in (("WORTH", 0.5), ("SHARE", 1.0), ("KEPT", np.inf)):
        monkeypatch.setattr(presplit, name, value)
    triangles = SHAPES[shape](3)
    balls = np.array([[0.5, 0.5, 0.5, 0.01]], np.float32)
    tree = build_blas(triangles, spheres=balls, sphere_triangle=np.array([len(triangles)], np.uint32), split=True)
    tree.validate()
    if shape in ("needles", "stadium"):
        assert len(tree.slots) > len(triangles) + 1
    origins, directions = rays(triangles, 800, 5)
    for precision in (np.float64, np.float32):
        plain = reference.traverse(build_blas(triangles), origins, directions, precision=precision)
        pieces = reference.traverse(build_blas(triangles, split=True), origins, directions, precision=precision)
        assert np.array_equal(plain.t, pieces.t) and np.array_equal(plain.triangle, pieces.triangle)
    inner = np.flatnonzero(np.bincount(tree.slots[:, 3]) > 1)
    if len(inner):  # a piece that is lost is noticed
        first = int(np.flatnonzero(tree.slots[:, 3] == inner[0])[0])
        slots = tree.slots.copy()
        slots[first] = tree.slots[np.flatnonzero(tree.slots[:, 3] != inner[0])[0]]
        with pytest.raises(GeometryError, match="tree: "):
            replace(tree, slots=slots).validate()


@pytest.mark.parametrize("name", ["progression", "chain"])
def test_depth_is_bounded(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    triangles = progression() if name == "progression" else chain(900)
    for small in (len(triangles), 0):
        monkeypatch.setattr(blas, "SMALL", small)
        assert build_blas(triangles).depth <= 24
    from glhybrid.bvh import build

    for small, module, more in ((0, build, reinsert.DEEPER), (len(triangles), sweep, 0)):
        monkeypatch.setattr(blas, "SMALL", small)
        monkeypatch.setattr(module, "MEDIAN_DEPTH", 3)  # from there on, halves
        tree = build_blas(triangles)
        tree.validate()
        assert tree.depth <= 3 + np.ceil(np.log2(len(triangles))) + more


@pytest.mark.parametrize("shape", SHAPES)
def test_the_builder_without_a_compiler_makes_trees_as_cheap(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    triangles = SHAPES[shape](6)
    monkeypatch.setattr(blas, "SMALL", 0)
    compiled = build_blas(triangles, reinsert=False)
    monkeypatch.setattr(blas, "SMALL", len(triangles))
    tree = build_blas(triangles)
    assert tree.sah_cost <= 1.03 * compiled.sah_cost and tree.depth <= compiled.depth + 2
    monkeypatch.setattr(sweep, "TOGETHER", 64)  # in many passes, one axis at a time: the same tree
    monkeypatch.setattr(sweep, "SHORT", 16)
    other = build_blas(triangles)
    assert np.array_equal(tree.nodes, other.nodes) and np.array_equal(tree.slots, other.slots)


@pytest.mark.parametrize("seed", [3])
def test_cost_is_that_of_a_textbook_build(seed: int) -> None:
    for triangles in (soup(100_000, seed, 0.004), SHAPES["sphere"](seed)):
        cost, _ = textbook.binned_sah(triangles)
        assert build_blas(triangles, reinsert=False).sah_cost <= 1.03 * cost
        assert build_blas(triangles).sah_cost <= 1.02 * cost


def test_stated_cost_is_that_of_the_stored_boxes() -> None:
    for count in (40, 5000):
        tree = build_blas(soup(count, 5))
        children = tree.nodes.reshape(-1, 2, 4).astype(np.int64)
        side = ((children[..., :3] >> 16) - (children[..., :3] & 0xFFFF)) * tree.grid_step.astype(np.float64)
        area = side[..., 0] * side[..., 1] + side[..., 1] * side[..., 2] + side[..., 2] * side[..., 0]
        refs = children[..., 3]
        low, high = (children[0, :, :3] & 0xFFFF).min(0), (children[0, :, :3] >> 16).max(0)
        x, y, z = (high - low) * tree.grid_step.astype(np.float64)
        cost = 1 + (area * np.where(refs < LEAF, 1, refs & 15)).sum() / (x * y + y * z + z * x)
        assert tree.sah_cost == pytest.approx(cost, rel=1e-5)


def test_same_tree_whatever_the_threads_and_the_flags_of_the_input() -> None:
    triangles = soup(60_000, 7, 0.01)
    first = build_blas(triangles, threads=1)
    triangles.flags.writeable = False
    for threads in (2, 3):
        assert same(first, build_blas(triangles, threads=threads))


def test_spheres_and_ids_reach_the_slots() -> None:
    rng = np.random.default_rng(11)
    for count in (20, 3000):
        triangles, balls = soup(count, 1), np.concatenate([rng.random((50, 3)), rng.random((50, 1)) * 0.1], 1)
        tree = build_blas(
            triangles, np.arange(count, dtype=np.uint32) + 100, np.full(count, 7, np.uint32),
            balls.astype(np.float32), np.arange(50, dtype=np.uint32) + 90_000, np.full(50, 9, np.uint32),
        )  # fmt: skip
        tree.validate()
        assert sorted(tree.slots[:, 3]) == [*range(100, 100 + count), *range(90_000, 90_050)]
        ball = tree.slots[:, 11] == blas.SPHERE
        assert ball.sum() == 50 and (tree.slots[ball, 7] == 9).all() and (tree.slots[~ball, 7] == 7).all()
        origin = np.array([5.0, 0.3, 0.2])
        direction = balls[:, :3] - origin
        hits = reference.traverse(tree, origin, direction)
        alone = reference.traverse(build_blas(np.zeros((0, 3, 3)), spheres=balls), origin, direction)
        assert alone.hit.all() and (hits.t <= alone.t).all()
        miss = np.linalg.norm(origin + alone.t[:, None] * direction - balls[alone.triangle, :3], axis=1)
        np.testing.assert_allclose(miss, balls[alone.triangle, 3], rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: build_blas(np.zeros((0, 3, 3))), "no triangle"),
        (lambda: build_blas(np.full((2, 3, 3), np.nan), np.array([4, 5])), "triangle 4: coordinate nan"),
        (lambda: build_blas(np.array([[[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]])), "triangle 0: coordinate inf"),
        (lambda: build_blas(soup(2000, 1) * np.float32(1e30)), "past 1e\\+18"),
        (lambda: build_blas(soup(2, 1), spheres=np.array([[0, 0, 0, np.nan]])), "sphere 0"),
        (lambda: build_blas(soup(2, 1), np.zeros(3)), "triangle: ids of shape"),
        (lambda: build_blas(soup(2, 1), max_leaf=5), "max_leaf 5"),
        (lambda: build_tlas(np.zeros((0, 2, 3))), "no instance"),
        (lambda: build_tlas(np.array([[[0, 0, 0], [1, 1, 1]], [[2, 0, 0], [1, 1, 1]]])), "instance 1"),
        (lambda: build_tlas(np.array([[[0, 0, 0], [1, np.nan, 1]]])), "instance 0"),
    ],
)
def test_bad_input_is_refused_by_name(make: Callable[[], object], says: str) -> None:
    with pytest.raises(GeometryError, match=says):
        make()


def test_validate_sees_damage() -> None:
    tree = build_blas(soup(3000, 4))

    def broken(change: Callable[[np.ndarray, np.ndarray], None]) -> Blas:
        nodes, slots = tree.nodes.copy(), tree.slots.copy()
        change(nodes, slots)
        return Blas(**{**vars(tree), "nodes": nodes, "slots": slots})

    inner = int(np.flatnonzero(tree.nodes[:, 3] < LEAF)[5])

    def set_node(row: int, column: int, value: int) -> Callable[[np.ndarray, np.ndarray], None]:
        return lambda nodes, slots: nodes.__setitem__((row, column), value)

    for change in (
        set_node(inner, 3, 0),
        set_node(inner, 3, 1 << 30),
        set_node(inner, 3, LEAF | 1),
        set_node(inner, 3, LEAF | 2999 << 4 | 4),
        set_node(int(tree.nodes[inner, 3]), 0, 0xFFFF0000),
        set_node(len(tree.nodes) - 1, 0, 0x00010001),
        lambda nodes, slots: slots.__setitem__((17, 0), np.float32(9).view(np.uint32)),
    ):
        with pytest.raises(GeometryError, match="tree: "):
            broken(change).validate()
    with pytest.raises(GeometryError, match="depth"):
        Blas(**{**vars(tree), "depth": tree.depth - 1}).validate()


def test_packed_trees_are_the_same_trees() -> None:
    trees = [build_blas(soup(n, n)) for n in (1, 300, 5000, 3)]
    nodes, slots, roots = pack(trees)
    assert roots.tolist() == np.cumsum([0] + [len(t.nodes) for t in trees[:-1]]).tolist()
    first = 0
    for tree, root in zip(trees, roots.tolist(), strict=True):
        part = nodes[root : root + len(tree.nodes)].copy()
        refs = part[:, 3::4]
        refs -= np.where(refs < LEAF, np.uint32(root), np.uint32(first << 4))
        assert np.array_equal(part, tree.nodes)
        assert np.array_equal(slots[first : first + len(tree.slots)], tree.slots)
        first += len(tree.slots)
    assert [a.shape for a in pack([])] == [(0, 8), (0, 12), (0,)]


def test_pack_refuses_what_a_reference_cannot_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    trees = [build_blas(soup(n, n)) for n in (10, 30)]
    monkeypatch.setattr(blas, "MAX_SLOTS", 39)
    with pytest.raises(GeometryError, match=r"40 slots.*39"):
        pack(trees)


@pytest.mark.parametrize("moving", [False, True], ids=["static", "moving"])
@pytest.mark.parametrize("count", [1, 2, 5, 100, 300, 20_000])
def test_instances_are_leaves_of_the_top_tree(count: int, moving: bool) -> None:
    rng = np.random.default_rng(count)
    low = rng.random((count, 3)) * 100 - 1e4
    tree = build_tlas(np.stack([low, low + rng.random((count, 3)) * (rng.random((count, 1)) < 0.9)], 1), moving)
    tree.validate()
    refs = tree.nodes[:, 3::4]
    leaves = refs[(refs >= LEAF) & (refs & 15 > 0)]
    assert sorted((leaves & 0x7FFFFFFF) >> 4) == list(range(count))
    assert tree.depth <= MEDIAN_DEPTH
