"""Scene TOML to `Scene`: model files and shapes composed with lights, cameras, materials and an environment.

The keys and their defaults are listed in scenes/README.md. Objects with equal shapes or the same file share one mesh
and become instances of it; a `material` replaces an instance's materials, never the mesh's, so the sharing holds.
"""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from glhybrid.errors import LoadError, unknown
from glhybrid.load import sceneparts, shapes, sky
from glhybrid.load import study as study_table
from glhybrid.load.require import ShapeError
from glhybrid.load.tables import LIGHT, NOT_NEGATIVE, PLACE, UNIT, Table, between, parse
from glhybrid.load.textures import Files, Textures
from glhybrid.scene import (
    F32,
    F64,
    Animation,
    Camera,
    Channel,
    Environment,
    Instance,
    Light,
    Material,
    Mesh,
    Node,
    Scene,
    Skin,
    Sphere,
    Triangles,
)

MAX_INSTANCES = 1_000_000  # a typing error should not fill the memory


def load_scene_file(path: Path, *, strict: bool = False, allow_outside: bool = False) -> Scene:
    """The scene of a TOML file, as it says: without default camera or light.

    Scene.sha256 is over the TOML and every file it names. Raises LoadError naming file, table and key.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise LoadError(f"{path}: cannot be read: {error.strerror or error}") from error
    return _Builder(path, text, strict, allow_outside).build()


class _Builder:
    """Reads the tables in order of dependence and collects the parts of the scene."""

    def __init__(self, path: Path, text: bytes, strict: bool, allow_outside: bool) -> None:
        self.path, self.strict, self.root = path, strict, parse(text, path)
        self.files = Files(path, text, allow_outside)
        self.textures = Textures(self.files)
        self.meshes: list[Mesh] = []
        self.instances: list[Instance] = []
        self.materials: list[Material] = []
        self.material_index: dict[str, int] = {}
        self.lights: list[Light] = []
        self.cameras: list[Camera] = []
        self.nodes: list[Node] = []
        self.skins: list[Skin] = []
        self.clips: dict[tuple[Path, int], tuple[str, list[Channel]]] = {}
        self.shape_meshes: dict[str, int] = {}
        self.models: dict[tuple[Path, bool], tuple[Scene, int, int]] = {}

    def build(self) -> Scene:
        root = self.root
        root.string("description", "")
        cameras, environment = root.named_tables("camera"), root.table("environment")
        lights, materials, objects = root.tables("light"), root.tables("material"), root.tables("object")
        probes, study = root.tables("probe"), root.table("study")
        root.finish()
        self.cameras += [sceneparts.camera(name, table) for name, table in cameras]
        sky_box = self._environment(environment) if environment else None
        described = study_table.read(study) if study else None
        self.lights += [sceneparts.light(table) for table in lights]
        for table in materials:
            self._material(table)
        for table in objects:
            self._object(table)
        return Scene(
            name=self.path.stem,
            meshes=tuple(self.meshes),
            instances=tuple(self.instances),
            materials=tuple(self.materials) or (Material(),),
            lights=tuple(self.lights),
            cameras=tuple(self.cameras),
            environment=sky_box,
            probes=tuple(sceneparts.probe(table) for table in probes),
            nodes=tuple(self.nodes),
            skins=tuple(self.skins),
            animations=tuple(Animation(name, tuple(channels)) for name, channels in self.clips.values()),
            path=self.path,
            sha256=self.files.digest.hexdigest(),
            warnings=tuple(self.files.warnings),
            study=described,
        )

    # Environment ---------------------------------------------------------------------------------------------------

    def _environment(self, table: Table) -> Environment:
        kinds = [kind for kind in ("file", "constant", "sky", "studio") if kind in table]
        intensity = table.number("intensity", 1.0, LIGHT)
        rotation = np.radians(table.number("rotation_deg", 0.0))
        if len(kinds) != 1:
            given = " and ".join(kinds) or "none of them"
            table.fail(f"needs exactly one of file, constant, sky and studio; has {given}")
        if kinds == ["file"]:
            from glhybrid.load.environment import read_environment

            path = self.files.find(table, "file")
            radiance, warnings = read_environment(path)
            for warning in warnings:
                self.files.warn(warning)
            self.files.count(path)
            name = path.name
        elif kinds == ["constant"]:
            radiance = np.array(table.vector("constant", (0, 0, 0), LIGHT), np.float32).reshape(1, 1, 3)
            name = "constant"
        elif kinds == ["sky"]:
            radiance, name = self._sky(table, intensity, rotation), "sky"
        else:
            radiance, name = sceneparts.studio(table), "studio"
        table.finish()
        return Environment(radiance, intensity, float(rotation), name)

    def _sky(self, parent: Table, intensity: float, rotation: float) -> F32:
        table = parent.table("sky")
        assert table is not None
        elevation = np.radians(table.number("sun_elevation_deg", 40.0, between(-5, 90)))
        azimuth = np.radians(table.number("sun_azimuth_deg", 0.0))
        turbidity = table.number("turbidity", 3.0, between(1, 10))
        ground = table.vector("ground", sky.GROUND, UNIT)
        if table.boolean("sun", False):
            light = sky.sun_light(elevation, azimuth - rotation, turbidity)
            self.lights.append(replace(light, intensity=light.intensity * intensity))
        table.finish()
        return sky.sky_map(elevation, azimuth, turbidity, (ground[0], ground[1], ground[2]))

    # Materials -----------------------------------------------------------------------------------------------------

    def _material(self, table: Table) -> None:
        table.need("name", "a material needs a name, for objects to use it by")
        name = table.string("name", "")
        if not name:
            table.fail("must not be empty", "name")
        if name in self.material_index:
            table.fail("another material has this name already", "name")
        base = table.raw("base_color")
        if isinstance(base, list) and len(base) == 3:  # opaque colours are commonly written without their alpha
            table.values["base_color"] = [*base, 1.0]
        plain = Material()
        strength = table.number("emissive_strength", 1.0, LIGHT)
        made = Material(
            name=name,
            base_color=sceneparts.four(table.vector("base_color", plain.base_color, UNIT)),
            emissive=sceneparts.three(tuple(strength * x for x in table.vector("emissive", plain.emissive, LIGHT))),
            alpha_mode=table.string("alpha_mode", plain.alpha_mode, ("OPAQUE", "MASK", "BLEND")),  # type: ignore[arg-type]
            double_sided=table.boolean("double_sided", plain.double_sided),
            unlit=table.boolean("unlit", plain.unlit),
            ior=table.number("ior", plain.ior, (lambda x: x == 0 or x >= 1, "must be at least 1, or 0")),
            specular_color=sceneparts.three(table.vector("specular_color", plain.specular_color, NOT_NEGATIVE)),
            normal_scale=table.number("normal_scale", plain.normal_scale),
            clearcoat_normal_scale=table.number("clearcoat_normal_scale", plain.clearcoat_normal_scale),
            **{key: table.number(key, getattr(plain, key), UNIT) for key in _UNIT_KEYS},
            textures=self.textures.read(table),
        )
        table.finish()
        self.material_index[name] = len(self.materials)
        self.materials.append(made)

    # Objects -------------------------------------------------------------------------------------------------------

    def _object(self, table: Table) -> None:
        name = table.string("name", "")
        material = self._material_of(table)
        world = sceneparts.transform(table)
        places = self._places(table)
        if "file" in table and "shape" in table:
            table.fail("needs either file or shape, not both")
        if "file" not in table:
            table.need("shape", "needs either file or shape")
        if "shape" in table:
            kind, mesh = self._shape(table)
            table.finish()
            materials = (self._default_material() if material is None else material,)
            self._ready(mesh, materials, table)
            for place in places:
                self.instances.append(Instance(mesh, _shifted(world, place), name or kind, materials))
            return
        smooth = table.boolean("smooth", False)
        path = self.files.find(table, "file")
        table.finish()
        model, first_mesh, first_material = self._model(path, smooth, table)
        for place in places:
            self._place(path, model, first_mesh, first_material, _shifted(world, place), name, material, table)

    def _material_of(self, table: Table) -> int | None:
        name = table.string("material", "")
        if name and name not in self.material_index:
            table.fail(unknown("material", name, (known for known in self.material_index if known)))
        return self.material_index[name] if name else None

    def _default_material(self) -> int:
        """White, roughness 1; made when the first object needs it. No TOML material can have its name."""
        if "" not in self.material_index:
            self.material_index[""] = len(self.materials)
            self.materials.append(Material())
        return self.material_index[""]

    def _places(self, table: Table) -> list[F64]:
        """Offsets in world axes: n along one step, or a block of nx x ny x nz."""
        step = table.vector("step", (0.0, 0.0, 0.0), PLACE)
        if isinstance(table.raw("count"), list):
            counts = table.vector(
                "count", (1, 1, 1), (lambda x: x >= 1 and x == int(x), "must be whole and at least 1")
            )
            each = tuple(int(n) for n in counts)
            stride = np.diag(step)
        else:
            each, stride = (table.integer("count", 1),), np.array([step])
        total = int(np.prod(each))
        if len(self.instances) + total > MAX_INSTANCES:
            table.fail(f"more than {MAX_INSTANCES} instances in all", "count")
        if total > 1 and any(n > 1 and not stride[i].any() for i, n in enumerate(each)):
            table.fail("needs a step that is not 0 where it repeats, or the copies coincide", "count")
        cells = itertools.product(*(range(n) for n in reversed(each)))
        return [np.array(cell[::-1], np.float64) @ stride for cell in cells]

    def _shape(self, table: Table) -> tuple[str, int]:
        kind = table.string("shape", "")
        if kind not in shapes.SHAPES:
            table.fail(unknown("shape", kind, shapes.SHAPES))
        given = sceneparts.parameters(table, shapes.parameters(kind))
        key = f"{kind} {sorted(given.items())}"
        if key not in self.shape_meshes:
            try:
                made = shapes.shape(kind, **given)
            except ShapeError as error:
                table.fail(str(error))
            self.shape_meshes[key] = len(self.meshes)
            self.meshes.append(Mesh(kind, (made,)))
        return kind, self.shape_meshes[key]

    def _model(self, path: Path, smooth: bool, table: Table) -> tuple[Scene, int, int]:
        """The scene of a model file, with the places of its first mesh and material here; read once."""
        from glhybrid.load import read_model

        if path.suffix.lower() == ".toml":
            table.fail("a scene file inside a scene file is not supported", "file")
        if (path, smooth) not in self.models:
            model = read_model(path, strict=self.strict, allow_outside=self.files.allow_outside, smooth=smooth)
            self.models[path, smooth] = model, len(self.meshes), len(self.materials)
            own = len(self.materials)
            self.meshes += [_with_materials_from(mesh, own) for mesh in model.meshes]
            self.materials += model.materials
            self.files.digest.update(model.sha256.encode())
            for warning in model.warnings:
                self.files.warn(f"{path.name}: {warning}")
        return self.models[path, smooth]

    def _place(
        self, path: Path, model: Scene, mesh: int, own: int, world: F64, name: str, material: int | None, table: Table
    ) -> None:
        """One copy of a model: its instances, lights and cameras moved; nodes only where something may move them."""
        alive = bool(model.animations or model.skins or any(n.morph_weights for n in model.nodes))
        root = len(self.nodes)
        node_of = (lambda n: n if n < 0 else root + 1 + n) if alive else (lambda n: -1)
        first_skin = len(self.skins)
        if alive:
            self.nodes.append(Node(name or path.stem, -1, matrix=world))
            self.nodes += [replace(n, parent=root if n.parent < 0 else node_of(n.parent)) for n in model.nodes]
            self.skins += [replace(s, joints=tuple(node_of(j) for j in s.joints)) for s in model.skins]
        for i, clip in enumerate(model.animations):
            _, channels = self.clips.setdefault((path, i), (clip.name, []))
            channels += [replace(c, node=node_of(c.node)) for c in clip.channels]
        for instance in model.instances:
            parts = len(model.meshes[instance.mesh].primitives)
            materials = None if instance.materials is None else tuple(own + m for m in instance.materials)
            if material is not None:
                materials = (material,) * parts
                self._ready(mesh + instance.mesh, materials, table)
            self.instances.append(
                Instance(
                    mesh + instance.mesh,
                    world @ instance.world_from_object,
                    "/".join(part for part in (name, instance.name) if part),
                    materials,
                    node_of(instance.node),
                    instance.skin + first_skin if instance.skin >= 0 else -1,
                )
            )
        self.lights += [sceneparts.moved_light(light, world, node_of(light.node)) for light in model.lights]
        self.cameras += [sceneparts.moved_camera(camera, world, node_of(camera.node)) for camera in model.cameras]

    def _ready(self, mesh: int, materials: tuple[int, ...], table: Table) -> None:
        """Makes sure that the mesh has what the materials put on it read: UVs, and tangents for normal maps."""
        from glhybrid.load.tangents import with_tangents

        parts = list(self.meshes[mesh].primitives)
        for i, (part, m) in enumerate(zip(parts, materials, strict=True)):
            textures = self.materials[m].textures
            if isinstance(part, Sphere) or not textures:
                continue
            if any((part.uv0 if t.uv_set == 0 else part.uv1) is None for t in textures.values()):
                self.files.warn(
                    f'{table.where}: mesh "{self.meshes[mesh].name}" has no UVs: the material\'s textures are flat'
                )
            normal = textures.get("normal") or textures.get("clearcoat_normal")
            if normal and part.tangent is None:
                parts[i] = with_tangents(part, normal.uv_set, normal.uv_transform)
        self.meshes[mesh] = replace(self.meshes[mesh], primitives=tuple(parts))


_UNIT_KEYS = (
    "metallic", "roughness", "alpha_cutoff", "occlusion_strength", "specular",
    "clearcoat", "clearcoat_roughness", "transmission",
)  # fmt: skip


def _shifted(world: F64, offset: F64) -> F64:
    moved = world.copy()
    moved[:3, 3] += offset
    return moved


def _with_materials_from(mesh: Mesh, first: int) -> Mesh:
    """The mesh of a file with its material indices counted from `first`."""

    def renumbered(p: Triangles | Sphere) -> Triangles | Sphere:
        return replace(p, material=p.material + first)

    return replace(mesh, primitives=tuple(renumbered(p) for p in mesh.primitives))
