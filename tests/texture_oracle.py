"""glTF's texture lookup in float64: filtered after decoding, (0, 0) the top left corner."""

from typing import Any

import numpy as np

from glhybrid.scene import F64, Texture


def linear(texels: Any, srgb: bool) -> F64:
    """(H, W, 4) uint8 as light, float64."""
    c = texels / 255.0
    if srgb:
        rgb = c[..., :3]
        c = np.concatenate([np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4), c[..., 3:]], -1)
    return np.asarray(c, np.float64)


def wrapped(i: Any, n: int, mode: str) -> Any:
    """Texel index by glTF's wrap modes."""
    if mode == "clamp":
        return np.clip(i, 0, n - 1)
    if mode == "repeat":
        return i % n
    i = i % (2 * n)
    return np.where(i < n, i, 2 * n - 1 - i)


def sampled(texture: Texture, light: F64, uv: F64) -> F64:
    """(R, 4): one level of a texture at (R, 2) coordinates that are already transformed."""
    height, width = light.shape[:2]
    p = uv * (width, height) - (0.0 if texture.nearest else 0.5)
    i = np.floor(p).astype(np.int64)
    f = np.zeros_like(p) if texture.nearest else p - i
    total = np.zeros((len(uv), 4))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (f[:, 0] if dx else 1 - f[:, 0]) * (f[:, 1] if dy else 1 - f[:, 1])
            x = wrapped(i[:, 0] + dx, width, texture.wrap_u)
            y = wrapped(i[:, 1] + dy, height, texture.wrap_v)
            total += weight[:, None] * light[y, x]
    return total


def transformed(texture: Texture, uv: F64) -> F64:
    if texture.uv_transform is None:
        return uv
    return np.asarray(uv @ texture.uv_transform[:, :2].T + texture.uv_transform[:, 2])
