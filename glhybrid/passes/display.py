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
    """Owns the exposure. A pass that makes radiance may encode it too, if the exposure is given: lib/tone.glsl."""

    name = "display"

    def __init__(self, context: Context, shaders: Shaders, constants: FrameConstants) -> None:
        self._program = shaders.compute("display", Features())
        self._exposure, self._write = context.gl.buffer(reserve=16), context.write
        self._shaders, self._constants, self._bindings = shaders, constants, context.bindings
        self._measure: Program | None = None  # compiled where exposure = auto asks for it
        self._given: float | None = None  # EV in the buffer, if it was not measured
        self._shown: tuple[Any, Any] = (None, None)  # radiance that was encoded when it was made, and how

    @property
    def given(self) -> bool:
        """Whether the exposure does not wait for the picture."""
        return self._constants.exposure_ev is not None

    @property
    def _how(self) -> tuple[float | None, int]:
        return self._constants.exposure_ev, int(self._constants.rows["tone_map"][0])

    def resources(self, targets: Targets) -> dict[str, Any]:
        """What encoding needs, under a given exposure."""
        given = self._constants.exposure_ev
        if given is not None and given != self._given:
            self._write(self._exposure, np.float32(given).tobytes())
        self._given = given
        return {"Frame": self._constants.buffer, "Exposure": self._exposure, "out_display": targets.get("display")}

    def encoded(self, radiance: Any) -> None:
        """A frame encoded this image as it made it, with the resources above."""
        self._shown = radiance, self._how

    def image(self, targets: Targets, radiance: Any) -> Any:
        """What to show of the radiance that a frame made."""
        return targets.get("display") if self._shown == (radiance, self._how) else self.run(targets, radiance)

    def run(self, targets: Targets, radiance: Any) -> Any:
        """Encodes, whatever is encoded already, and returns the image to show."""
        self._shown = None, None
        resources = self.resources(targets) | {"radiance": radiance}
        if not self.given:
            self._measure = self._measure or self._shaders.compute("exposure", Features())
        with self._bindings.keep():
            if self._measure is not None and not self.given:
                self._measure.dispatch(resources, (1, 1))
            self._program.dispatch(resources, targets.size)
        return resources["out_display"]

    def exposure_ev(self) -> float:
        """EV that the last frame was shown at. Waits for it."""
        return at_once(self.exposure())

    def exposure(self) -> Reading[float]:
        """The same as a reading."""
        data = yield self._exposure
        return float(np.frombuffer(data, np.float32)[0])

    def release(self) -> None:
        self._exposure.release()
