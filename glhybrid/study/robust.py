"""A mean that a few paths do not decide: what light transport finds by one path in a million is a speck in a picture of
thousands, and would be taken for an error of everything that is held against it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from glhybrid.bvh.blas import threads_available
from glhybrid.scene import F32
from glhybrid.study.picture import LUMINANCE

ROWS = 32  # of a picture at once, a thread each
REACH = 2  # pixels to each side of a neighbourhood


def mean_of_means(parts: F32) -> F32:
    """(M, H, W, 3) independent estimates of a picture -> (H, W, 3): their mean, less the outermost where they differ.

    By pixel the parts are put in order of luminance, and floor(G M / 2) of them left out at both ends, with G their
    Gini coefficient: 0 where they agree (all count), towards 1 where one has nearly all the light (the median counts).
    Buisine, Delepoulle, Renaud, "Firefly removal in Monte Carlo rendering with adaptive Median of meaNs", EGSR 2021.

    Alone that is too dark where few paths light everything, as a lamp without size does by way of walls: their noise is
    skewed, and its median below its mean. Neighbourhoods of 25 pixels agree there though one pixel's parts do not, so
    pixels of which something was left out are scaled to what the same estimate makes of their neighbourhood.
    The more paths a part has the less the parts differ: what is left out falls to nothing, the estimate is consistent.
    """
    height = parts.shape[1]
    found = np.empty(parts.shape[1:], np.float32)

    def band(first: int) -> None:
        low, high = (
            max(first - REACH, 0),
            min(first + ROWS + REACH, height),
        )  # with the neighbours of its first and last row
        found[first : first + ROWS] = _of_band(parts[:, low:high])[first - low :][:ROWS]

    with ThreadPoolExecutor(threads_available()) as pool:
        list(pool.map(band, range(0, height, ROWS)))
    return found


def _of_band(parts: F32) -> F32:
    level = np.stack([part @ LUMINANCE.astype(np.float32) for part in parts])
    found, cut = _trimmed(parts, level)
    if not cut.any():
        return found
    near = np.stack([_around(np.where(cut, one, 0)) for one in level])
    wanted, _ = _trimmed(near[..., None], near)
    had = _around(np.where(cut, found @ LUMINANCE, 0))
    scale = np.divide(wanted[..., 0], had, out=np.ones_like(had), where=cut & (had > 0))
    return found * scale[..., None]


def _trimmed(parts: F32, level: F32) -> tuple[F32, NDArray[np.bool_]]:
    """(H, W, C) the mean of the inner parts by their level (M, H, W), and (H, W) where some were left out."""
    count = len(level)
    weight = (2 * np.arange(count) + 1 - count).astype(np.float32)
    order = np.sort(np.ascontiguousarray(np.moveaxis(level, 0, -1)), -1)
    gini = order @ weight / np.maximum(count * order.sum(-1), 1e-30)
    out = np.minimum((gini * count / 2).astype(int), (count - 1) // 2)
    low = np.take_along_axis(order, out[..., None], -1)[..., 0]
    high = np.take_along_axis(order, count - 1 - out[..., None], -1)[..., 0]
    kept = ((level >= low) & (level <= high)).astype(np.float32)
    return np.einsum("mhw,mhwc->hwc", kept, parts) / kept.sum(0)[..., None], out > 0


def _around(image: NDArray[np.floating]) -> F32:
    """(H, W) sums over the pixels within REACH."""
    for axis in (0, 1):
        edge = [(0, 0), (0, 0)]
        edge[axis] = (REACH, REACH)
        padded, length = np.pad(image, edge), image.shape[axis]
        image = sum(np.take(padded, range(k, k + length), axis) for k in range(2 * REACH + 1))  # type: ignore[assignment]
    return image.astype(np.float32)
