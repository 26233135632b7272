"""What the processes of peers share: reading what they are given, and radiance out of 8-bit pictures."""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

BRACKETS = (1.0, 1 / 8, 1 / 64)  # exposures, times one that shows the mean as middle grey
REPEATS = 3
Times = tuple[float, float]  # ms from start to end; ms of processor time of all threads, over the number of processors
ENOUGH_S = 5.0  # of timed pictures: one of a slow path tracer tells as much


def read(folder: str) -> tuple[Path, dict[str, Any], Any]:
    """The GLB's path, scene.json, and the sky (H, W, 3)."""
    where = Path(folder)
    with np.load(where / "sky.npz") as file:
        sky = file["radiance"]
    return where / "scene.glb", json.loads((where / "scene.json").read_text(encoding="utf-8")), sky


def answer(path: str, radiance: Any, times: Times, version: str, notes: list[str]) -> None:
    """radiance (H, W, 3) linear, row 0 at the top; times: of one picture; notes: differences in model."""
    told = json.dumps({"ms": times[0], "cpu_ms": times[1], "version": version, "notes": notes})
    np.savez(path, radiance=np.ascontiguousarray(radiance[..., :3], np.float32), told=told)


def timed(draw: Callable[[], Any]) -> tuple[Any, Times]:
    """The result, and medians over REPEATS, or fewer that take ENOUGH_S, after one that prepares."""
    draw()
    times: list[Times] = []
    while len(times) < REPEATS and sum(wall for wall, _ in times) < 1e3 * ENOUGH_S:
        started, worked = time.perf_counter(), time.process_time()
        result = draw()
        cpu_ms = (time.process_time() - worked) * 1e3 / len(os.sched_getaffinity(0))
        times.append(((time.perf_counter() - started) * 1e3, cpu_ms))
    wall, cpu = np.median(times, axis=0).tolist()
    return result, (wall, cpu)


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
