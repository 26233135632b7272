"""Which techniques are worth their time: those that no other beats in both time and error."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

SAME_TIME = 0.02  # relative: two medians this close are one time
SAME_ERROR = 0.01  # and two errors this close one error, that nobody can see


def front(time: ArrayLike, error: ArrayLike, same_time: float = SAME_TIME, same_error: float = SAME_ERROR) -> list[int]:
    """Indices of the points on the front, by ascending time. Points with a value that is not finite are on none.

    A point is off the front where another has less error and no more time than `same_time` above its own, or as little
    error in less time, or where its error is not `same_error` below the front's to its left: neither noise of the clock
    nor what nobody can see puts anyone on it.
    """
    time, error = np.asarray(time, np.float64), np.asarray(error, np.float64)
    assert time.shape == error.shape and time.ndim == 1
    good = np.isfinite(time) & np.isfinite(error)
    on = []
    for i in np.flatnonzero(good):
        less = good & (error < error[i]) & (time <= time[i] * (1 + same_time))
        equal = good & (error == error[i]) & ((time < time[i]) | ((time == time[i]) & (np.arange(len(time)) < i)))
        if not (less.any() or equal.any()):
            on.append(int(i))
    kept: list[int] = []
    for point in sorted(on, key=lambda i: (time[i], error[i])):
        if not kept or error[point] < error[kept[-1]] * (1 - same_error):
            kept.append(point)
    return kept


def cheapest_under(time: Sequence[float], error: Sequence[float], bar: float) -> int | None:
    """The fastest point whose error is at most `bar`; None if there is none."""
    fit = [i for i, e in enumerate(error) if np.isfinite(e) and e <= bar and np.isfinite(time[i])]
    return min(fit, key=lambda i: time[i]) if fit else None
