"""SAH costs of trees as they stand on the GPU, added up there: a few floats come back, not the trees."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from glhybrid.context import Context
from glhybrid.needs import Features
from glhybrid.readback import Piece, Reading
from glhybrid.shaders import Shaders

NODES_A_GROUP = 256 * 16  # as in refit_cost.comp


class Cost:
    """Of trees with room for so many nodes each. resources: by GLSL name; RefitTrees says how many are taken."""

    def __init__(
        self, context: Context, shaders: Shaders, features: Features, resources: dict[str, Any], room: list[int]
    ) -> None:
        self._program = shaders.compute("refit_cost", features)
        firsts = [np.arange(0, nodes, NODES_A_GROUP) for nodes in room]
        self._ends = np.cumsum([0, *map(len, firsts)]).tolist()
        parts = np.column_stack([np.repeat(np.arange(len(room)), np.diff(self._ends)), np.concatenate(firsts)])
        self._parts = context.gl.buffer(parts.astype(np.uint32))
        self._costs = context.gl.buffer(reserve=8 * len(parts))
        self._resources = {**resources, "RefitParts": self._parts, "Costs": self._costs}

    def readings(self) -> list[Reading[float]]:
        """Of each tree its cost in the terms of Blas.sah_cost, as it is now."""
        self._program.dispatch(self._resources, (self._ends[-1], 1), (1, 1))
        return list(self._each())

    def _each(self) -> Iterator[Reading[float]]:
        for first, end in zip(self._ends, self._ends[1:], strict=False):
            yield _reading(Piece(self._costs, 8 * first, 8 * (end - first)))

    @property
    def bytes(self) -> int:
        """Of its buffers."""
        return int(self._parts.size + self._costs.size)

    def release(self) -> None:
        self._parts.release()
        self._costs.release()


def _reading(piece: Piece) -> Reading[float]:
    data = yield piece
    total, root = np.frombuffer(data, np.float32).reshape(-1, 2).sum(0, dtype=np.float64)
    return float((root + total) / root)
