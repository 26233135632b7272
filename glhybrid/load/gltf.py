"""glTF 2.0 and GLB to a Scene: the whole core specification and the extensions in SUPPORTED.

A reader of our own, on json and numpy: trimesh loses most of glTF, and a Scene needs checks for every index anyway.
Only what the default scene draws is kept, its meshes and materials renumbered in the order of first use; nodes, skins
and animations keep the file's numbers.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.load.gltf_accessors import AccessorReader
from glhybrid.load.gltf_animation import read_animations, read_skins
from glhybrid.load.gltf_document import KINDS, Document, Item, show
from glhybrid.load.gltf_materials import Materials
from glhybrid.load.gltf_meshes import MeshReader
from glhybrid.load.gltf_nodes import Hierarchy, instance_matrices, read_camera, read_hierarchy, read_light
from glhybrid.load.report import Report
from glhybrid.scene import Camera, Instance, Light, Mesh, Scene, Skin, Triangles

SUPPORTED = frozenset({
    "EXT_mesh_gpu_instancing", "EXT_texture_avif", "EXT_texture_webp", "KHR_lights_punctual", "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_transmission",
    "KHR_materials_unlit", "KHR_mesh_quantization", "KHR_node_visibility", "KHR_texture_transform",
})  # fmt: skip
INVISIBLE = frozenset({"KHR_xmp", "KHR_xmp_json_ld"})  # metadata: nothing to draw, so nothing lost
COMPRESSED = {  # what to do where a file cannot be read without an extension
    "KHR_draco_mesh_compression": "export it without Draco compression",
    "EXT_meshopt_compression": "export it without meshopt compression",
    "KHR_meshopt_compression": "export it without meshopt compression",
    "KHR_texture_basisu": "export its textures as PNG or JPEG",
}


@np.errstate(all="ignore")  # a file may hold any bits; what is made is checked
def load_gltf(path: Path, *, strict: bool = False, smooth: bool = False, allow_outside: bool = False) -> Scene:
    """The default scene of a .gltf or .glb file, told apart by content.

    strict: anything dropped or changed is an error instead of a sentence in Scene.warnings.
    smooth: smooth instead of flat normals where the file has none.
    allow_outside: files named by the model may lie outside its folder. Nothing is ever fetched from a network.
    Scene.sha256 is over the file and then each file it names, in the order they are read.
    Raises LoadError naming file, thing, value, limit and remedy.
    """
    path = Path(path)
    report = Report(path)
    doc = Document(path, report, allow_outside)
    _check_extensions(doc)
    accessors = AccessorReader(doc)
    hierarchy = read_hierarchy(doc)
    with Materials(doc) as materials:
        contents = _Contents(doc, accessors, hierarchy, MeshReader(doc, accessors, materials, smooth))
        built = materials.build()
    animations = read_animations(doc, accessors, hierarchy.nodes, contents.target_counts)
    if not contents.instances:
        report.warn("there is nothing to draw: no triangles in the scene")
    return Scene(
        name=path.stem,
        meshes=tuple(contents.reader.meshes),
        instances=tuple(contents.instances),
        materials=built,
        lights=tuple(contents.lights),
        cameras=tuple(contents.cameras),
        nodes=hierarchy.nodes,
        skins=contents.skins,
        animations=animations,
        path=path,
        sha256=doc.hash.hexdigest(),
        warnings=report.finish(strict),
    )


class _Contents:
    """What the drawn nodes place in the world."""

    def __init__(self, doc: Document, accessors: AccessorReader, hierarchy: Hierarchy, reader: MeshReader) -> None:
        self.doc, self.accessors, self.hierarchy = doc, accessors, hierarchy
        self.instances: list[Instance] = []
        self.cameras: list[Camera] = []
        self.lights: list[Light] = []
        self.skins: tuple[Skin, ...] = read_skins(doc, accessors)
        self.target_counts: dict[int, int] = {}  # by node
        self.reader = reader
        self._read()

    def _read(self) -> None:
        doc, items = self.doc, self.doc.items("nodes")
        drawn = self.hierarchy.drawn
        placed = dict.fromkeys(m for n in drawn if (m := items[n].index("mesh", "meshes")) is not None)
        library = not items and not doc.count("scenes")  # meshes alone: glTF 2.0, 3.5.1 leaves open what to show
        if library and doc.count("meshes"):
            doc.report.warn("there are no nodes: each mesh is drawn at the origin")
            placed = dict.fromkeys(range(doc.count("meshes")))
        for index, mesh in enumerate(doc.items("meshes")):
            if index in placed:
                self._order_images(mesh)
            elif doc.count("scenes") < 2:  # else one of the others may show it, and they are reported
                mesh.warn("not loaded: no node of the scene shows it")
        for index in placed:
            use = self.reader.use(index)
            if library and use.slot >= 0:
                self.instances.append(Instance(use.slot, np.eye(4), use.name, materials=use.materials))
        lights = self._light_items()
        for node in drawn:
            self._place(node, items[node], lights)
        for index, item in enumerate(items):
            self._check_weights(index, item)

    def _order_images(self, mesh: Item) -> None:
        """Starts to decode what a mesh's materials need, before any geometry is read."""
        for primitive in mesh.children("primitives", "primitive"):
            if primitive.integer("mode", 4) >= 4:
                self.reader.materials.use(primitive.index("material", "materials"))

    def _light_items(self) -> list[Item]:
        extension = self.doc.root.extension("KHR_lights_punctual")
        return extension.children("lights", "light") if extension else []

    def _place(self, node: int, item: Item, lights: list[Item]) -> None:
        world, name = self.hierarchy.world[node], self.hierarchy.nodes[node].name
        if (camera := item.index("camera", "cameras")) is not None:
            self.cameras.append(read_camera(self.doc.items("cameras")[camera], node, name, world))
        if extension := item.extension("KHR_lights_punctual"):
            number = extension.integer("light")
            if number >= len(lights):
                raise extension.fail(f"light {show(number)} does not exist: the file has {len(lights)}")
            self.lights.append(read_light(lights[number], node, name, world))
        mesh = item.index("mesh", "meshes")
        if mesh is None or (use := self.reader.use(mesh)).slot < 0:
            return
        skin = self._skin(item, self.reader.meshes[use.slot])
        matrices = instance_matrices(item, self.accessors, world)
        if skin >= 0:  # 3.7.3.3: only the joints place a skinned mesh, the node's transform has no say
            matrices = np.eye(4)[None]
        if matrices is None:
            matrices = world[None]
        label = name or use.name
        for i, matrix in enumerate(matrices):
            number_label = f"{label}[{i}]" if len(matrices) > 1 else label
            self.instances.append(
                Instance(use.slot, matrix, number_label, materials=use.materials, node=node, skin=skin)
            )

    def _skin(self, item: Item, mesh: Mesh) -> int:
        skin: int | None = item.index("skin", "skins")
        if skin is None:
            return -1
        pieces = [p for p in mesh.primitives if isinstance(p, Triangles)]
        if any(p.joints is None for p in pieces):
            item.warn("has a skin, but its mesh lacks JOINTS_0 and WEIGHTS_0: drawn where the node stands")
            return -1
        count = len(self.skins[skin].joints)
        for p in pieces:
            assert p.joints is not None and p.weights is not None
            worst = int(p.joints.max(initial=0, where=p.weights > 0.0))
            if worst >= count:
                raise item.fail(f'mesh "{mesh.name}" uses joint {worst}, skin {skin} has {count}; the file is broken')
        return skin

    def _check_weights(self, index: int, item: Item) -> None:
        """Morph weights of a node must fit its mesh."""
        mesh = item.index("mesh", "meshes")
        given = len(self.hierarchy.nodes[index].morph_weights)
        if mesh is None:
            if given:
                item.warn("has morph weights and no mesh")
            return
        primitives = self.doc.items("meshes")[mesh].children("primitives", "primitive")
        wanted = len(primitives[0].children("targets", "target")) if primitives else 0
        self.target_counts[index] = wanted
        if given not in (0, wanted):
            raise item.fail(f"has {given} morph weights, its mesh has {wanted} targets")


def _check_extensions(doc: Document) -> None:
    """LoadError for a required extension we lack; a warning with a count for each other one that is used."""
    required = doc.root.data.get("extensionsRequired", [])
    if not isinstance(required, list):
        raise doc.fail(f'"extensionsRequired" is {show(required)}, must be a list')
    for name in required:
        if not isinstance(name, str) or name not in SUPPORTED | INVISIBLE:
            remedy = COMPRESSED.get(name, "export it without that") if isinstance(name, str) else "correct the file"
            raise doc.fail(f"needs the extension {show(name)}, which is not supported; {remedy}")
    for name, places in _used_extensions(doc).items():
        if name not in SUPPORTED | INVISIBLE:
            where = ", ".join(f"{n} {KINDS.get(kind, kind)}{'s' * (n > 1)}" for kind, n in sorted(places.items()))
            doc.report.warn(f"{name} is not supported and ignored in {where}")


def _used_extensions(doc: Document) -> dict[str, Counter[str]]:
    """How often each extension occurs, by the top-level array it occurs in."""
    extensions = doc.root.child("extensions")
    found: dict[str, Counter[str]] = {name: Counter(file=1) for name in extensions.data} if extensions else {}
    stack: list[tuple[str, Any]] = [(key, value) for key, value in doc.root.data.items() if key != "extras"]
    while stack:
        kind, value = stack.pop()
        if isinstance(value, list):
            stack += [(kind, v) for v in value if isinstance(v, list | dict)]
        elif isinstance(value, dict):
            local = value.get("extensions")
            for name in local if isinstance(local, dict) else ():
                found.setdefault(name, Counter())[kind] += 1
            stack += [(kind, v) for k, v in value.items() if k != "extras" and isinstance(v, list | dict)]
    return found
