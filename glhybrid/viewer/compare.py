"""How far a displayed picture is from another: numbers and maps, by the device that drew them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.context import Context
from glhybrid.flip import Flip
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.viewer import views
from glhybrid.viewer.picture import Picture

FLIP_UNIT = "equal ... as unlike as can be"


@dataclass(frozen=True)
class Error:
    """flip: mean FLIP of the displayed images, 0 to 1, None where it was not asked for.

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

    def __init__(self, context: Context, shaders: Shaders, flip: Flip, palette: Any) -> None:
        self._context, self._shaders, self._flip, self._palette = context, shaders, flip, palette
        self._sums: Any = None
        self._maps: dict[str, Any] = {}

    def prepare(self) -> None:
        """Compiles what is not yet."""
        for stem in ("errors", "difference", "heat"):
            self._shaders.compute(stem, Features())
        self._flip.prepare()

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
        image = self._image(name, ours.size)
        self._shaders.compute("difference", Features()).dispatch(
            {"ours": ours.display, "theirs": theirs.display, "out_difference": image, "palette": self._palette,
             "gain": gain},
            ours.size,
        )  # fmt: skip
        return image, views.Scale(0.0, 255.0 / gain, "levels of 255", "magma")

    def flip(self, name: str, ours: Picture, theirs: Picture) -> tuple[Any, float]:
        """(texture, mean) of FLIP; it is drawn over at the next call of this name."""
        error = self._flip.ldr(ours.display, theirs.display)
        image = self._image(name, ours.size)
        self._shaders.compute("heat", Features()).dispatch(
            {"values": error, "out_heat": image, "palette": self._palette}, ours.size
        )
        return image, float(np.frombuffer(error.read(), np.float32).mean(dtype=np.float64))

    def _image(self, name: str, size: tuple[int, int]) -> Any:
        image = self._maps.get(name)
        if image is None or image.size != size:
            if image is not None:
                image.release()
            image = self._maps[name] = self._context.gl.texture(size, 4)
            image.repeat_x = image.repeat_y = False
        return image

    def release(self) -> None:
        self._flip.release()
        for image in (*self._maps.values(), *([self._sums] if self._sums is not None else [])):
            image.release()
        self._maps.clear()
        self._sums = None
