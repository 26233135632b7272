"""Normals and tangents where a file has none.

Tangents are those of MikkTSpace (Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited"; the reference is
mikktspace.c), which glTF 2.0, 3.7.2.1 asks for, so that normal maps baked elsewhere shade without seams. The steps are
the reference's, done on whole arrays: weld corners of equal position, normal and texture coordinate; join the corners
about a vertex across shared edges where the mapping keeps its handedness; sum the projected triangle tangents of each
such fan by the angle at the vertex. Quads are triangles here, and a fan is never split by the angle between its
tangents: at the default threshold of 180 degrees the reference splits only exactly opposite ones, an accident of
rounding. Where a surface has no direction in the texture the reference says +X; here it is some tangent of the surface.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glhybrid.scene import F32, F64, U32, MorphTarget, Triangles

I64 = NDArray[np.int64]
# A file may hold any numbers: the public functions run without floating-point warnings, what they make is checked.
VERTEX_ARRAYS = ("position", "normal", "tangent", "uv0", "uv1", "color", "joints", "weights")
MAX_RINGS = 8  # triangles without texture area between two with it about one vertex; deeper ones touch none with it
_TINY = np.finfo(np.float32).tiny  # the reference's "not zero"


@np.errstate(all="ignore")
def face_normals(position: F32, index: U32) -> F32:
    """(T, 3) unit normals of the triangles, counter-clockwise; (0, 0, 1) for those without area or not finite."""
    return _unit(_area_vectors(position, index), fallback=(0.0, 0.0, 1.0)).astype(np.float32)


@np.errstate(all="ignore")
def smooth_normals(position: F32, index: U32, weld: bool = True) -> F32:
    """(V, 3) unit vertex normals: triangle normals weighted by their angle at the vertex (Thuermer & Wuethrich 1998).

    weld: vertices at equal positions share a normal, so that a surface whose triangles share no vertices (STL) is
    smooth as well. Vertices that no triangle with area uses get (0, 0, 1).
    """
    n_face = _unit(_area_vectors(position, index))
    p = position[index].astype(np.float64)
    vertex = (first_equal_row(position) if weld else np.arange(len(position)))[index]
    total = np.zeros((len(position), 3))
    for corner in range(3):
        a = _unit(p[:, (corner + 1) % 3] - p[:, corner])
        b = _unit(p[:, (corner + 2) % 3] - p[:, corner])
        angle = np.nan_to_num(np.arccos(np.clip(_dot(a, b), -1.0, 1.0)))
        _add_rows(total, vertex[:, corner], n_face * angle[:, None])
    unit = _unit(total, fallback=(0.0, 0.0, 1.0)).astype(np.float32)
    return unit[first_equal_row(position)] if weld else unit


def flat(triangles: Triangles) -> Triangles:
    """The same triangles with one normal each. Un-shares every vertex: V becomes 3 T. Tangents are dropped."""
    normal = np.repeat(face_normals(triangles.position, triangles.index), 3, axis=0)
    split = take_vertices(triangles, triangles.index.ravel())
    morph_targets = tuple(replace(m, normal=None, tangent=None) for m in split.morph_targets)
    index = np.arange(len(normal), dtype=np.uint32).reshape(-1, 3)
    return replace(split, normal=normal, index=index, tangent=None, morph_targets=morph_targets)


def smooth(triangles: Triangles) -> Triangles:
    """The same triangles with smooth vertex normals. Tangents are dropped."""
    return replace(triangles, normal=smooth_normals(triangles.position, triangles.index), tangent=None)


@np.errstate(all="ignore")
def with_normals(triangles: Triangles, normal: NDArray[np.floating]) -> Triangles:
    """The same triangles with these normals (V, 3) at length 1; those without direction replaced by smooth ones."""
    unit = _unit(normal.astype(np.float64)).astype(np.float32)
    bad = ~np.any(unit, axis=1)
    if bad.any():
        unit[bad] = smooth_normals(triangles.position, triangles.index)[bad]
    return replace(triangles, normal=unit, tangent=None)


def with_tangents(triangles: Triangles, uv_set: int = 0, uv_transform: F64 | None = None) -> Triangles:
    """The same triangles with MikkTSpace tangents for a texture read with this UV set and transform.

    Vertices where fans of different handedness or direction meet are doubled, so V may grow. Without that UV set, or
    where the mapping gives no direction, the tangent is some unit vector square to the normal.
    """
    uv = triangles.uv1 if uv_set == 1 else triangles.uv0
    if uv is None:
        uv = np.zeros((len(triangles.position), 2), np.float32)
    if uv_transform is not None:
        uv = (uv @ uv_transform[:, :2].T.astype(np.float32)).astype(np.float32)
    tangent, source, index = tangents(triangles.position, triangles.normal, uv, triangles.index)
    if len(source) != len(triangles.position):
        triangles = take_vertices(triangles, source)
    return replace(triangles, tangent=tangent, index=index)


@np.errstate(all="ignore")
def tangents(position: F32, normal: F32, uv: F32, index: U32) -> tuple[F32, I64, U32]:
    """MikkTSpace tangents.

    position, normal (unit): (V, 3); uv: (V, 2), v down as in glTF; index: (T, 3).
    Returns tangent (W, 4) float32, unit, square to the normal, handedness in w (the bitangent cross(normal, tangent) w
    points to -v, which is up in the image); source (W,), the old vertex of each new one, which begins with 0 to V - 1;
    and the new index (T, 3). W > V only where corners of one vertex need different tangents.
    """
    weld = first_equal_row(np.concatenate([position, normal, uv], axis=1))[index]
    slope, positive, usable, healthy = _triangle_tangents(position, uv, index)
    fan, positive = _fans(weld, positive, usable, healthy)
    n = normal[index].reshape(-1, 3).astype(np.float64)
    weight = (_corner_angles(position, normal, index) * healthy[:, None]).ravel()
    total = np.zeros((len(fan), 3))
    _add_rows(total, fan, _unit(_project(np.repeat(slope, 3, axis=0), n)) * weight[:, None])
    roots = np.unique(fan)
    direction = np.zeros_like(total)
    direction[roots] = _unit(_project(total[roots], n[roots]))
    lost = roots[~direction[roots].any(axis=1)]
    direction[lost] = _any_square(n[lost])
    direction = direction[fan]
    sign = np.where(positive[fan // 3], -1.0, 1.0)  # v points down in glTF, up in MikkTSpace
    corner = np.concatenate([direction, sign[:, None]], axis=1).astype(np.float32)
    return _share_vertices(corner, index, normal)


def _share_vertices(corner: F32, index: U32, normal: F32) -> tuple[F32, I64, U32]:
    """Corners of one vertex with equal tangents share a vertex; the first tangent of a vertex keeps the old number."""
    vertex, count = index.ravel().astype(np.int64), len(normal)
    key = vertex * np.int64(len(corner) + 1) + first_equal_row(corner)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    new_vertex = vertex[first]  # of each pair of vertex and tangent, sorted: the pairs of one vertex are neighbours
    again = np.flatnonzero(new_vertex[1:] == new_vertex[:-1]) + 1
    source = np.concatenate([np.arange(count), new_vertex[again]])
    new_vertex[again] = count + np.arange(len(again))
    tangent = np.ones((len(source), 4), np.float32)
    tangent[new_vertex] = corner[first]
    unused = np.ones(len(source), bool)
    unused[new_vertex] = False
    if unused.any():
        tangent[unused, :3] = _any_square(normal[source[unused]].astype(np.float64))
    return tangent, source, new_vertex[inverse.ravel()].reshape(-1, 3).astype(np.uint32)


def _triangle_tangents(
    position: F32, uv: F32, index: U32
) -> tuple[F64, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Unit d position / d u of each triangle (T, 3), and whether the mapping keeps orientation, whether the triangle
    has three different positions, and whether it also has area in the texture."""
    p, t = position[index].astype(np.float64), uv[index]
    d1, d2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    t1, t2 = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]  # float32 as in the reference: the sign of a sliver counts
    area = t1[:, 0] * t2[:, 1] - t1[:, 1] * t2[:, 0]
    u_axis = t2[:, 1:] * d1 - t1[:, 1:] * d2  # Mikkelsen, eq. 18
    v_axis = t1[:, :1] * d2 - t2[:, :1] * d1  # eq. 19
    positive = area > 0
    usable = np.asarray(np.isfinite(p).all((1, 2)))
    for edge in (d1, d2, d2 - d1):
        usable &= _dot(edge, edge) > 0.0
    steep = np.minimum(_dot(u_axis, u_axis), _dot(v_axis, v_axis))
    healthy = usable & (np.abs(area) > _TINY) & (steep > 0.0) & np.isfinite(steep)
    slope = _unit(u_axis) * np.where(positive, 1.0, -1.0)[:, None]
    slope[~healthy] = 0.0
    return slope, positive, usable, healthy


def _fans(
    weld: I64, positive: NDArray[np.bool_], usable: NDArray[np.bool_], healthy: NDArray[np.bool_]
) -> tuple[I64, NDArray[np.bool_]]:
    """The fan of each corner (3 T,), named by its lowest corner, and the orientation of each triangle, in which
    triangles without area in the texture have taken that of a neighbour."""
    a, b = _edge_pairs(weld, usable)  # half edges 3 t + i from corner i to corner i + 1, which meet head to tail
    fan, known = _joined(a, b, positive, healthy), healthy
    for _ in range(MAX_RINGS):  # each round reaches one triangle further into a patch without area in the texture
        near, far = np.concatenate([a, b]), np.concatenate([b, a])
        reach = known[near // 3] & ~known[far // 3]
        if not reach.any():
            break
        near, far = near[reach], far[reach] // 3
        # The reference grows fans in the order of their first corners: the first to arrive decides.
        rank = np.minimum(fan[near], fan[_next(near)])
        order = np.lexsort((rank, far))
        far, first = np.unique(far[order], return_index=True)
        positive, known = positive.copy(), known.copy()
        positive[far] = positive[near[order[first]] // 3]
        known[far] = True
        fan = _joined(a, b, positive, known)
    if not np.array_equal(known, usable):
        fan = _joined(a, b, positive, usable)
    lost = np.repeat(~usable, 3)  # corners of triangles without area join any fan at their vertex: nobody sees them
    if lost.any():
        host = np.full(int(weld.max()) + 1, -1)
        host[weld.ravel()[~lost]] = fan[~lost]
        found = host[weld.ravel()]
        fan = np.where(lost & (found >= 0), found, fan)
    return fan, positive


def _joined(a: I64, b: I64, positive: NDArray[np.bool_], among: NDArray[np.bool_]) -> I64:
    """The fan of each corner: corners joined across half edges a and b of some triangles, of equal orientation."""
    ta, tb = a // 3, b // 3
    join = (positive[ta] == positive[tb]) & among[ta] & among[tb]
    a, b = a[join], b[join]
    return _components(3 * len(positive), np.concatenate([a, _next(a)]), np.concatenate([_next(b), b]))


def _next(half_edge: I64) -> I64:
    """The corner at the end of a half edge: the next one of the same triangle."""
    return np.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1)


def _edge_pairs(weld: I64, usable: NDArray[np.bool_]) -> tuple[I64, I64]:
    """Half edges of usable triangles that run in opposite directions between the same two vertices.

    Where more than two triangles share an edge the n-th of one direction meets the n-th of the other, by number, which
    is what the reference's first-come search comes to.
    """
    half = np.flatnonzero(np.repeat(usable, 3))
    start, end = weld.ravel()[half], weld.ravel()[_next(half)]
    low, high = np.minimum(start, end), np.maximum(start, end)
    undirected = low * np.int64(int(weld.max(initial=0)) + 1) + high
    order = np.argsort(undirected * 2 + (start > end), kind="stable")
    half, undirected, backward = half[order], undirected[order], (start > end)[order]
    begins = np.ones(len(half), bool)
    begins[1:] = (undirected[1:] != undirected[:-1]) | (backward[1:] != backward[:-1])
    rank = np.arange(len(half)) - np.maximum.accumulate(np.where(begins, np.arange(len(half)), 0))
    slot = np.flatnonzero(backward)
    # The forward partner of rank r of an edge lies r after the first of that edge.
    place = np.searchsorted(undirected, undirected[slot]) + rank[slot]
    met = ~backward[place] & (undirected[place] == undirected[slot])
    return half[place[met]], half[slot[met]]


def _components(count: int, a: I64, b: I64) -> I64:
    """The lowest node of each node's connected component: roots hook onto lower roots, then paths are halved."""
    label = np.arange(count)
    while len(a):
        la, lb = label[a], label[b]
        apart = la != lb
        a, b, la, lb = a[apart], b[apart], la[apart], lb[apart]
        np.minimum.at(label, np.maximum(la, lb), np.minimum(la, lb))
        while True:
            shorter = label[label]
            if np.array_equal(shorter, label):
                break
            label = shorter
    return label


def _corner_angles(position: F32, normal: F32, index: U32) -> F64:
    """(T, 3) angle of each triangle at each corner, radians, seen along the vertex normal."""
    angles = np.zeros(index.shape)
    p, n = position[index].astype(np.float64), normal[index].astype(np.float64)
    for i in range(3):
        to_next = _unit(_project(p[:, (i + 1) % 3] - p[:, i], n[:, i]))
        to_last = _unit(_project(p[:, (i + 2) % 3] - p[:, i], n[:, i]))
        angles[:, i] = np.arccos(np.clip(_dot(to_next, to_last), -1.0, 1.0))
    return np.nan_to_num(angles)


def _area_vectors(position: F32, index: U32) -> F64:
    p = position[index].astype(np.float64)
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


def _project(v: F64, n: F64) -> F64:
    """v without its part along the unit vector n."""
    return v - _dot(v, n)[:, None] * n


def _unit(v: F64, fallback: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> F64:
    """Rows of length 1; the fallback for rows that are zero or not finite."""
    length = np.sqrt(_dot(v, v))
    bad = ~(np.isfinite(length) & (length > 0.0))
    unit = v / length[:, None]
    if bad.any():
        unit[bad] = fallback
    return unit


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _any_square(n: F64) -> F64:
    """Some unit vector square to each unit n (Duff et al. 2017, "Building an Orthonormal Basis, Revisited")."""
    sign = np.copysign(1.0, n[:, 2])
    a = -1.0 / (sign + n[:, 2])
    square = np.stack([1.0 + sign * n[:, 0] ** 2 * a, sign * n[:, 0] * n[:, 1] * a, -sign * n[:, 0]], axis=1)
    return _unit(square, fallback=(1.0, 0.0, 0.0))


def _add_rows(total: F64, row: I64, values: F64) -> None:
    """total[row] += values, where rows repeat."""
    for k in range(total.shape[1]):
        total[:, k] += np.bincount(row, values[:, k], minlength=len(total))


def first_equal_row(rows: F32) -> I64:
    """(N,) the index of the first row with the same values (-0 equals 0; NaN equals a NaN of the same bits)."""
    bits = np.ascontiguousarray(rows + np.float32(0.0), np.float32).view(np.uint32)
    key = np.zeros(len(bits), np.uint64)
    for k in range(bits.shape[1]):  # multiply and fold: far cheaper to sort than whole rows
        key = (key ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    representative = first[inverse.ravel()]
    if not np.array_equal(bits[representative], bits):  # two rows with one key: compare in full
        _, first, inverse = np.unique(bits, axis=0, return_index=True, return_inverse=True)
        representative = first[inverse.ravel()]
    return representative


def take_vertices(triangles: Triangles, source: NDArray[np.integer]) -> Triangles:
    """All vertex arrays gathered by source; the index stays as it is."""
    arrays = {name: getattr(triangles, name) for name in VERTEX_ARRAYS}
    targets = [MorphTarget(*(None if a is None else a[source] for a in (m.position, m.normal, m.tangent)))
               for m in triangles.morph_targets]  # fmt: skip
    taken = {name: array[source] for name, array in arrays.items() if array is not None}
    return replace(triangles, **taken, morph_targets=tuple(targets))
