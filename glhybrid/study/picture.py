"""How far a picture is from another, in linear radiance: relative MSE, PSNR, SSIM, bias, beside HDR-FLIP (flip.py).

Pictures are (H, W, 3) float, row 0 at the top.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
REL_FLOOR = 0.01  # of relMSE's denominator, in units of the reference's mean luminance squared
MIDDLE_GREY = 0.18


@dataclass(frozen=True)
class AllLight:
    """mean: luminance over pixels, of all paths, those that make specks too. error: its standard deviation."""

    mean: float
    error: float

    def bias(self, got: float) -> tuple[float, float]:
        """By how many per cent a mean luminance is off, and the standard deviation of that, of the truth's noise."""
        if self.mean <= 0:
            return 0.0, 0.0
        return 100 * (got / self.mean - 1), 100 * got / self.mean * self.error / self.mean


@dataclass(frozen=True)
class Difference:
    """flip: mean HDR-FLIP, 0 to 1. rel_mse: mean e^2 / (ref^2 + 0.01 mean^2). psnr: dB, of sRGB-encoded values at an
    exposure that brings the reference to middle grey; ssim: of their luma. bias_percent: of mean luminance, against all
    light; bias_error_percent: its standard deviation, of the reference's noise."""

    flip: float
    rel_mse: float
    psnr: float
    ssim: float
    bias_percent: float
    bias_error_percent: float

    to_dict = asdict


def compare(got: F32, want: F32, flip: F32, light: AllLight | None = None) -> Difference:
    """The figures. flip: the map of the two, (H, W). light: what bias is told against, where `want` leaves some out."""
    assert got.shape == want.shape and got.ndim == 3, (got.shape, want.shape)
    a, b = got.astype(np.float64), want.astype(np.float64)
    mean = float((b @ LUMINANCE).mean())
    ya, yb = encoded(a, mean), encoded(b, mean)
    mse = float(((ya - yb) ** 2).mean())
    bias, bias_error = (light or AllLight(mean, 0.0)).bias(float((a @ LUMINANCE).mean()))
    return Difference(
        flip=float(flip.mean(dtype=np.float64)),
        rel_mse=rel_mse(a, b),
        psnr=float(-10 * np.log10(mse)) if mse > 0 else float("inf"),
        ssim=ssim(ya @ LUMINANCE, yb @ LUMINANCE),
        bias_percent=bias,
        bias_error_percent=bias_error,
    )


def rel_mse(got: F64, want: F64) -> float:
    """Relative mean square error of two (H, W, 3) pictures; the floor keeps black from counting for all."""
    mean = float((want @ LUMINANCE).mean())
    floor = REL_FLOOR * mean**2 if mean > 0 else REL_FLOOR
    return float(((got - want) ** 2 / (want**2 + floor)).mean())


def encoded(radiance: F64, mean: float) -> F64:
    """sRGB, 0 to 1, at the exposure that shows `mean` as middle grey."""
    x = np.clip(radiance * (MIDDLE_GREY / mean if mean > 0 else 1.0), 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def ssim(a: F64, b: F64, sigma: float = 1.5) -> float:
    """Mean structural similarity of two (H, W) images with values 0 to 1 (Wang et al. 2004), Gaussian window."""
    c1, c2 = 0.01**2, 0.03**2
    ma, mb = _blur(a, sigma), _blur(b, sigma)
    va, vb = _blur(a * a, sigma) - ma**2, _blur(b * b, sigma) - mb**2
    covariance = _blur(a * b, sigma) - ma * mb
    value = (2 * ma * mb + c1) * (2 * covariance + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))
    return float(value.mean())


def _blur(image: F64, sigma: float) -> F64:
    reach = int(3.5 * sigma + 0.5)
    x = np.arange(-reach, reach + 1)
    weight = np.exp(-(x**2) / (2 * sigma**2))
    weight /= weight.sum()
    for axis in (0, 1):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (reach, reach)
        padded = np.pad(image, pad, mode="symmetric")
        length = image.shape[axis]
        image = sum(w * np.take(padded, range(k, k + length), axis) for k, w in enumerate(weight))
    return image


def weighted_mean(values: Any, weight: Any) -> float | None:
    """None where nothing has weight."""
    total = float(weight.sum(dtype=np.float64))
    return float((values * weight).sum(dtype=np.float64) / total) if total > 0 else None


def magma(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W) in 0 to 1 -> (H, W, 3) uint8: FLIP's colours (the map "magma" of Smith and van der Walt, nine stops)."""
    stops = np.array(
        [(0, 0, 4), (28, 16, 68), (79, 18, 123), (129, 37, 129), (181, 54, 122), (229, 80, 100), (251, 135, 97),
         (254, 194, 135), (252, 253, 191)]
    )  # fmt: skip
    x = np.clip(np.nan_to_num(values, nan=1.0), 0, 1) * (len(stops) - 1)
    return np.stack([np.interp(x, np.arange(len(stops)), stops[:, c]) for c in range(3)], -1).round().astype(np.uint8)
