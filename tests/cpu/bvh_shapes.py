"""Meshes that break tree builders, and the rays to ask them with. All seeded."""

import numpy as np
from numpy.typing import NDArray

from glhybrid.bvh import Blas

Triangles = NDArray[np.float32]


def soup(count: int, seed: int, size: float = 0.05, centre: float = 0.0) -> Triangles:
    rng = np.random.default_rng(seed)
    return (rng.random((count, 1, 3)) + rng.normal(size=(count, 3, 3)) * size + centre).astype(np.float32)


def sphere(parts: int, radius: float = 2.0, centre: tuple[float, float, float] = (0, 0, 0)) -> Triangles:
    """A closed UV sphere; vertices shared by triangles are equal to the bit; poles have no empty triangles."""
    u = np.linspace(0, 2 * np.pi, 2 * parts + 1)[:-1]
    v = np.linspace(0, np.pi, parts + 1)
    ring = np.stack(
        [np.outer(np.sin(v), np.cos(u)), np.outer(np.cos(v), np.ones_like(u)), np.outer(np.sin(v), np.sin(u))]
    )
    ring[[0, 2], 0], ring[[0, 2], -1] = 0, 0
    points = (np.moveaxis(ring, 0, -1) * radius + np.array(centre)).astype(np.float32)
    points = np.concatenate([points, points[:, :1]], axis=1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.concatenate(
        [np.stack([a, c, b], -2)[:-1].reshape(-1, 3, 3), np.stack([a, d, c], -2)[1:].reshape(-1, 3, 3)]
    )
    return np.ascontiguousarray(triangles)


def progression(count: int = 175, ratio: float = 2.0) -> Triangles:
    """Triangles at ratio^i, up to 1e18: a midpoint split makes a chain of them."""
    x = ratio ** (np.arange(count) + 58.0 - count)
    base = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
    return ((base[None] * x[:, None, None] * 0.25) + x[:, None, None] * np.array([1.0, 0, 0])).astype(np.float32)


def needles(count: int, seed: int) -> Triangles:
    """Long and thin in every direction, 10^4 times as long as wide."""
    rng = np.random.default_rng(seed)
    along, across = rng.normal(size=(2, count, 3))
    start = rng.random((count, 3))
    return np.stack([start, start + along, start + along + across * 1e-4], 1).astype(np.float32)


def rods() -> Triangles:
    """Needles across a room of small things, as in architecture: reinsertion makes the tree of it cheaper."""
    return np.concatenate([soup(3000, 8, 0.004), needles(200, 9)])


def lattice(cells: int = 6) -> Triangles:
    """Axis-aligned quads on the planes of an integer grid: box faces meet rays exactly."""
    quads = []
    for axis in range(3):
        for i in range(cells):
            for j in range(cells):
                corner = np.array([i % 3, i, j], np.float32)
                corners = [corner + np.array([0, a, b], np.float32) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
                corners = [np.roll(c, axis) for c in corners]
                quads += [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
    return np.array(quads, np.float32)


def chain(count: int) -> Triangles:
    """Sizes and distances so uneven that SAH takes single triangles off the end, over and over, on all axes in turn."""
    parts = [progression(count // 3, 1.07) * np.float32(1e-9) for _ in range(3)]
    return np.concatenate([np.roll(p, k, axis=2) for k, p in enumerate(parts)])


SHAPES = {
    "one": lambda seed: soup(1, seed),
    "two": lambda seed: soup(2, seed),
    "leaf": lambda seed: soup(4, seed),
    "five": lambda seed: soup(5, seed),
    "equal": lambda seed: np.repeat(soup(1, seed), 300, axis=0),
    "equal-many": lambda seed: np.repeat(soup(3, seed), 1500, axis=0),
    "flat": lambda seed: (soup(3000, seed) * np.float32([1, 0, 1])),
    "line": lambda seed: (soup(2000, seed, 0.01) * np.float32([1, 1e-7, 1e-7])),
    "needles": lambda seed: needles(3000, seed),
    "far": lambda seed: soup(3000, seed, centre=1e6),
    "huge": lambda seed: soup(2000, seed) * np.float32(1e15),
    "tiny": lambda seed: soup(2000, seed) * np.float32(1e-9),
    "progression": lambda seed: progression(),
    "chain": lambda seed: chain(900),
    "duplicates": lambda seed: np.repeat(soup(1500, seed), 2, axis=0),
    "lattice": lambda seed: lattice(),
    "sphere": lambda seed: sphere(24),
    "stadium": lambda seed: np.concatenate([soup(2000, seed) * np.float32(1e-4), soup(2, seed) * np.float32(1e3)]),
    "soup": lambda seed: soup(20_000, seed, 0.01),
}  # fmt: skip


def rays(triangles: Triangles, count: int, seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Half towards a point of some triangle, from 1 to 1000 of its sizes away, half from a box about all, anywhere."""
    rng = np.random.default_rng(seed)
    low, high = triangles.reshape(-1, 3).min(0).astype(np.float64), triangles.reshape(-1, 3).max(0).astype(np.float64)
    extent = max(float((high - low).max()), 1e-30)
    half = count // 2
    weights = rng.dirichlet((1, 1, 1), half)
    chosen = triangles[rng.integers(len(triangles), size=half)].astype(np.float64)
    target = np.einsum("rv,rvk->rk", weights, chosen)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = np.ptp(chosen, axis=1).max(1, keepdims=True)
    outside = target - direction[:half] * size * 10 ** rng.uniform(0, 3, (half, 1))
    inside = rng.uniform(low - 0.1 * extent, high + 0.1 * extent, (count - half, 3))
    return np.concatenate([outside, inside]).astype(np.float32), direction.astype(np.float32)


def axis_rays() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """All 26 axis and diagonal directions from the corners and centres of an integer lattice."""
    steps = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], np.float32)
    places = np.array([(x, y, z) for x in range(-1, 8) for y in range(-1, 8) for z in range(-1, 8)], np.float32)
    places = np.concatenate([places, places + np.float32(0.5), places + np.float32([0.5, 0, 0.25])])
    return np.repeat(places, len(steps), axis=0), np.tile(steps, (len(places), 1))


def same(a: Blas, b: Blas) -> bool:
    """Equal to the bit, but for how long it took to build."""
    arrays = ("nodes", "slots", "grid_min", "grid_step", "bounds")
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in arrays) and (a.depth, a.sah_cost) == (
        b.depth,
        b.sah_cost,
    )
