"""Shapes by name: `shape(name, **parameters)` gives a Sphere, or Triangles with normals, UVs and tangents.

All are centred on the origin with +Y up, in metres, and their parameters are the keyword arguments of the functions
below with the defaults given there. UVs run 0 to 1 over each face. Bodies are closed: corners that meet are bit-equal.
"""

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from glhybrid.errors import unknown
from glhybrid.load import architecture, hostile
from glhybrid.load.patch import around, fan, join, lathe, patch, quad, tube
from glhybrid.load.require import ShapeError, counts, positive
from glhybrid.scene import F64, Sphere, Triangles


def box(*, size: Sequence[float] = (1.0, 1.0, 1.0), bevel: float = 0.0, segments: int = 4) -> Triangles:
    """A box. bevel: radius of its rounded edges, each in `segments` steps (0 = sharp)."""
    positive(size=size)
    half = np.array(size, np.float64) / 2
    if not 0 <= bevel <= half.min():
        raise ShapeError("bevel", bevel, f"must be between 0 and half the smallest side ({half.min():g})")
    if bevel == 0:
        return join([quad(corners * half) for corners in _CUBE_FACES])
    counts(256, segments=segments)
    # Along each axis: samples of the two rounded edges, mirrored exactly so that faces meet in the same numbers.
    bend = np.tan(np.linspace(0, np.pi / 4, segments + 1))
    stops = [np.concatenate([-(h - bevel + bevel * bend[::-1]), h - bevel + bevel * bend]) for h in half]
    core = half - bevel
    parts = []
    for top_left, top_right, _, bottom_left in _CUBE_FACES:
        u_axis = int(np.flatnonzero(top_left != top_right)[0])
        v_axis = int(np.flatnonzero(top_left != bottom_left)[0])
        u = stops[u_axis] * (1 if top_right[u_axis] > 0 else -1)
        v = stops[v_axis] * (1 if bottom_left[v_axis] > 0 else -1)
        cube = np.broadcast_to(top_left * half, (len(v), len(u), 3)).copy()
        cube[..., u_axis], cube[..., v_axis] = u[None, :], v[:, None]
        inner = np.clip(cube, -core, core)
        normal = (cube - inner) / np.sqrt(np.square(cube - inner).sum(-1, keepdims=True))
        across = (np.abs(u - u[0]) / abs(u[-1] - u[0]), np.abs(v - v[0]) / abs(v[-1] - v[0]))
        parts.append(patch(inner + bevel * normal, normal, across))
    return join(parts)


# Corners of the faces of a cube from -1 to 1, as `quad` takes them: front, back, right, left, top, bottom.
_CUBE_FACES: F64 = np.array(
    [
        [(-1, 1, 1), (1, 1, 1), (1, -1, 1), (-1, -1, 1)],
        [(1, 1, -1), (-1, 1, -1), (-1, -1, -1), (1, -1, -1)],
        [(1, 1, 1), (1, 1, -1), (1, -1, -1), (1, -1, 1)],
        [(-1, 1, -1), (-1, 1, 1), (-1, -1, 1), (-1, -1, -1)],
        [(-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)],
        [(-1, -1, 1), (1, -1, 1), (1, -1, -1), (-1, -1, -1)],
    ],
    np.float64,
)


def plane(*, size: Sequence[float] = (1.0, 1.0)) -> Triangles:
    """A rectangle that faces +Y; one-sided."""
    positive(size=size)
    return quad(_CUBE_FACES[4] * (size[0] / 2, 0.0, size[1] / 2))


def sphere(*, radius: float = 0.5, segments: int = 0) -> Sphere | Triangles:
    """An analytic sphere; with segments > 0 one of triangles, that many around and half as many from pole to pole."""
    positive(radius=radius)
    if segments == 0:
        return Sphere(float(radius))
    counts(4096, low=3, segments=segments)
    return ellipsoid(radii=(radius, radius, radius), segments=segments)


def ellipsoid(*, radii: Sequence[float] = (0.5, 0.5, 0.5), segments: int = 64) -> Triangles:
    """Of triangles, with exact normals."""
    positive(radii=radii)
    counts(4096, low=3, segments=segments)
    rows = max(segments // 2, 2)
    polar = np.arange(rows + 1)[:, None] / rows * np.pi
    turn = np.arange(segments + 1)[None, :] / segments * 2 * np.pi
    ring = np.sin(polar)
    ring[[0, -1]] = 0.0  # sin(pi) is not quite 0: the poles must close
    unit = np.stack([ring * np.sin(turn), np.cos(polar) + 0 * turn, ring * np.cos(turn)], axis=-1)
    unit[:, -1] = unit[:, 0]
    normal = unit / np.asarray(radii)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return patch(unit * np.asarray(radii), normal, closed_u=True)


def cylinder(*, radius: float = 0.5, height: float = 1.0, segments: int = 64, bevel: float = 0.0) -> Triangles:
    """Along Y, closed by caps. bevel: radius of its rounded rims."""
    positive(radius=radius, height=height)
    counts(4096, low=3, segments=segments)
    limit = min(radius, height / 2)
    if not 0 <= bevel <= limit:
        raise ShapeError("bevel", bevel, f"must be between 0 and the smaller of radius and half height ({limit:g})")
    turn, flat = around(segments), radius - bevel
    if bevel > 0:
        bend = np.linspace(0, np.pi / 2, 7)
        sin, cos = np.sin(bend), np.append(np.cos(bend[:-1]), 0.0)
        rim = np.stack([flat + bevel * sin, height / 2 - bevel + bevel * cos], axis=1)
        below = rim[::-1] * (1, -1)
        parts = [lathe(np.concatenate([rim, below[1 if bevel == height / 2 else 0 :]]), turn)]
    else:
        out = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
        normal = np.concatenate([out, out[:1]])[None].repeat(2, 0)
        side = normal * radius
        side[0, :, 1], side[1, :, 1] = height / 2, -height / 2
        parts = [patch(side, normal, closed_u=True)]
    if flat > 0:
        top = np.stack([flat * np.sin(turn), np.full(segments, height / 2), flat * np.cos(turn)], axis=1)
        parts += [fan(top, (0, 1, 0)), fan((top * (1, -1, 1))[::-1], (0, -1, 0))]
    return join(parts)


def torus(*, radius: float = 0.5, tube: float = 0.15, segments: int = 96, sides: int = 48) -> Triangles:
    """About the Y axis. radius: from the centre to the middle of the tube; tube: the tube's own radius."""
    positive(radius=radius, tube=tube)
    counts(4096, low=3, segments=segments, sides=sides)
    if tube > radius:
        raise ShapeError("tube", tube, f"must not be greater than radius ({radius:g})")
    turn = np.arange(segments + 1)[None, :, None] / segments * 2 * np.pi
    roll = np.arange(sides + 1)[:, None, None] / sides * 2 * np.pi
    out = np.concatenate([np.sin(turn), 0 * turn, np.cos(turn)], axis=2)
    normal = np.cos(roll) * out - np.sin(roll) * np.array([0.0, 1.0, 0.0])
    normal[-1], normal[:, -1] = normal[0], normal[:, 0]
    return patch(radius * out + tube * normal, normal, closed_u=True, closed_v=True)


def knot(
    *, radius: float = 0.4, tube: float = 0.1, turns: int = 2, loops: int = 3, segments: int = 512, sides: int = 32
) -> Triangles:
    """A torus knot about Y: `turns` times round the axis while winding `loops` times through the hole."""
    positive(radius=radius, tube=tube)
    counts(64, turns=turns, loops=loops)
    counts(8192, low=3, segments=segments, sides=sides)
    if np.gcd(turns, loops) != 1:
        raise ShapeError(
            "loops", loops, f"must have no divisor in common with turns ({turns}), or the knot falls apart"
        )
    t = np.arange(segments) / segments * 2 * np.pi
    ring = radius * (1 + 0.45 * np.cos(loops * t))
    curve = np.stack([ring * np.sin(turns * t), 0.45 * radius * np.sin(loops * t), ring * np.cos(turns * t)], axis=1)
    return _tube(curve, tube, sides)


_tube = tube  # two parameters above are named so as well


def revolve(*, profile: Sequence[Any] = ((0.0, 0.5), (0.5, 0.0), (0.0, -0.5)), segments: int = 64) -> Triangles:
    """A profile [[radius, y], ...] from the top down, turned about Y; corners under 145 degrees stay sharp."""
    try:
        points = np.asarray(profile, np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ShapeError("profile", profile, "must be two or more pairs [radius, y] of numbers")
    if (points[:, 0] < 0).any() or (np.linalg.norm(np.diff(points, axis=0), axis=1) == 0).any():
        raise ShapeError("profile", profile, "radii must not be negative, nor two points that follow be the same")
    counts(4096, low=3, segments=segments)
    return lathe(points, around(segments))


def grid(
    *,
    size: Sequence[float] = (10.0, 10.0),
    cells: Sequence[int] = (64, 64),
    height: str = "waves",
    amplitude: float = 0.2,
    wavelength: float = 2.0,
    seed: int = 1,
) -> Triangles:
    """A rectangle of cells that faces +Y, with a height: flat, waves (water), hills (noise), steps (a stair up to -Z).

    amplitude: metres, the greatest height of waves and hills, the riser of steps. wavelength: metres, the largest
    feature, the tread of steps (which have no cells).
    """
    positive(size=size, wavelength=wavelength)
    counts(4096, cells=cells)
    if cells[0] * cells[1] > 4_000_000:
        raise ShapeError("cells", list(cells), "must not be more than 4,000,000 in all")
    if height not in HEIGHTS:
        raise ShapeError("height", height, unknown("height", height, HEIGHTS))
    if height == "steps":
        return _steps(size, amplitude, wavelength)
    x, z = np.meshgrid(
        np.linspace(-size[0] / 2, size[0] / 2, cells[0] + 1), np.linspace(-size[1] / 2, size[1] / 2, cells[1] + 1)
    )
    y = amplitude * HEIGHTS[height](x, z, wavelength, np.random.default_rng(seed))
    return patch(np.stack([x, y, z], axis=-1))


def _steps(size: Sequence[float], riser: float, tread: float) -> Triangles:
    """Treads and risers as flat faces; the lowest tread is at y = 0 in front (+Z)."""
    count = max(int(np.ceil(size[1] / tread - 1e-9)), 1)
    if count > 4096:
        raise ShapeError("wavelength", tread, f"must be at least 1/4096 of the length ({size[1] / 4096:g})")
    x, i = size[0] / 2, np.arange(count)
    near = size[1] / 2 - i * tread
    far, y = np.append(near[1:], -size[1] / 2), i * riser

    def face(y_top: Any, z_top: Any, y_low: Any, z_low: Any) -> F64:
        corners = [(-x, y_top, z_top), (x, y_top, z_top), (x, y_low, z_low), (-x, y_low, z_low)]
        return np.stack([np.stack(np.broadcast_arrays(*c), axis=-1) for c in corners], axis=1)

    return quad(np.concatenate([face(y, far, y, near), face(y[1:], near[1:], y[:-1], near[1:])]))


def _waves(x: F64, z: F64, length: float, random: np.random.Generator) -> F64:
    """Eleven sines in a fan of directions, shorter ones lower, scaled to -1 to 1."""
    y = np.zeros_like(x)
    for i in range(11):
        turn, k = random.normal(0.6, 0.7), 2 * np.pi / length * 1.37**i
        y += 0.62**i * np.sin(k * (x * np.cos(turn) + z * np.sin(turn)) + random.uniform(0, 2 * np.pi))
    return y / max(np.abs(y).max(), 1e-12)


def _hills(x: F64, z: F64, length: float, random: np.random.Generator) -> F64:
    """Five octaves of smooth value noise, 0 to 1."""
    y = np.zeros_like(x)
    for octave in range(5):
        lattice = random.uniform(0, 1, (64, 64))
        u, v = x / length * 2**octave, z / length * 2**octave
        i, j = np.floor(u).astype(int), np.floor(v).astype(int)
        a, b = u - i, v - j
        a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
        i, j, i1, j1 = i % 64, j % 64, (i + 1) % 64, (j + 1) % 64
        low = lattice[i, j] * (1 - a) + lattice[i1, j] * a
        y += 0.45**octave * (low * (1 - b) + (lattice[i, j1] * (1 - a) + lattice[i1, j1] * a) * b)
    return (y - y.min()) / max(np.ptp(y), 1e-12)


HEIGHTS: dict[str, Callable[[F64, F64, float, np.random.Generator], F64]] = {
    "flat": lambda x, z, length, random: np.zeros_like(x),
    "waves": _waves,
    "hills": _hills,
    "steps": lambda x, z, length, random: np.zeros_like(x),  # flat faces, made by _steps
}

SHAPES: dict[str, Callable[..., Triangles | Sphere]] = {
    f.__name__: f
    for f in (
        box, plane, sphere, ellipsoid, cylinder, torus, knot, revolve, grid,
        architecture.column, architecture.arch, architecture.cloth, architecture.facade,
        hostile.blades, hostile.debris,
    )
}  # fmt: skip


def parameters(name: str) -> dict[str, Any]:
    """The parameters of a shape with their defaults."""
    return {key: p.default for key, p in inspect.signature(SHAPES[name]).parameters.items()}


def shape(name: str, **given: Any) -> Triangles | Sphere:
    """The shape of that name. Raises ShapeError where a name is unknown or a value out of range."""
    if name not in SHAPES:
        raise ShapeError("shape", name, unknown("shape", name, SHAPES))
    for key in given:
        if key not in parameters(name):
            raise ShapeError(key, given[key], unknown(f"parameter of {name}", key, parameters(name)))
    return SHAPES[name](**given)
