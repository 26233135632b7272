"""Trees over moved vertices, built in compute: Morton codes, a radix sort, and merging by levels (bvh/merging.py)."""

from itertools import zip_longest
from typing import Any

import numpy as np

from glhybrid import layout
from glhybrid.bvh.merging import merging
from glhybrid.context import Context
from glhybrid.gpu_trees import GpuTrees
from glhybrid.needs import Features
from glhybrid.owned import Owned
from glhybrid.shaders import Program, Shaders

SORT_WIDTH = 512  # threads of a group that sorts
SORT_GROUPS = 256  # at most, so that one group can add up their counts
DIGIT_BITS = 8
SPARE_BITS = 10  # of keys, beyond those that number the triangles: they are not spread evenly


class Rebuild:
    """Owns what only building needs, for all trees together.

    resources: by GLSL name, those of passes/refit.py. meshes: rows of geometry.meshes, by row of RefitTrees.
    """

    name = "rebuild"

    def __init__(
        self, context: Context, shaders: Shaders, features: Features, trees: GpuTrees, meshes: list[int],
        resources: dict[str, Any],
    ) -> None:  # fmt: skip
        counts = [len(trees.items[mesh]) for mesh in meshes]
        total = sum(counts)
        digits = min(-(-(total.bit_length() + SPARE_BITS) // DIGIT_BITS), 32 // DIGIT_BITS)
        self.key_bits = digits * DIGIT_BITS - (len(meshes) - 1).bit_length()
        items = np.zeros(total, layout.dtype("BuildItem"))
        items["triangle"], items["geometry"] = np.concatenate([trees.items[mesh] for mesh in meshes]).T
        items["tree"] = np.repeat(np.arange(len(meshes)), counts)
        plans, item, cluster = [], 0, 0
        for tree, (mesh, count) in enumerate(zip(meshes, counts, strict=True)):
            plans.append(merging(count, tree, item, trees.slot_first(mesh), cluster))
            item, cluster = item + count, cluster + plans[-1].clusters
        levels = zip_longest(*(plan.levels for plan in plans), fillvalue=np.zeros(0, layout.dtype("BuildChunk")))
        chunks = [np.concatenate(rows) for rows in levels]
        gl = context.gl
        rounds = -(-total // (SORT_WIDTH * SORT_GROUPS))
        groups = -(-total // (SORT_WIDTH * rounds))
        buffers = {
            "BuildItems": gl.buffer(items), "BuildChunks": gl.buffer(np.concatenate(chunks)),
            "PairsA": gl.buffer(reserve=8 * total), "PairsB": gl.buffer(reserve=8 * total),
            "Digits": gl.buffer(reserve=(4 << DIGIT_BITS) * groups),
            "Places": gl.buffer(reserve=(4 << DIGIT_BITS) * groups),
            "Clusters": gl.buffer(reserve=16 * max(cluster, 1)),
        }  # fmt: skip
        self._owned = Owned(buffers.values())
        given = {**resources, **buffers, "item_total": total, "sort_rounds": rounds}
        programs = {
            stem: shaders.compute(f"rebuild_{stem}", features) for stem in ("keys", "count", "scan", "scatter", "merge")
        }
        a, b = buffers["PairsA"], buffers["PairsB"]
        self._steps: list[tuple[Program, dict[str, Any], tuple[int, int], tuple[int, int]]] = [
            (programs["keys"], {**given, "PairsOut": a}, (min(total, 65536), -(-total // 65536)), (64, 1))
        ]
        for shift in range(0, digits * DIGIT_BITS, DIGIT_BITS):
            own = {**given, "PairsIn": a, "PairsOut": b, "sort_shift": shift, "sort_groups": groups}
            self._steps += [
                (programs["count"], own, (groups, 1), (1, 1)), (programs["scan"], own, (1, 1), (1, 1)),
                (programs["scatter"], own, (groups, 1), (1, 1)),
            ]  # fmt: skip
            a, b = b, a
        self._sorted, first = a, 0
        for rows in chunks:
            self._steps.append(
                (programs["merge"], {**given, "PairsIn": a, "chunk_first": first}, (len(rows), 1), (1, 1))
            )
            first += len(rows)

    def run(self) -> None:
        """All trees anew, on the grids and with the axes that RefitTrees holds."""
        for program, resources, size, group in self._steps:
            program.dispatch(resources, size, group)

    @property
    def dispatches(self) -> int:
        """How many run() takes."""
        return len(self._steps)

    @property
    def bytes(self) -> int:
        """Of its buffers."""
        return self._owned.buffer_bytes

    def release(self) -> None:
        self._owned.release()
