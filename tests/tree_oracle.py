"""Costs of trees in float64."""

from typing import Any

import numpy as np

from glhybrid.bvh.fragments import LEAF


def sah_cost(nodes: Any, grid_step: Any) -> float:
    """Of nodes (N, 8): node and triangle at 1, relative to the root's area."""
    children = nodes.reshape(-1, 2, 4)
    words, refs = children[..., :3], children[..., 3]
    low, high = (words & 0xFFFF).astype(np.int64), (words >> 16).astype(np.int64)
    x, y, z = np.moveaxis((high - low) * grid_step, -1, 0)
    a, b, c = (high[0].max(0) - low[0].min(0)) * grid_step
    root = a * b + b * c + c * a
    return float(1 + ((x * y + y * z + z * x) * np.where(refs < LEAF, 1, refs & 15)).sum() / root)
