"""Where probes go in a scene that does not say, and the boxes that they stand for. No OpenGL.

From points just off the surfaces that reflect, and from places where a probe could be, small cubes of distances are
drawn. The former are the truth: the point that a probe would show there, through a box, against the one that is there,
where cameras look by a mirror. Space is cut in two, and again, each time by the plane across which two probes take most
of the error away that one leaves, until a cut would hardly matter: so a room with mirrors gets a probe of its own, a
scene of one room one, and where the sky is as good as any none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glhybrid.probe_surfaces import Surfaces
from glhybrid.scene import F64, Probe

WALLS = (0.02, 0.1, 0.3)  # shares of all directions that may end beyond a wall of a fitted box
SIGHT = 32  # texels a side of a face that a place looks at
STRIDE = 2  # of them, for truths
TRUTHS, CANDIDATES = 48, 16  # groups of surfaces with a truth each, and of those with a place for a probe
OFF = 0.35  # of the distance: a point shown so far from the right one is as wrong as can be
HEIGHTS = 0.15, 0.5  # of what is free before a surface: where probes may be
LOBE, SPREAD = 8, 0.1  # directions weigh by a power of the cosine to where cameras look by a mirror, and a little all
LEAST_GAIN = 0.2, 1e-3  # of the error of a cell that more probes could take away, and of all: what a cut must
WORTH = 0.8  # of the sky's error: a probe that is not better shows wrong things sharply, and the sky is smooth
UNSEEN, LEAST_SHARE = 0.1, 0.01  # how much counts what a camera does not see, and what is ever so far away
FADE = 0.05  # of a box's diagonal, over which it gives way to the next: no wider than walls between rooms
FACES = (  # right, up and forward of +X -X +Y -Y +Z -Z, as lib/probe.glsl reads them
    ((0, 0, 1), (0, 1, 0), (1, 0, 0)), ((0, 0, -1), (0, 1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, 1), (0, 1, 0)), ((-1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1)), ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen from a point: distance (6, SIGHT, SIGHT) m along texel_directions(SIGHT), inf where the sky is."""

    position: F64
    distance: F64

    @cached_property
    def points(self) -> F64:
        """(6 SIGHT^2, 3) world, infinite where the sky is."""
        distance = self.distance.reshape(-1, 1)
        with np.errstate(invalid="ignore"):
            found = self.position + distance * texel_directions(SIGHT).reshape(-1, 3)
        return np.where(np.isfinite(distance), found, np.inf)

    @cached_property
    def farthest(self) -> F64:
        """(6 SIGHT^2,) m, of each texel and those around it."""
        padded = np.pad(self.distance, ((0, 0), (1, 1), (1, 1)), mode="edge")
        around = [padded[:, y : y + SIGHT, x : x + SIGHT] for y in range(3) for x in range(3)]
        return np.asarray(np.max(around, axis=0).ravel())

    def sees(self, points: F64) -> NDArray[np.bool_]:
        """(N,) whether nothing stands before points (N, 3), to a texel."""
        way = points - self.position
        return np.asarray(self.farthest[_texel(way)] > 0.97 * np.linalg.norm(way, axis=-1))


def _texel(way: F64) -> NDArray[np.int64]:
    """(...,) row of a Sight's points in directions (..., 3)."""
    axis = np.abs(way).argmax(-1)

    def part(axis: NDArray[np.int64]) -> F64:
        return np.take_along_axis(way, axis[..., None], -1)[..., 0]

    major = part(axis)
    face = 2 * axis + (major < 0)
    scale = 0.5 * SIGHT / np.maximum(np.abs(major), 1e-300)
    across, up = (part(_AXES[k][face]) * (_SIGNS[k][face] * scale) + 0.5 * SIGHT for k in (0, 1))
    x, y = (np.clip(v, 0, SIGHT - 1).astype(np.int64) for v in (across, up))
    return np.asarray((face * SIGHT + y) * SIGHT + x)


Look = Callable[[F64], Sight]
_TURNS = [np.array([f[k] for f in FACES], np.float64) for k in (0, 1)]  # of each face: unit axes to the right and up
_AXES = [np.abs(turn).argmax(-1) for turn in _TURNS]
_SIGNS = [turn.sum(-1) for turn in _TURNS]


def place(surfaces: Surfaces, eyes: list[F64], bounds: F64, count: int, blend: float, look: Look) -> tuple[Probe, ...]:
    """At most `count` probes.

    eyes: where the scene's cameras stand: what they see counts more. bounds: (2, 3) of what is drawn. look: what is
    seen from a point. blend: m around a box over which its probe gives way, at least.
    """
    extent = float(np.linalg.norm(bounds[1] - bounds[0])) or 1.0
    sights = [look(eye) for eye in eyes]
    places = sights + [look(bounds.mean(0))] + ([look((eyes[0] + bounds.mean(0)) / 2)] if eyes else [])
    if not len(surfaces.point):
        return ()
    surfaces = _seen_from(surfaces, eyes, sights, extent)
    groups = _groups(surfaces, TRUTHS)
    truths = [_truth(surfaces, groups == k, 1e-3 * extent, look) for k in range(int(groups.max()) + 1)]
    coarse = _groups(surfaces, CANDIDATES)
    middles = [_middle(surfaces, np.flatnonzero(coarse == k)) for k in range(int(coarse.max()) + 1)]
    for truth in (truths[groups[row]] for row in middles):
        ahead = truth.sight.distance.ravel()[_texel(truth.normal)]
        free = min(float(ahead), _openness(truth.sight, extent))
        places += [look(truth.sight.position + share * free * truth.normal) for share in HEIGHTS]
    options = [_Option(s, fit(s, bounds, wall)) for s in places for wall in WALLS]
    alone = [float(truth.share @ np.isfinite(truth.point).all(-1)) for truth in truths]
    wrong = np.concatenate([_errors(options, truths), [alone]])
    wrong[-1] *= WORTH
    error = wrong.T[groups] * surfaces.weight[:, None]  # of each point under each option, the sky last
    worst = float(error[:, -1].sum())
    cells = [_Cell(np.arange(len(groups)), np.array([bounds[0] - extent, bounds[1] + extent]))]
    while len(cells) < count:
        cuts = [_best_cut(cell, surfaces.point, error) for cell in cells]
        k = int(np.argmax([cut.gain for cut in cuts]))
        if not cuts[k].gain > LEAST_GAIN[1] * worst:
            break
        cells[k : k + 1] = _halves(cells[k], surfaces.point, cuts[k])
    found = []
    for k, cell in enumerate(cells):
        left = error[cell.rows].sum(0)
        best = int(left[:-1].argmin())
        if left[best] < left[-1]:  # else the sky, at no cost
            found.append(_bounded(options[best], cell, surfaces, blend, k))
    return tuple(found)


class _Cell(NamedTuple):
    """rows (R,) of the points in a box (2, 3) of space."""

    rows: NDArray[np.int64]
    box: F64


class _Cut(NamedTuple):
    gain: float
    axis: int = 0
    at: float = 0.0


def _best_cut(cell: _Cell, points: F64, error: F64) -> _Cut:
    """The plane that leaves least error (N, options) to the best option on either side; of equals in the widest gap.

    Without gain where no plane takes enough away.
    """
    best = _Cut(0.0)
    whole = error[cell.rows].sum(0)
    removable = float(whole.min() - error[cell.rows].min(1).sum())
    for axis in range(3):
        rows = cell.rows[np.argsort(points[cell.rows, axis], kind="stable")]
        places, below = points[rows, axis], np.cumsum(error[rows], axis=0)
        gap = np.diff(places)
        left = below[:-1].min(1) + (whole - below[:-1]).min(1)
        gain = whole.min() - left - 1e-3 * whole.min() * (1 - gap / max(float(gap.max(initial=0)), 1e-30))
        gain[gap <= 0] = 0
        if len(gain) and gain.max() > max(best.gain, LEAST_GAIN[0] * removable):
            k = int(gain.argmax())
            best = _Cut(float(gain[k]), axis, float(places[k] + places[k + 1]) / 2)
    return best


def _halves(cell: _Cell, points: F64, cut: _Cut) -> list[_Cell]:
    low = points[cell.rows, cut.axis] < cut.at
    boxes = cell.box.copy(), cell.box.copy()
    boxes[0][1, cut.axis] = boxes[1][0, cut.axis] = cut.at
    return [_Cell(cell.rows[low], boxes[0]), _Cell(cell.rows[~low], boxes[1])]


@dataclass(frozen=True, eq=False)
class _Truth:
    """What is around a group of surfaces: points (D, 3) in directions (D, 3), share (D,) of each in their mirror."""

    sight: Sight
    normal: F64
    way: F64
    point: F64
    share: F64


class _Option(NamedTuple):
    sight: Sight
    probe: Probe


def _seen_from(surfaces: Surfaces, eyes: list[F64], sights: list[Sight], extent: float) -> Surfaces:
    """Weighted by what cameras make of them: by nearness, and a quarter where they do not see them. Fronts of two
    sides are those seen."""
    if not eyes:
        return surfaces
    way = surfaces.point[None] - np.array(eyes)[:, None]
    far = np.linalg.norm(way, axis=-1)
    way /= np.maximum(far, 1e-12)[..., None]
    nearest = np.take_along_axis(way, far.argmin(0)[None, :, None], 0)[0]
    across = surfaces.two_sided & ((nearest * surfaces.normal).sum(-1) > 0)
    normal = np.where(across[:, None], -surfaces.normal, surfaces.normal)
    seen = np.array([s.sees(surfaces.point) for s in sights]) & ((way * normal).sum(-1) < 0)
    scale = max(_openness(s, extent) for s in sights)
    share = np.maximum(np.where(seen, 1.0, UNSEEN) / (1 + (far / scale) ** 2), LEAST_SHARE)
    mirror = way - 2 * (way * normal).sum(-1, keepdims=True) * normal
    return surfaces._replace(
        normal=normal, weight=surfaces.weight * share.max(0), mirror=mirror, share=share / share.sum(0)
    )


def _openness(sight: Sight, reach: float) -> float:
    """How far a point sees: the geometric mean of distances, m, up to `reach`. In a corner it is small."""
    near = np.clip(sight.distance, 1e-4 * reach, reach)
    return float(np.exp(np.average(np.log(near), weights=np.broadcast_to(_solid_angles(SIGHT), near.shape))))


def _groups(surfaces: Surfaces, count: int) -> NDArray[np.int64]:
    """(N,) number of the group of each point: near each other and turned alike, by k-means from k-means++."""
    reach = np.sqrt(np.average(((surfaces.point - np.median(surfaces.point, 0)) ** 2).sum(1), weights=surfaces.weight))
    at = np.concatenate([surfaces.point, 0.5 * reach * surfaces.normal], axis=1)
    rng = np.random.default_rng(1)
    centres = at[[int(np.argmax(surfaces.weight))]]
    for _ in range(count - 1):
        apart = ((at[:, None] - centres[None]) ** 2).sum(-1).min(1) * surfaces.weight
        if not apart.sum() > 0:
            break
        centres = np.concatenate([centres, at[[rng.choice(len(at), p=apart / apart.sum())]]])
    for _ in range(8):
        nearest = ((at[:, None] - centres[None]) ** 2).sum(-1).argmin(1)
        used = np.unique(nearest)
        centres = np.array([np.average(at[nearest == k], axis=0, weights=surfaces.weight[nearest == k]) for k in used])
    nearest = ((at[:, None] - centres[None]) ** 2).sum(-1).argmin(1)
    return np.asarray(np.unique(nearest, return_inverse=True)[1])


def _middle(surfaces: Surfaces, rows: NDArray[np.int64]) -> int:
    """The one of some points that is nearest to their mean."""
    point, weight = surfaces.point[rows], surfaces.weight[rows]
    return int(rows[((point - np.average(point, axis=0, weights=weight)) ** 2).sum(1).argmin()])


def _truth(surfaces: Surfaces, mine: NDArray[np.bool_], off: float, look: Look) -> _Truth:
    """What is seen from just off the middle of a group."""
    point, normal = (a[_middle(surfaces, np.flatnonzero(mine))] for a in (surfaces.point, surfaces.normal))
    sight = look(point + off * normal)
    few = slice(STRIDE // 2, None, STRIDE)
    rows = np.arange(6 * SIGHT * SIGHT).reshape(6, SIGHT, SIGHT)[:, few, few].ravel()
    way = texel_directions(SIGHT).reshape(-1, 3)[rows]
    lit = np.maximum(way @ surfaces.normal[mine].T, 0)
    if surfaces.mirror is not None and surfaces.share is not None:
        pairs = zip(surfaces.mirror[:, mine], surfaces.share[:, mine], strict=True)
        lit = lit * (SPREAD + sum(share * np.maximum(way @ mirror.T, 0) ** LOBE for mirror, share in pairs))
    lit = lit @ surfaces.weight[mine] * np.tile(_solid_angles(SIGHT)[few, few].ravel(), 6)
    used = lit > 0
    return _Truth(sight, normal, way[used], sight.points[rows[used]], lit[used] / lit.sum())


def _errors(options: Sequence[_Option], truths: Sequence[_Truth]) -> F64:
    """(options, truths) how wrong each probe's image is on each group, 0 to 1."""
    counts = [len(truth.way) for truth in truths]
    eye = np.repeat([truth.sight.position for truth in truths], counts, axis=0)
    way, point, share = (np.concatenate([getattr(t, name) for t in truths]) for name in ("way", "point", "share"))
    sky, reach = ~np.isfinite(point).all(-1), OFF * _length(point - eye)
    group = np.repeat(np.arange(len(truths)), counts)
    wrong = (share * _wrong(option, eye, way, point, sky, reach) for option in options)
    return np.array([np.bincount(group, one, len(truths)) for one in wrong])


def _wrong(option: _Option, eye: F64, way: F64, point: F64, sky: NDArray[np.bool_], reach: F64) -> F64:
    """(D,) how wrong a probe's image is, 0 to 1, where one sees points (D, 3) in directions (D, 3) from eyes (D, 3)."""
    low, high = np.array(option.probe.low), np.array(option.probe.high)
    start = np.clip(eye, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(way > 0, high - start, low - start) / way
        wall = np.minimum.reduce(np.where(way == 0, np.inf, t).T)  # of three columns: NumPy is slow over rows of three
        shown = option.sight.points[_texel(start + wall[:, None] * way - option.sight.position)]
        texel = 3 / SIGHT * _length(shown - option.sight.position)  # one and a half: as far as is known
        wrong = np.minimum(np.maximum(_length(shown - point) - texel, 0) / reach, 1.0)
    sky_shown = np.isinf(shown[:, 0])
    return np.where(sky | sky_shown, sky != sky_shown, wrong)


def _length(v: F64) -> F64:
    return np.asarray(np.sqrt(np.einsum("...i,...i", v, v)))


def _bounded(option: _Option, cell: _Cell, surfaces: Surfaces, blend: float, k: int) -> Probe:
    """Probe k, for the surfaces in a cell. It fades out around that, but not into what it does not see."""
    mine = np.zeros(len(surfaces.point), bool)
    mine[cell.rows] = True
    own, others = surfaces.point[mine], np.flatnonzero(~mine)
    fade = max(blend, FADE * float(np.linalg.norm(np.ptp(own, axis=0)))) if len(own) else blend
    point = surfaces.point[others]
    away = np.maximum(cell.box[0] - point, point - cell.box[1]).max(1, initial=0)
    near = np.flatnonzero((away < fade) & ~option.sight.sees(point)) if len(others) else others
    for row in near.tolist():  # those that are no continuation of what is its own: behind a wall
        apart = np.linalg.norm(own - point[row], axis=1)
        alike = surfaces.normal[mine] @ surfaces.normal[others[row]] > 0.5
        if not (apart[alike] < 4 * fade).any():
            fade = min(fade, 0.5 * float(away[row]))
    reach = tuple(cell.box[0].tolist()), tuple(cell.box[1].tolist())
    return replace(option.probe, reach=reach, fade=fade, name=f"automatic {k + 1}")


def fit(sight: Sight, bounds: F64, wall: float) -> Probe:
    """A probe and its box: as far along each axis as all but `wall` of directions see; to the bounds where sky is."""
    low, high = bounds[0].copy(), bounds[1].copy()
    position, points, solid_angle = sight.position, sight.points, np.tile(_solid_angles(SIGHT).ravel(), 6)
    seen = np.isfinite(points).all(-1)
    if seen.any():
        points, weight = points[seen], solid_angle[seen]
        for axis in range(3):
            order = np.argsort(points[:, axis])
            share = np.cumsum(weight[order]) / solid_angle.sum()
            values = points[order, axis]
            low[axis] = max(low[axis], values[min(np.searchsorted(share, wall / 2), len(values) - 1)])
            high[axis] = min(high[axis], values[np.searchsorted(share, share[-1] - wall / 2).clip(0, len(values) - 1)])
    # The probe is inside, whatever it saw, and boxes have a size.
    least = 1e-3 * float(np.linalg.norm(bounds[1] - bounds[0])) or 1e-3
    low, high = np.minimum(low, position - least), np.maximum(high, position + least)
    return Probe(tuple(position.tolist()), tuple(low.tolist()), tuple(high.tolist()))


@cache
def texel_directions(size: int) -> F64:
    """(6, size, size, 3) unit, of the texels of faces without a border, row 0 at the bottom."""
    edge = (np.arange(size) + 0.5) / size * 2 - 1
    right, up, forward = (np.array([f[k] for f in FACES], np.float64)[:, None, None] for k in range(3))
    way = forward + edge[None, None, :, None] * right + edge[None, :, None, None] * up
    return np.asarray(way / np.linalg.norm(way, axis=-1, keepdims=True))


def _solid_angles(size: int) -> F64:
    """(size, size) of the texels of a face without a border, up to a factor."""
    return solid_angles(size + 2)[1:-1, 1:-1]


def face_pose(position: F64, face: int) -> F64:
    """(4, 4) world_from_view of a face's camera."""
    right, up, forward = (np.array(v, np.float64) for v in FACES[face])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, up, -forward, position
    return pose


def solid_angles(size: int) -> F64:
    """(size, size) of the texels of a face with a border texel on each side, which count nothing."""
    edge = (np.arange(size) + 0.5 - size / 2) / (size / 2 - 1)
    u, v = np.meshgrid(edge, edge)
    inside = (np.abs(u) < 1) & (np.abs(v) < 1)
    return np.where(inside, (1 + u * u + v * v) ** -1.5, 0.0)


def equirect(faces: F64, width: int, height: int) -> F64:
    """(6, S, S, 3) faces with a border texel, row 0 at the bottom, as an equirect (H, W, 3), row 0 at +Y; bilinear."""
    theta = ((np.arange(height) + 0.5) / height * np.pi)[:, None]
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    d = np.stack(np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)), -1)
    axis = np.abs(d).argmax(-1)
    major = np.take_along_axis(d, axis[..., None], -1)[..., 0]
    face = 2 * axis + (major < 0)
    right, up = (np.array([f[k] for f in FACES], np.float64)[face] for k in (0, 1))
    size = faces.shape[1]
    u, v = (((d * way).sum(-1) / np.abs(major) * 0.5 + 0.5) * (size - 2) + 0.5 for way in (right, up))
    i, j = (np.clip(np.floor(x).astype(int), 0, size - 2) for x in (u, v))
    fu, fv = (u - i)[..., None], (v - j)[..., None]
    low = faces[face, j, i] * (1 - fu) + faces[face, j, i + 1] * fu
    high = faces[face, j + 1, i] * (1 - fu) + faces[face, j + 1, i + 1] * fu
    result: F64 = low * (1 - fv) + high * fv
    return result
