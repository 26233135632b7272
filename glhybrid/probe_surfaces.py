"""Where a scene reflects, and how much: points spread over its smooth surfaces. No OpenGL."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glhybrid.needs import reflective
from glhybrid.scene import F64, Material, Scene, Sphere, Triangles

POINTS = 4096
GOLDEN = 0.6180339887498949
PLASTIC = 0.7548776662466927, 0.5698402909980532  # Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences"


class Surfaces(NamedTuple):
    """Points (N, 3) world, unit normals (N, 3) of their fronts, weight (N,): m^2 times how clearly they reflect.

    two_sided (N,) bool: the back reflects too. mirror (E, N, 3), share (E, N): where each camera looks by them,
    and how much it counts, if there are any.
    """

    point: F64
    normal: F64
    weight: F64
    two_sided: NDArray[np.bool_]
    mirror: F64 | None = None
    share: F64 | None = None


def clarity(material: Material, cutoff: float) -> float:
    """How much of a reflection is seen in a material, 0 to 1: its reflectance, less what roughness blurs away."""
    if not reflective(material, cutoff):
        return 0.0
    roughness, metallic = material.roughness, material.metallic
    if "metallic_roughness" in material.textures:
        texels = material.textures["metallic_roughness"].image.texels
        few = (
            texels[:: max(len(texels) // 64, 1), :: max(texels.shape[1] // 64, 1)].reshape(-1, texels.shape[2]) / 255.0
        )
        roughness, metallic = roughness * float(few[:, 1].mean()), metallic * float(few[:, 2].mean())
    f0 = 0.04 * material.specular * (1 - metallic) + max(material.base_color[:3]) * metallic
    coat = 0.04 * material.clearcoat * (1 - material.clearcoat_roughness) ** 2
    return max(min(f0, 1.0) * (1 - min(roughness, 1.0)) ** 2, coat, 1e-4)


def sample(scene: Scene, cutoff: float, count: int = POINTS) -> Surfaces:
    """Points by area and clarity, the same ones every time."""
    own = [tuple(p.material for p in mesh.primitives) for mesh in scene.meshes]
    worth = [clarity(material, cutoff) for material in scene.materials]
    kinds: dict[tuple[int, tuple[int, ...]], list[int]] = {}
    for number, instance in enumerate(scene.instances):
        kinds.setdefault((instance.mesh, instance.materials or own[instance.mesh]), []).append(number)
    found: list[tuple[list[int], F64, F64]] = []  # instances, weight of each, running weight of their mesh's pieces
    for (mesh, materials), numbers in kinds.items():
        shares = [worth[m] * _areas(p) for p, m in zip(scene.meshes[mesh].primitives, materials, strict=True)]
        running = np.cumsum(np.concatenate([np.zeros(0), *shares]))
        if not len(running) or not running[-1] > 0:
            continue
        poses = np.array([scene.instances[i].world_from_object[:3, :3] for i in numbers])
        with np.errstate(invalid="ignore", over="ignore"):
            size = np.abs(np.linalg.det(poses)) ** (2 / 3) * running[-1]
        found.append((numbers, np.where(np.isfinite(size), size, 0.0), running))
    total = np.array([weight.sum() for _, weight, _ in found])
    if not total.sum() > 0:
        return Surfaces(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool))
    parts: list[tuple[F64, F64, NDArray[np.bool_]]] = []
    place = (np.arange(count) + 0.5) / count * total.sum()
    ends = np.cumsum(total)
    which = np.searchsorted(ends, place).clip(0, len(found) - 1)
    for k in np.unique(which).tolist():
        numbers, weight, running = found[k]
        mine = place[which == k] - (ends[k] - total[k])
        rows = np.searchsorted(np.cumsum(weight), mine).clip(0, len(numbers) - 1)
        along = (np.arange(len(mine)) * GOLDEN + 0.5) % 1 * running[-1]
        pieces = np.searchsorted(running, along).clip(0, len(running) - 1)
        for row in np.unique(rows).tolist():
            parts.append(_at(scene, numbers[row], pieces[rows == row]))
    point, normal, both = (np.concatenate(p) for p in zip(*parts, strict=True))
    fine = np.isfinite(point).all(1) & np.isfinite(normal).all(1)
    return Surfaces(point[fine], normal[fine], np.full(int(fine.sum()), total.sum() / count), both[fine])


def _areas(piece: Triangles | Sphere) -> F64:
    """(T,) m^2 of its triangles, object space; of a sphere one."""
    if isinstance(piece, Sphere):
        return np.array([4 * np.pi * piece.radius**2])
    corner = piece.position[piece.index].astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    return np.where(np.isfinite(area), area, 0.0)


def _at(scene: Scene, number: int, pieces: NDArray[np.int64]) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Points and normals (N, 3), world, and whether both sides count, on triangles (N,) of an instance's mesh."""
    instance = scene.instances[number]
    mesh, pose = scene.meshes[instance.mesh], instance.world_from_object
    rows = np.arange(len(pieces))
    u, v = ((rows * step + 0.5) % 1 for step in PLASTIC)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    point, normal, both = np.zeros((len(rows), 3)), np.zeros((len(rows), 3)), np.zeros(len(rows), bool)
    first = 0
    for k, piece in enumerate(mesh.primitives):
        count = 1 if isinstance(piece, Sphere) else len(piece.index)
        on = (pieces >= first) & (pieces < first + count)
        if isinstance(piece, Sphere):
            z, phi = 1 - 2 * (rows[on] * PLASTIC[0] % 1), 2 * np.pi * (rows[on] * PLASTIC[1] % 1)
            r = np.sqrt(1 - z * z)
            normal[on] = np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)
            point[on] = piece.radius * normal[on]
        else:
            corner = piece.position[piece.index[pieces[on] - first]].astype(np.float64)
            along, across = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
            point[on] = corner[:, 0] + u[on, None] * along + v[on, None] * across
            normal[on] = np.cross(along, across)
        both[on] = scene.materials[(instance.materials or tuple(p.material for p in mesh.primitives))[k]].double_sided
        first += count
    linear = pose[:3, :3]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        try:
            normal = normal @ (np.abs(np.linalg.det(linear)) * np.linalg.inv(linear))
        except np.linalg.LinAlgError:  # squashed flat: not drawn
            normal = np.full_like(normal, np.nan)
        return point @ linear.T + pose[:3, 3], normal / np.linalg.norm(normal, axis=1, keepdims=True), both
