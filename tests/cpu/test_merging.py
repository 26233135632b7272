"""Plans of trees that the GPU builds: every triangle, cluster, node and slot has a place of its own, whatever is merged."""

import numpy as np
import pytest

from glhybrid.bvh.merging import FREE_TURNS, KEPT, WIDTH, key_axes, merging

COUNTS = [1, 2, 3, 4, 5, 15, 16, 17, 1023, 1024, 1025, 2048, 16_384, 16_385, 100_000, 1_234_567]


def taken(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """All rows of ranges, in order."""
    rows = [np.arange(f, f + n) for f, n in zip(first.tolist(), count.tolist(), strict=True)]
    return np.sort(np.concatenate([*rows, np.zeros(0, np.int64)]))


@pytest.mark.parametrize("count", COUNTS)
def test_everything_has_a_place_of_its_own(count: int) -> None:
    plan = merging(count, tree=3, item_first=70, slot_first=900, cluster_first=40)
    first = plan.levels[0]
    assert (taken(first["first"], first["count"]) == np.arange(70, 70 + count)).all()
    assert (taken(first["slot_first"], first["count"]) == np.arange(900, 900 + count)).all()
    nodes = np.concatenate([taken(level["node_first"], level["node_count"]) for level in plan.levels])
    assert (np.sort(nodes) == np.arange(1, plan.nodes)).all()  # the root's is 0
    clusters = 40
    for level, after in zip(plan.levels, plan.levels[1:], strict=False):
        rows = np.arange(clusters, clusters + int(level["kept"].sum()))
        assert (taken(level["out_first"], level["kept"]) == rows).all()
        assert (taken(after["first"], after["count"]) == rows).all()
        clusters += len(rows)
    assert plan.clusters == clusters - 40
    for number, level in enumerate(plan.levels):
        assert (level["count"] <= WIDTH).all() and (level["tree"] == 3).all()
        assert (level["leaves"] == (number == 0)).all() and (level["root"] == (number == len(plan.levels) - 1)).all()
    assert len(plan.levels[-1]) == 1 and plan.levels[-1]["kept"][0] == 1
    assert plan.nodes <= max(1.07 * count, 2) and plan.depth <= 1 + 3 * np.log2(max(count, 2)) + 3


@pytest.mark.parametrize("count", COUNTS)
def test_the_bound_holds_for_the_worst_that_can_come(count: int) -> None:
    """Whatever merges, a level ends with at most `kept`: here nothing does but the pairs as they come, after towers of
    the greatest height."""
    plan, depth = merging(count), 0
    for level in plan.levels:
        left, forced = level["count"].astype(np.int64), 0
        while (left > level["kept"]).any():
            left, forced = np.where(left > level["kept"], -(-left // 2), left), forced + 1
        assert forced <= level["turns"][0] - FREE_TURNS
        assert level["root"][0] or (level["count"] <= KEPT * level["kept"].astype(np.int64)).all()
        depth += int(level["highest"][0]) + forced
    assert max(depth, 1) <= plan.depth
    # A turn halves at most: of nodes there are no more than room is for.
    for level in plan.levels:
        fewest = np.where(level["root"] == 1, 1, (level["kept"] + 2) // 2)
        made = np.maximum(level["count"].astype(np.int64) - fewest - (level["root"] == 1), 0)
        assert (made <= level["node_count"]).all()


def test_bits_halve_the_longest_side() -> None:
    rng = np.random.default_rng(1)
    steps = 2.0 ** rng.uniform(-5, 5, (50, 3))
    for bits in (1, 20, 32):
        for step, words in zip(steps, key_axes(steps, bits), strict=True):
            side, left = step.copy(), [17, 17, 17]
            for k in range(bits):
                axis = int(np.argmax([s if n else 0 for s, n in zip(side, left, strict=True)]))
                side[axis] /= 2
                left[axis] -= 1
                assert int(words[k // 16]) >> 2 * (k % 16) & 3 == axis
