"""Exposure, tone map and sRGB encoding: linear radiance -> what a screen shows."""

from typing import Any

import moderngl
import numpy as np

from glhybrid.context import Context
from glhybrid.needs import Features
from glhybrid.readback import Reading, at_once
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class Display:
    name = "display"

    def __init__(self, context: Context, shaders: Shaders, frame: moderngl.Buffer) -> None:
        self._exposure_program = shaders.compute("exposure", Features())
        self._program = shaders.compute("display", Features())
        self._exposure = context.gl.buffer(reserve=16)
        self._frame = frame

    def run(self, targets: Targets, radiance: Any) -> Any:
        display = targets.get("display")
        resources = {"Frame": self._frame, "Exposure": self._exposure, "radiance": radiance, "out_display": display}
        self._exposure_program.dispatch(resources, (1, 1))
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
