"""Rays and meshes for the tests of the tracer, and a Tracer that sends the rays through glsl/lib as the passes do."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from glhybrid import geometry, layout, needs
from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene
from glhybrid.scene import F32, F64, U32, Instance, Material, Mesh, Scene, Sphere, Triangles
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders

SCALE = float(os.environ.get("GLHYBRID_TEST_SCALE", "1"))  # of the number of rays; 100 is the full run
NO_HIT = 0xFFFFFFFF
HERE = Path(__file__).resolve().parent
EMBREE_FAR = np.array([148376.0, 1234.0, -223423.0])  # where Embree's own watertight test puts its sphere
Array = NDArray[Any]


def count(full: int) -> int:
    """Rays of a full run -> rays of this run, at least 1000."""
    return int(np.clip(full * SCALE / 100, min(1000, full), full))


def say(line: str) -> None:
    """A figure for the record, in full runs (give pytest -s)."""
    if SCALE > 1:
        print(line, flush=True)


# --- scenes --------------------------------------------------------------------------------------------------------


def piece(position: Any, index: Any, material: int = 0, uv: Any = None) -> Triangles:
    """Triangles with the normals of their faces at the vertices that they use last: tests of rays do not read them."""
    position = np.ascontiguousarray(position, np.float32)
    index = np.ascontiguousarray(index, np.uint32)
    normal = np.zeros_like(position)
    with np.errstate(invalid="ignore", over="ignore"):
        corner = position[index].astype(np.float64)
        face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        length = np.linalg.norm(face, axis=1, keepdims=True)
        face = np.divide(face, length, out=np.zeros_like(face), where=length > 0)
    for k in range(3):
        normal[index[:, k]] = face
    return Triangles(position, index, normal, material, uv0=None if uv is None else np.asarray(uv, np.float32))


def soup(corners: Any, material: int = 0) -> Triangles:
    """(T, 3, 3) corners as triangles that share no vertex, so that each has its own normal."""
    corners = np.ascontiguousarray(corners, np.float32).reshape(-1, 3)
    return piece(corners, np.arange(len(corners)).reshape(-1, 3), material)


def scene_of(
    *pieces: Triangles | Sphere, poses: Sequence[Any] = (), materials: Sequence[Material] = (), **more: Any
) -> Scene:
    """Every piece a mesh, placed once by its pose (identity if there is none)."""
    matrices = [np.asarray(p, np.float64) for p in poses] or [np.eye(4)] * len(pieces)
    return Scene(
        "test",
        meshes=tuple(Mesh(f"mesh {i}", (p,)) for i, p in enumerate(pieces)),
        instances=tuple(Instance(i, m, f"instance {i}") for i, m in enumerate(matrices)),
        materials=tuple(materials) or (Material(double_sided=True),),
        **more,
    )


def moved(offset: Any, linear: Any = None) -> F64:
    """(4, 4) float64: linear, then a translation."""
    pose = np.eye(4)
    if linear is not None:
        pose[:3, :3] = linear
    pose[:3, 3] = offset
    return pose


def rotation(rng: np.random.Generator) -> F64:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def uv_sphere(n: int, radius: float = 2.0) -> tuple[F64, U32]:
    """A closed sphere of n rows and 2n columns, every vertex once: (V, 3) positions and (T, 3) indices."""
    theta = np.pi * np.arange(1, n)[:, None] / n
    phi = np.pi * np.arange(2 * n)[None] / n
    ring = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta) + 0 * phi, np.sin(theta) * np.sin(phi)], -1)
    position = radius * np.concatenate([[[0, 1, 0]], ring.reshape(-1, 3), [[0, -1, 0]]])
    row, col = np.meshgrid(np.arange(n - 2), np.arange(2 * n), indexing="ij")
    a, b = 1 + row * 2 * n + col, 1 + row * 2 * n + (col + 1) % (2 * n)
    quads = np.concatenate(
        [np.stack([a, b, a + 2 * n], -1).reshape(-1, 3), np.stack([b, b + 2 * n, a + 2 * n], -1).reshape(-1, 3)]
    )
    k = np.arange(2 * n)
    top = np.stack([0 * k, 1 + (k + 1) % (2 * n), 1 + k], 1)
    last, end = 1 + (n - 2) * 2 * n, len(position) - 1
    bottom = np.stack([0 * k + end, last + k, last + (k + 1) % (2 * n)], 1)
    return position, np.concatenate([top, quads, bottom]).astype(np.uint32)


def jagged(n: int, rng: np.random.Generator) -> tuple[F64, U32]:
    """A closed, star-shaped body with spikes: a sphere whose every vertex has a random radius from 1 to 3."""
    position, index = uv_sphere(n, 1.0)
    return position * rng.uniform(1, 3, (len(position), 1)), index


def drum(n: int, radius: float = 1.0, height: float = 3.0) -> tuple[F64, U32]:
    """A closed cylinder of n sides: long, thin triangles, fans and axis-parallel edges."""
    turn = 2 * np.pi * np.arange(n) / n
    ring = np.stack([radius * np.cos(turn), 0 * turn, radius * np.sin(turn)], 1)
    lift = np.array([0, height / 2, 0])
    position = np.concatenate([ring - lift, ring + lift, [-lift, lift]])
    k, j = np.arange(n), (np.arange(n) + 1) % n
    sides = [np.stack([k, n + k, j], 1), np.stack([j, n + k, n + j], 1)]
    caps = [np.stack([0 * k + 2 * n, k, j], 1), np.stack([0 * k + 2 * n + 1, n + j, n + k], 1)]
    return position, np.concatenate(sides + caps).astype(np.uint32)


# --- rays ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Rays:
    """origin, direction (R, 3) float32; t_min, t_max (R,) float32. In the space of Tracer.origin."""

    origin: F32
    direction: F32
    t_min: F32
    t_max: F32

    @staticmethod
    def make(origin: Any, direction: Any, t_max: Any = np.inf, t_min: Any = 0.0) -> "Rays":
        direction = np.ascontiguousarray(direction, np.float32)
        n = len(direction)
        ends = [np.array(np.broadcast_to(np.asarray(t, np.float32), n)) for t in (t_min, t_max)]
        return Rays(np.array(np.broadcast_to(origin, (n, 3)), np.float32), direction, *ends)

    def __len__(self) -> int:
        return len(self.direction)

    def __getitem__(self, rows: Any) -> "Rays":
        return Rays(self.origin[rows], self.direction[rows], self.t_min[rows], self.t_max[rows])


def join(parts: Sequence[Rays]) -> Rays:
    return Rays(*(np.concatenate([getattr(p, f) for p in parts]) for f in ("origin", "direction", "t_min", "t_max")))


def unit(v: Any) -> F64:
    v = np.asarray(v, np.float64)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def sphere_directions(rng: np.random.Generator, n: int) -> F64:
    return unit(rng.normal(size=(n, 3)))


def camera_rays(low: F64, high: F64, n: int, rng: np.random.Generator) -> Rays:
    """The pixels of a few pinhole cameras around and inside a box."""
    side = max(int(np.sqrt(n / 4)), 2)
    ndc = np.stack(np.meshgrid(*[(np.arange(side) + 0.5) / side * 2 - 1] * 2), -1).reshape(-1, 2)
    centre, extent, parts = (low + high) / 2, np.linalg.norm(high - low), []
    for distance in (0.02, 0.3, 0.9, 3.0):
        eye = centre + distance * extent * unit(rng.normal(size=3))
        target = centre + 0.1 * extent * rng.normal(size=3)
        forward = unit(target - eye)
        right = unit(np.cross(forward, rng.normal(size=3)))
        up = np.cross(right, forward)
        parts.append(Rays.make(eye, unit(forward + 0.6 * (ndc[:, :1] * right + ndc[:, 1:] * up))))
    return join(parts)


def random_rays(low: Any, high: Any, n: int, rng: np.random.Generator) -> Rays:
    return Rays.make(rng.uniform(low, high, (n, 3)), sphere_directions(rng, n))


def lattice_rays(low: F64, high: F64, n: int, rng: np.random.Generator) -> Rays:
    """The 26 axis and diagonal directions, from points whose coordinates are those of the corners, or lie between."""
    directions = np.array(
        [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], np.float64
    )
    step = (high - low) / 8
    origin = low - step + step * rng.integers(0, 11, (n, 3))
    return Rays.make(origin, directions[rng.integers(0, 26, n)])


def bounced_rays(kind: str, first: Rays, t: F64, normal: F64, extent: float, rng: np.random.Generator) -> Rays:
    """Shadow, mirror or diffuse rays from where `first` (all hits) met surfaces of the given geometric normals."""
    d = first.direction.astype(np.float64)
    normal = np.where((normal * d).sum(1, keepdims=True) > 0, -normal, normal)
    # Off the surface by much more than float32 of the scene: leaving it exactly is test_self_shadow.py's business.
    point = first.origin + t[:, None] * d + 1e-4 * extent * normal
    if kind == "mirror":
        return Rays.make(point, d - 2 * (d * normal).sum(1, keepdims=True) * normal)
    if kind == "diffuse":
        return Rays.make(point, unit(normal + 0.999 * sphere_directions(rng, len(d))))
    sun = unit(rng.normal(size=3) + np.array([0, 2, 0]))
    lamp = extent * rng.normal(size=3)
    to_lamp = lamp - point
    far = np.linalg.norm(to_lamp, axis=1)
    half = np.arange(len(d)) % 2 == 0
    lit = [half & (normal @ sun > 0), ~half & ((normal * to_lamp).sum(1) > 0)]
    sunny = Rays.make(point[lit[0]], np.broadcast_to(sun, (int(lit[0].sum()), 3)))
    return join([sunny, Rays.make(point[lit[1]], unit(to_lamp[lit[1]]), far[lit[1]])])


# --- the tracer ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Found:
    """What the GPU found. t: inf = a miss. triangle: row of Geometry.triangles. light: what any_hit lets by, 0 to 1."""

    t: F64
    bary: F64
    triangle: U32
    instance: U32
    light: F64

    @property
    def blocked(self) -> NDArray[np.bool_]:
        return self.light == 0

    @property
    def hit(self) -> NDArray[np.bool_]:
        return self.triangle != NO_HIT


def world_triangles(g: geometry.Geometry, origin: F64) -> tuple[F64, U32, U32]:
    """Every triangle of every instance relative to origin, float64: corners (T, 3, 3), row of triangles, instance.

    Of the scene as it is uploaded: vertices are float32, and so are matrices.
    """
    corners, rows, instances = [np.zeros((0, 3, 3))], [np.zeros(0, np.uint32)], [np.zeros(0, np.uint32)]
    for i, (mesh, pose) in enumerate(zip(g.instance_mesh, g.world_from_object, strict=True)):
        m = g.meshes[mesh]
        spheres = {s[0] for s in m.spheres}
        kept = [r for first, n in m.geometries for r in range(first, first + n) if r not in spheres]
        local = g.vertices[g.triangles[kept, :3], :3].astype(np.float64)
        linear, shift = (x.astype(np.float32).astype(np.float64) for x in (pose[:3, :3], pose[:3, 3] - origin))
        corners.append(local @ linear.T + shift)
        rows.append(np.array(kept, np.uint32))
        instances.append(np.full(len(kept), i, np.uint32))
    return np.concatenate(corners), np.concatenate(rows), np.concatenate(instances)


class Tracer:
    """A scene on the GPU, in a world rebased on `origin`, and rays through its tree."""

    def __init__(
        self, context: Context, scene: Scene, levels: int | str = 1, origin: Any = None, shaders: Shaders | None = None,
        **features: Any,
    ) -> None:  # fmt: skip
        self.context, self.scene = context, scene
        self._owns_shaders = shaders is None
        self.shaders = shaders or Shaders(context, extra=(HERE,))
        found = needs.find(scene, Settings()).features
        steps = 1 << 20 if context.device.software else 3
        self.geometry = geometry.build(scene, levels, tangents=found.tangents, attributes=found.extra_attributes)
        kinds = {"exact_distance": True, "branchless": context.device.software, **features}
        found = found.replace(two_level=self.geometry.levels == 2, bvh_inner_steps=steps, **kinds)
        self.upload = GpuScene(context, scene, self.geometry, found)
        self.features = found.replace(bvh_stack=self.upload.stack_entries)
        self.origin = scene.bounds().mean(0) if origin is None else np.asarray(origin, np.float64)
        self.upload.rebase(self.origin)
        constants = np.zeros(1, layout.dtype("FrameConstants"))
        constants["top_root"] = self.upload.top_root
        constants["top_grid_min"], constants["top_grid_step"] = self.upload.top_grid(self.origin)
        self._frame = context.gl.buffer(constants)
        self.resources: dict[str, Any] = {**self.upload.resources, "Frame": self._frame}

    def program(self, stem: str, **features: Any) -> Any:
        return self.shaders.compute(stem, self.features.replace(**features), folder="probes")

    def trace(self, rays: Rays, **features: Any) -> Found:
        """Closest hit and any hit of every ray."""
        gl, n = self.context.gl, len(rays)
        rows = np.empty((n, 8), np.float32)
        rows[:, :3], rows[:, 3], rows[:, 4:7], rows[:, 7] = rays.origin, rays.t_min, rays.direction, rays.t_max
        source, target = gl.buffer(rows), gl.buffer(reserve=n * 32)
        self.program("trace", **features).dispatch(
            {**self.resources, "Rays": source, "Hits": target, "ray_count": n}, (min(n, 65536), -(-n // 65536)), (64, 1)
        )
        data = np.frombuffer(target.read(), np.uint32).reshape(n, 8)
        source.release()
        target.release()
        real = data.view(np.float32).astype(np.float64)
        return Found(real[:, 0], real[:, 1:3], data[:, 3].copy(), data[:, 4].copy(), real[:, 6])

    def triangles(self) -> tuple[F64, U32, U32]:
        """What is there, in float64 and in the space of the rays: corners (T, 3, 3), row of triangles, instance."""
        return world_triangles(self.geometry, self.origin)

    def close(self) -> None:
        self._frame.release()
        self.upload.release()
        if self._owns_shaders:
            self.shaders.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()
