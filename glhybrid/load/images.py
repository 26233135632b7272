"""Image files to texels, through Pillow. Colour profiles and orientation tags are ignored, as glTF asks."""

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.errors import LoadError
from glhybrid.scene import U8, Image

MAX_SIDE = 16384  # the texture size every OpenGL 4.3 desktop driver offers (GL_MAX_TEXTURE_SIZE)
# Named one by one: Pillow's others include formats that run helper programs (EPS) or have no business in a scene.
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "GIF", "TIFF", "AVIF")


def load_image(source: Path | bytes | memoryview, name: str, warn: Callable[[str], None] | None = None) -> Image:
    """Texels of an image file or of its bytes.

    name: what messages call it, and Image.name. warn: told what was lost (16 bits a channel reduced to 8).
    Returns Image with texels (H, W, 4) uint8, row 0 at the top, alpha 255 where the file has none.
    Raises LoadError where the file is absent, is no image, is cut short, has no texels or too many.
    Safe to call from several threads; Pillow decodes without holding the interpreter lock.
    """
    from PIL import Image as Pillow

    # Pillow's word about 90 million texels is not for who named the file; sides are bounded here.
    warnings.filterwarnings("ignore", category=Pillow.DecompressionBombWarning)
    if isinstance(source, Path) and not source.is_file():
        raise LoadError(f"{name}: there is no file {source}; put it there or correct the name")
    formats = [f for f in FORMATS if f != "AVIF" or "AVIF" in Pillow.OPEN]
    try:
        with Pillow.open(source if isinstance(source, Path) else io.BytesIO(source), formats=formats) as image:
            width, height = image.size
            if min(width, height) == 0 or max(width, height) > MAX_SIDE:
                raise LoadError(f"{name}: {width} x {height} texels; both sides must be 1 to {MAX_SIDE}: resize it")
            if _bits(image) > 8 and warn:
                warn("16 bits a channel are reduced to 8")
            return Image(_rgba(image), name)
    except LoadError:
        raise
    except Pillow.DecompressionBombError:
        most = 2 * (Pillow.MAX_IMAGE_PIXELS or 0)
        raise LoadError(f"{name}: more than {most:,} texels, which is the limit of an image: resize it") from None
    except Exception as error:  # Pillow's plugins raise whatever a broken file makes them stumble over
        reason = str(error) or type(error).__name__
        if "cannot identify" in reason:
            reason = f"not one of the formats read here ({', '.join(FORMATS)})"
        raise LoadError(f"{name}: cannot be decoded: {reason}; save it again as PNG or JPEG") from None


def _bits(image: Any) -> int:
    """Bits a channel in the file. Pillow opens 16-bit RGB as 8-bit and says so only in the decoder's raw mode."""
    if image.mode[0] in "IF":
        return 16
    tile = getattr(image, "tile", None)
    return 16 if tile and ";16" in str(tile[0][3]) else 8


def _rgba(image: Any) -> U8:
    if image.mode[0] in "IF":  # I;16 and its byte orders, I, F: grey; Pillow's own conversion would clip, not scale
        grey = np.asarray(image, np.float64)
        scale = 255.0 if image.mode == "F" else 255.0 / 65535.0
        level = np.clip(np.rint(grey * scale), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(np.dstack([level, level, level, np.full_like(level, 255)]))
    if image.mode in ("CMYK", "YCbCr", "LAB", "HSV"):
        image = image.convert("RGB")
    return np.asarray(image if image.mode == "RGBA" else image.convert("RGBA"))
