"""How two pictures are held against each other: relative errors, edges left out, and tests of noisy ones."""

from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer
    from glhybrid.scene import Scene
    from glhybrid.settings import Settings

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]


def relative(got: Any, want: Any) -> F64:
    """Largest channel error per pixel over |want| + 1e-3 of the picture's mean: (H, W)."""
    got, want = np.asarray(got, np.float64), np.asarray(want, np.float64)
    assert got.shape == want.shape
    error = np.abs(got - want) / (np.abs(want) + 1e-3 * np.abs(want).mean() + 1e-30)
    return np.where(np.isfinite(got), error, np.inf).max(-1)


def edges(*images: Any, reach: int = 1) -> Mask:
    """Pixels within `reach` of one where any of the (H, W, ...) images changes: outlines of ids, creases, shadows."""
    height, width = images[0].shape[:2]
    found = np.zeros((height, width), bool)
    for image in images:
        flat = np.asarray(image).reshape(height, width, -1).astype(np.float64)
        flat = np.where(np.isfinite(flat), flat, 1e30)
        for axis in (0, 1):
            change = (np.abs(np.diff(flat, axis=axis)) > 1e-3).any(-1)
            first = [slice(None), slice(None)]
            second = [slice(None), slice(None)]
            first[axis], second[axis] = slice(None, -1), slice(1, None)
            found[tuple(first)] |= change
            found[tuple(second)] |= change
    for _ in range(reach - 1):
        grown = found.copy()
        grown[1:] |= found[:-1]
        grown[:-1] |= found[1:]
        grown[:, 1:] |= found[:, :-1]
        grown[:, :-1] |= found[:, 1:]
        found = grown
    return found


@dataclass(frozen=True)
class Noisy:
    """The mean of independent estimates of a picture, and the variance of that mean: (H, W, 3)."""

    mean: F64
    variance: F64


def reference_batches(
    renderer: "Renderer", scene: "Scene", size: tuple[int, int], settings: "Settings", batches: int
) -> Noisy:
    """The reference `batches` times, settings.samples paths each, under seeds of their own."""
    from glhybrid.timing import Timing
    from glhybrid.view import choose_camera, make_view

    staged = renderer.stage(scene, settings, size)
    staged.look(make_view(choose_camera(scene, None), size, scene, renderer.context.limits.clip_control))
    assert staged.reference is not None
    total, square = np.zeros((size[1], size[0], 3)), np.zeros((size[1], size[0], 3))
    timing = Timing(renderer.context.gl.finish)
    for seed in range(batches):
        staged.constants.put(seed=7919 * settings.seed + seed)
        image = staged.reference.run(staged.targets, staged, timing, None)
        values = np.frombuffer(image.read(), np.float32).reshape(size[1], size[0], 4)[::-1, :, :3].astype(np.float64)
        total += values
        square += values**2
    mean = total / batches
    return Noisy(mean, np.maximum(square / batches - mean**2, 0) / (batches - 1))


@dataclass(frozen=True)
class Agreement:
    """Of a per-pixel Z-test between two noisy pictures.

    passed: share of pixels not rejected at `alpha` over the whole picture (Sidak), Mitsuba's own criterion.
    tiles: largest |z| of a mean over 8 x 8 pixels, which sees a bias that single pixels hide. whole: z of the mean.
    spread: mean z squared: 1 where the variances are right.
    """

    passed: float
    tiles: float
    whole: float
    spread: float
    ratio: float


def z_test(got: Noisy, want: Noisy, alpha: float = 0.01, floor: float = 1e-4, tile: int = 8) -> Agreement:
    """floor: smallest standard error, as a share of the picture's mean: without noise, rounding would decide."""
    least = (floor * np.abs(want.mean).mean()) ** 2
    variance = np.maximum(got.variance + want.variance, least)
    z = (got.mean - want.mean) / np.sqrt(variance)
    limit = NormalDist().inv_cdf(1 - (1 - (1 - alpha) ** (1 / z.size)) / 2)
    fine = (np.abs(z) <= limit).all(-1, keepdims=True)  # the rest counts in `passed`, and must not decide a tile
    height, width = z.shape[0] // tile * tile, z.shape[1] // tile * tile

    def tiles(values: F64) -> F64:
        values = np.where(fine, values, 0)[:height, :width]
        return values.reshape(height // tile, tile, width // tile, tile, 3).sum((1, 3))

    tile_z = tiles(got.mean - want.mean) / np.sqrt(np.maximum(tiles(variance), least))
    whole = tiles(got.mean - want.mean).sum((0, 1)) / np.sqrt(tiles(variance).sum((0, 1)))
    return Agreement(
        float(fine.mean()), float(np.abs(tile_z).max()), float(np.abs(whole).max()),
        float((np.where(fine, z, 0) ** 2).mean()), float(np.abs(got.mean.sum((0, 1)) / want.mean.sum((0, 1)) - 1).max()),
    )  # fmt: skip


def keep(folder: Path, **images: Any) -> str:
    """Writes images of a failed comparison as .npy and returns a line for the message."""
    for name, image in images.items():
        np.save(folder / f"{name}.npy", np.asarray(image))
    return f"got, want and difference in {folder}"
