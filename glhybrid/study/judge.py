"""FLIP of a study's pictures, on the device that drew them: all of one scene are held against the same two pictures."""

import hashlib
from typing import Any

import numpy as np

from glhybrid.flip import Flip, Reference
from glhybrid.image import Frame
from glhybrid.scene import F32
from glhybrid.study import picture
from glhybrid.study.measure import ErrorMaps, Truth


class Judge:
    """Holds pictures against the truth; release() frees its images."""

    def __init__(self, flip: Flip, truth: Truth) -> None:
        self._flip, self._truth = flip, truth
        self._whole = flip.reference(truth.radiance)
        self._direct: Reference | None = None
        self._lit: Any = None  # (H, W): where light would arrive if nothing were in its way
        self._shadows: dict[bytes, float | None] = {}  # by visibility: techniques of other kinds leave shadows alone

    def maps(self, frame: Frame, at_rest: F32 | None = None) -> ErrorMaps:
        """Of a frame with its visibility, and of the radiance of a later one."""
        later = None if at_rest is None else self._flip.map(at_rest, self._whole)
        return ErrorMaps(self._flip.map(frame["radiance"], self._whole), later, self._shadow(frame["visibility"]))

    def _shadow(self, visibility: F32) -> float | None:
        light = self._truth.light
        if light is None:
            return None
        if self._direct is None:
            self._direct, self._lit = self._flip.reference(light.truth()), light.counted.any(-1)
        key = hashlib.blake2b(np.ascontiguousarray(visibility).data, digest_size=16).digest()
        if key not in self._shadows:
            error = self._flip.map(light.direct(visibility), self._direct)
            self._shadows[key] = picture.weighted_mean(error, self._lit)
        return self._shadows[key]

    def release(self) -> None:
        """Twice is harmless."""
        for reference in (self._whole, *([self._direct] if self._direct is not None else [])):
            reference.release()
