"""Arrays as colours: every AOV and every image of a pass becomes a picture with a legend. NumPy, no OpenGL.

What a view is follows from image.AOVS (dtype, channels, unit), so that a new row there is a new view by itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.image import AOVS, NO_ID
from glhybrid.layout import CONSTANTS
from glhybrid.scene import F64, U8

PICTURE = "picture"
# Anchors of the palettes, sRGB, evenly spaced: matplotlib's viridis, magma and Google's turbo.
_ANCHORS: dict[str, tuple[int, ...]] = {
    "viridis": (0x440154, 0x482878, 0x3E4989, 0x31688E, 0x26828E, 0x1F9E89, 0x35B779, 0x6DCD59, 0xB4DE2C, 0xFDE725),
    "magma": (0x000004, 0x180F3D, 0x440F76, 0x721F81, 0x9E2F7F, 0xCD4071, 0xF1605D, 0xFD9668, 0xFECA8D, 0xFCFDBF),
    "turbo": (0x30123B, 0x4662D7, 0x36AAF9, 0x1AE4B6, 0x72FE5E, 0xC8EF34, 0xFABA39, 0xF66B19, 0xCA2A04, 0x7A0403),
    "grey": (0x000000, 0xFFFFFF),
}
MISS = (38, 40, 44)  # where the camera ray meets nothing
NON_FINITE = (255, 0, 255)
_REASON_COLORS = (
    (60, 64, 70), (120, 134, 150), (224, 122, 62), (92, 168, 224), (214, 88, 140), (126, 190, 92), (232, 200, 80),
    (150, 110, 210), (90, 196, 180), (200, 70, 60), (230, 230, 230), (140, 90, 60),
    (40, 120, 90), (70, 90, 200),
)  # fmt: skip


@dataclass(frozen=True)
class Scale:
    """A legend with a ramp. palette: a key of palettes()."""

    low: float
    high: float
    unit: str
    palette: str


@dataclass(frozen=True)
class Swatches:
    """A legend of colours: (label, sRGB, share of the image's pixels)."""

    rows: tuple[tuple[str, tuple[int, int, int], float], ...]


@dataclass(frozen=True)
class Note:
    """A legend in words."""

    text: str


Legend = Scale | Swatches | Note


@dataclass(frozen=True)
class Look:
    """What an array alone does not say. names: of ids, by AOV; bounds (2, 3): of the scene, metres."""

    exposure: float = 0.0
    light: int = -1  # of visibility: which; -1 = their mean
    names: Mapping[str, Sequence[str]] | None = None
    bounds: F64 | None = None


def palette(name: str) -> U8:
    """(256, 3) uint8 sRGB."""
    anchors = np.array([[(c >> 16) & 255, (c >> 8) & 255, c & 255] for c in _ANCHORS[name]], np.float64)
    at = np.linspace(0, len(anchors) - 1, 256)
    ramp = [np.interp(at, np.arange(len(anchors)), anchors[:, k]) for k in range(3)]
    return np.stack(ramp, -1).round().astype(np.uint8)


def colour(name: str, array: NDArray[Any], look: Look) -> tuple[U8, Legend]:
    """An AOV or channel (H, W[, C]) as (H, W, 3) uint8 sRGB, row 0 at the top, and its legend."""
    if name.startswith("reason"):
        return _reasons(array)
    if name == "visibility":
        return _visibility(array, look)
    if name == "motion":
        return _motion(array)
    row = AOVS.get(name)
    if array.dtype.kind in "ui" and name != "bvh_steps":
        return _ids(name, array[..., -1] if array.ndim == 3 else array, look)
    if name == "position":
        return _position(array, look)
    if name.startswith("normal") or (row is not None and row.unit == "unit vector"):
        return _vectors(array)
    if name == "bvh_steps":
        return _ramp(array.astype(np.float64), "turbo", "nodes and triangles", array == 0, whole=True)
    if array.ndim == 3 and array.shape[-1] >= 3:
        exposure = look.exposure if row is None or row.unit == "radiance" else 0.0
        text = f"linear, shown at {exposure:+.2f} EV without a tone map" if exposure else "linear, sRGB-encoded"
        return _rgb(array[..., :3], exposure), Note(text)
    if array.ndim == 3:
        array = array[..., 0]
    if row is not None and row.unit == "0 to 1":
        return _apply(array.astype(np.float64), 0.0, 1.0, "viridis"), Scale(0.0, 1.0, "", "viridis")
    unit = row.unit if row is not None else ""
    return _ramp(array.astype(np.float64), "viridis", unit, ~np.isfinite(array) | (array == 0))


def opaque(rgb: U8) -> U8:
    """(H, W, 4) of (H, W, 3): what textures take as it is."""
    pixels = np.full((*rgb.shape[:2], 4), 255, np.uint8)
    for channel in range(3):  # NumPy takes three to eight times as long for all at once
        pixels[..., channel] = rgb[..., channel]
    return pixels


def heat(values: NDArray[Any], high: float, unit: str, name: str = "magma") -> tuple[U8, Legend]:
    """Errors (H, W) from 0 to `high`."""
    return _apply(values, 0.0, high, name), Scale(0.0, high, unit, name)


def _apply(values: NDArray[Any], low: float, high: float, name: str) -> U8:
    span = high - low if high > low else 1.0
    with np.errstate(invalid="ignore", over="ignore"):
        index = np.nan_to_num((values - low) * (255.0 / span), nan=0.0, posinf=255.0, neginf=0.0)
    return palette(name)[np.clip(index + 0.5, 0, 255).astype(np.uint8)]


def _ramp(values: F64, name: str, unit: str, missing: NDArray[Any], whole: bool = False) -> tuple[U8, Legend]:
    """Over the range of all but the most extreme hundredth."""
    seen = values[~missing & np.isfinite(values)]
    low, high = (float(v) for v in np.percentile(seen, (1, 99))) if len(seen) else (0.0, 1.0)
    if whole:
        low = 0.0
        high = max(high, 1.0)
    rgb = _apply(values, low, high, name)
    rgb[missing] = MISS
    return rgb, Scale(low, high, unit, name)


def _rgb(linear: NDArray[Any], exposure: float) -> U8:
    c = np.clip(np.nan_to_num(linear.astype(np.float32), posinf=1e9) * np.float32(2.0**exposure), 0, 1)
    c = np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.power(np.maximum(c, 1e-8), 1 / 2.4) - 0.055)
    rgb = (c * 255 + 0.5).astype(np.uint8)
    bad = ~np.isfinite(linear).all(-1)
    if bad.any():
        rgb[bad] = NON_FINITE
    return rgb


def _vectors(array: NDArray[Any]) -> tuple[U8, Legend]:
    rgb = np.clip((array[..., :3] * 0.5 + 0.5) * 255 + 0.5, 0, 255).astype(np.uint8)
    rgb[(array[..., :3] == 0).all(-1)] = MISS
    return rgb, Note("red +X, green +Y, blue +Z; grey = 0")


def _position(array: NDArray[Any], look: Look) -> tuple[U8, Legend]:
    if look.bounds is None:
        return _vectors(array)
    low, high = look.bounds
    span = np.where(high > low, high - low, 1.0)
    rgb = np.clip((array - low) / span * 255, 0, 255).astype(np.uint8)
    rgb[(array == 0).all(-1)] = MISS
    words = (f"{c} {a:.4g} to {b:.4g}" for c, a, b in zip(("red X", "green Y", "blue Z"), low, high, strict=True))
    return rgb, Note(", ".join(words) + " m")


def _motion(array: NDArray[Any]) -> tuple[U8, Legend]:
    length = np.hypot(array[..., 0], array[..., 1])
    high = max(float(np.percentile(length, 99)), 1e-3)
    hue = np.arctan2(array[..., 1], array[..., 0]) / (2 * np.pi) + 0.5
    rgb = _hsv(hue, 0.75, np.clip(length / high, 0, 1))
    return rgb, Note(f"hue is the way, brightness up to {high:.3g} pixels a frame")


def _visibility(array: NDArray[Any], look: Look) -> tuple[U8, Legend]:
    if array.ndim == 2:
        array = array[..., None]
    count = array.shape[-1]
    if count == 0:
        return np.full((*array.shape[:2], 3), MISS, np.uint8), Note("the scene has no light")
    chosen = 0 <= look.light < count
    values = array[..., look.light] if chosen else array.mean(-1)
    unit = f"of light {look.light}" if chosen else f"mean of {count} light{'s' if count > 1 else ''}"
    return _apply(values, 0.0, 1.0, "grey"), Scale(0.0, 1.0, unit, "grey")


def _ids(name: str, array: NDArray[Any], look: Look) -> tuple[U8, Legend]:
    ids = array.astype(np.int64)
    # The golden ratio's multiples spread neighbours over the circle of hues.
    rgb = _hsv((ids * 0.61803398875) % 1.0, 0.35 + 0.4 * ((ids * 0.7548776662) % 1.0), 0.95)
    miss = array == NO_ID
    rgb[miss] = MISS
    found, counts = np.unique(array[~miss], return_counts=True)
    order = np.argsort(-counts)[:8]
    names = (look.names or {}).get(name, ())
    rows = []
    for i in order.tolist():
        number = int(found[i])
        label = names[number] if number < len(names) and names[number] else f"{name.removesuffix('_id')} {number}"
        y, x = np.argwhere(array == found[i])[0]
        rows.append((label, tuple(int(v) for v in rgb[y, x]), float(counts[i]) / array.size))
    return rgb, Swatches(tuple(rows))  # type: ignore[arg-type]


def _reasons(array: NDArray[Any]) -> tuple[U8, Legend]:
    codes = {k: v for k, v in CONSTANTS.items() if k.startswith("REASON_")}
    words = {v: k.removeprefix("REASON_").lower().replace("_", " ") for k, v in codes.items()}
    table = np.full((256, 3), NON_FINITE, np.uint8)
    for i, color in enumerate(_REASON_COLORS):
        table[i] = color
    found, counts = np.unique(array, return_counts=True)
    rows = [
        (words.get(int(v), f"code {v}"), tuple(int(c) for c in table[v]), float(n) / array.size)
        for v, n in sorted(zip(found.tolist(), counts.tolist(), strict=True), key=lambda pair: -pair[1])
    ]
    return table[array.astype(np.uint8)], Swatches(tuple(rows))  # type: ignore[arg-type]


def _hsv(hue: NDArray[Any], saturation: Any, value: Any) -> U8:
    k = (np.asarray(hue)[..., None] * 6 + np.array([5.0, 3.0, 1.0])) % 6
    s, v = np.asarray(saturation)[..., None], np.asarray(value)[..., None]
    return ((v - v * s * np.clip(np.minimum(k, 4 - k), 0, 1)) * 255 + 0.5).astype(np.uint8)
