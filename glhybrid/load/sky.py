"""A clear sky from first principles: sunlight scattered by air, haze and ozone over a round earth.

Chosen: single scattering integrated along each view ray plus the isotropic series for all higher orders (Hillaire
2020, "A Scalable and Production Ready Sky and Atmosphere Rendering Technique", EGSR), with the coefficients of
Bruneton and Neyret 2008 and haze by Angstrom's formula as in Preetham, Shirley and Smits 1999, appendix A. It holds
down to and under the horizon, and sky and sun come out of one computation, so they balance.
Rejected: Preetham's fitted formula (wrong near sunset and for clear air), Hosek-Wilkie (3,600 tabulated numbers).

Units: a texel is kcd/m^2 and the sun's intensity klux, so daylight stays near 1 and far inside a half float; an
environment intensity of 1000 gives cd/m^2 beside lamps in candela.
Azimuth is a compass bearing: 0 along -Z, the centre column of the map, 90 along +X. Elevation is above the horizon.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from glhybrid.scene import F32, F64, Light

SUN_ILLUMINANCE = 133.3  # klux above the atmosphere (solar constant 1361 W/m^2 x 98 lm/W), taken as white
SUN_ANGLE = np.radians(0.53)  # mean angular diameter
GROUND_KM, TOP_KM = 6360.0, 6460.0
EYE_KM = 0.2  # the observer, above the ground so that the horizon is not a special case
AIR_SCATTERING = np.array([5.802, 13.558, 33.1]) * 1e-3  # 1/km at 680, 550, 440 nm at sea level
OZONE_ABSORPTION = np.array([0.650, 1.881, 0.085]) * 1e-3  # 1/km at the layer's centre
AIR_HEIGHT, HAZE_HEIGHT = 8.0, 1.2  # km, scale heights
HAZE_ALBEDO = 0.92  # single scattering, continental aerosol
HAZE_G = 0.76  # asymmetry of the haze's phase function
WAVELENGTH_UM = np.array([0.680, 0.550, 0.440])
GROUND = (0.22, 0.20, 0.18)  # albedo of the land below the horizon


def sky_map(
    elevation: float,
    azimuth: float,
    turbidity: float = 3.0,
    ground: tuple[float, float, float] = GROUND,
    width: int = 512,
) -> F32:
    """(width / 2, width, 3) float32 equirect radiance in kcd/m^2, without the sun's disc.

    elevation, azimuth: of the sun, radians. turbidity: 1 = no haze, 2 clear, 3 usual, 6 hazy, 10 the limit.
    Below the horizon: the sunlit ground, through more and more air towards the horizon.
    """
    upright = _sky_facing_north(round(elevation, 9), round(turbidity, 9), tuple(ground), width)
    turn = azimuth / (2 * np.pi) * width  # whole texels by roll, the rest by interpolation: the sun's place stays exact
    whole = int(np.floor(turn))
    rest = np.float32(turn - whole)
    near = np.roll(upright, whole, axis=1)
    if rest < 1e-6:
        return near.copy()
    return np.ascontiguousarray(near * (1 - rest) + np.roll(upright, whole + 1, axis=1) * rest)


def sun_light(elevation: float, azimuth: float, turbidity: float = 3.0) -> Light:
    """The sun that belongs to `sky_map` of the same arguments: directional, klux, color's largest component 1."""
    arrived = _sun_at_eye(elevation, turbidity)
    peak = float(arrived.max())
    color = arrived / peak if peak > 0 else np.ones(3)
    toward = sun_direction(elevation, azimuth)
    return Light(
        kind="directional",
        color=(float(color[0]), float(color[1]), float(color[2])),
        intensity=peak,
        direction=(float(-toward[0]), float(-toward[1]), float(-toward[2])),
        name="sun",
    )


def sun_direction(elevation: float, azimuth: float) -> F64:
    """(3,) unit vector towards the sun."""
    flat = np.cos(elevation)
    return np.array([np.sin(azimuth) * flat, np.sin(elevation), -np.cos(azimuth) * flat])


@lru_cache(maxsize=8)
def _sky_facing_north(elevation: float, turbidity: float, ground: tuple[float, float, float], width: int) -> F32:
    """The map for a sun at azimuth 0, symmetric about its centre."""
    height = width // 2
    row_elevation = np.pi / 2 - (np.arange(height) + 0.5) / height * np.pi
    above = row_elevation > 0
    azimuths = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi  # from the sun's bearing
    coarse = np.linspace(0, np.pi, 25)  # what varies with azimuth but for the phase functions is smooth
    rows = row_elevation[above]
    by_air, by_haze, soft = _in_scattering(elevation, rows, coarse, turbidity)
    where = np.abs(azimuths) / np.pi * (len(coarse) - 1)
    left = np.minimum(where.astype(int), len(coarse) - 2)
    blend = (where - left)[None, :, None]

    def spread(v: F64) -> F64:
        return v[:, left] * (1 - blend) + v[:, left + 1] * blend

    cos_sun = np.sin(elevation) * np.sin(rows)[:, None] + np.cos(elevation) * np.cos(rows)[:, None] * np.cos(azimuths)
    upper = spread(by_air) * _phase_air(cos_sun)[..., None] + spread(by_haze) * _phase_haze(cos_sun)[..., None]
    upper += spread(soft)
    sky = np.zeros((height, width, 3))
    sky[above] = upper
    # The ground seen through the air: fades into the lowest row of the sky, which is all air.
    solid_angle = np.cos(rows) * (np.pi / height) * (2 * np.pi / width)
    irradiance = (upper * (np.sin(rows) * solid_angle)[:, None, None]).sum((0, 1))
    irradiance += _sun_at_eye(elevation, turbidity) * max(np.sin(elevation), 0.0)
    land = np.asarray(ground) * irradiance / np.pi
    air = np.exp(row_elevation[~above] / np.radians(3))[
        :, None, None
    ]  # 3 degrees: a soft edge, no streak under the sun
    sky[~above] = land * (1 - air) + sky[above][-1] * air
    return sky.astype(np.float32)


def _sun_at_eye(elevation: float, turbidity: float) -> F64:
    """(3,) klux on a surface that faces the sun."""
    depth = _columns(np.array([GROUND_KM + EYE_KM]), np.array([np.sin(elevation)])) @ _extinction(turbidity)
    return SUN_ILLUMINANCE * np.exp(-depth[0])


def _haze_scattering(turbidity: float) -> F64:
    """(3,) 1/km at sea level, from the vertical optical depth beta x wavelength^-1.3."""
    beta = max(0.04608 * turbidity - 0.04586, 0.0)
    return HAZE_ALBEDO * beta * WAVELENGTH_UM**-1.3 / HAZE_HEIGHT


def _extinction(turbidity: float) -> F64:
    """(3 media: air, haze, ozone; 3 colours) 1/km at density 1."""
    return np.stack([AIR_SCATTERING, _haze_scattering(turbidity) / HAZE_ALBEDO, OZONE_ABSORPTION])


def _density(height_km: F64) -> F64:
    """(..., 3 media) relative to sea level, ozone relative to its layer's centre."""
    h = np.maximum(height_km, 0.0)
    ozone = np.maximum(1 - np.abs(h - 25) / 15, 0)
    return np.stack([np.exp(-h / AIR_HEIGHT), np.exp(-h / HAZE_HEIGHT), ozone], axis=-1)


def _phase_air(cos_angle: F64) -> F64:
    return 3 / (16 * np.pi) * (1 + cos_angle**2)


def _phase_haze(cos_angle: F64) -> F64:
    """Cornette and Shanks 1992."""
    g = HAZE_G
    top = 3 * (1 - g * g) * (1 + cos_angle**2)
    return top / (8 * np.pi * (2 + g * g) * (1 + g * g - 2 * g * cos_angle) ** 1.5)


def _to_top(radius: F64, mu: F64) -> F64:
    """Kilometres from radius along mu = cos(zenith angle) to the top of the atmosphere."""
    return -radius * mu + np.sqrt(np.maximum(radius**2 * (mu**2 - 1) + TOP_KM**2, 0))


def _columns(radius: F64, mu: F64, steps: int = 48) -> F64:
    """(..., 3 media) kilometres of sea-level density up to the top; inf where the ground is in the way."""
    length = _to_top(radius, mu)[..., None]
    u = (np.arange(steps) + 0.5) / steps
    t = length * u**2  # short steps where the air is dense
    r = np.sqrt(radius[..., None] ** 2 + t**2 + 2 * t * (radius * mu)[..., None])
    total = (_density(r - GROUND_KM) * (length * 2 * u / steps)[..., None]).sum(-2)
    blocked = (mu < 0) & (radius**2 * (1 - mu**2) < GROUND_KM**2)
    total[blocked] = np.inf
    return total


class _SunTable:
    """Transmittance towards the sun and multiply scattered light, over height and the sun's local zenith angle."""

    def __init__(self, mu_range: tuple[float, float], turbidity: float) -> None:
        self.heights = 100.0 * np.linspace(0, 1, 40) ** 2
        self.mu_low, self.mu_high = mu_range
        self.mus = np.linspace(self.mu_low, self.mu_high, 33)
        radius, mu = np.meshgrid(GROUND_KM + self.heights, self.mus, indexing="ij")
        self.extinction = _extinction(turbidity)
        self.transmittance = np.exp(-(_columns(radius, mu)[..., None] * self.extinction).sum(-2))

    def __call__(self, table: F64, height: F64, mu: F64) -> F64:
        """table (heights, mus, 3) at any height and mu, bilinear."""
        x = np.clip(np.sqrt(np.maximum(height, 0) / 100), 0, 1) * (len(self.heights) - 1)
        y = np.clip((mu - self.mu_low) / (self.mu_high - self.mu_low), 0, 1) * (len(self.mus) - 1)
        i, j = np.minimum(x.astype(int), len(self.heights) - 2), np.minimum(y.astype(int), len(self.mus) - 2)
        a, b = (x - i)[..., None], (y - j)[..., None]
        near = table[i, j] * (1 - b) + table[i, j + 1] * b
        return near * (1 - a) + (table[i + 1, j] * (1 - b) + table[i + 1, j + 1] * b) * a


def _march(radius: F64, mu_view: F64, steps: int) -> tuple[F64, F64, F64]:
    """Sample distances (..., S), their step lengths (..., S) and radii along rays that end at the ground or the top."""
    inside = radius**2 * (mu_view**2 - 1) + GROUND_KM**2
    hits = (mu_view < 0) & (inside > 0)
    length = np.where(hits, -radius * mu_view - np.sqrt(np.maximum(inside, 0)), _to_top(radius, mu_view))[..., None]
    u = (np.arange(steps) + 0.5) / steps
    t = length * u**2
    return t, length * 2 * u / steps, np.sqrt(radius[..., None] ** 2 + t**2 + 2 * t * (radius * mu_view)[..., None])


def _in_scattering(elevation: float, rows: F64, azimuths: F64, turbidity: float) -> tuple[F64, F64, F64]:
    """(rows, azimuths, 3) each: light to be scaled by air's phase function, by haze's, and the multiply scattered."""
    steps = 40
    mu_sun = np.sin(elevation)
    spread = 0.16  # a ray to the horizon sees the sun up to about 9 degrees higher or lower (TOP_KM at its end)
    table = _SunTable((max(mu_sun - spread, -1.0), min(mu_sun + spread, 1.0)), turbidity)
    haze_scattering = _haze_scattering(turbidity)
    many = _multiple_scattering(table, haze_scattering)

    view, turn = np.meshgrid(rows, azimuths, indexing="ij")
    start = np.full(view.shape, GROUND_KM + EYE_KM)
    t, dt, r = _march(start, np.sin(view), steps)
    cos_to_sun = mu_sun * np.sin(view) + np.cos(elevation) * np.cos(view) * np.cos(turn)
    mu_local = (start * mu_sun)[..., None] / r + t * cos_to_sun[..., None] / r
    density = _density(r - GROUND_KM)
    depth = ((density * dt[..., None])[..., None] * table.extinction).sum(-2)
    through = np.exp(-(np.cumsum(depth, axis=-2) - depth / 2)) * dt[..., None] * SUN_ILLUMINANCE
    sunlit = through * table(table.transmittance, r - GROUND_KM, mu_local)
    air = (sunlit * (density[..., 0, None] * AIR_SCATTERING)).sum(-2)
    haze = (sunlit * (density[..., 1, None] * haze_scattering)).sum(-2)
    scattering = density[..., 0, None] * AIR_SCATTERING + density[..., 1, None] * haze_scattering
    soft = (through * table(many, r - GROUND_KM, mu_local) * scattering).sum(-2)
    return air, haze, soft


def _multiple_scattering(table: _SunTable, haze_scattering: F64) -> F64:
    """(heights, mus, 3) isotropic radiance per unit of sun by two and more scatterings (Hillaire 2020, section 5.5)."""
    steps, albedo = 16, 0.25
    heights, mus = table.heights[::3], table.mus[::4]
    zenith = np.arccos(1 - 2 * (np.arange(8) + 0.5) / 8)  # equal areas
    turn = (np.arange(6) + 0.5) / 6 * np.pi  # one half: the other is its mirror image
    h, mu, z, a = np.meshgrid(heights, mus, zenith, turn, indexing="ij")
    radius = GROUND_KM + np.maximum(h, 1e-3)
    t, dt, r = _march(radius, np.cos(z), steps)
    cos_to_sun = mu * np.cos(z) + np.sqrt(np.maximum(1 - mu**2, 0)) * np.sin(z) * np.cos(a)
    mu_local = ((radius * mu)[..., None] + t * cos_to_sun[..., None]) / r
    density = _density(r - GROUND_KM)
    depth = ((density * dt[..., None])[..., None] * table.extinction).sum(-2)
    through = np.exp(-(np.cumsum(depth, axis=-2) - depth / 2)) * dt[..., None]
    scattering = density[..., 0, None] * AIR_SCATTERING + density[..., 1, None] * haze_scattering
    sun = table(table.transmittance, r - GROUND_KM, mu_local)
    second = (through * scattering * sun).sum(-2) / (4 * np.pi)
    share = (through * scattering).sum(-2)
    ground = (np.cos(z) < 0) & (radius**2 * (1 - np.cos(z) ** 2) < GROUND_KM**2)
    bounce = albedo / np.pi * np.exp(-depth.sum(-2)) * sun[..., -1, :] * np.maximum(mu_local[..., -1, None], 0)
    second += np.where(ground[..., None], bounce, 0)
    coarse = second.mean((2, 3)) / (1 - np.minimum(share.mean((2, 3)), 0.999))
    full = np.empty((len(table.heights), len(table.mus), 3))
    for c in range(3):
        by_mu = np.stack([np.interp(table.mus, mus, row) for row in coarse[..., c]])
        full[..., c] = np.stack([np.interp(np.sqrt(table.heights), np.sqrt(heights), col) for col in by_mu.T]).T
    return full


@dataclass(frozen=True)
class SoftBox:
    """A rectangle of light at infinity. size: full angles; soft: share of the half size over which its edge fades."""

    azimuth: float
    elevation: float
    size: tuple[float, float]
    radiance: tuple[float, float, float]
    soft: float = 0.2


def studio_map(
    boxes: Sequence[SoftBox], floor: tuple[float, float, float], ceiling: tuple[float, float, float], width: int = 512
) -> F32:
    """(width / 2, width, 3) float32 equirect radiance: soft boxes before a background from floor to ceiling colour."""
    height = width // 2
    up = np.cos((np.arange(height) + 0.5) / height * np.pi)[:, None]
    turn = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi
    flat = np.sqrt(1 - up**2)
    way = np.stack(np.broadcast_arrays(flat * np.sin(turn), up, -flat * np.cos(turn)), axis=-1)
    blend = (0.5 + 0.5 * up)[..., None]
    picture = np.broadcast_to((1 - blend) * floor + blend * ceiling, way.shape).copy()
    for box in boxes:
        ahead = sun_direction(box.elevation, box.azimuth)
        right = np.array([np.cos(box.azimuth), 0.0, np.sin(box.azimuth)])
        depth = way @ ahead
        cover = np.where(depth > 0, 1.0, 0.0)
        for axis, angle in ((right, box.size[0]), (np.cross(ahead, right), box.size[1])):
            across = np.abs(way @ axis) / np.maximum(depth, 1e-9) / np.tan(angle / 2)
            edge = np.clip((1 - across) / max(box.soft, 1e-6), 0, 1)
            cover *= edge * edge * (3 - 2 * edge)
        picture += cover[..., None] * (np.asarray(box.radiance) - picture)
    return picture.astype(np.float32)
