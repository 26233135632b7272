"""All images of a scene in the pages of one array texture: texels as in the files, every mip level a rectangle.

Data only; glsl/lib/texture.glsl does wrapping and filtering. Any number, size and sampler, one texture unit.
"""

from dataclasses import dataclass

import numpy as np

from glhybrid import layout
from glhybrid.errors import LoadError
from glhybrid.scene import SRGB_SLOTS, U8, U16, Image, Material, Texture

LARGEST_PAGE = 16384  # texels across: what OpenGL 4.3 drivers offer

_DECODE = np.array(
    [(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4) * 65535 + 0.5 for c in np.arange(256) / 255],
    np.uint16,
)
_WRAP = {"repeat": "WRAP_REPEAT", "clamp": "WRAP_CLAMP", "mirror": "WRAP_MIRROR"}


@dataclass(frozen=True, eq=False)
class TexturePages:
    """pages (P, S, S, 4) uint8; levels (L, 4) uint32: x, y, width | height << 16, page; textures: rows of Texture.

    row_of: the row of a (texture, is sRGB) pair.
    """

    pages: U8
    levels: np.ndarray
    textures: np.ndarray
    row_of: dict[tuple[int, bool], int]


def pack(materials: tuple[Material, ...]) -> TexturePages:
    """Every texture of the materials, each image and encoding once. Raises LoadError for an image wider than a page."""
    wanted: dict[tuple[int, bool], Texture] = {}
    mipped: dict[tuple[int, bool], bool] = {}
    for material in materials:
        for slot, texture in material.textures.items():
            srgb = slot in SRGB_SLOTS
            wanted.setdefault((id(texture), srgb), texture)
            key = (id(texture.image), srgb)
            mipped[key] = mipped.get(key, False) or texture.mipmap
    images = {(id(t.image), srgb): t.image for (_, srgb), t in wanted.items()}
    chains = {key: _mip_chain(image, key[1], mipped[key]) for key, image in images.items()}
    rectangles = [(key, level) for key, chain in chains.items() for level in range(len(chain))]
    size, places = _shelves([chains[key][level].shape[:2] for key, level in rectangles])
    pages = np.zeros((max((p[2] for p in places), default=0) + 1, size, size, 4), np.uint8)
    levels = np.zeros((max(len(rectangles), 1), 4), np.uint32)
    first: dict[tuple[int, bool], int] = {}
    for row, ((key, level), (x, y, page)) in enumerate(zip(rectangles, places, strict=True)):
        texels = chains[key][level]
        height, width = texels.shape[:2]
        pages[page, y : y + height, x : x + width] = texels
        levels[row] = x, y, width | height << 16, page
        first.setdefault(key, row)
    table = np.zeros(max(len(wanted), 1), layout.dtype("Texture"))
    row_of = {}
    for row, ((identity, srgb), texture) in enumerate(wanted.items()):
        key = (id(texture.image), srgb)
        height, width = texture.image.texels.shape[:2]
        matrix = texture.uv_transform if texture.uv_transform is not None else np.eye(2, 3)
        scale = abs(np.linalg.det(matrix[:, :2]))
        flags = layout.CONSTANTS[_WRAP[texture.wrap_u]] | layout.CONSTANTS[_WRAP[texture.wrap_v]] << 2
        table[row]["first_level"] = first[key]
        table[row]["level_count"] = len(chains[key]) if texture.mipmap else 1
        table[row]["sampling"] = flags | texture.nearest << 4 | texture.uv_set << 5
        table[row]["log2_texels"] = np.log2(max(width * height * scale, 1e-30))
        table[row]["u_row"], table[row]["v_row"] = matrix
        row_of[identity, srgb] = row
    return TexturePages(pages, levels, table, row_of)


def _mip_chain(image: Image, srgb: bool, mipped: bool) -> list[U8]:
    """Levels by a 2x2 box, averaged as light (sRGB is decoded first). An odd last row or column is left out."""
    texels = image.texels
    if max(texels.shape[:2]) > LARGEST_PAGE:
        raise LoadError(
            f'image "{image.name}" is {texels.shape[1]}x{texels.shape[0]}, '
            f"the limit is {LARGEST_PAGE} texels across: scale it down"
        )
    chain = [texels]
    if not mipped:
        return chain
    linear: U16 = texels.astype(np.uint16) * np.uint16(257)
    if srgb:
        linear[..., :3] = _DECODE[texels[..., :3]]
    while max(linear.shape[:2]) > 1:
        linear = _halve(_halve(linear, 0), 1)
        level = np.empty(linear.shape, np.uint8)
        level[...] = (linear.astype(np.uint32) * 255 + 32767) // 65535
        if srgb:
            level[..., :3] = np.searchsorted(_DECODE_MIDDLE, linear[..., :3], side="right")
        chain.append(level)
    return chain


_DECODE_MIDDLE = ((_DECODE[1:].astype(np.uint32) + _DECODE[:-1]) // 2 + 1).astype(np.uint16)


def _halve(texels: U16, axis: int) -> U16:
    count = texels.shape[axis]
    if count == 1:
        return texels
    even = texels.take(range(0, count - 1, 2), axis).astype(np.uint32)
    odd = texels.take(range(1, count, 2), axis)
    return ((even + odd + 1) // 2).astype(np.uint16)


def _shelves(sizes: list[tuple[int, ...]]) -> tuple[int, list[tuple[int, int, int]]]:
    """Packs (height, width) rectangles on shelves, tallest first; returns page size and (x, y, page) by rectangle."""
    if not sizes:
        return 1, []
    largest = max(max(s) for s in sizes)
    area = sum(h * w for h, w in sizes)
    size = 1 << max(int(largest - 1).bit_length(), 0)
    while size < LARGEST_PAGE and size * size < min(area * 1.15, 4096 * 4096):
        size *= 2
    places: list[tuple[int, int, int]] = [(0, 0, 0)] * len(sizes)
    x = y = page = shelf = 0
    for i in sorted(range(len(sizes)), key=lambda i: (-sizes[i][0], -sizes[i][1])):
        height, width = sizes[i]
        if x + width > size:
            x, y, shelf = 0, y + shelf, 0
        if y + height > size:
            x, y, shelf, page = 0, 0, 0, page + 1
        places[i] = (x, y, page)
        x += width
        shelf = max(shelf, height)
    return size, places
