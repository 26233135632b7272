"""How passes/rebuild_merge.comp comes from triangles in Morton order to a tree: fixed before a vertex is known, so that
nothing has to be read back.

Parallel locally-ordered clustering (Meister & Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume
Hierarchy Construction", TVCG 24(3) 2018) by work groups: one takes up to a thousand neighbours on the Morton curve and
merges nearest pairs until a sixteenth of them is left; what is left of all goes to the next level, until one group
makes the root. As in Benthin et al., "H-PLOC" (HPG 2024), no group waits for another.

The traversal's stack needs a bound on the depth: in a level, nearest pairs may make towers `highest` nodes high; what
is higher waits until nothing else is to be had. Then pairs are as they come, which halves them every turn. (A bound on
turns instead breaks up trees as they form: it made their SAH cost 1.4 times the builder's, in place of 1.07.)
"""

from typing import NamedTuple

import numpy as np

from glhybrid import layout

WIDTH = layout.CONSTANTS["MERGE_WIDTH"]  # clusters in one work group
KEPT = 16  # one of so many goes to the next level
HIGHEST = 3  # nodes above one another, beyond those of a balanced tree, that nearest pairs may make in a level
FREE_TURNS = 48  # of nearest pairs, each of which leaves about 0.6 of what was there


class Merging(NamedTuple):
    """levels: rows of BuildChunk each. Nodes count from that of the root."""

    levels: list[np.ndarray]
    nodes: int  # rows that a tree takes, some of them not in use
    clusters: int  # rows between levels
    depth: int  # that no tree exceeds


def merging(triangles: int, tree: int = 0, item_first: int = 0, slot_first: int = 0, cluster_first: int = 0) -> Merging:
    """The plan for a tree over so many triangles, one at least; *_first: its rows of sorted pairs, slots, clusters."""
    levels: list[np.ndarray] = []
    count, first, nodes, clusters, depth = triangles, item_first, 1, cluster_first, 0  # node 0 is the root
    while True:
        groups = -(-count // WIDTH)
        ends = np.arange(groups + 1) * count // groups
        rows = np.zeros(groups, layout.dtype("BuildChunk"))
        rows["tree"], rows["first"], rows["count"] = tree, first + ends[:-1], np.diff(ends)
        rows["leaves"], rows["root"], rows["slot_first"] = not levels, groups == 1, slot_first + ends[:-1]
        rows["kept"] = 1 if groups == 1 else -(-rows["count"].astype(np.int64) // KEPT)
        halvings = int(np.ceil(np.log2(np.maximum(rows["count"] / rows["kept"], 1))).max())
        rows["free_turns"], rows["highest"] = FREE_TURNS, halvings + HIGHEST
        rows["turns"] = FREE_TURNS + halvings
        depth += int(rows["highest"][0]) + halvings
        # The last turn began with more than `kept`, and left half of them at least; the root has its own place.
        most = rows["count"].astype(np.int64) - np.where(rows["root"] == 1, 2, (rows["kept"] + 2) // 2)
        rows["node_count"] = np.maximum(most, 0)
        starts = np.cumsum([0, *rows["node_count"].tolist()])
        rows["node_first"] = nodes + starts[:-1]
        nodes += int(starts[-1])
        levels.append(rows)
        if groups == 1:
            return Merging(levels, nodes, clusters - cluster_first, max(depth, 1))
        first, count = clusters, int(rows["kept"].sum())
        rows["out_first"] = clusters + np.cumsum([0, *rows["kept"].tolist()])[:-1]
        clusters += count


def key_axes(grid_step: np.ndarray, bits: int) -> np.ndarray:
    """(T, 2) uint32 for RefitTree.axes: which axis each bit of a Morton code halves, on grids of steps (T, 3)."""
    sides = np.log2(np.asarray(grid_step, np.float64))[:, :, None] - np.arange(17)
    axis = np.argsort(-sides.reshape(len(sides), -1), axis=1, kind="stable")[:, :bits] // 17
    words = np.zeros((len(sides), 32), np.uint32)
    words[:, :bits] = axis
    return np.bitwise_or.reduce(words.reshape(-1, 2, 16) << (2 * np.arange(16, dtype=np.uint32)), axis=2)
