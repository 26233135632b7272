"""Triangles that fill their boxes very badly may get several smaller boxes before a tree is built. NumPy only.

Karras & Aila 2013, "Fast Parallel Construction of High-Quality Bounding Volume Hierarchies", section 5: splits are
given out by the cube root of the area that a box wastes. Two changes: a piece is halved across its longest side, and
nothing is split that wastes less than WORTH boxes of median size: evenly tessellated meshes have no such triangle, and
their builds take no longer.

The tree over the pieces is built beside the tree over whole triangles and kept only where its SAH cost is lower, after
reinsertion of both. Steps a ray (camera, diffuse, mirror) of what is kept: showroom 0.89; Sponza, atrium, plaza, an
apartment, a game level 1.00, for whose trees splitting was dearer both by SAH and in steps (0.98 to 1.17).

A triangle may then be in several leaves: an any-hit function sees it once in each that the ray meets, so what counts
hits (tinted shadows) must keep its triangles whole; and boxes of pieces cannot be refitted when vertices move.
"""

import numpy as np
from numpy.typing import NDArray

from glhybrid.bvh.fragments import quantise
from glhybrid.scene import F32, F64, U16

SHARE = 0.02  # of the triangles: pieces added at most; more of them cost more than they gain
WORTH = 64.0  # median boxes of waste that are worth a split
KEPT = 0.99  # of the SAH cost over whole triangles that the tree over pieces must stay under
MOST = 60  # splits of one triangle
THINNEST = 4.0  # cells: thinner pieces only overlap


def split_counts(area: F32, position: F32, budget: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which of the triangles (T, 3, 3) to split and how often, `budget` times in all at most.

    area: (T,) half the surface area of their boxes, as large as the grid makes them.
    """
    least = WORTH * float(np.median(area[:: max(1, len(area) // 65536)]))
    which = np.flatnonzero(area > least)
    edge = position[which, 1:].astype(np.float64) - position[which, :1]
    filled = np.abs(np.cross(edge[:, 0], edge[:, 1])).sum(1) / 2  # what no subdivision can go below
    waste = area[which] - filled
    which, waste = which[waste > least], waste[waste > least]

    def counts(threshold: float) -> NDArray[np.int64]:
        return np.minimum(np.cbrt(waste / threshold), MOST).astype(np.int64)

    low, high = np.log(max(least, 1e-300)), np.log(max(waste.max(initial=0), least, 1e-300) * 2)
    if counts(np.exp(low)).sum() > budget:
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (low, middle) if counts(np.exp(middle)).sum() <= budget else (middle, high)
        low = high
    times = counts(np.exp(low))
    return which[times > 0], times[times > 0]


def split(
    fragments: U16,
    area: F32,
    position: F32,
    grid_min: F32,
    grid_step: F32,
    pad: float,
    budget: int,
) -> tuple[U16, U16]:
    """(F, 8) fragments, F <= T + budget, of which some are replaced by a piece and others added; and the new pieces."""
    which, times = split_counts(area, position, budget)
    if not len(which):
        return fragments, fragments[:0]
    step = grid_step.astype(np.float64)
    corners = (position[which].astype(np.float64) - grid_min) / step  # (S, 3, 3) in cells
    owner, low, high = np.arange(len(which)), corners.min(1), corners.max(1)
    done: list[tuple[NDArray[np.int64], F64, F64]] = []
    while len(owner):
        size = (high - low) * step
        axis = size.argmax(1)
        wide = (times > 0) & (np.take_along_axis(high - low, axis[:, None], 1)[:, 0] >= THINNEST)
        done.append((owner[~wide], low[~wide], high[~wide]))
        owner, times, low, high, axis = owner[wide], times[wide], low[wide], high[wide], axis[wide]
        lows, highs = clip(corners[owner], axis, low, high)
        left = times - 1  # what is left to split goes to the longer half
        length = np.maximum((highs - lows) * step, 1e-300).max(2)
        first = np.clip(np.rint(left * length[0] / length.sum(0)), 0, left).astype(np.int64)
        owner, times = np.concatenate([owner, owner]), np.concatenate([first, left - first])
        low, high = lows.reshape(-1, 3), highs.reshape(-1, 3)
        some = (low <= high).all(1)
        owner, times, low, high = owner[some], times[some], low[some], high[some]
    owner, low, high = (np.concatenate(parts) for parts in zip(*done, strict=True))
    pieces = quantise(low - pad / step, high + pad / step, which[owner])
    order = np.argsort(owner, kind="stable")
    owner, pieces = owner[order], pieces[order]
    first_of_owner = np.diff(owner, prepend=-1) > 0
    fragments = fragments.copy()
    fragments[which] = pieces[first_of_owner]
    return np.concatenate([fragments, pieces[~first_of_owner]]), pieces


def clip(corners: F64, axis: NDArray[np.int64], low: F64, high: F64) -> tuple[F64, F64]:
    """Boxes (2, P, 3) of both halves of triangles (P, 3, 3) within boxes (P, 3) that are cut in the middle of an axis.

    The triangle need not reach both ends of its box: then a half may be empty, and its low side past its high side.
    """
    rows = np.arange(len(corners))
    plane = (low[rows, axis] + high[rows, axis]) / 2
    x = corners[rows, :, axis]
    following = corners[:, [1, 2, 0]]
    ahead = x[:, [1, 2, 0]]
    crosses = (x < plane[:, None]) != (ahead < plane[:, None])
    along = (plane[:, None] - x) / np.where(crosses, ahead - x, 1)
    cuts = corners + along[..., None] * (following - corners)
    cuts[rows, :, axis] = plane[:, None]
    points = np.concatenate([corners, cuts], axis=1)  # (P, 6, 3), of which each half has some
    lows, highs = [], []
    for mine in (x <= plane[:, None], x >= plane[:, None]):
        inside = np.concatenate([mine, crosses], axis=1)[..., None]
        lows.append(np.maximum(np.where(inside, points, np.inf).min(1), low))
        highs.append(np.minimum(np.where(inside, points, -np.inf).max(1), high))
    return np.stack(lows), np.stack(highs)
