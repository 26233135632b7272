"""How far a picture is from another: numbers and maps. NumPy and the authors' own FLIP, no OpenGL."""

import importlib
import multiprocessing
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.scene import F32, U8


@dataclass(frozen=True)
class Error:
    """flip: mean of NVIDIA's FLIP of the displayed images, 0 to 1, None where flip-evaluator is missing.

    psnr: dB of the displayed images. rel_mse: mean over pixels of |a - r|^2 / (|r|^2 + 0.01), linear radiance.
    """

    psnr: float
    rel_mse: float
    flip: float | None = None
    samples: int = 0  # of the reference


def numbers(rgb: U8, reference: U8, radiance: F32, reference_radiance: F32, samples: int = 0) -> Error:
    """All but FLIP."""
    difference = rgb.astype(np.float32) - reference.astype(np.float32)
    mse = float(np.mean(difference * difference))
    psnr = float(10 * np.log10(255.0**2 / mse)) if mse > 0 else float("inf")
    squared = np.square(radiance - reference_radiance).sum(-1)
    relative = squared / (np.square(reference_radiance).sum(-1) + 0.01)
    return Error(psnr, float(np.mean(relative[np.isfinite(relative)])), samples=samples)


def difference(rgb: U8, reference: U8) -> F32:
    """(H, W) float32: largest difference over channels of the displayed images, in levels of 255."""
    return np.abs(rgb.astype(np.float32) - reference.astype(np.float32)).max(-1)


def has_flip() -> bool:
    try:
        importlib.import_module("flip_evaluator")
    except ImportError:
        return False
    return True


def flip(rgb: U8, reference: U8) -> tuple[F32, float]:
    """FLIP's error map (H, W) float32 and its mean: Andersson et al. 2020, LDR, 67 pixels a degree."""
    import flip_evaluator

    test, truth = (np.ascontiguousarray(image, np.float32) / 255 for image in (rgb, reference))
    error, mean, _ = flip_evaluator.evaluate(truth, test, "LDR", applyMagma=False)
    return np.asarray(error, np.float32).reshape(rgb.shape[:2]), float(mean)


class Worker:
    """Errors made aside: numbers in a thread, FLIP in a process of its own, as it holds Python's lock for a second.

    For pictures of 1920x1080 both take half a second and more.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "glhybrid-compare")
        self._pool: ProcessPoolExecutor | None = None
        self._numbers: tuple[Any, Future[Error]] | None = None
        self._flip: tuple[Any, Future[tuple[F32, float]]] | None = None

    @property
    def busy(self) -> bool:
        return self._numbers is not None or self._flip is not None

    @property
    def flipping(self) -> bool:
        return self._flip is not None

    @property
    def counting(self) -> bool:
        return self._numbers is not None

    def count(self, key: Any, rgb: U8, reference: U8, radiance: F32, true_radiance: F32, samples: int) -> None:
        """numbers() aside. key: given back with the result. Only while not `counting`."""
        assert self._numbers is None
        self._numbers = key, self._thread.submit(numbers, rgb, reference, radiance, true_radiance, samples)

    def start(self, key: Any, rgb: U8, reference: U8) -> None:
        """flip() aside. key: given back with the result. Only while not `flipping`."""
        assert self._flip is None
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        self._flip = key, self._pool.submit(flip, rgb.copy(), reference.copy())

    def counted(self, wait: bool = False) -> tuple[Any, Error] | None:
        """(key, numbers) once; None while there is nothing new. Raises what the work raised."""
        if self._numbers is None or not (wait or self._numbers[1].done()):
            return None
        (key, future), self._numbers = self._numbers, None
        return key, future.result()

    def flipped(self, wait: bool = False) -> tuple[Any, F32, float] | None:
        """(key, map, mean) once; None while there is nothing new. Raises what the work raised."""
        if self._flip is None or not (wait or self._flip[1].done()):
            return None
        (key, future), self._flip = self._flip, None
        return key, *future.result()

    def close(self) -> None:
        self._thread.shutdown(cancel_futures=True)
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None
