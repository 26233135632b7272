"""How far a displayed picture is from another: numbers and a map of differences by the GPU, FLIP in a process aside."""

import importlib
import multiprocessing
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.context import Context
from glhybrid.needs import Features
from glhybrid.scene import F32, U8
from glhybrid.shaders import Shaders
from glhybrid.viewer import views
from glhybrid.viewer.picture import Picture

FLIP_UNIT = "equal ... as unlike as can be"


@dataclass(frozen=True)
class Error:
    """flip: mean of NVIDIA's FLIP of the displayed images, 0 to 1, None where flip-evaluator is missing.

    psnr: dB of the displayed images. rel_mse: mean over pixels of |a - r|^2 / (|r|^2 + 0.01), linear radiance.
    """

    psnr: float
    rel_mse: float
    flip: float | None = None
    samples: int = 0  # of the reference


class Differ:
    """Compares two pictures where they are: reading them back takes longer than an answer may. Owns its images.

    palette: 256 colours, 256 x 1.
    """

    def __init__(self, context: Context, shaders: Shaders, palette: Any) -> None:
        self._context, self._shaders, self._palette = context, shaders, palette
        self._sums: Any = None
        self._maps: dict[str, Any] = {}

    def prepare(self) -> None:
        """Compiles what is not yet."""
        for stem in ("errors", "difference"):
            self._shaders.compute(stem, Features())

    def error(self, ours: Picture, theirs: Picture) -> Error:
        """All but FLIP. Of pictures of one size that were brought to display."""
        width, height = ours.size
        tiles = -(-width // 8) * -(-height // 8)
        if self._sums is None or self._sums.size != 16 * tiles:
            if self._sums is not None:
                self._sums.release()
            self._sums = self._context.gl.buffer(reserve=16 * tiles)
        resources = {
            "ours": ours.display, "theirs": theirs.display, "ours_radiance": ours.image,
            "theirs_radiance": theirs.image, "Errors": self._sums,
        }  # fmt: skip
        self._shaders.compute("errors", Features()).dispatch(resources, ours.size)
        rows = np.frombuffer(self._sums.read(), np.uint32).reshape(tiles, 4)
        mse = float(rows[:, 0].sum(dtype=np.float64)) / (3 * width * height)
        psnr = float(10 * np.log10(255.0**2 / mse)) if mse > 0 else float("inf")
        count, total = rows[:, 1].sum(dtype=np.float64), rows[:, 2].view(np.float32).sum(dtype=np.float64)
        return Error(psnr, float(total / max(count, 1.0)), samples=theirs.done)

    def map(self, name: str, ours: Picture, theirs: Picture, gain: float) -> tuple[Any, views.Legend]:
        """(texture, legend) of the largest difference over channels; it is drawn over at the next call of this name."""
        image = self._maps.get(name)
        if image is None or image.size != ours.size:
            if image is not None:
                image.release()
            image = self._maps[name] = self._context.gl.texture(ours.size, 4)
            image.repeat_x = image.repeat_y = False
        self._shaders.compute("difference", Features()).dispatch(
            {"ours": ours.display, "theirs": theirs.display, "out_difference": image, "palette": self._palette,
             "gain": gain},
            ours.size,
        )  # fmt: skip
        return image, views.Scale(0.0, 255.0 / gain, "levels of 255", "magma")

    def release(self) -> None:
        for image in (*self._maps.values(), *([self._sums] if self._sums is not None else [])):
            image.release()
        self._maps.clear()
        self._sums = None


def has_flip() -> bool:
    """Whether `pip install glhybrid[study]` was done: FLIP is optional."""
    try:
        importlib.import_module("flip_evaluator")
    except ImportError:
        return False
    return True


def flip(rgb: U8, reference: U8) -> tuple[F32, float]:
    """FLIP's error map (H, W) float32 and its mean: Andersson et al. 2020, LDR, 67 pixels a degree. (H, W, 3 or 4)."""
    import flip_evaluator

    test, truth = (np.ascontiguousarray(image[..., :3], np.float32) / 255 for image in (rgb, reference))
    error, mean, _ = flip_evaluator.evaluate(truth, test, "LDR", applyMagma=False)
    return np.asarray(error, np.float32).reshape(rgb.shape[:2]), float(mean)


def flip_picture(rgb: U8, reference: U8) -> tuple[U8, float]:
    """FLIP's map as colours, (H, W, 4) uint8, and its mean."""
    error, mean = flip(rgb, reference)
    return views.opaque(views.heat(error, 1.0, FLIP_UNIT)[0]), mean


class Worker:
    """FLIP in a process of its own: at 1920x1080 it takes half a second, and holds Python's lock."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._flip: tuple[Any, Future[tuple[U8, float]]] | None = None

    @property
    def busy(self) -> bool:
        """Whether a result is on its way, or waits for flipped()."""
        return self._flip is not None

    def start(self, key: Any, rgb: U8, reference: U8) -> None:
        """flip_picture() aside. key: given back with the result. Only while not `busy`."""
        assert self._flip is None
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        self._flip = key, self._pool.submit(flip_picture, rgb, reference)

    def flipped(self, wait: bool = False) -> tuple[Any, U8, float] | None:
        """(key, picture, mean) once; None while there is nothing new. Raises what the work raised."""
        if self._flip is None or not (wait or self._flip[1].done()):
            return None
        (key, future), self._flip = self._flip, None
        return key, *future.result()

    def close(self) -> None:
        """Waits for the work under way; its result is lost."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None
