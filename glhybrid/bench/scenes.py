"""The scenes of the bench: a columned hall, spheres on a plane, a box city, at any number of triangles.

All surfaces of a scene are cut into cells of one size, so that a scene keeps its shape while its triangles get smaller:
rates then show what the tree costs, not what the scene is. Every body is a mesh of its own, none is repeated, so that
a scene can be traced in one level or in two.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glhybrid.errors import SettingError, unknown
from glhybrid.scene import F64, Camera, Instance, Light, Material, Mesh, Scene, Triangles

SMALLEST, LARGEST = 2_000, 64_000_000  # triangles


@dataclass(frozen=True)
class Surface:
    """A curved rectangle: place (R, C, 3) and unit normal of v (R, 1) and u (1, C) in 0..1; its sides in metres."""

    width: float
    height: float
    place: Callable[[F64, F64], tuple[F64, F64]]
    closed: bool = False  # the last column is the first again
    poles: bool = False  # the first and the last row are points

    def cells(self, size: float) -> tuple[int, int]:
        """Columns and rows of cells no larger than `size` metres."""
        return max(round(self.width / size), 6 if self.closed else 1), max(round(self.height / size), 3 * self.poles, 1)

    def triangles(self, size: float) -> int:
        """How many cut() would make."""
        columns, rows = self.cells(size)
        return 2 * columns * (rows - self.poles)

    def cut(self, size: float) -> tuple[F64, F64, NDArray[np.int64]]:
        """Positions (V, 3), normals (V, 3), triangles (T, 3): counter-clockwise from the front."""
        columns, rows = self.cells(size)
        u, v = np.linspace(0, 1, columns + 1)[None, :], np.linspace(0, 1, rows + 1)[:, None]
        position, normal = self.place(u, v)
        corner = np.arange(position[..., 0].size).reshape(rows + 1, columns + 1)
        if self.closed:
            corner[:, -1] = corner[:, 0]
        a, b, c, d = (q.ravel() for q in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
        lower, upper = np.stack([a, c, d], 1), np.stack([a, d, b], 1)
        if self.poles:
            lower, upper = lower[:-columns], upper[columns:]
        return position.reshape(-1, 3), normal.reshape(-1, 3), np.concatenate([lower, upper])


def _flat(corner: Sequence[float], right: Sequence[float], down: Sequence[float]) -> Surface:
    """A rectangle seen from its front: its top left corner and its sides."""
    a, b = np.asarray(right, np.float64), np.asarray(down, np.float64)
    normal = np.cross(b, a)
    normal /= np.linalg.norm(normal)

    def place(u: F64, v: F64) -> tuple[F64, F64]:
        position = np.asarray(corner, np.float64) + u[..., None] * a + v[..., None] * b
        return position, np.broadcast_to(normal, position.shape)

    return Surface(float(np.linalg.norm(a)), float(np.linalg.norm(b)), place)


def _box(low: Sequence[float], high: Sequence[float]) -> list[Surface]:
    """Four walls and a roof."""
    (x, y, z), (w, h, d) = low, np.subtract(high, low)
    down = (0, -h, 0)
    return [
        _flat((x, y + h, z + d), (w, 0, 0), down), _flat((x + w, y + h, z + d), (0, 0, -d), down),
        _flat((x + w, y + h, z), (-w, 0, 0), down), _flat((x, y + h, z), (0, 0, d), down),
        _flat((x, y + h, z), (w, 0, 0), (0, 0, d)),
    ]  # fmt: skip


def _shaft(x: float, z: float, radius: float, height: float) -> Surface:
    """An upright round shaft, from the ground up."""

    def place(u: F64, v: F64) -> tuple[F64, F64]:
        turn = 2 * np.pi * u + 0 * v
        out = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], -1)
        return radius * out + np.stack([x + 0 * turn, height * (1 - v) + 0 * turn, z + 0 * turn], -1), out

    return Surface(2 * np.pi * radius, height, place, closed=True)


def _ball(centre: Sequence[float], radius: float) -> Surface:
    def place(u: F64, v: F64) -> tuple[F64, F64]:
        ring = np.sin(np.pi * v)
        ring[[0, -1]] = 0.0  # sin(pi) is not quite 0
        turn = 2 * np.pi * u
        out = np.stack([ring * np.sin(turn), np.cos(np.pi * v) + 0 * turn, ring * np.cos(turn)], -1)
        return np.asarray(centre, np.float64) + radius * out, out

    return Surface(2 * np.pi * radius, np.pi * radius, place, closed=True, poles=True)


@dataclass(frozen=True)
class Site:
    """What a scene is made of: bodies, each of some surfaces; where it is looked at from and lit."""

    bodies: list[list[Surface]]
    camera: Camera
    light: Light


def _hall() -> Site:
    """A hall of 16 x 8 x 40 m with three rows of columns, seen along it, lit by one lamp: every ray meets something."""
    w, h, d = 16.0, 8.0, 40.0
    down, along, across = (0, -h, 0), (0, 0, d), (w, 0, 0)
    room = [
        _flat((-w / 2, 0, -d / 2), across, along), _flat((-w / 2, h, d / 2), across, (0, 0, -d)),
        _flat((-w / 2, h, -d / 2), across, down), _flat((w / 2, h, d / 2), (-w, 0, 0), down),
        _flat((-w / 2, h, d / 2), (0, 0, -d), down), _flat((w / 2, h, -d / 2), along, down),
    ]  # fmt: skip
    columns = [[_shaft(x, z, 0.45, h)] for x in (-5.0, 0.0, 5.0) for z in np.linspace(-17, 17, 12)]
    camera = Camera.look_at((-2.8, 3.2, 19.0), (1.0, 2.6, -8.0), fov_y=np.radians(60))
    return Site([room, *columns], camera, Light("point", intensity=500.0, position=(2.5, 6.5, 4.0)))


def _spheres() -> Site:
    """144 balls of many sizes on a plane of 48 x 48 m under the sun: silhouettes, contacts and sky."""
    rng = np.random.default_rng(7)
    bodies = [[_flat((-24, 0, -24), (48, 0, 0), (0, 0, 48))]]
    for x in np.linspace(-20, 20, 12):
        for z in np.linspace(-20, 20, 12):
            r = rng.uniform(0.5, 1.6)
            at = rng.uniform(-0.2, 0.2, 2)
            bodies.append([_ball((x + at[0], r, z + at[1]), r)])
    camera = Camera.look_at((14.0, 7.0, 26.0), (0.0, 0.5, 0.0), fov_y=np.radians(50))
    return Site(bodies, camera, Light("directional", direction=_sun(38, 60)))


def _city() -> Site:
    """24 x 24 houses with streets between, 64 blocks, seen from above a corner, low sun: occlusion, depth."""
    rng = np.random.default_rng(3)
    blocks: list[list[Surface]] = [[] for _ in range(64)]
    for i in range(24):
        for j in range(24):
            x, z = (i - 12) * 20.0 + 10 * (i // 3 - 4), (j - 12) * 20.0 + 10 * (j // 3 - 4)
            height = float(rng.uniform(8, 30) + (rng.random() < 0.12) * rng.uniform(20, 70))
            inset = rng.uniform(1, 4, 4)
            house = _box((x + inset[0], 0, z + inset[1]), (x + 20 - inset[2], height, z + 20 - inset[3]))
            blocks[i // 3 * 8 + j // 3] += house
    ground = [_flat((-300, 0, -300), (600, 0, 0), (0, 0, 600))]
    camera = Camera.look_at((230.0, 75.0, 260.0), (40.0, 5.0, 30.0), fov_y=np.radians(50))
    return Site([ground, *blocks], camera, Light("directional", direction=_sun(28, 215)))


def _sun(elevation_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    """The way its light travels."""
    e, a = np.radians(elevation_deg), np.radians(azimuth_deg)
    return -float(np.cos(e) * np.sin(a)), -float(np.sin(e)), -float(np.cos(e) * np.cos(a))


SITES: dict[str, Callable[[], Site]] = {"hall": _hall, "spheres": _spheres, "city": _city}


def make(name: str, triangles: int) -> Scene:
    """The scene of that name (SITES) with about that many triangles: within 3 % from 10,000 on."""
    if name not in SITES:
        raise SettingError(unknown("bench scene", name, SITES))
    if not SMALLEST <= triangles <= LARGEST:
        raise SettingError(f"{name}: {triangles} triangles asked for; the bench makes {SMALLEST} to {LARGEST}")
    site = SITES[name]()
    size = _cell_size([s for body in site.bodies for s in body], triangles)
    meshes = tuple(Mesh(f"{name} {i}", (_piece(body, size),)) for i, body in enumerate(site.bodies))
    return Scene(
        name,
        meshes=meshes,
        instances=tuple(Instance(i, np.eye(4), mesh.name) for i, mesh in enumerate(meshes)),
        materials=(Material(double_sided=True),),
        lights=(site.light,),
        cameras=(site.camera,),
    )


def ball(triangles: int) -> Triangles:
    """A ball of radius 1 m about the origin, of about that many triangles."""
    surface = _ball((0, 0, 0), 1.0)
    return _piece([surface], _cell_size([surface], triangles))


def floor() -> Mesh:
    """The plane that the spheres stand on, as one square."""
    return Mesh("floor", (_piece(SITES["spheres"]().bodies[0], 1e3),))


def _piece(surfaces: list[Surface], size: float) -> Triangles:
    parts = [surface.cut(size) for surface in surfaces]
    first = np.cumsum([0, *(len(position) for position, _, _ in parts[:-1])])
    return Triangles(
        position=np.concatenate([position for position, _, _ in parts]).astype(np.float32),
        index=np.concatenate([index + at for (_, _, index), at in zip(parts, first, strict=True)]).astype(np.uint32),
        normal=np.concatenate([normal for _, normal, _ in parts]).astype(np.float32),
    )


def _cell_size(surfaces: list[Surface], triangles: int) -> float:
    """The cell whose count comes closest."""
    low, high = 1e-4, 1e3
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if sum(s.triangles(middle) for s in surfaces) > triangles else (low, middle)
    return min((low, high), key=lambda size: abs(sum(s.triangles(size) for s in surfaces) - triangles))
