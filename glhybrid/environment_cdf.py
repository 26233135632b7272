"""Where an environment is bright: the tables that glsl/lib/environment_sample.glsl draws directions from. No OpenGL."""

import numpy as np

from glhybrid.scene import F32, F64, Environment

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LAMP = 50.0  # times the mean luminance: what lobes find too rarely. Skies without a sun reach 20 at their brightest.
EVEN = 4.0  # times the mean luminance: what lobes find often enough


def has_lamps(environment: Environment) -> bool:
    """Whether some of it is so bright that few rays of a rough surface find much of its light: suns, studio lamps."""
    light = np.maximum(environment.radiance @ LUMINANCE.astype(np.float32), 0)
    return bool(light.max() > LAMP * _mean(light))


def mean_luminance(environment: Environment) -> float:
    """Of what is seen of it, over all directions."""
    return _mean(np.maximum(environment.radiance @ LUMINANCE.astype(np.float32), 0)) * environment.intensity


def _mean(light: F32 | F64) -> float:
    """Over the sphere, of an equirect (H, W)."""
    solid = -np.diff(np.cos(np.linspace(0, np.pi, light.shape[0] + 1)))
    return float(light.mean(1) @ solid / 2)


def environment_cdf(environment: Environment, above: float = 0.0) -> F32:
    """(H + 1, max(W, H)) float32: cumulated luminance times solid angle along each row, then over rows.

    above: times the mean luminance; only what exceeds it counts. What is even is then left to a BSDF's own samples:
    Karlik et al., "MIS Compensation", SIGGRAPH Asia 2019.
    """
    height, width = environment.radiance.shape[:2]
    theta = np.arange(height + 1) / height * np.pi
    solid = np.cos(theta[:-1]) - np.cos(theta[1:])
    light = np.maximum(environment.radiance.astype(np.float64) @ LUMINANCE, 0)
    # What is looked up over a texel, bilinear, is beside a lamp far more than the texel: its mean, or beside one alone
    # its root mean square, for which a constant density leaves the least noise.
    light = np.maximum(_over_texels(light, 3 / 4, 1 / 8), np.sqrt(_over_texels(light**2, 7 / 12, 1 / 24)))
    weight = np.maximum(light - above * _mean(light), 0) * solid[:, None]
    table = np.ones((height + 1, max(width, height)))
    rows = weight.sum(1)
    along = np.cumsum(weight, 1)
    table[:height, :width] = np.where(
        rows[:, None] > 0, along / np.maximum(rows[:, None], 1e-300), np.arange(1, width + 1) / width
    )
    table[height, :height] = np.cumsum(rows) / max(rows.sum(), 1e-300)
    return table.astype(np.float32)


def _over_texels(light: F64, own: float, next_to: float) -> F64:
    """A sum over 3 x 3 texels of an equirect (H, W); columns wrap, rows are repeated."""
    height = len(light)
    light = own * light + next_to * (np.roll(light, 1, 1) + np.roll(light, -1, 1))
    return own * light + next_to * (light[np.r_[0, : height - 1]] + light[np.r_[1:height, height - 1]])
