"""Exposure, tone map and sRGB encoding: linear radiance -> what a screen shows."""

from typing import Any

import numpy as np

from glhybrid.context import Context
from glhybrid.frame_constants import FrameConstants
from glhybrid.needs import Features
from glhybrid.readback import Reading, at_once
from glhybrid.shaders import Program, Shaders
from glhybrid.targets import Targets


class Display:
    name = "display"

    def __init__(self, context: Context, shaders: Shaders, constants: FrameConstants) -> None:
        self._program = shaders.compute("display", Features())
        self._exposure = context.gl.buffer(reserve=16)
        self._shaders, self._constants = shaders, constants
        self._measure: Program | None = None  # compiled where exposure = auto asks for it
        self._given: float | None = None  # EV in the buffer, if it was not measured

    def run(self, targets: Targets, radiance: Any) -> Any:
        display, given = targets.get("display"), self._constants.exposure_ev
        resources = {
            "Frame": self._constants.buffer, "Exposure": self._exposure, "radiance": radiance, "out_display": display,
        }  # fmt: skip
        if given is None:
            self._measure = self._measure or self._shaders.compute("exposure", Features())
            self._measure.dispatch(resources, (1, 1))
        elif given != self._given:
            self._exposure.write(np.float32(given).tobytes())
        self._given = given
        self._program.dispatch(resources, targets.size)
        return display

    def exposure_ev(self) -> float:
        """EV that the last frame was shown at. Waits for it."""
        return at_once(self.exposure())

    def exposure(self) -> Reading[float]:
        """The same as a reading."""
        data = yield self._exposure
        return float(np.frombuffer(data, np.float32)[0])

    def release(self) -> None:
        self._exposure.release()
