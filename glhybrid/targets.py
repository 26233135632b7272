"""Images of a frame, by the channels of layout.py: only those asked for, freed together."""

from typing import Any

import moderngl
import numpy as np

from glhybrid.context import Context
from glhybrid.errors import SettingError
from glhybrid.layout import CHANNELS


class Targets:
    """Images of one size. `layers` makes an array texture."""

    def __init__(self, context: Context, size: tuple[int, int]) -> None:
        limit = context.limits.texture_size
        if max(size) > limit or min(size) < 1:
            raise SettingError(f"size {size[0]}x{size[1]}: this device draws from 1x1 to {limit}x{limit} pixels")
        self._context = context
        self.size = size
        self._images: dict[str, Any] = {}
        self._other: list[Any] = []

    def get(self, name: str, layers: int = 0, size: tuple[int, int] | None = None) -> Any:
        """The image of a channel, allocated at first use. size: another than that of all."""
        if name not in self._images:
            channel = CHANNELS[name]
            gl = self._context.gl
            if layers > (most := self._context.limits.texture_layers):
                raise SettingError(f"{name}: {layers} layers, one a light; this device's images have at most {most}")
            if layers:
                image: Any = gl.texture_array((*self.size, layers), channel.components, dtype=channel.dtype)
            else:
                image = gl.texture(size or self.size, channel.components, dtype=channel.dtype)
            if errors := self._context.raw.errors():
                image.release()
                width, height = size or self.size
                raise SettingError(
                    f"{name}: no memory for {width}x{height} pixels" + (f" by {layers} lights" if layers else "")
                    + f" ({', '.join(errors)}): ask for a smaller --size" + (" or use fewer lights" if layers else "")
                )  # fmt: skip
            image.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._images[name] = image
        return self._images[name]

    def framebuffer(self, name: str) -> moderngl.Framebuffer:
        """The image of a channel as a raster target, with a 32-bit float depth buffer of its own."""
        key = f"{name}.framebuffer"
        if key not in self._images:
            depth = self._context.raw.depth32f(self._context.gl, self.size)
            self._other.append(depth)
            self._images[key] = self._context.gl.framebuffer([self.get(name)], depth)
        framebuffer: moderngl.Framebuffer = self._images[key]
        return framebuffer

    @property
    def names(self) -> tuple[str, ...]:
        """Channels that have an image."""
        return tuple(name for name in self._images if name in CHANNELS)

    def read(self, name: str) -> np.ndarray:
        """A channel's image as (H, W, C) or, of layers, (H, W, C * L); row 0 at the top."""
        image, channel = self._images[name], CHANNELS[name]
        kind = {"f1": np.uint8, "f2": np.float16, "f4": np.float32, "u4": np.uint32, "u1": np.uint8}[channel.dtype]
        layers = getattr(image, "layers", 1)
        texels = np.frombuffer(image.read(alignment=1), kind).reshape(layers, image.height, image.width, -1)[:, ::-1]
        texels = np.moveaxis(texels, 0, 2).reshape(image.height, image.width, -1)
        return texels / np.float32(255) if channel.dtype == "f1" else texels

    @property
    def bytes(self) -> int:
        """Of all images, depth included."""
        total = 4 * self.size[0] * self.size[1] * len(self._other)
        for name, image in self._images.items():
            if name in CHANNELS:
                total += CHANNELS[name].bytes_per_pixel * image.width * image.height * getattr(image, "layers", 1)
        return total

    def release(self) -> None:
        if self._other:
            # moderngl binds the last used framebuffer again when it makes the next one: that must not be one of ours.
            self._context.gl.detect_framebuffer(0).use()
        for image in [*reversed(self._images.values()), *self._other]:
            image.release()
        self._images.clear()
        self._other.clear()
