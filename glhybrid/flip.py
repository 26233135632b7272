"""FLIP on the device: how different two pictures look to an eye that sees them one after the other in the same place.

LDR-FLIP is of what a screen is given (Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images");
HDR-FLIP of linear light: the largest LDR-FLIP over the exposures at which the reference shows anything (2021,
"Visualizing Errors in Rendered High Dynamic Range Images"). Exposures, tone map, borders and the eye's distance of 67
pixels a degree are as in the authors' flip-evaluator 1.7, which tests hold it against.

Both pictures go through the same two dispatches for each exposure. What comes of the reference is kept, where that is
not too much, and serves all pictures that are held against it.
"""

import math
from typing import Any

import moderngl
import numpy as np

from glhybrid.context import Context
from glhybrid.errors import SettingError
from glhybrid.needs import Features
from glhybrid.scene import F32
from glhybrid.shaders import Shaders

BLOCK = 8  # pixels that one invocation works on: as in lib/flip.glsl
KEPT_BYTES = 1 << 28  # of what comes of a reference, over all exposures
BYTES_A_PIXEL = 20  # of that, at one exposure
MOST = 1e4  # times the mean luminance: what is looked at at most, so that an infinite highlight does not set exposures
CURVE = (0.9036, 0.018, 0.8748, 0.354, 0.14)  # of the tone map, as in passes/flip_across.comp
WHITE = 0.85  # what it makes of the brightest pixel at the first exposure, and of the median at the last
DARKEST = float(np.finfo(np.float32).eps)  # that the median is taken for at least
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


class Reference:
    """A picture that others are held against: release() frees its images.

    exposures: factors of its light times `scale`; (0,) for a picture in sRGB; none if it is black.
    """

    def __init__(
        self, size: tuple[int, int], picture: Any, exposures: tuple[float, ...], scale: float = 1.0, most: float = 1.0
    ) -> None:
        """picture: a texture, which becomes its own."""
        self.size, self.picture, self.exposures, self.scale, self.most = size, picture, exposures, scale, most
        self.kept: list[tuple[Any, Any]] = []  # by exposure: colours and edges, points

    def release(self) -> None:
        """Twice is harmless."""
        for image in (*([self.picture] if self.picture is not None else []), *sum(self.kept, ())):
            image.release()
        self.picture, self.kept = None, []


class Flip:
    """Compares pictures. Owns images of the size that was compared last; programs are compiled at first use."""

    def __init__(self, context: Context, shaders: Shaders) -> None:
        self._context, self._shaders = context, shaders
        self._size = (0, 0)
        self._images: dict[str, Any] = {}

    def prepare(self) -> None:
        """Compiles what is not yet."""
        for stem in ("flip_across", "flip_down"):
            self._shaders.compute(stem, Features())

    def reference(self, want: F32) -> Reference:
        """(H, W, 3) linear light, to be released. What is not finite counts as black or as MOST."""
        size = _size(want)
        self._context.make_current()
        mean = float((np.nan_to_num(want, posinf=0, neginf=0) @ LUMINANCE).mean(dtype=np.float64))
        if not mean > 0:
            return Reference(size, None, ())
        scaled = np.clip(np.nan_to_num(want / np.float32(mean)), 0, np.float32(MOST))
        picture = self._image(size, 3, np.ascontiguousarray(want, np.float32))
        return Reference(size, picture, exposures(scaled @ LUMINANCE), 1 / mean, MOST)

    def hdr(self, got: F32, want: F32) -> F32:
        """HDR-FLIP of every pixel, (H, W), 0 to 1, of pictures (H, W, 3) of linear light; `want` is the reference."""
        reference = self.reference(want)
        try:
            return self.map(got, reference)
        finally:
            reference.release()

    def map(self, got: F32, reference: Reference) -> F32:
        """HDR-FLIP of every pixel, (H, W), 0 to 1; got: (H, W, 3) linear light.

        A black reference gives no exposure: what is not black is then fully wrong. Raises SettingError for pictures
        of another size.
        """
        if (size := _size(got)) != reference.size:
            sizes = [f"{width}x{height}" for width, height in (size, reference.size)]
            raise SettingError(
                f"FLIP: a picture of {sizes[0]} and a reference of {sizes[1]} pixels: give two of one size"
            )
        if not reference.exposures:
            return (got.max(-1) > 0).astype(np.float32)
        self._context.make_current()
        self._work_at(size)
        if "picture" not in self._images:
            self._images["picture"] = self._image(self._size, 3)
        self._images["picture"].write(np.ascontiguousarray(got, np.float32))
        error = self.compare(self._images["picture"], reference)
        return np.frombuffer(error.read(), np.float32).reshape(got.shape[:2])

    def ldr(self, picture: Any, want: Any) -> Any:
        """LDR-FLIP of two textures in sRGB, 0 to 1: the map as a texture, gone with the next."""
        self._context.make_current()
        self._work_at(picture.size)
        reference = Reference(picture.size, want, (0.0,))
        return self._compare(picture, reference, keeps=False)

    def compare(self, picture: Any, reference: Reference) -> Any:
        """The map as a texture, gone with the next; picture: a texture of the reference's size, which is not black."""
        self._context.make_current()
        self._work_at(picture.size)
        room = picture.width * picture.height * BYTES_A_PIXEL * len(reference.exposures)
        return self._compare(picture, reference, keeps=room <= KEPT_BYTES)

    def _compare(self, picture: Any, reference: Reference, keeps: bool) -> Any:
        for i, exposure in enumerate(reference.exposures):
            there = keeps and i < len(reference.kept)
            kept = reference.kept[i] if there else self._new_pair() if keeps else self._pair()
            if not there:
                self._see(reference.picture, exposure, reference, kept, 0, 0)
            if keeps and not there:
                reference.kept.append(kept)
            self._see(picture, exposure, reference, kept, 1, int(i > 0))
        return self._images["error"]

    def _see(
        self, picture: Any, exposure: float, reference: Reference, kept: tuple[Any, Any], compares: int, goes_on: int
    ) -> None:
        width, height = self._size
        across, down = (self._shaders.compute(stem, Features()) for stem in ("flip_across", "flip_down"))
        colour, edges, error = (self._images[name] for name in ("colour", "edges", "error"))
        across.dispatch(
            {"picture": picture, "scale": reference.scale, "most": reference.most, "exposure": exposure,
             "out_colour": colour, "out_edges": edges},
            (-(-width // BLOCK), height),
        )  # fmt: skip
        down.dispatch(
            {"colour": colour, "edges": edges, "kept": kept[0], "kept_points": kept[1], "error": error,
             "compares": compares, "goes_on": goes_on},
            (width, -(-height // BLOCK)),
        )  # fmt: skip

    def _work_at(self, size: tuple[int, int]) -> None:
        if size == self._size:
            return
        self.release()
        self._images = {"colour": self._image(size, 4), "edges": self._image(size, 4), "error": self._image(size, 1)}
        self._size = size

    def _pair(self) -> tuple[Any, Any]:
        """One for all exposures."""
        if "kept" not in self._images:
            self._images["kept"], self._images["kept_points"] = self._new_pair()
        return self._images["kept"], self._images["kept_points"]

    def _new_pair(self) -> tuple[Any, Any]:
        return self._image(self._size, 4), self._image(self._size, 1)

    def _image(self, size: tuple[int, int], components: int, data: Any = None) -> Any:
        image = self._context.gl.texture(size, components, data, dtype="f4", alignment=4)
        if errors := self._context.raw.errors():
            image.release()
            raise SettingError(
                f"FLIP of {size[0]}x{size[1]} pixels: no memory ({', '.join(errors)}): ask for a smaller --size"
            )
        image.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return image

    def release(self) -> None:
        """Frees its images. Twice is harmless."""
        for image in self._images.values():
            image.release()
        self._images, self._size = {}, (0, 0)


def _size(picture: F32) -> tuple[int, int]:
    if picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise SettingError(f"FLIP: an array of shape {picture.shape}: pictures are (H, W, 3)")
    return picture.shape[1], picture.shape[0]


def exposures(luminance: F32) -> tuple[float, ...]:
    """Factors from what shows the brightest pixel as WHITE to what shows the median so, a stop or less apart.

    luminance: of a reference, any shape, not all 0.
    """
    a, b, c = CURVE[0] - WHITE * CURVE[2], CURVE[1] - WHITE * CURVE[3], -WHITE * CURVE[4]
    white = (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)
    middle = luminance.size // 2
    median = max(float(np.partition(luminance, middle, axis=None)[middle]), DARKEST)
    start, stop = math.log2(white / float(luminance.max())), math.log2(white / median)
    return tuple(np.exp2(np.linspace(start, stop, max(2, math.ceil(stop - start)))).tolist())
