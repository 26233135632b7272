"""Scene -> Geometry: the arrays that raster and rays both read, hit-group records, and a tree per mesh.

Two levels: one mesh, one Blas, any number of instances. One level: a static scene whose meshes are not repeated is
flattened into one mesh in world space (relative to its own centre, so that float32 is spent on the scene, not on where
it lies): no top-level tree, no change of space in the middle of a ray.
"""

from dataclasses import dataclass, replace

import numpy as np

from glhybrid import layout, pieces
from glhybrid.bvh import Blas, load_or_build
from glhybrid.errors import GeometryError
from glhybrid.levels import choose_levels
from glhybrid.scene import F32, F64, U32, Instance, Material, Mesh, Scene, Sphere, Triangles

LARGEST = 1e12  # m: above it, they overflow


@dataclass(frozen=True, eq=False)
class MeshData:
    """One mesh in the shared arrays."""

    first_triangle: int
    geometries: tuple[tuple[int, int], ...]  # first triangle and count, by geometry
    first_vertex: int = 0  # a mesh's vertices lie together, its pieces in order
    spheres: tuple[tuple[int, int, F32], ...] = ()  # row of triangles, geometry, centre and radius
    tree: Blas | None = None  # until something traces

    @property
    def blas(self) -> Blas:
        """The tree, where there must be one."""
        assert self.tree is not None
        return self.tree


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is traced and drawn. Rows of `triangles` are the ids that hits carry.

    vertices (V, 8) float32: position, u; normal, v (a sphere: centre, 0; radius, 0, 0, 0). triangles (T, 4): three
    rows of vertices, geometry. tangents (V, 4) float32, attributes (V, 4) uint32 (second UV, colour as halves) or None.
    Instances: mesh (I,), world_from_object (I, 4, 4) float64, scene_id (I,), first_record (I,).
    """

    levels: int
    vertices: F32
    triangles: U32
    tangents: F32 | None
    attributes: U32 | None
    meshes: tuple[MeshData, ...]
    instance_mesh: U32
    world_from_object: F64
    instance_id: U32
    first_record: U32
    records: U32  # (R, 2): hit group, scene instance
    hit_groups: U32  # (G, 4): columns of layout HitGroup
    materials: tuple[Material, ...]  # those in use
    material_index: U32  # (M,): their rows in Scene.materials
    source_triangle: U32  # (T,): triangle within its scene mesh, primitives in order
    dropped: int
    flattened_away: int  # of those dropped, triangles that two levels would have kept
    may_split: bool  # a triangle may lie in several leaves


def _check_reach(scene: Scene, levels: int) -> None:
    """Raises GeometryError where a mesh is too large for the arithmetic of a ray."""
    names: tuple[Mesh | Instance, ...] = scene.instances if levels == 1 else scene.meshes
    boxes = (
        scene.instance_bounds - scene.bounds().mean(0) if levels == 1 else np.array([m.bounds for m in scene.meshes])
    )
    reach = np.abs(boxes).reshape(-1, 6).max(1)
    if (far := np.flatnonzero(reach > LARGEST)).size:
        what = "instance" if levels == 1 else "mesh"
        raise GeometryError(
            f'{scene.name}: {what} "{names[far[0]].name}" reaches {reach[far[0]]:g} m from the middle, the limit is '
            f"{LARGEST:g}: past it products of three lengths overflow float32; scale it down or leave it out"
        )


def build(
    scene: Scene,
    levels: int | str = "auto",
    *,
    tangents: bool = True,
    attributes: bool = True,
    deforming: frozenset[int] = frozenset(),
    trees: bool = True,
) -> Geometry:
    """Arrays, records and trees of a scene. Triangles with a non-finite vertex or no area are dropped and counted.

    deforming: rows of scene.meshes that will change shape: their triangles may be without area now. trees: False
    leaves them to grow_trees.
    """
    chosen, _ = choose_levels(scene, levels)
    _check_reach(scene, chosen)
    builder = _Builder(scene, tangents, attributes, deforming)
    if chosen == 1:
        builder.flatten()
    else:
        builder.keep_instances()
    geometry = builder.finish(chosen)
    return grow_trees(geometry) if trees else geometry


def grow_trees(geometry: Geometry) -> Geometry:
    """With the tree of every mesh that has none, from the disk where one over the same triangles is kept."""
    if all(m.tree is not None for m in geometry.meshes):
        return geometry
    ends = [*(m.first_triangle for m in geometry.meshes[1:]), len(geometry.triangles)]
    trees = (m.tree or _tree(geometry, m, end) for m, end in zip(geometry.meshes, ends, strict=True))
    return replace(
        geometry, meshes=tuple(replace(m, tree=tree) for m, tree in zip(geometry.meshes, trees, strict=True))
    )


def _tree(geometry: Geometry, mesh: MeshData, end: int) -> Blas:
    """Over rows first_triangle..end-1, which it knows by their place in the mesh."""
    rows = geometry.triangles[mesh.first_triangle : end]
    balls = [row - mesh.first_triangle for row, _, _ in mesh.spheres]
    flat = np.ones(len(rows), bool)
    flat[balls] = False
    return load_or_build(
        geometry.vertices[rows[flat, :3], :3],
        np.flatnonzero(flat).astype(np.uint32),
        rows[flat, 3],
        spheres=np.array([ball for _, _, ball in mesh.spheres], np.float32).reshape(-1, 4),
        sphere_triangle=np.array(balls, np.uint32),
        sphere_geometry=np.array([number for _, number, _ in mesh.spheres], np.uint32),
        split=geometry.may_split,
    )


class _Builder:
    """Collects pieces in order; `finish` concatenates them once."""

    def __init__(self, scene: Scene, tangents: bool, attributes: bool, deforming: frozenset[int]) -> None:
        self.scene = scene
        self.deforming = {id(scene.meshes[row]) for row in deforming}
        # A triangle in several leaves is met several times: its tint would count as often. Nor can pieces be refitted.
        tint = layout.CONSTANTS["ANY_HIT_TINT"]
        self.may_split = not deforming and not any(any_hit(m) == tint for m in scene.materials)
        self.with_tangents, self.with_attributes = tangents, attributes
        self.vertices: list[F32] = []
        self.tangents: list[F32] = []
        self.attributes: list[U32] = []
        self.triangles: list[U32] = []
        self.sources: list[U32] = []
        self.vertex_count = self.triangle_count = self.dropped = self.flattened_away = 0
        self.meshes: list[MeshData] = []
        self.instance_mesh: list[int] = []
        self.placements: list[F64] = []
        self.instance_id: list[int] = []
        self.first_record: list[int] = []
        self.records: list[tuple[int, int]] = []
        self.groups: dict[tuple[int, int, int, int], int] = {}
        self.material_rows: dict[int, int] = {}

    def hit_group(self, primitive: Triangles | Sphere, material_index: int) -> int:
        """Row of the record's hit group: equal combinations share it."""
        material = self.scene.materials[material_index]
        row = self.material_rows.setdefault(material_index, len(self.material_rows))
        kind = layout.CONSTANTS["KIND_SPHERE" if isinstance(primitive, Sphere) else "KIND_TRIANGLE"]
        key = (kind, row, any_hit(material), int(not material.double_sided))
        return self.groups.setdefault(key, len(self.groups))

    def add_piece(self, mesh: Mesh, k: int, geometry: int, to_mesh: F64 | None) -> tuple[int, int]:
        """Appends primitive k of a mesh, moved by to_mesh; returns its rows of triangles."""
        primitive = mesh.primitives[k]
        assert isinstance(primitive, Triangles)
        piece = pieces.triangles(primitive, to_mesh, self.with_attributes, deforms=id(mesh) in self.deforming)
        self.dropped += piece.dropped
        self.flattened_away += piece.flattened_away
        before = sum(len(p.index) if isinstance(p, Triangles) else 1 for p in mesh.primitives[:k])
        return self._append(piece, geometry, before)

    def _append(self, piece: pieces.Piece, geometry: int, before: int = 0) -> tuple[int, int]:
        """Its rows of triangles. before: triangles of the mesh in front of it."""
        self.sources.append(piece.source + np.uint32(before))
        self.vertices.append(piece.vertices)
        count = len(piece.vertices)
        if self.with_tangents:
            self.tangents.append(piece.tangents if piece.tangents is not None else np.zeros((count, 4), np.float32))
        if self.with_attributes:
            packed = piece.attributes if piece.attributes is not None else pieces.pack_attributes(None, count)
            self.attributes.append(packed)
        rows = np.empty((len(piece.index), 4), np.uint32)
        rows[:, :3] = piece.index + np.uint32(self.vertex_count)
        rows[:, 3] = geometry
        self.triangles.append(rows)
        self.vertex_count += count
        first = self.triangle_count
        self.triangle_count += len(rows)
        return first, len(rows)

    def add_sphere(self, geometry: int, centre: F64, radius: float) -> tuple[int, int, F32]:
        """Appends a sphere: one vertex, one row of triangles. Returns what MeshData.spheres holds of it."""
        row, _ = self._append(pieces.sphere(centre, radius), geometry)
        return row, geometry, np.array([*centre, radius], np.float32)

    def placed(self) -> list[tuple[int, Instance]]:
        """Instances with their numbers. Those that are squashed flat, or too small or large to trace, are dropped."""
        poses = np.array([i.world_from_object[:3] for i in self.scene.instances]).reshape(-1, 3, 4)
        with np.errstate(invalid="ignore", over="ignore"):
            volume, sides = np.abs(np.linalg.det(poses[:, :, :3])), np.linalg.norm(poses[:, :, :3], axis=1)
            fine = np.isfinite(poses).all((1, 2)) & (volume > 1e-12 * sides.prod(1))
            fine &= (sides > 1 / LARGEST).all(1) & (sides < LARGEST).all(1)  # products of three lengths, as above
        for i in np.flatnonzero(~fine).tolist():
            pieces = self.scene.meshes[self.scene.instances[i].mesh].primitives
            self.dropped += sum(len(p.index) if isinstance(p, Triangles) else 1 for p in pieces)
        return [(i, self.scene.instances[i]) for i in np.flatnonzero(fine).tolist()]

    def mark(self) -> tuple[int, int]:
        """Where a mesh begins: triangles, vertices so far."""
        return self.triangle_count, self.vertex_count

    def close_mesh(
        self,
        mark: tuple[int, int],
        ranges: list[tuple[int, int]],
        spheres: list[tuple[int, int, F32]],
    ) -> bool:
        """A mesh of everything since `mark`; False if nothing is left to draw."""
        first, vertex = mark
        if first == self.triangle_count:
            return False
        self.meshes.append(MeshData(first, tuple(ranges), vertex, tuple(spheres)))
        return True

    def flatten(self) -> None:
        scene = self.scene
        centre = scene.bounds().mean(0)
        parts = [
            (instance, number, k, (instance.materials or _own_materials(scene.meshes[instance.mesh]))[k])
            for number, instance in self.placed()
            for k in range(len(scene.meshes[instance.mesh].primitives))
        ]
        # By raster state, so that each state is one draw.
        parts.sort(key=lambda part: draw_state(scene.materials[part[3]]))
        ranges: list[tuple[int, int]] = []
        spheres: list[tuple[int, int, F32]] = []
        for geometry, (instance, number, k, material) in enumerate(parts):
            mesh = scene.meshes[instance.mesh]
            primitive = mesh.primitives[k]
            to_mesh = instance.world_from_object.copy()
            to_mesh[:3, 3] -= centre
            if isinstance(primitive, Sphere):
                scale = abs(np.linalg.det(to_mesh[:3, :3])) ** (1 / 3)
                spheres.append(self.add_sphere(geometry, to_mesh[:3, 3], primitive.radius * scale))
                ranges.append((self.triangle_count, 0))
            else:
                ranges.append(self.add_piece(mesh, k, geometry, to_mesh))
            self.records.append((self.hit_group(primitive, material), number))
        if self.close_mesh((0, 0), ranges, spheres):
            pose = np.eye(4)
            pose[:3, 3] = centre
            self.place(0, pose, layout.CONSTANTS["ID_NONE"], 0)

    def keep_instances(self) -> None:
        scene = self.scene
        meshes: dict[tuple[int, ...], int] = {}  # by identity of the primitives' arrays: equal data is stored once
        records: dict[tuple[int, tuple[int, ...]], int] = {}
        keys = [tuple(id(p.position if isinstance(p, Triangles) else p) for p in m.primitives) for m in scene.meshes]
        for number, instance in self.placed():
            mesh, key = scene.meshes[instance.mesh], keys[instance.mesh]
            if key not in meshes:
                mark, ranges, spheres = self.mark(), [], []
                for geometry, primitive in enumerate(mesh.primitives):
                    if isinstance(primitive, Sphere):
                        spheres.append(self.add_sphere(geometry, np.zeros(3), primitive.radius))
                        ranges.append((self.triangle_count, 0))
                    else:
                        ranges.append(self.add_piece(mesh, geometry, geometry, None))
                built = self.close_mesh(mark, ranges, spheres)
                meshes[key] = len(self.meshes) - 1 if built else -1
            row = meshes[key]
            if row < 0:
                continue
            materials = instance.materials or _own_materials(mesh)
            # Records carry the scene's instance only where they are not shared; the Instance row always does.
            if (row, materials) not in records:
                records[row, materials] = len(self.records)
                self.records += [
                    (self.hit_group(p, m), layout.CONSTANTS["ID_NONE"])
                    for p, m in zip(mesh.primitives, materials, strict=True)
                ]
            self.place(row, instance.world_from_object, number, records[row, materials])

    def place(self, mesh: int, world_from_object: F64, scene_id: int, first_record: int) -> None:
        self.instance_mesh.append(mesh)
        self.placements.append(world_from_object)
        self.instance_id.append(scene_id)
        self.first_record.append(first_record)

    def finish(self, levels: int) -> Geometry:
        if self.triangle_count >= 2**27:
            raise GeometryError(f"{self.scene.name}: {self.triangle_count} triangles; the tree's limit is {2**27 - 1}")
        materials = tuple(self.scene.materials[i] for i in self.material_rows)
        return Geometry(
            levels=levels,
            vertices=_stack(self.vertices, 8, np.float32),
            triangles=_stack(self.triangles, 4, np.uint32),
            tangents=_stack(self.tangents, 4, np.float32) if self.with_tangents else None,
            attributes=_stack(self.attributes, 4, np.uint32) if self.with_attributes else None,
            meshes=tuple(self.meshes),
            instance_mesh=np.array(self.instance_mesh, np.uint32),
            world_from_object=np.array(self.placements, np.float64).reshape(-1, 4, 4),
            instance_id=np.array(self.instance_id, np.uint32),
            first_record=np.array(self.first_record, np.uint32),
            records=np.array(self.records, np.uint32).reshape(-1, 2),
            hit_groups=np.array(list(self.groups), np.uint32).reshape(-1, 4),
            materials=materials,
            material_index=np.array(list(self.material_rows), np.uint32),
            source_triangle=np.concatenate(self.sources) if self.sources else np.zeros(0, np.uint32),
            dropped=self.dropped,
            flattened_away=self.flattened_away,
            may_split=self.may_split,
        )


def any_hit(material: Material) -> int:
    """What a shadow ray does at this material."""
    if material.alpha_mode == "BLEND" or material.transmission > 0:
        return layout.CONSTANTS["ANY_HIT_TINT"]
    return layout.CONSTANTS["ANY_HIT_MASK" if material.alpha_mode == "MASK" else "ANY_HIT_OPAQUE"]


def draw_state(material: Material) -> tuple[int, int]:
    """Raster state: (any hit, single-sided)."""
    return any_hit(material), int(not material.double_sided)


def _own_materials(mesh: Mesh) -> tuple[int, ...]:
    return tuple(p.material for p in mesh.primitives)


def _stack(parts: list[np.ndarray], width: int, kind: type) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros((0, width), kind)
