"""Refit of a tree over many instances, compiled. Import it only where there are that many."""

import numpy as np
from numba import types

from glhybrid.bvh.fragments import LEAF
from glhybrid.jit import kernel
from glhybrid.scene import F32, F64, U32

_f1, _f3 = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 3))


@kernel(types.float64(_f3, _f1, _f1, types.float64, types.uint32[:, ::1]))
def refit(boxes, grid_min, cells, pad, nodes):  # type: ignore[no-untyped-def]
    """Boxes (I, 2, 3) into the nodes (N, 8), children before parents; returns the SAH cost, node and leaf at 1.

    cells: 1 / grid step. Rounded outward as fragments.quantise does.
    """
    cost = 0.0
    side = np.empty(3)
    for node in range(len(nodes) - 1, -1, -1):
        for child in range(2):
            ref = nodes[node, 4 * child + 3]
            for axis in range(3):
                if ref >= LEAF:
                    box = boxes[(ref & np.uint32(0x7FFFFFFF)) >> np.uint32(4)]
                    low = np.int64(np.floor((box[0, axis] - pad - grid_min[axis]) * cells[axis] - 0.05))
                    high = np.int64(np.ceil((box[1, axis] + pad - grid_min[axis]) * cells[axis] + 0.05))
                    low, high = max(low, np.int64(0)), min(high, np.int64(65535))
                else:
                    left, right = np.int64(nodes[ref, axis]), np.int64(nodes[ref, 4 + axis])
                    low = min(left & 65535, right & 65535)
                    high = max(left >> 16, right >> 16)
                nodes[node, 4 * child + axis] = np.uint32(low | high << 16)
                side[axis] = (high - low) / cells[axis]
            cost += side[0] * side[1] + side[1] * side[2] + side[2] * side[0]
    for axis in range(3):
        left, right = np.int64(nodes[0, axis]), np.int64(nodes[0, 4 + axis])
        side[axis] = (max(left >> 16, right >> 16) - min(left & 65535, right & 65535)) / cells[axis]
    return cost / (side[0] * side[1] + side[1] * side[2] + side[2] * side[0]) + 1


def refitted(nodes: U32, boxes: F64, grid_min: F32, grid_step: F32, pad: float) -> tuple[U32, float]:
    """Nodes (N, 8) of the same tree over other boxes, and its SAH cost. Two instances or more."""
    nodes = nodes.copy()
    step = grid_step.astype(np.float64)
    cost = refit(boxes, grid_min.astype(np.float64), 1 / step, pad, nodes)
    return nodes, float(cost)
