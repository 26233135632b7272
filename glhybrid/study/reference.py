"""The converged picture that all techniques are held against, and how noisy it still is.

PARTS independent pictures are put together by pixel (robust.py), and leave out specks. What is a sum of light, bias, is
told against the plain mean of all paths. Each half of the parts, put together alike, is a picture of
its own: half the difference of the two is the standard deviation of the whole, so the reference says how small an error
it can tell. That is watched in FLIP: relative MSE may hang on a few paths that found a sun in a mirror's mirror.
It is kept on disk by content, a third as large as in memory (packing.py), and goes on from where it was.
"""

import contextlib
import hashlib
import json
import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.caches import REFERENCES_BYTES
from glhybrid.content_cache import trim
from glhybrid.flip import Flip
from glhybrid.image import replacing
from glhybrid.jit import cache_dir
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import picture, store
from glhybrid.study.packing import pack, unpack
from glhybrid.study.robust import mean_of_means

log = logging.getLogger("glhybrid")
Progress = Callable[[str, int, int], None]
Mask = NDArray[np.bool_]
PARTS = 16
BATCH, LARGEST_BATCH = 4, 64  # paths a pixel of a part, before all are looked at: they double
LOOK_SHARE = 4.0  # times as long as a look at its noise takes it is worked on before the next
FLIP_POWER = 2.0  # paths grow by it as the noise falls
LOOK_PIXELS, BAND = 300_000, 32  # that a look is at, in bands of so many rows
LEAST = 64  # paths a pixel, whatever the time: fewer tell nothing apart


@dataclass(frozen=True, eq=False)
class Reference:
    """radiance: (H, W, 3) float32. noise_*: the error that its own noise is expected to have, in the same measures.

    light: of all paths, over the pixels asked for. left_out_percent: of all light, what so few paths found that it is
    in no pixel. complete: whether the target was reached, not the limit of paths or time.
    """

    radiance: F32
    light: picture.AllLight
    samples: int
    bounces: int
    noise_rel_mse: float
    noise_flip: float
    left_out_percent: float
    seconds: float
    complete: bool
    key: str

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON, without the pictures."""
        names = (
            "samples", "bounces", "noise_rel_mse", "noise_flip", "left_out_percent", "seconds", "complete", "key",
        )  # fmt: skip
        light = {"mean_luminance": self.light.mean, "mean_luminance_error": self.light.error}
        return {name: getattr(self, name) for name in names} | light

    @staticmethod
    def from_dict(radiance: F32, kept: dict[str, Any]) -> "Reference":
        """What to_dict() has told of it. Raises KeyError where that was of another version."""
        light = picture.AllLight(kept["mean_luminance"], kept["mean_luminance_error"])
        names = [f.name for f in fields(Reference) if f.name not in ("radiance", "light")]
        return Reference(radiance, light, **{name: kept[name] for name in names})


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
    counted: Mask | None = None,
) -> Reference:
    """Averages paths until the FLIP of its noise is at most `target`, or `most` paths a pixel, or the time.

    counted: (H, W), the pixels that `light` is of; default all.
    folder: where it is kept; default `reference` in the cache folder, nowhere with GLHYBRID_CACHE=off. What was there
    is gone on from. budget_s counts this call alone, after its first batches.
    """
    key = content_key(scene, camera, size, bounces)
    if folder is None and os.environ.get("GLHYBRID_CACHE") != "off":
        folder = cache_dir() / "reference"
    # A scene without a digest of its content is not known again.
    path = folder / f"{key}.npz" if folder is not None and scene.sha256 else None
    parts = _Parts.read(path, size) if path is not None else _Parts.empty(size)
    started, kept_s, saved = time.perf_counter(), parts.seconds, time.perf_counter()
    noise, looked, looking_s, batches = math.inf, started, 0.0, parts.batches
    while True:
        # To look takes seconds where pictures are large: at most a fifth of the time goes there.
        due = parts.samples >= LEAST and time.perf_counter() - looked >= LOOK_SHARE * looking_s
        due = due or parts.samples >= most
        if due or time.perf_counter() - started >= budget_s:
            looking = time.perf_counter()
            noise = parts.noise_flip(renderer.flip)
            looked = time.perf_counter()
            looking_s = looked - looking
        spent = time.perf_counter() - started
        timed_out = spent >= budget_s and parts.samples >= LEAST and parts.batches > batches
        enough = parts.samples > 0 and (noise <= target or parts.samples >= most or timed_out)
        known = 0 < noise < math.inf
        aim = min(most, parts.samples * (noise / max(target, 1e-9)) ** FLIP_POWER) if known else most
        if enough:
            break
        count = min(parts.count or BATCH, LARGEST_BATCH, max(1, (most - parts.samples) // PARTS))
        if parts.count and math.isfinite(budget_s):
            rate = (parts.seconds + 1e-9) / parts.samples
            count = max(1, min(count, int((budget_s - spent) / rate / PARTS) + 1))
        for part in range(PARTS):
            base = Settings(reflections="reference", aa=1, bounces=bounces, samples=count, seed=parts.batches)
            parts.add(part, renderer.render(scene, camera, size, base)["radiance"], count)
            if progress is not None:
                done = parts.samples + (part + 1) * count
                progress("reference", done, max(math.ceil(aim), done))
            if parts.batches == 1:
                started = time.perf_counter()  # the first also compiles, which is no progress
        parts.count += count
        parts.seconds = kept_s + time.perf_counter() - started
        if path is not None and time.perf_counter() - saved > 20:
            parts.write(path)
            saved = time.perf_counter()
    if path is not None and parts.seconds > kept_s:
        parts.write(path)
    whole, off = parts.pictures()
    return Reference(
        whole.astype(np.float32), parts.light(counted), parts.samples, bounces, picture.rel_mse(off, whole), noise,
        parts.left_out_percent(whole), parts.seconds, noise <= target, key,
    )  # fmt: skip


def _pictures(sums: F32, count: int) -> tuple[Any, Any]:
    """Of sums of `count` paths a pixel: the whole, and a picture one standard deviation away from it."""
    whole = mean_of_means(sums).astype(np.float64) / count
    a, b = (mean_of_means(sums[half::2]) / count for half in range(2))
    return whole, np.maximum(whole + (a - b) / 2, 0)


class _Parts:
    """Sums of independent estimates, each of `count` paths a pixel."""

    def __init__(self, sums: F32, count: int, batches: int, seconds: float) -> None:
        self.sums, self.count, self.batches, self.seconds = sums, count, batches, seconds
        self._known: tuple[int, Any, Any] | None = None  # pictures() of so many batches

    @staticmethod
    def empty(size: tuple[int, int]) -> "_Parts":
        return _Parts(np.zeros((PARTS, size[1], size[0], 3), np.float32), 0, 0, 0.0)

    @property
    def samples(self) -> int:
        return PARTS * self.count

    def add(self, part: int, radiance: F32, count: int) -> None:
        self.sums[part] += radiance * np.float32(count)
        self.batches += 1

    def pictures(self) -> tuple[Any, Any]:
        """The whole, and a picture one standard deviation away from it."""
        if self._known is None or self._known[0] != self.batches:  # seconds, where pictures are large
            self._known = self.batches, *_pictures(self.sums, self.count)
        return self._known[1:]

    def noise_flip(self, flip: Flip) -> float:
        """Of bands of rows all over the picture, LOOK_PIXELS of it: medians of two million take seconds."""
        if not self.count:
            return math.inf
        height, width = self.sums.shape[1:3]
        every = max(round(height * width / LOOK_PIXELS), 1)
        rows = np.flatnonzero(np.arange(height) // BAND % every == every // 2)
        if every == 1 or not len(rows):
            whole, off = self.pictures()
        else:
            whole, off = _pictures(self.sums[:, rows], self.count)
        return float(flip.hdr(off.astype(np.float32), whole.astype(np.float32)).mean())

    def light(self, counted: Mask | None = None) -> picture.AllLight:
        """The plain mean; parts are independent, so their spread tells how sure it is."""
        where = slice(None) if counted is None else counted
        means = [
            float((part[where].mean((0, 1) if counted is None else 0, dtype=np.float64)) @ picture.LUMINANCE)
            for part in self.sums
        ]
        return picture.AllLight(
            float(np.mean(means)) / self.count, float(np.std(means, ddof=1)) / self.count / PARTS**0.5
        )

    def left_out_percent(self, whole: Any) -> float:
        all_light = self.light().mean
        return 100 * (1 - float((whole @ picture.LUMINANCE).mean()) / all_light) if all_light > 0 else 0.0

    def write(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            words, scale = pack(self.sums)
            with replacing(path) as temporary, temporary.open("wb") as file:
                np.savez(file, words=words, scale=scale, rest=[self.count, self.batches, self.seconds])
            trim(path, REFERENCES_BYTES)
            self.sums, self._known = unpack(words, scale), None  # what another run goes on from
        except Exception as error:  # a cache that cannot be written costs time, nothing else
            log.warning("%s: the reference is not kept: %s", path, error)

    @staticmethod
    def read(path: Path, size: tuple[int, int]) -> "_Parts":
        try:
            with path.open("rb") as opened, np.load(opened) as file:  # a damaged archive does not close itself
                sums, (count, batches, seconds) = unpack(file["words"], file["scale"]), file["rest"].tolist()
            with contextlib.suppress(OSError):
                os.utime(path)  # what was used longest ago goes first
            if sums.shape == (PARTS, size[1], size[0], 3):
                return _Parts(sums, int(count), int(batches), float(seconds))
        except Exception:  # absent, damaged or foreign: made anew
            pass
        return _Parts.empty(size)
