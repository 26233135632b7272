"""Shapes to build halls and streets from: fluted column, arched wall, hanging cloth, facade of windows."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from glhybrid.load.patch import around, join, lathe, moved, patch, quad
from glhybrid.load.require import ShapeError, counts, positive
from glhybrid.scene import F64, Triangles


def column(
    *, height: float = 5.0, radius: float = 0.35, flutes: int = 20, segments: int = 240, rows: int = 16
) -> Triangles:
    """An Ionic sort of column without volutes: square plinth, moulded base, fluted shaft with entasis, capital, abacus.

    radius: of the shaft at its foot. Base and capital take their proportions from it; its foot is at -height / 2.
    """
    positive(height=height, radius=radius)
    counts(4096, segments=segments, rows=rows)
    counts(128, low=0, flutes=flutes)
    if height < 6 * radius:
        raise ShapeError("height", height, f"must be at least 6 times the radius ({6 * radius:g})")
    r, foot, top = radius, -height / 2, height / 2
    plinth, abacus = 0.30 * r, 0.24 * r
    sunk = 0.02 * r  # each part reaches a little into the next, so that no ray passes between them
    base = [(0.8 * r, foot + plinth + 0.86 * r), (1.05 * r, foot + plinth + 0.86 * r)]
    base += _bulge(1.12 * r, foot + plinth + 0.80 * r, foot + plinth + 0.58 * r, 0.11 * r, 8)
    base += _hollow(1.13 * r, foot + plinth + 0.54 * r, foot + plinth + 0.36 * r, 0.07 * r, 8)
    base += _bulge(1.22 * r, foot + plinth + 0.34 * r, foot + plinth, 0.17 * r, 10)
    base += [(1.2 * r, foot + plinth - sunk)]
    shaft_low, shaft_high = foot + plinth + 0.86 * r, top - abacus - 0.72 * r
    t = np.linspace(0, 1, rows + 1)
    width = r * (1 - 0.15 * t**1.6)  # entasis: the taper begins slowly
    neck = float(width[-1])
    bell = [(1.62 * neck, top - abacus + sunk), (1.60 * neck, top - abacus - 0.10 * r)]
    a = np.linspace(0, np.pi / 2, 9)
    bell += [(neck * (1.10 + 0.48 * np.cos(x)), top - abacus - 0.10 * r - 0.36 * r * np.sin(x)) for x in a]
    bell += _bulge(1.06 * neck, shaft_high + 0.24 * r, shaft_high + 0.08 * r, 0.08 * r, 8)
    bell += [(neck + sunk, shaft_high), (0.8 * neck, shaft_high)]
    smooth = around(max(segments // 2, 24))
    return join(
        [
            _block(2.9 * r, plinth, foot),
            lathe(np.array(base), smooth),
            _shaft(width[::-1], np.linspace(shaft_high + sunk, shaft_low - sunk, rows + 1), flutes, segments),
            lathe(np.array(bell), smooth),
            _block(3.3 * neck, abacus, top - abacus),
        ]
    )


def _shaft(width: F64, y: F64, flutes: int, segments: int) -> Triangles:
    if not flutes:
        return lathe(np.stack([width, y], axis=1), around(segments))
    # Round grooves between flat fillets, sampled at the edges of both.
    across = -np.cos(np.linspace(0, np.pi, max(segments // flutes, 5)))  # -1 to 1 over a groove
    rim = np.sqrt(1 - 0.9**2)
    groove = (np.sqrt(1 - (0.9 * across) ** 2) - rim) / (1 - rim)  # nine tenths of a half circle: its edge is a corner
    angle = ((np.arange(flutes)[:, None] + 0.5 + 0.42 * across) * (2 * np.pi / flutes)).ravel()
    t = np.linspace(0, 1, len(y))
    ends = np.sqrt(np.clip(np.minimum(t, 1 - t) / 0.06, 0, 1))[:, None]  # grooves run out at both ends
    scale = 1 - 0.6 * np.sin(np.pi / flutes) * ends * np.tile(groove, flutes)
    return lathe(np.stack([width, y], axis=1), angle, scale)


def _bulge(radius: float, high: float, low: float, out: float, steps: int) -> list[tuple[float, float]]:
    """A half-round moulding from high to low, standing out from radius."""
    a = np.linspace(0, np.pi, steps)
    return [(radius + out * np.sin(x), (high + low) / 2 + (high - low) / 2 * np.cos(x)) for x in a]


def _hollow(radius: float, high: float, low: float, depth: float, steps: int) -> list[tuple[float, float]]:
    return [(2 * radius - r, y) for r, y in _bulge(radius, high, low, depth, steps)]


def _block(width: float, height: float, foot: float) -> Triangles:
    """A square slab with its foot at that height."""
    from glhybrid.load.shapes import box

    slab = box(size=(width, height, width), bevel=min(height, width) * 0.08, segments=2)
    return moved(slab, (0.0, foot + height / 2, 0.0))


def arch(
    *,
    size: Sequence[float] = (4.0, 5.0, 0.6),
    opening: Sequence[float] = (2.4, 4.0),
    segments: int = 48,
    moulding: float = 0.0,
) -> Triangles:
    """A piece of wall with a round-headed opening through it along Z, standing on its foot at -size.y / 2.

    opening: width and height to the crown; the arch springs at height - width / 2. A wall as deep as a hall is its
    barrel vault. moulding: width of a raised band round the opening on both faces (0 = none).
    """
    positive(size=size, opening=opening)
    counts(4096, low=4, segments=segments)
    (x, y, z), (w, h) = size, opening
    if not w < x:
        raise ShapeError("opening", list(opening), f"its width must be less than the wall's ({x:g})")
    if not w / 2 <= h < y:
        raise ShapeError("opening", list(opening), f"its height must be between half its width and the wall's ({y:g})")
    spring = h - w / 2 - y / 2
    # Rays from the centre of the arch, the corners of the wall among them, meet the opening and the wall's outline.
    corner = np.arctan2(y / 2 - spring, x / 2)
    angle = np.sort(np.concatenate([np.linspace(0, np.pi, segments + 1), [corner, np.pi - corner]]))[::-1]
    cos, sin = np.cos(angle), np.sin(angle)
    cos[0], cos[-1], sin[0], sin[-1] = -1.0, 1.0, 0.0, 0.0
    reach = np.minimum(x / 2 / np.maximum(np.abs(cos), 1e-12), (y / 2 - spring) / np.maximum(sin, 1e-12))
    outer = np.stack([reach * cos, spring + reach * sin], axis=1)
    outer[:, 0] = np.clip(outer[:, 0], -x / 2, x / 2)
    outer[:, 1] = np.minimum(outer[:, 1], y / 2)
    for i, sign in ((np.flatnonzero(angle == np.pi - corner)[0], -1), (np.flatnonzero(angle == corner)[0], 1)):
        outer[i] = sign * x / 2, y / 2
    inner = np.stack([w / 2 * cos, spring + w / 2 * sin], axis=1)
    foot = -y / 2
    if spring > foot:  # the jambs below the springing
        inner = np.concatenate([[(-w / 2, foot)], inner, [(w / 2, foot)]])
        outer = np.concatenate([[(-x / 2, foot)], outer, [(x / 2, foot)]])
    parts = [
        _between(outer, inner, z / 2, x, y),  # front
        _between(inner, outer, -z / 2, x, y),  # back
        _ribbon(inner, z / 2, -z / 2),  # the soffit
        *(_ribbon(run, -z / 2, z / 2) for run in _straight_runs(outer)),
        quad([[(s * x / 2 if s < 0 else w / 2, foot, z / 2), (-w / 2 if s < 0 else x / 2, foot, z / 2),
               (-w / 2 if s < 0 else x / 2, foot, -z / 2), (s * x / 2 if s < 0 else w / 2, foot, -z / 2)]
              for s in (-1, 1)]),
    ]  # fmt: skip
    if moulding > 0:
        parts += [_moulding(inner, moulding, z / 2, side) for side in (1, -1)]
    return join(parts)


def _between(upper: F64, lower: F64, z: float, x: float, y: float) -> Triangles:
    """The flat band between two outlines (N, 2) at height z, u and v over the whole wall."""
    p = np.stack([upper, lower])
    position = np.concatenate([p, np.full((*p.shape[:2], 1), z)], axis=2)
    normal = np.zeros_like(position)
    normal[..., 2] = np.sign(z)
    u, v = p[..., 0] / x + 0.5, 0.5 - p[..., 1] / y
    made = patch(position, normal, (u if z > 0 else 1 - u, v))
    tangent = np.tile(np.array([np.sign(z), 0, 0, 1], np.float32), (len(made.position), 1))
    return Triangles(made.position, made.index, made.normal, 0, tangent, made.uv0)


def _ribbon(outline: F64, z_top: float, z_bottom: float) -> Triangles:
    """A band along an outline (N, 2), from one depth to the other."""
    rows = [np.concatenate([outline, np.full((len(outline), 1), z)], axis=1) for z in (z_top, z_bottom)]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    return patch(np.stack(rows), uv=(along / along[-1], (0.0, 1.0)))


def _straight_runs(outline: F64) -> list[F64]:
    """The outline cut at its corners."""
    way = np.diff(outline, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    cuts = [0, *(np.flatnonzero((way[1:] * way[:-1]).sum(1) < 0.5) + 1).tolist(), len(outline) - 1]
    return [outline[a : b + 1] for a, b in pairwise(cuts)]


def _moulding(inner: F64, width: float, z: float, side: int) -> Triangles:
    """A rounded band that stands out from the wall along the opening, its section a half round with a fillet."""
    way = np.gradient(inner, axis=0)
    out = np.stack([-way[:, 1], way[:, 0]], axis=1)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    a = np.linspace(0, np.pi, 9)
    reach = np.concatenate([0.5 - 0.5 * np.cos(a)]) * width
    rise = np.sin(a) * width * 0.4
    p = np.empty((len(reach), len(inner), 3))
    p[..., :2] = inner + reach[:, None, None] * out
    p[..., 2] = side * (z + rise[:, None])
    return patch(p[::-1] if side > 0 else p)


def cloth(
    *,
    size: Sequence[float] = (2.0, 3.0),
    cells: Sequence[int] = (96, 128),
    folds: float = 5.0,
    depth: float = 0.12,
    sag: float = 0.1,
    seed: int = 1,
) -> Triangles:
    """A hanging cloth that faces +Z, its top edge held up in folds that open towards the hem; give it two sides.

    depth: of the folds, sag: how far the top edge hangs through between the folds; metres.
    """
    positive(size=size)
    counts(2048, cells=cells)
    random = np.random.default_rng(seed)
    u, v = np.meshgrid(np.linspace(0, 1, cells[0] + 1), np.linspace(0, 1, cells[1] + 1))
    phase = random.uniform(0, 2 * np.pi, 4)
    drift = 0.35 * np.sin(2.1 * v + phase[0]) + 0.25 * np.sin(3.7 * u + phase[1]) * v
    fold = np.cos(2 * np.pi * folds * u + drift * 2 + 0.8 * np.sin(2 * np.pi * u + phase[2]))
    broad = np.sin(2 * np.pi * (0.6 * u + 0.35 * v) + phase[3])
    z = depth * ((0.75 + 0.25 * np.sin(3 * v + phase[1])) * fold + 0.6 * v * broad)
    x = (u - 0.5) * size[0] + 0.25 * depth * np.sin(4 * np.pi * folds * u + 2 * drift)
    y = (0.5 - v) * size[1] - sag * (0.5 - 0.5 * fold) * (1 - v) - 0.3 * depth * v * broad
    return patch(np.stack([x, y, z], axis=-1))


def facade(
    *,
    size: Sequence[float] = (20.0, 60.0, 20.0),
    bays: Sequence[int] = (8, 8),
    floors: int = 16,
    frame: float = 0.25,
    depth: float = 0.3,
    mullions: int = 1,
) -> Triangles:
    """The frames of all windows on the four walls of a block, and its flat roof; the openings are left empty.

    bays: windows along x and along z; frame: half the width of the bars between openings; depth: how far these lie
    back, where a box of size - 2 depth closes them with glass. mullions: upright bars within each window.
    """
    positive(size=size, frame=frame, depth=depth)
    counts(256, bays=bays, floors=floors)
    counts(16, low=0, mullions=mullions)
    x, y, z = size
    parts = [quad(np.array([[(-x, y, -z), (x, y, -z), (x, y, z), (-x, y, z)]]) / 2)]
    for side in range(4):
        wide, deep, count = (x, z, bays[0]) if side % 2 == 0 else (z, x, bays[1])
        wall = _windows(wide, y, count, floors, frame, depth, mullions)
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[side]
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], np.float64)
        parts.append(quad((wall + np.array([0, 0, deep / 2])) @ turn.T))
    return join(parts)


def _windows(wide: float, high: float, bays: int, floors: int, frame: float, depth: float, mullions: int) -> F64:
    """(Q, 4, 3) rectangles of one wall about z = 0: per window a rim of four, four reveals, three faces a mullion."""
    if 2 * frame >= min(wide / bays, high / floors):
        raise ShapeError("frame", frame, f"must be less than half a window ({min(wide / bays, high / floors) / 2:g})")
    left, top = np.meshgrid(np.arange(bays) / bays * wide - wide / 2, high / 2 - np.arange(floors) / floors * high)
    right = np.append(left[0], wide / 2)[None, 1:].repeat(floors, 0)
    bottom = np.append(top[:, 0], -high / 2)[1:, None].repeat(bays, 1)
    lo, hi, t, b = left + frame, right - frame, top - frame, bottom + frame
    front, back = np.zeros_like(lo), np.full_like(lo, -depth)

    def face(*corners: tuple[F64, F64, F64]) -> F64:
        return np.stack([np.stack(c, axis=-1) for c in corners], axis=-2).reshape(-1, 4, 3)

    faces = [
        face((left, top, front), (right, top, front), (hi, t, front), (lo, t, front)),
        face((lo, b, front), (hi, b, front), (right, bottom, front), (left, bottom, front)),
        face((left, top, front), (lo, t, front), (lo, b, front), (left, bottom, front)),
        face((hi, t, front), (right, top, front), (right, bottom, front), (hi, b, front)),
        face((lo, t, front), (hi, t, front), (hi, t, back), (lo, t, back)),
        face((lo, b, back), (hi, b, back), (hi, b, front), (lo, b, front)),
        face((lo, t, front), (lo, t, back), (lo, b, back), (lo, b, front)),
        face((hi, t, back), (hi, t, front), (hi, b, front), (hi, b, back)),
    ]
    for i in range(mullions):
        middle = lo + (hi - lo) * ((i + 1) / (mullions + 1))
        bar, proud = frame * 0.35, np.full_like(lo, -depth * 0.45)
        p, q = middle - bar, middle + bar
        faces += [
            face((p, t, proud), (q, t, proud), (q, b, proud), (p, b, proud)),
            face((p, t, back), (p, t, proud), (p, b, proud), (p, b, back)),
            face((q, t, proud), (q, t, back), (q, b, back), (q, b, proud)),
        ]
    return np.concatenate(faces)
