"""What goes into a tree, and what comes out of its builders (sweep.py, build.py). NumPy only.

A *fragment* is the box of a triangle, sphere or instance on the tree's own 16-bit grid, and an id. It is eight uint16,
one SIMD register: (65535 - lo).xyz, hi.xyz, id low, id high. Storing the low side inverted makes the union of two
boxes one lane-wise maximum. The boxes are those that the traversal will see, rounded outward already, so the tree is
optimised for what is traced, unions are exact, and no float box is touched after the first pass.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glhybrid.scene import F32, F64, U16, U32

LEAF = 0x80000000
MEDIAN_DEPTH = 40  # below this depth ranges are halved, which bounds the depth by 40 + log2(fragments)


class Grown(NamedTuple):
    """A tree before it is put on its grid: packed nodes (N, 8) uint32, depth and SAH cost."""

    nodes: U32  # (N, 8), parents before children, root first
    depth: int  # inner nodes on the longest way from the root to a leaf
    cost: float  # SAH cost, node and triangle at 1, relative to the root's area


def make_grid(low: F64, high: F64, pad: float) -> tuple[F32, F32]:
    """(grid_min, grid_step) (3,) of a 16-bit grid that holds the padded box with about a cell to spare on every side.

    Steps are no smaller than 1/1024 of the largest: flat meshes need no finer, and float32 rays stay exact on the grid.
    """
    step = (high - low + 2 * pad) / 65533
    step = np.maximum(step, max(step.max() / 1024, 1e-30))
    corner = np.nextafter((low - pad - step).astype(np.float32), np.float32(-np.inf))
    step = np.maximum(step, (high + pad - corner.astype(np.float64)) / 65534)
    return corner, np.nextafter(step.astype(np.float32), np.float32(np.inf))


def quantise(low: F64, high: F64, ids: NDArray[np.integer]) -> U16:
    """(F, 8) fragments of boxes (F, 3) in cells, padded already; rounded outward, a twentieth of a cell to spare."""
    fragments = np.empty((len(low), 8), np.uint16)
    fragments[:, :3] = 65535 - np.clip(np.floor(low - 0.05), 0, 65535)
    fragments[:, 3:6] = np.clip(np.ceil(high + 0.05), 0, 65535)
    fragments[:, 6], fragments[:, 7] = ids & 65535, ids >> 16
    return fragments


def box_fragments(low: F64, high: F64, grid_min: F32, grid_step: F32, first_id: int = 0) -> U16:
    """(F, 8) fragments of boxes (F, 3), padded already, with ids in order."""
    origin, step = grid_min.astype(np.float64), grid_step.astype(np.float64)
    return quantise((low - origin) / step, (high - origin) / step, np.arange(first_id, first_id + len(low)))


def identity(fragments: U16) -> U32:
    """(F,) uint32: what each fragment stands for, in leaf order once a tree is grown."""
    return fragments[:, 6].astype(np.uint32) | fragments[:, 7].astype(np.uint32) << np.uint32(16)


def pack_boxes(boxes: U16) -> U32:
    """(..., 8) fragments or unions -> (..., 3) words low | high << 16."""
    wide = boxes.astype(np.uint32)
    return (np.uint32(65535) - wide[..., :3]) | wide[..., 3:6] << np.uint32(16)


def single_leaf(fragments: U16) -> Grown:
    """Over (n, 8) fragments: a root with one leaf, and an empty child that names the same slots."""
    words = pack_boxes(fragments.max(0))
    return Grown(np.array([[*words, LEAF | len(fragments), *words, LEAF]], np.uint32), 1, 1.0 + len(fragments))
