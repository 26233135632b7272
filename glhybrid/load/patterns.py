"""Procedural textures by name: a field between 0 and 1 that repeats without a seam, coloured from `low` to `high`.

In a colour slot low and high are linear colours with alpha, encoded to sRGB; in a data slot they are the channels as
they are (metallic_roughness: [-, roughness, metallic, -]); in a normal slot the field is a height of `relief` texels.
"""

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from glhybrid.errors import unknown
from glhybrid.load.require import ShapeError, counts
from glhybrid.scene import F64, SRGB_SLOTS, Image

COMMON: dict[str, Any] = {
    "low": (0.0, 0.0, 0.0, 1.0),
    "high": (1.0, 1.0, 1.0, 1.0),
    "relief": 8.0,
    "texels": (512, 512),
    "seed": 1,
}


def checker(u: F64, v: F64, random: np.random.Generator, *, cells: Sequence[int] = (8, 8)) -> F64:
    """Squares, alternately 0 and 1; an even number of cells repeats."""
    return (np.floor(u * cells[0]) + np.floor(v * cells[1])) % 2


def tiles(
    u: F64,
    v: F64,
    random: np.random.Generator,
    *,
    cells: Sequence[int] = (4, 4),
    joint: float = 0.02,
    vary: float = 0.5,
    shift: float = 0.0,
) -> F64:
    """Tiles of different values up to 1, apart by joints of 0. joint: width in tiles; shift: of every other row."""
    y = v * cells[1]
    x = u * cells[0] + shift * (np.floor(y) % 2)
    shade = 1 - vary * random.random((cells[1], cells[0]))
    value = shade[np.floor(y).astype(int) % cells[1], np.floor(x).astype(int) % cells[0]]
    edge = np.minimum(np.minimum(x % 1, 1 - x % 1), np.minimum(y % 1, 1 - y % 1))
    return value * _smooth(joint / 2, joint / 2 * 1.6 + 1e-9, edge)


def noise(u: F64, v: F64, random: np.random.Generator, *, cells: Sequence[int] = (8, 8), octaves: int = 5) -> F64:
    """Smooth noise, 0 to 1."""
    return _noise(u, v, cells, octaves, random)


def marble(
    u: F64,
    v: F64,
    random: np.random.Generator,
    *,
    cells: Sequence[int] = (3, 3),
    veins: float = 3.0,
    sharpness: float = 6.0,
) -> F64:
    """Clouded stone, near 1, with dark veins of 0."""
    bent = _noise(u, v, cells, 6, random) - 0.5
    second = _noise(u, v, cells, 6, random) - 0.5
    crack = np.minimum(np.abs(np.sin(np.pi * veins * (bent + second * 0.4))) + 0.15, 1)
    fine = np.minimum(np.abs(np.sin(np.pi * veins * 2.3 * (second - bent * 0.3))) * 1.6 + 0.35, 1)
    cloud = 0.8 + 0.2 * _noise(u, v, (cells[0] * 2, cells[1] * 2), 4, random)
    return np.clip((1 - (1 - crack) ** sharpness) * (1 - 0.5 * (1 - fine) ** sharpness) * cloud, 0, 1)


def brushed(u: F64, v: F64, random: np.random.Generator, *, cells: Sequence[int] = (4, 256)) -> F64:
    """Fine streaks along u."""
    return _noise(u, v, cells, 2, random)


def wood(u: F64, v: F64, random: np.random.Generator, *, cells: Sequence[int] = (2, 6), rings: float = 9.0) -> F64:
    """Grain along u."""
    bend = _noise(u, v, cells, 3, random)
    grain = (bend * rings) % 1
    return 0.75 * np.sqrt(grain) * _smooth(1.0, 0.86, grain) + 0.25 * _noise(u, v, (8, 160), 2, random)


def lattice(
    u: F64,
    v: F64,
    random: np.random.Generator,
    *,
    cells: Sequence[int] = (8, 8),
    hole: float = 0.62,
    border: float = 0.0,
) -> F64:
    """Pierced cloth: 0 in eight-pointed star holes, 1 between them and in the border (share of the whole)."""
    x, y = np.abs((u * cells[0]) % 1 - 0.5), np.abs((v * cells[1]) % 1 - 0.5)
    star = np.minimum(np.maximum(x, y) * 1.18, (x + y) * 0.835)  # a square and the same square turned by 45 degrees
    edge = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    solid = _smooth(hole / 2 - 0.02, hole / 2 + 0.02, star)
    return np.maximum(solid, np.where(edge < border, 1.0, 0.0))


def weave(u: F64, v: F64, random: np.random.Generator, *, cells: Sequence[int] = (64, 64)) -> F64:
    """Threads over and under each other."""
    x, y = u * cells[0], v * cells[1]
    over = (np.floor(x) + np.floor(y)) % 2
    across, along = np.abs(np.sin(np.pi * x)), np.abs(np.sin(np.pi * y))
    return np.where(over > 0, across * (0.55 + 0.45 * along), along * (0.55 + 0.45 * across))


PATTERNS: dict[str, Callable[..., F64]] = {
    f.__name__: f for f in (checker, tiles, noise, marble, brushed, wood, lattice, weave)
}


def parameters(name: str) -> dict[str, Any]:
    """The parameters of a pattern with their defaults."""
    own = inspect.signature(PATTERNS[name]).parameters.values()
    return COMMON | {p.name: p.default for p in own if p.kind is p.KEYWORD_ONLY}


def pattern(name: str, slot: str = "base_color", **given: Any) -> Image:
    """The texels of a pattern for a texture slot. Raises ShapeError where a name is unknown or a value out of range."""
    if name not in PATTERNS:
        raise ShapeError("pattern", name, unknown("pattern", name, PATTERNS))
    common = {key: given.pop(key, default) for key, default in COMMON.items()}
    counts(4096, texels=common["texels"])
    width, height = common["texels"]
    cells = given.get("cells", parameters(name)["cells"])
    counts(2048, cells=cells)
    if 2 * cells[0] > width or 2 * cells[1] > height:
        raise ShapeError("cells", cells, f"must not be more than half the texels ({width} x {height}): add texels")
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    value = PATTERNS[name](u, v, np.random.default_rng(common["seed"]), **given)
    texels = np.full((height, width, 4), 255, np.uint8)
    if slot.endswith("normal"):
        slope_u = (np.roll(value, -1, 1) - np.roll(value, 1, 1)) / 2 * common["relief"]
        slope_v = (np.roll(value, -1, 0) - np.roll(value, 1, 0)) / 2 * common["relief"]
        normal = np.stack([-slope_u, slope_v, np.ones_like(value)], axis=-1)  # green is up, v is down
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        texels[..., :3] = np.rint(normal * 127.5 + 127.5)
        return Image(texels, name)
    # The field in 256 levels: colours are computed once for each, not for each texel.
    low, high = np.array(common["low"]), np.array(common["high"])
    if not (((low >= 0) & (low <= 1)).all() and ((high >= 0) & (high <= 1)).all()):
        raise ShapeError("low, high", (common["low"], common["high"]), "must be between 0 and 1")
    ramp = low + (high - low) * (np.arange(256) / 255)[:, None]
    if slot in SRGB_SLOTS:
        ramp[:, :3] = np.where(ramp[:, :3] <= 0.0031308, ramp[:, :3] * 12.92, 1.055 * ramp[:, :3] ** (1 / 2.4) - 0.055)
    return Image(np.rint(ramp * 255).astype(np.uint8)[np.rint(np.clip(value, 0, 1) * 255).astype(np.uint8)], name)


def _noise(u: F64, v: F64, cells: Sequence[int], octaves: int, random: np.random.Generator) -> F64:
    """Octaves of cubic-blended value noise that repeat in u and v; a grid in u and v, so it is separable by octave."""
    total, weight = np.zeros_like(u), 0.0
    for octave in range(octaves):
        nx, ny = cells[0] << octave, cells[1] << octave
        if nx > u.shape[1] or ny > u.shape[0]:
            break  # finer than the texels
        lattice = random.random((ny, nx))
        total += 0.5**octave * (_blend(v[:, 0], ny) @ lattice @ _blend(u[0], nx).T)
        weight += 0.5**octave
    low, high = total.min(), total.max()
    return (total - low) / max(high - low, 1e-12)


def _blend(x: F64, cells: int) -> F64:
    """(len(x), cells) weights of the lattice points beside each x in 0 to 1, smoothly blended, wrapped."""
    at = x * cells - 0.5
    i = np.floor(at).astype(int)
    t = at - i
    t = t * t * (3 - 2 * t)
    weights = np.zeros((len(x), cells))
    rows = np.arange(len(x))
    weights[rows, i % cells] += 1 - t
    weights[rows, (i + 1) % cells] += t
    return weights


def _smooth(low: float, high: float, x: F64) -> F64:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
