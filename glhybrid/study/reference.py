"""The converged picture that all techniques are held against, and how noisy it still is.

Two independent halves are averaged: half their difference is the standard deviation of their mean, so the reference
says how small an error it can tell. That is watched in FLIP: relative MSE may hang on a few paths that found a sun in a
mirror's mirror, and then falls with no number of samples. It is kept on disk by content and goes on from where it was.
"""

import hashlib
import json
import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.image import replacing
from glhybrid.jit import cache_dir
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import picture, store

log = logging.getLogger("glhybrid")
Progress = Callable[[str, int, int], None]
BATCH = 8  # paths a pixel of the first two batches; they double
LARGEST_BATCH = 256
LOOK_SHARE = 4.0  # times as long as a look at its noise takes it is worked on before the next
FLIP_POWER = 3.0  # paths grow by it as the noise falls: FLIP compresses small errors
LEAST = 64  # paths a pixel, whatever the time: fewer tell nothing apart


@dataclass(frozen=True, eq=False)
class Reference:
    """radiance: (H, W, 3) float32. noise_*: the error that its own noise is expected to have, in the same measures.

    complete: whether the target was reached, not the limit of paths or time.
    """

    radiance: F32
    samples: int
    bounces: int
    noise_rel_mse: float
    noise_flip: float
    seconds: float
    complete: bool
    key: str

    def to_dict(self) -> dict[str, Any]:
        names = ("samples", "bounces", "noise_rel_mse", "noise_flip", "seconds", "complete", "key")
        return {name: getattr(self, name) for name in names}


def content_key(scene: Scene, camera: Camera, size: tuple[int, int], bounces: int) -> str:
    """Everything that decides the picture: the file's content, the view, the size, the depth and our own sources."""
    view = [camera.world_from_view.tolist(), camera.fov_y, camera.fov_short, camera.near, camera.xmag, camera.ymag]
    parts = [store.renderer_digest(), scene.sha256, view, list(size), bounces]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def converge(
    renderer: Renderer,
    scene: Scene,
    camera: Camera,
    size: tuple[int, int],
    *,
    bounces: int = 8,
    target: float = 0.002,
    most: int = 4096,
    budget_s: float = math.inf,
    progress: Progress | None = None,
    folder: Path | None = None,
) -> Reference:
    """Averages paths until the FLIP of its noise is at most `target`, or `most` paths a pixel, or the time.

    folder: where it is kept; default `reference` in the cache folder, nowhere with GLHYBRID_CACHE=off. What was there
    is gone on from. budget_s counts this call alone, after its first batches.
    """
    key = content_key(scene, camera, size, bounces)
    if folder is None and os.environ.get("GLHYBRID_CACHE") != "off":
        folder = cache_dir() / "reference"
    # A scene without a digest of its content is not known again.
    path = folder / f"{key}.npz" if folder is not None and scene.sha256 else None
    halves = _Halves.read(path, size) if path is not None else _Halves.empty(size)
    started, kept_s, saved = time.perf_counter(), halves.seconds, time.perf_counter()
    noise, looked, looking_s = math.inf, started, 0.0
    while True:
        # To look takes seconds where pictures are large: at most a fifth of the time goes there.
        due = halves.samples >= LEAST and time.perf_counter() - looked >= LOOK_SHARE * looking_s
        due = due or halves.samples >= most
        if due or time.perf_counter() - started >= budget_s:
            looking = time.perf_counter()
            noise = halves.noise_flip()
            looked = time.perf_counter()
            looking_s = looked - looking
        spent = time.perf_counter() - started
        timed_out = spent >= budget_s and halves.samples >= LEAST
        enough = halves.samples > 0 and (noise <= target or halves.samples >= most or timed_out)
        if progress is not None:
            aim = (
                most
                if noise <= 0 or not math.isfinite(noise)
                else min(most, halves.samples * (noise / max(target, 1e-9)) ** FLIP_POWER)
            )
            progress("reference", halves.samples, max(math.ceil(aim), halves.samples))
        if enough:
            break
        count = min(LARGEST_BATCH, max(BATCH, halves.samples // 2))
        if halves.samples and math.isfinite(budget_s):
            rate = (halves.seconds + 1e-9) / halves.samples
            count = max(1, min(count, int((budget_s - spent) / rate / 2) + 1))
        for half in range(2):
            base = Settings(reflections="reference", aa=1, bounces=bounces, samples=count, seed=halves.batches)
            frame = renderer.render(scene, camera, size, base)
            halves.add(half, frame["radiance"], count)
        if halves.batches == 2:
            started = time.perf_counter()  # the first pair also compiles, which is no progress
        halves.seconds = kept_s + time.perf_counter() - started
        if path is not None and time.perf_counter() - saved > 20:
            halves.write(path)
            saved = time.perf_counter()
    if path is not None and halves.seconds > kept_s:
        halves.write(path)
    mean, off = halves.pictures()
    return Reference(
        mean.astype(np.float32), halves.samples, bounces, picture.rel_mse(off, mean), noise, halves.seconds,
        noise <= target, key,
    )  # fmt: skip


class _Halves:
    """Sums of two independent estimates."""

    def __init__(self, sums: list[Any], counts: list[int], batches: int, seconds: float) -> None:
        self.sums, self.counts, self.batches, self.seconds = sums, counts, batches, seconds

    @staticmethod
    def empty(size: tuple[int, int]) -> "_Halves":
        return _Halves([np.zeros((size[1], size[0], 3)) for _ in range(2)], [0, 0], 0, 0.0)

    @property
    def samples(self) -> int:
        return sum(self.counts)

    def add(self, half: int, radiance: F32, count: int) -> None:
        self.sums[half] += radiance.astype(np.float64) * count
        self.counts[half] += count
        self.batches += 1

    def pictures(self) -> tuple[Any, Any]:
        """The mean of both, and a picture one standard deviation of that mean away from it: the first half."""
        a, b = (s / n for s, n in zip(self.sums, self.counts, strict=True))
        return (a + b) / 2, a

    def noise_flip(self) -> float:
        if not all(self.counts):
            return math.inf
        mean, off = self.pictures()
        return float(picture.flip_map(off.astype(np.float32), mean.astype(np.float32)).mean())

    def write(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as temporary, temporary.open("wb") as file:
                np.savez(file, a=self.sums[0], b=self.sums[1], counts=self.counts, rest=[self.batches, self.seconds])
        except Exception as error:  # a cache that cannot be written costs time, nothing else
            log.warning("%s: the reference is not kept: %s", path, error)

    @staticmethod
    def read(path: Path, size: tuple[int, int]) -> "_Halves":
        try:
            with path.open("rb") as opened, np.load(opened) as file:  # a damaged archive does not close itself
                sums, counts, rest = [file["a"], file["b"]], file["counts"].tolist(), file["rest"].tolist()
            if sums[0].shape == (size[1], size[0], 3) == sums[1].shape:
                return _Halves(sums, counts, int(rest[0]), float(rest[1]))
        except Exception:  # absent, damaged or foreign: made anew
            pass
        return _Halves.empty(size)
