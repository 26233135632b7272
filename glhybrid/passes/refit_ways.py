"""How boxes of trees over moved vertices are refitted, children before parents.

Climb: one dispatch, in which the last thread to come to a node goes on to its parent; it only needs to know parents,
which a GPU writes as it builds. Levels: a dispatch each, for trees that the CPU built. An H100 takes 0.24 ms for them,
most of it between dispatches; a software rasteriser, where a thread waits for the ways of its neighbours, half as long
as it would climb.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from glhybrid.bvh.blas import Blas
from glhybrid.bvh.fragments import LEAF
from glhybrid.context import Context
from glhybrid.layout import CONSTANTS
from glhybrid.needs import Features
from glhybrid.scene import U32
from glhybrid.shaders import Shaders

GROUP = 64


class Way(Protocol):
    """trees: rows of RefitTree, kept by reference; room: rows of nodes that all of them may take."""

    resources: dict[str, Any]  # by GLSL name, given ones and its own

    def __init__(
        self, context: Context, shaders: Shaders, features: Features, resources: dict[str, Any], trees: np.ndarray,
        room: int,
    ) -> None: ...  # fmt: skip

    def link(self, blases: Mapping[int, Blas]) -> None:
        """Learns of trees that the CPU built, by row of trees."""

    def run(self) -> None:
        """New boxes."""

    def release(self) -> None:
        """Frees its buffers, not the given ones."""

    @property
    def dispatches(self) -> int:
        """How many run() takes."""

    @property
    def bytes(self) -> int:
        """Of its own buffers."""


class Levels:
    """The deepest level first."""

    def __init__(
        self, context: Context, shaders: Shaders, features: Features, resources: dict[str, Any], trees: np.ndarray,
        room: int,
    ) -> None:  # fmt: skip
        self._program = shaders.compute("refit", features)
        self._trees, self._blases = trees, dict[int, Blas]()
        self._order, self._write = context.gl.buffer(reserve=8 * room), context.write
        self._levels: list[tuple[int, int]] = []
        self.resources = {**resources, "RefitOrder": self._order}

    def link(self, blases: Mapping[int, Blas]) -> None:
        self._blases |= blases
        levels: dict[int, list[U32]] = {}
        for tree, blas in self._blases.items():
            for depth, nodes in enumerate(levels_of(blas)):
                rows = nodes + int(self._trees["node_first"][tree])
                levels.setdefault(depth, []).append(np.column_stack([rows, np.full(len(rows), tree)]).astype(np.uint32))
        parts = [np.concatenate(levels[depth]) for depth in sorted(levels, reverse=True)]
        ends = np.cumsum([len(p) for p in parts])
        self._levels = [(int(end) - len(p), len(p)) for p, end in zip(parts, ends, strict=True)]
        self._write(self._order, np.concatenate(parts))

    def run(self) -> None:
        for first, count in self._levels:
            resources = {**self.resources, "refit_first": first, "refit_count": count}
            self._program.dispatch(resources, (min(count, 65536), -(-count // 65536)), (GROUP, 1))

    def release(self) -> None:
        self._order.release()

    @property
    def dispatches(self) -> int:
        return len(self._levels)

    @property
    def bytes(self) -> int:
        return int(self._order.size)


class Climb:
    """From the leaves to the root at once."""

    dispatches = 1

    def __init__(
        self, context: Context, shaders: Shaders, features: Features, resources: dict[str, Any], trees: np.ndarray,
        room: int,
    ) -> None:  # fmt: skip
        self._program = shaders.compute("refit_climb", features)
        self._trees, self._room = trees, room
        self._nodes, self._write = context.gl.buffer(reserve=8 * room), context.write
        self._arrived = context.gl.buffer(bytes(4 * room))
        self.resources = {**resources, "RefitNodes": self._nodes, "Arrived": self._arrived, "refit_total": room}

    def link(self, blases: Mapping[int, Blas]) -> None:
        ends = [*self._trees["entry_first"].tolist(), self._room]
        for tree, blas in blases.items():
            rows = np.full((ends[tree + 1] - ends[tree], 2), (CONSTANTS["ID_NONE"], tree), np.uint32)
            rows[: len(blas.nodes), 0] = parents_of(blas.nodes, int(self._trees["node_first"][tree]))
            self._write(self._nodes, rows, 8 * ends[tree])

    def run(self) -> None:
        size = min(self._room, 65536), -(-self._room // 65536)
        self._program.dispatch(self.resources, size, (GROUP, 1))

    def release(self) -> None:
        self._nodes.release()
        self._arrived.release()

    @property
    def bytes(self) -> int:
        return int(self._nodes.size + self._arrived.size)


def levels_of(blas: Blas) -> list[np.ndarray]:
    """(N,) int64 rows of nodes, an array a depth, the root first."""
    refs = blas.nodes[:, 3::4]
    levels = [np.zeros(1, np.int64)]
    while len(below := refs[levels[-1]][refs[levels[-1]] < LEAF]):
        levels.append(below.astype(np.int64))
    return levels


def parents_of(nodes: U32, first: int = 0) -> U32:
    """(N,) uint32 of each node: 2 * parent + side, counted from `first`; REFIT_ROOT for the root."""
    refs = nodes[:, 3::4]
    parent, side = np.nonzero(refs < LEAF)
    found = np.zeros(len(nodes), np.uint32)
    found[refs[parent, side]] = 2 * (parent + first) + side
    found[0] = CONSTANTS["REFIT_ROOT"]
    return found
