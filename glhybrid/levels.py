"""How many levels of trees a scene gets: one, flattened into world space, or two, a tree a mesh under one of instances.

One is faster where no mesh is repeated. It holds vertices in float32 about the middle of the scene, where what is small
beside the scene loses its shape, and at last its area; two hold a mesh as its file does.
"""

from weakref import WeakKeyDictionary

import numpy as np

from glhybrid.bvh.blas import SMALL
from glhybrid.scene import F64, Scene, Sphere, Triangles

# Triangles after flattening / before: above it, instances save more than one level gains. A GPU gains more: on an H100
# one level made `atrium` (5 times as many) 1.28 times as fast, `plaza` (12 times, 90 MB instead of 8) only 1.11 times.
FLATTEN_GROWTH = 1.25
FLATTEN_GROWTH_GPU = 6.0
FLATTEN_RATIO = 1e-4  # smallest instance / scene: below it, float32 about the scene's centre would bend its shape
FLATTEN_MOST = 1 << 25  # triangles: what a buffer texture of 2^27 texels holds of a tree, with some of them split
BENT = 32  # roundings about the middle of the scene across a triangle: with fewer, it is bent by 3 % and more ...
FINER = 16  # ... and is saved by two levels if its mesh holds it so many times as exactly


_lost: "WeakKeyDictionary[Scene, float]" = WeakKeyDictionary()  # what _lost_detail found


def choose_levels(scene: Scene, asked: int | str, software: bool = True) -> tuple[int, str]:
    """How many levels of trees (1 or 2), and why. asked: 1, 2 or auto; software: the device is a CPU."""
    if asked in (1, 2):
        if asked == 1 and (odd := [i for i in scene.instances if not _flattenable(scene, i.mesh, i.world_from_object)]):
            return 2, f'instance "{odd[0].name}" is a sphere under a non-uniform scale'
        return int(asked), "asked for"
    if not scene.instances:
        return 1, "nothing is drawn"
    drawn, stored = drawn_and_stored(scene)
    if drawn > (FLATTEN_GROWTH if software else FLATTEN_GROWTH_GPU) * stored:
        return 2, f"meshes are repeated: {drawn} triangles drawn from {stored} stored"
    if drawn != stored and drawn > FLATTEN_MOST:
        return 2, f"{drawn} triangles, {stored} without repeats: more than one level's buffers hold"
    if any(not _flattenable(scene, i.mesh, i.world_from_object) for i in scene.instances):
        return 2, "a sphere stands under a non-uniform scale"
    extent = float(np.linalg.norm(np.diff(scene.bounds(), axis=0)))
    sizes = np.linalg.norm(scene.instance_bounds[:, 1] - scene.instance_bounds[:, 0], axis=1)
    smallest = float(min(sizes[sizes > 0], default=extent))
    if smallest < FLATTEN_RATIO * extent:
        return 2, f"the smallest object is {smallest / extent:.1e} of the scene"
    if scene not in _lost:  # 0.1 s of a quarter of a million triangles, for each setting it is drawn with
        _lost[scene] = _lost_detail(scene)
    if smallest := _lost[scene]:
        return 2, f"triangles of {smallest:.1e} m would lose their shape in a scene of {extent:.1e} m"
    if drawn == stored:
        return 1, "no mesh is repeated"
    return 1, f"one level, {drawn / stored:.1f} times the triangles: faster on this device"


def drawn_and_stored(scene: Scene) -> tuple[int, int]:
    """Triangles and spheres: of all instances, and of the meshes that they draw."""
    counts = [sum(len(p.index) if isinstance(p, Triangles) else 1 for p in m.primitives) for m in scene.meshes]
    return sum(counts[i.mesh] for i in scene.instances), sum(counts[i] for i in {i.mesh for i in scene.instances})


def _flattenable(scene: Scene, mesh: int, world_from_object: F64) -> bool:
    if (
        not any(isinstance(p, Sphere) for p in scene.meshes[mesh].primitives)
        or not np.isfinite(world_from_object).all()
    ):
        return True
    gram = world_from_object[:3, :3].T @ world_from_object[:3, :3]
    return bool(np.allclose(gram, np.eye(3) * gram[0, 0], rtol=0, atol=1e-6 * gram[0, 0]))


def _lost_detail(scene: Scene) -> float:
    """Length (m) of the smallest triangle or sphere that flattening bends and two levels save; 0 if there is none.

    Such a one lies near the origin of its mesh, where float32 is fine.
    """
    reach = float(np.abs(np.diff(scene.bounds(), axis=0)).max()) / 2
    smallest = np.inf
    scales: dict[int, float] = {}  # by mesh, of its smallest instance
    for instance in scene.instances:
        if np.isfinite(instance.world_from_object).all():
            scale = float(np.linalg.norm(instance.world_from_object[:3, :3])) / 3**0.5
            scales[instance.mesh] = min(scale, scales.get(instance.mesh, np.inf))
    for mesh, scale in scales.items():
        for piece in scene.meshes[mesh].primitives:
            if isinstance(piece, Sphere):
                smallest = min(smallest, 2 * piece.radius * scale)
                continue
            near = np.abs(piece.position).max(1, initial=0) * scale < reach / FINER  # False for NaN
            corner = piece.position[piece.index[near[piece.index].all(1)]]
            length = (corner.max(1) - corner.min(1)).max(1, initial=0)
            smallest = min(smallest, scale * float(length.min(initial=np.inf, where=length > 0)))
    return smallest if smallest < BENT * 2.0**-24 * reach else 0.0


def builds_on_gpu(rebuild: float, builder: str, software: bool, triangles: int) -> bool:
    """Whether deforming trees, the largest over so many triangles, are built anew in compute, under Settings.rebuild
    and Settings.builder. A software rasteriser takes six times as long as the compiled builder, a sixth of NumPy's.
    """
    return rebuild != 0 and (builder == "gpu" or (builder == "auto" and (not software or triangles <= SMALL)))
