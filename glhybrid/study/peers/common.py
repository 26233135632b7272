"""What the processes of peers share: reading what they are given, and radiance out of 8-bit pictures."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

BRACKETS = (1.0, 1 / 8, 1 / 64)  # exposures, times one that shows the mean as middle grey
REPEATS = 3
ENOUGH_S = 5.0  # of timed pictures: one of a slow path tracer tells as much


def read(folder: str) -> tuple[Path, dict[str, Any], Any]:
    """The GLB's path, scene.json, and the sky (H, W, 3)."""
    where = Path(folder)
    with np.load(where / "sky.npz") as file:
        sky = file["radiance"]
    return where / "scene.glb", json.loads((where / "scene.json").read_text(encoding="utf-8")), sky


def answer(path: str, radiance: Any, ms: float, version: str, notes: list[str]) -> None:
    """radiance (H, W, 3) linear, row 0 at the top; ms: of one picture, median; notes: differences in model."""
    told = json.dumps({"ms": ms, "version": version, "notes": notes})
    np.savez(path, radiance=np.ascontiguousarray(radiance[..., :3], np.float32), told=told)


def timed(draw: Callable[[], Any]) -> tuple[Any, float]:
    """The result, and median ms over REPEATS, or fewer that take ENOUGH_S, after one that prepares."""
    draw()
    times: list[float] = []
    while len(times) < REPEATS and sum(times) < 1e3 * ENOUGH_S:
        started = time.perf_counter()
        result = draw()
        times.append((time.perf_counter() - started) * 1e3)
    return result, float(np.median(times))


def encoded(linear: Any) -> Any:
    """sRGB of linear values, 0 to 1."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def bracketed(draw: Callable[[float], Any], mean: float) -> Any:
    """Radiance from a renderer of 8-bit sRGB. draw(gain) -> (H, W, 3) uint8 with all light times gain.

    Each pixel is taken from the brightest picture in which it is not clipped.
    """
    base = 0.18 / mean if mean > 0 else 1.0
    found = None
    for share in BRACKETS:
        shown = np.asarray(draw(base * share))[..., :3].astype(np.float64) / 255
        linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4) / (base * share)
        clipped = (shown > 0.98).any(-1, keepdims=True)
        if found is None:
            found, open_ = linear, clipped
        else:
            found = np.where(open_, linear, found)
            open_ = open_ & clipped
    return found
