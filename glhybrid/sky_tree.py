"""An environment as a quadtree of light: what glsl/passes/sky_prefilter.comp sums its lobes from. No OpenGL.

Chosen: a deterministic sum over nodes as fine as the lobe asks for. Rejected: 256 samples of the lobe with blurred
texels (Karis 2013; Colbert & Krivanek 2007), which was 5 to 50 % off under a low sun, and far more beside bright lamps.
"""

import numpy as np

from glhybrid.scene import F32, F64

VERSION = 2  # of what sky_nodes makes: part of the name under which convolutions are kept on disk
LEVELS = 7  # 8 x 4 nodes of 45 degrees down to 512 x 256 of 0.7: half as wide as the sharpest lobe
WIDTH, HEIGHT = 8 << LEVELS - 1, 4 << LEVELS - 1
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def sky_nodes(radiance: F32) -> F32:
    """(N, 12) float32, level by level from the coarsest, rows within. Three fours: mean radiance, solid angle;
    centre of light, radius; centre, 0.

    radiance: (H, W, 3) equirect. Centres are unit directions, means over the node, that of light weighted by luminance:
    in an even sky the two are one. radius: half the node's diagonal, rad.
    """
    light = resample(np.maximum(radiance, 0))
    edge = np.cos(np.arange(HEIGHT + 1) / HEIGHT * np.pi)
    solid = np.broadcast_to((edge[:-1] - edge[1:])[:, None] * 2 * np.pi / WIDTH, (HEIGHT, WIDTH))
    flux = light * solid[..., None]
    # A touch of evenness, so that black nodes have a centre too.
    weight = flux @ _LUMINANCE + solid * (1e-6 * (flux.sum((0, 1)) @ _LUMINANCE) + 1e-30)
    directions = _directions()
    even, moment = directions * solid[..., None], directions * weight[..., None]
    levels = []
    for k in range(LEVELS):
        height, width = solid.shape
        theta = (np.arange(height) + 0.5) / height * np.pi
        radius = 0.5 * np.hypot(np.pi / height, 2 * np.pi / width * np.sin(theta))[:, None]
        node = np.zeros((height, width, 12))
        node[..., :3], node[..., 3] = flux / solid[..., None], solid
        node[..., 4:7], node[..., 7] = _unit(moment), radius
        node[..., 8:11] = _unit(even)
        levels.append(node.reshape(-1, 12))
        if k < LEVELS - 1:
            flux, moment, even, solid = (_quarter(a) for a in (flux, moment, even, solid))
    return np.concatenate(levels[::-1]).astype(np.float32)


def _directions() -> F64:
    """(HEIGHT, WIDTH, 3) unit directions of the finest nodes; the centre column looks along -Z, row 0 is +Y."""
    theta = ((np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi)[:, None]
    phi = ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5) * 2 * np.pi
    sin = np.sin(theta)
    return np.stack(np.broadcast_arrays(sin * np.sin(phi), np.cos(theta), -sin * np.cos(phi)), axis=-1)


def _unit(v: F64) -> F64:
    result: F64 = v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)
    return result


def resample(radiance: F32) -> F64:
    """(HEIGHT, WIDTH, 3) mean radiance of (H, W, 3) over each cell: no light is lost, whatever the size of the map."""
    height, width = radiance.shape[:2]
    if width < WIDTH or height < HEIGHT:  # as it is looked up: bilinear
        radiance = _bilinear(radiance, max(height, HEIGHT), max(width, WIDTH))
        height, width = radiance.shape[:2]
    columns = np.empty((height, WIDTH, 3))
    for first in range(0, height, 256):  # in strips: the widest maps would fill the memory with their sums
        columns[first : first + 256] = _cells(
            radiance[first : first + 256].astype(np.float64), np.ones(width), WIDTH, 1
        )
    edge = np.cos(np.arange(height + 1) / height * np.pi)
    want = np.cos(np.arange(HEIGHT + 1) / HEIGHT * np.pi)
    return _cells(columns, edge[:-1] - edge[1:], HEIGHT, 0, at=1 - want)


def _cells(values: F64, sizes: F64, count: int, axis: int, at: F64 | None = None) -> F64:
    """Means over `count` cells along an axis, of values that are constant over pieces of the given sizes."""
    values = np.moveaxis(values, axis, 0)
    by_row = (-1, *[1] * (values.ndim - 1))
    ends = np.concatenate([[0.0], np.cumsum(sizes)])
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values * sizes.reshape(by_row), 0)])
    if at is None:
        at = np.arange(count + 1) / count * ends[-1]
    i = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(sizes) - 1)
    share = np.clip((at - ends[i]) / sizes[i], 0, 1).reshape(by_row)
    sums = total[i] * (1 - share) + total[i + 1] * share
    means = np.diff(sums, axis=0) / np.diff(at).reshape(by_row)
    return np.moveaxis(means, 0, axis)


def _bilinear(radiance: F32, height: int, width: int) -> F32:
    """The map on a finer grid, as environment_texels in lib/environment.glsl reads it."""
    rows, columns = radiance.shape[:2]
    v = (np.arange(height) + 0.5) / height * rows - 0.5
    u = (np.arange(width) + 0.5) / width * columns - 0.5
    j, i = np.floor(v).astype(int), np.floor(u).astype(int)
    fv, fu = (v - j).astype(np.float32)[:, None, None], (u - i).astype(np.float32)[:, None]
    low, high = radiance[np.clip(j, 0, rows - 1)], radiance[np.clip(j + 1, 0, rows - 1)]
    across = low * (1 - fv) + high * fv
    result: F32 = across[:, i % columns] * (1 - fu) + across[:, (i + 1) % columns] * fu
    return result


def _quarter(a: F64) -> F64:
    """Sums over 2 x 2."""
    result: F64 = a.reshape(a.shape[0] // 2, 2, a.shape[1] // 2, 2, *a.shape[2:]).sum((1, 3))
    return result
