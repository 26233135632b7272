"""Many noisy pictures in a third of the room: the three channels of a pixel share an exponent, 32 bits in all.

As OpenGL's RGB9_E5, but that exponents count down from that of the brightest of the pictures at each pixel: any range
fits. A channel is off by 1/512 of the pixel's largest at most, the mean of 16 equal ones by 0.03 % (root mean square):
far less than noise. What is 2^31 times darker than the same pixel of another picture is black.
"""

import numpy as np
from numpy.typing import NDArray

from glhybrid.scene import F32, U32

I16 = NDArray[np.int16]
BITS, MOST = 9, 511  # of a channel
LOWEST = 31  # exponents under the largest
BLACK = -100  # an exponent: what is under 2^-100 is none


def pack(pictures: F32) -> tuple[U32, I16]:
    """(M, H, W, 3) float32, none negative -> (M, H, W) words, and (H, W) the largest exponent at each pixel.

    Raises ValueError where something is negative or not finite. What was packed before comes out as it went in.
    """
    if not (pictures.min(initial=0) >= 0 and np.isfinite(pictures).all()):
        raise ValueError("radiance that is negative or not finite")
    exponents = np.stack([_exponent(picture) for picture in pictures])
    scale = exponents.max(0)
    words = np.empty(exponents.shape, np.uint32)
    for word, picture, exponent in zip(words, pictures, exponents, strict=True):
        down = np.minimum(scale - exponent, LOWEST)
        channels = np.rint(picture * _power(BITS - scale + down)[..., None]).astype(np.uint32)
        word[:] = channels[..., 0] | channels[..., 1] << 9 | channels[..., 2] << 18 | down.astype(np.uint32) << 27
    return words, scale


def unpack(words: U32, scale: I16) -> F32:
    """The pictures that pack() was given, (M, H, W, 3) float32."""
    pictures = np.empty((*words.shape, 3), np.float32)
    for picture, word in zip(pictures, words, strict=True):
        step = _power(scale - (word >> 27).astype(np.int16) - BITS)
        for channel in range(3):
            picture[..., channel] = (word >> BITS * channel & MOST) * step
    return pictures


def _exponent(picture: F32) -> I16:
    """(H, W) the least by which the largest channel, rounded to BITS, is under 1."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    largest = np.maximum(np.maximum(red, green), blue)  # .max(-1) takes ten times as long
    part, exponent = np.frexp(largest)
    over = np.rint(part * (MOST + 1)) > MOST
    return np.where(largest > 0, np.maximum(exponent + over, BLACK), BLACK).astype(np.int16)


def _power(exponent: I16) -> F32:
    return np.ldexp(np.float32(1), exponent)
