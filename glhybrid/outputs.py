"""Bytes of images as arrays, row 0 at the top: the readings (readback.py) of pictures, radiance and passes' images."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.readback import Reading

KINDS: dict[str, Any] = {"f1": np.uint8, "u1": np.uint8, "f2": np.float16, "f4": np.float32, "u4": np.uint32}


def rgba(image: Any) -> Reading[NDArray[np.uint8]]:
    """(H, W, 4) uint8 of an RGBA8 image, as it is."""
    data = yield image
    return np.array(_rows(data, image))


def rgb(image: Any) -> Reading[NDArray[np.uint8]]:
    """(H, W, 3) uint8 of an RGBA8 image."""
    data = yield image
    rows = _rows(data, image)
    picture = np.empty((*rows.shape[:2], 3), np.uint8)
    for channel in range(3):  # NumPy takes three to eight times as long for all at once
        picture[..., channel] = rows[..., channel]
    return picture


def texels(image: Any, first: int = 0, count: int = 0) -> Reading[NDArray[Any]]:
    """(H, W, count) of channels from `first` on, (H, W) for one; float32 where the image holds floats."""
    data = yield image
    rows = _rows(data, image)
    values = rows[..., first] if count == 1 else rows[..., first : first + count if count else None]
    return np.array(values, np.float32 if image.dtype in ("f2", "f4") else None, order="C")


def layers(image: Any) -> Reading[NDArray[np.float32]]:
    """(H, W, L) float32, 0 to 1, of an array texture: the mean of each layer's first three channels."""
    data = yield image
    values = _rows(data, image)[..., :3].astype(np.float32).mean(-1) / (255 if image.dtype == "f1" else 1)
    return np.array(np.moveaxis(values, 0, -1), np.float32, order="C")


def constant(array: NDArray[Any]) -> Reading[NDArray[Any]]:
    """An array, as it is, that need not be read."""
    return array
    yield


def _rows(data: Any, image: Any) -> NDArray[Any]:
    """(H, W, C), or (L, H, W, C) of an array texture, on the data itself."""
    shape = (image.height, image.width, image.components)
    rows = np.frombuffer(data, KINDS[image.dtype])
    if hasattr(image, "layers"):
        return rows.reshape(image.layers, *shape)[:, ::-1]
    return rows.reshape(shape)[::-1]
