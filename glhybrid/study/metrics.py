"""How wrong a picture's shadows are. NumPy alone: no OpenGL, no image library.

Visibilities are (H, W) float, 0 to 1, row 0 at the top; masks are (H, W) bool and say which pixels count. Every figure
is over the pixels of its mask, 0 where there is none.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Mask = NDArray[np.bool_]
F64 = NDArray[np.float64]


def edge_band(image: ArrayLike, reach: int = 1) -> Mask:
    """Pixels within `reach` (in 8 directions) of one that differs from a direct neighbour: the borders in an image."""
    image = np.asarray(image)
    found = np.zeros(image.shape[:2], bool)
    for axis in (0, 1):
        change = np.diff(image, axis=axis) != 0
        if change.ndim > 2:
            change = change.any(-1)
        low = [slice(None), slice(None)]
        high = [slice(None), slice(None)]
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        found[tuple(low)] |= change
        found[tuple(high)] |= change
    for _ in range(reach - 1):
        grown = found.copy()
        for axis in (0, 1):
            for shift in (1, -1):
                rolled = np.roll(grown, shift, axis)
                edge = [slice(None), slice(None)]
                edge[axis] = slice(0, 1) if shift == 1 else slice(-1, None)
                rolled[tuple(edge)] = False
                found |= rolled
            grown = found.copy()
    return found


@dataclass(frozen=True)
class WrongShadow:
    """Per cent of pixels on the wrong side of one half: of all, outside and inside the band of the true border.

    false_shadow and false_light: the two ways to be wrong, per cent of all; they sum to `all`.
    """

    all: float
    outside: float
    inside: float
    false_shadow: float
    false_light: float


def wrong_shadow_percent(got: ArrayLike, want: ArrayLike, counted: Mask, band: Mask | None = None) -> WrongShadow:
    """counted: pixels that face the light. band: about the true border; default: one pixel to either side."""
    got, want = np.asarray(got, np.float64), np.asarray(want, np.float64)
    assert got.shape == want.shape == counted.shape
    if band is None:
        band = edge_band(want > 0.5)
    wrong = np.abs(got - want) > 0.5
    return WrongShadow(
        _percent(wrong, counted), _percent(wrong, counted & ~band), _percent(wrong, counted & band),
        _percent(wrong & (got < want), counted), _percent(wrong & (got > want), counted),
    )  # fmt: skip


def visibility_mae(got: ArrayLike, want: ArrayLike, counted: Mask) -> float:
    """Mean |got - want|."""
    error = np.abs(np.asarray(got, np.float64) - np.asarray(want, np.float64))
    return float(error[counted].mean()) if counted.any() else 0.0


def flip_rate(frames: ArrayLike, counted: Mask) -> float:
    """Per cent of points that change sides of one half from a frame to the next, mean over steps.

    frames: (N, H, W) visibility of the same points, one a frame.
    """
    lit = np.asarray(frames) > 0.5
    assert len(lit) > 1
    return float(np.mean([_percent(a != b, counted) for a, b in pairwise(lit)]))


def penumbra_width(offset: ArrayLike, visibility: ArrayLike, low: float = 0.1, high: float = 0.9) -> float:
    """Distance over which visibility rises from low to high along a line across a border, in the unit of offset.

    offset, visibility: (N,). Samples are put in order of offset and joined by straight lines; the first crossing of
    low and the first crossing of high after it count. NaN where one is not crossed.
    """
    offset, visibility = np.asarray(offset, np.float64), np.asarray(visibility, np.float64)
    order = np.argsort(offset)
    x, v = offset[order], visibility[order]
    start = _crossing(x, v, low)
    after = x >= start
    return _crossing(x[after], v[after], high) - start if np.isfinite(start) else float("nan")


def disc_visibility(u: ArrayLike) -> F64:
    """The share of a disc of unit radius that a straight edge at u leaves: 0 at u <= -1, 1 at u >= 1."""
    u = np.clip(np.asarray(u, np.float64), -1, 1)
    return np.asarray(1 - (np.arccos(u) - u * np.sqrt(1 - u**2)) / np.pi)


def _crossing(x: F64, v: F64, level: float) -> float:
    above = np.flatnonzero(v >= level)
    if not len(above):
        return float("nan")
    k = int(above[0])
    if k == 0 or v[k] == v[k - 1]:
        return float(x[k])
    return float(x[k - 1] + (level - v[k - 1]) / (v[k] - v[k - 1]) * (x[k] - x[k - 1]))


def _percent(wrong: Mask, counted: Mask) -> float:
    return 100.0 * float(wrong[counted].mean()) if counted.any() else 0.0
