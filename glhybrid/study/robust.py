"""A mean that a few paths do not decide: what light transport finds by one path in a million is a speck in a picture of
thousands, and would be taken for an error of everything that is held against it."""

import numpy as np
from numpy.typing import NDArray

from glhybrid.study.picture import LUMINANCE

F64 = NDArray[np.float64]
ROWS = 64  # of a picture at once: its parts are sorted


def mean_of_means(parts: NDArray[np.floating]) -> F64:
    """(M, H, W, 3) independent estimates of a picture -> (H, W, 3): their mean, less the outermost where they differ.

    By pixel the parts are put in order of luminance, and floor(G M / 2) of them left out at both ends, with G their
    Gini coefficient: 0 where they agree (all count), towards 1 where one has nearly all the light (the median counts).
    The more paths a part has the less they differ, so what is left out falls to nothing: the estimate is consistent.
    Buisine, Delepoulle, Renaud, "Firefly removal in Monte Carlo rendering with adaptive Median of meaNs", EGSR 2021.
    """
    found = np.empty(parts.shape[1:])
    for first in range(0, parts.shape[1], ROWS):
        found[first : first + ROWS] = _of_rows(parts[:, first : first + ROWS].astype(np.float64))
    return found


def _of_rows(parts: F64) -> F64:
    count = len(parts)
    level = parts @ LUMINANCE
    order = np.argsort(level, 0)
    level = np.take_along_axis(level, order, 0)
    rank = np.arange(count)[:, None, None]
    total = level.sum(0)
    gini = ((2 * rank + 1 - count) * level).sum(0) / np.maximum(count * total, 1e-300)
    cut = np.minimum((gini * count / 2).astype(int), (count - 1) // 2)
    kept = (rank >= cut) & (rank < count - cut)
    sums: F64 = (np.take_along_axis(parts, order[..., None], 0) * kept[..., None]).sum(0)
    return sums / (count - 2 * cut)[..., None]
