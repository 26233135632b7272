"""The glTF reader: each feature of the specification on the smallest asset that holds it."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import QUAD, QUAD_INDEX, QUAD_UV, Builder

from glhybrid.errors import LoadError
from glhybrid.load.gltf import load_gltf
from glhybrid.scene import Scene, Triangles


def load(builder: Builder, folder: Path, **options: Any) -> Scene:
    return load_gltf(builder.write(folder), **options)


def piece(scene: Scene, mesh: int = 0, primitive: int = 0) -> Triangles:
    found = scene.meshes[mesh].primitives[primitive]
    assert isinstance(found, Triangles)
    return found


# --- where bytes come from


def test_buffers_embedded_external_and_data_uri_give_the_same_scene(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    embedded = load(b, tmp_path)
    document = b.document()
    folder = tmp_path / "a folder"
    folder.mkdir()
    (folder / "the data.bin").write_bytes(b.binary)
    document["buffers"][0]["uri"] = "a%20folder/the%20data.bin"
    (tmp_path / "external.gltf").write_text(json.dumps(document))
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(b.binary).decode()
    (tmp_path / "inline.gltf").write_text(json.dumps(document))
    for name in ("external.gltf", "inline.gltf"):
        other = load_gltf(tmp_path / name)
        for field in ("position", "normal", "uv0", "index"):
            np.testing.assert_array_equal(getattr(piece(other), field), getattr(piece(embedded), field))
    np.testing.assert_array_equal(piece(embedded).position, QUAD)
    np.testing.assert_array_equal(piece(embedded).index.ravel(), QUAD_INDEX)


def test_hash_is_over_the_file_and_what_it_names(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    document = b.document()
    document["buffers"][0]["uri"] = "data.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    (tmp_path / "data.bin").write_bytes(b.binary)
    before = load_gltf(tmp_path / "a.gltf").sha256
    assert len(before) == 64 and load_gltf(tmp_path / "a.gltf").sha256 == before
    (tmp_path / "data.bin").write_bytes(b.binary + b"more")
    assert load_gltf(tmp_path / "a.gltf").sha256 != before


@pytest.mark.parametrize("uri", ["../data.bin", "a/../../data.bin", "%2E%2E/data.bin", "{absolute}"])
def test_files_outside_the_folder_need_leave(tmp_path: Path, uri: str) -> None:
    b = Builder()
    b.scene(b.quad())
    inner = tmp_path / "inner"
    (inner / "a").mkdir(parents=True)
    (tmp_path / "data.bin").write_bytes(b.binary)
    document = b.document()
    document["buffers"][0]["uri"] = uri.format(absolute=tmp_path / "data.bin")
    (inner / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(LoadError, match="leaves the folder"):
        load_gltf(inner / "a.gltf")
    assert load_gltf(inner / "a.gltf", allow_outside=True).triangle_count() == 2


# --- accessors


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16"])
@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_positions(tmp_path: Path, dtype: str, normalized: bool) -> None:
    limits = np.iinfo(dtype)
    stored = np.array([[0, 0, 0], [limits.max, 0, 0], [0, limits.max, 0], [limits.min, 7, 1]], dtype)
    b = Builder()
    b.scene(b.primitive({"POSITION": b.accessor(stored, normalized=normalized)}, indices=b.accessor(QUAD_INDEX)))
    got = piece(load(b, tmp_path, smooth=True)).position
    want = np.maximum(stored / limits.max, -1.0) if normalized else stored
    np.testing.assert_allclose(got, want, rtol=1e-6)
    assert got.dtype == np.float32 and got.flags.c_contiguous


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32"])
def test_index_types(tmp_path: Path, dtype: str) -> None:
    b = Builder()
    b.scene(b.quad(indices=b.accessor(QUAD_INDEX.astype(dtype))))
    got = piece(load(b, tmp_path)).index
    assert got.dtype == np.uint32
    np.testing.assert_array_equal(got.ravel(), QUAD_INDEX)


def test_interleaved_and_unaligned(tmp_path: Path) -> None:
    rows = np.zeros(4, [("pad", "u1"), ("position", "<f4", 3), ("uv", "<u2", 2), ("tail", "u1", 3)])
    rows["position"], rows["uv"] = QUAD, QUAD_UV * 65535
    b = Builder()
    view = b.view(rows.tobytes(), byteStride=rows.itemsize)
    position = b.add("accessors", bufferView=view, byteOffset=1, componentType=5126, type="VEC3", count=4)
    uv = b.add("accessors", bufferView=view, byteOffset=13, componentType=5123, type="VEC2", count=4, normalized=True)
    b.scene(b.primitive({"POSITION": position, "TEXCOORD_0": uv}, indices=b.accessor(QUAD_INDEX)))
    got = piece(load(b, tmp_path, smooth=True))
    np.testing.assert_array_equal(got.position, QUAD)
    np.testing.assert_array_equal(got.uv0, QUAD_UV)


def test_sparse_over_data_and_over_nothing(tmp_path: Path) -> None:
    b = Builder()
    moved = np.float32([[9, 8, 7], [6, 5, 4]])
    sparse = {"count": 2, "indices": {"bufferView": b.view(np.uint8([1, 3]).tobytes()), "componentType": 5121},
              "values": {"bufferView": b.view(moved.tobytes())}}  # fmt: skip
    over_data = b.accessor(QUAD, sparse=sparse)
    over_nothing = b.add("accessors", componentType=5126, type="VEC3", count=4, sparse=sparse)
    for accessor in (over_data, over_nothing):
        b.scene(b.primitive({"POSITION": accessor}, indices=b.accessor(QUAD_INDEX)))
    scene = load(b, tmp_path, smooth=True)
    for mesh, base in ((0, QUAD.copy()), (1, np.zeros_like(QUAD))):
        base[[1, 3]] = moved
        np.testing.assert_array_equal(piece(scene, mesh).position, base)


# --- primitives


def test_strips_and_fans_keep_their_winding(tmp_path: Path) -> None:
    zigzag = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]])
    ring = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 1, 0]])
    b = Builder()
    b.scene(
        b.primitive({"POSITION": b.accessor(zigzag)}, mode=5),
        b.primitive({"POSITION": b.accessor(ring)}, mode=6, indices=b.accessor(np.uint8([0, 1, 2, 3, 4]))),
        b.primitive({"POSITION": b.accessor(zigzag[:3])}),
    )
    scene = load(b, tmp_path)
    assert [len(p.index) for p in scene.meshes[0].primitives] == [3, 3, 1]  # type: ignore[union-attr]
    for k in range(3):  # all counter-clockwise, so all face +Z
        np.testing.assert_array_equal(
            piece(scene, 0, k).normal, np.tile([0, 0, 1], (len(piece(scene, 0, k).normal), 1))
        )
    np.testing.assert_array_equal(piece(scene, 0, 0).position[:6], zigzag[[0, 1, 2, 1, 3, 2]])
    np.testing.assert_array_equal(piece(scene, 0, 1).position[:6], ring[[1, 2, 0, 2, 3, 0]])
    assert scene.warnings == ()


@pytest.mark.parametrize(("mode", "name"), [(0, "POINTS"), (1, "LINES"), (2, "LINE_LOOP"), (3, "LINE_STRIP")])
def test_points_and_lines_are_reported(tmp_path: Path, mode: int, name: str) -> None:
    b = Builder()
    b.scene(b.quad(), b.quad(mode=mode))
    scene = load(b, tmp_path)
    assert scene.triangle_count() == 2
    assert scene.warnings == (f'mesh "lamp", primitive 1: {name} are not drawn',)
    with pytest.raises(LoadError, match="not drawn"):
        load(b, tmp_path, strict=True)


def test_missing_normals_are_flat_or_smooth(tmp_path: Path) -> None:
    roof = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 1], [1, 2, 0], [0, 2, 0]])
    index = np.uint16([0, 1, 2, 0, 2, 3, 3, 2, 4, 3, 4, 5])
    b = Builder()
    b.scene(b.primitive({"POSITION": b.accessor(roof)}, indices=b.accessor(index)))
    flat, smooth = piece(load(b, tmp_path)), piece(load(b, tmp_path, smooth=True))
    assert len(flat.position) == 12 and len(smooth.position) == 6
    np.testing.assert_allclose(flat.normal[:6], np.tile([0, -(0.5**0.5), 0.5**0.5], (6, 1)), atol=1e-6)
    np.testing.assert_allclose(flat.normal[6:], np.tile([0, 0.5**0.5, 0.5**0.5], (6, 1)), atol=1e-6)
    np.testing.assert_array_equal(flat.position[flat.index], roof[index.reshape(-1, 3)])
    # The ridge: angles of 45 + 90 degrees from each side at both of its ends.
    np.testing.assert_allclose(smooth.normal[[2, 3]], [[0, 0, 1], [0, 0, 1]], atol=1e-6)


def test_normals_are_made_unit_and_those_without_direction_replaced(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad()
    normal = np.float32([[0, 0, 5], [0, 0, 0], [np.nan, 0, 0], [0, 3, 4]])
    quad["attributes"]["NORMAL"] = b.accessor(normal)
    scene = load(b.scene(quad), tmp_path)
    np.testing.assert_allclose(piece(scene).normal, [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0.6, 0.8]], atol=1e-6)
    assert any("normals without direction" in w for w in scene.warnings)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("width", [3, 4])
def test_vertex_colours(tmp_path: Path, dtype: str, width: int) -> None:
    value = np.array([[0.2, 0.4, 0.6, 0.8]] * 4)[:, :width]
    scale = 1 if dtype == "float32" else np.iinfo(dtype).max
    b = Builder()
    quad = b.quad()
    quad["attributes"]["COLOR_0"] = b.accessor((value * scale).astype(dtype), normalized=dtype != "float32")
    got = piece(load(b.scene(quad), tmp_path)).color
    assert got is not None and got.shape == (4, 4)
    np.testing.assert_allclose(got[:, :width], value, atol=3e-3)
    assert width == 4 or np.all(got[:, 3] == 1.0)


def test_what_is_not_read_is_named(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad()
    quad["attributes"]["TEXCOORD_2"] = quad["attributes"]["TEXCOORD_0"]
    quad["attributes"]["_TEMPERATURE"] = quad["attributes"]["TEXCOORD_0"]
    b.json["extensionsUsed"] = ["KHR_materials_sheen"]
    for _ in range(2):
        b.add("materials", extensions={"KHR_materials_sheen": {}})
    b.scene(quad)
    warnings = load(b, tmp_path).warnings
    assert "KHR_materials_sheen is not supported and ignored in 2 materials" in warnings
    assert 'mesh "lamp", primitive 0: TEXCOORD_2 is not used' in warnings
    assert 'mesh "lamp", primitive 0: _TEMPERATURE is not used' in warnings


def test_nan_vertices_pass_through(tmp_path: Path) -> None:
    broken = QUAD.copy()
    broken[3] = np.nan
    b = Builder()
    for attributes in ({}, {"TEXCOORD_0": b.accessor(QUAD_UV)}):
        b.scene(b.primitive({"POSITION": b.accessor(broken), **attributes}, indices=b.accessor(QUAD_INDEX), material=0))
    b.add("materials", normalTexture={"index": 0})
    b.add("textures", source=0)
    b.add("images", bufferView=b.view(PNG), mimeType="image/png")
    scene = load(b, tmp_path)
    for mesh in (0, 1):
        made = piece(scene, mesh)
        assert len(made.index) == 2  # dropping them is the geometry stage's business
        assert np.isfinite(made.normal).all() and made.tangent is not None and np.isfinite(made.tangent).all()


# --- nodes


def test_hierarchy_of_trs_and_matrix(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    quarter = [0, 0, 0.5**0.5, 0.5**0.5]  # 90 degrees about +Z
    matrix = np.array([[2, 0, 0, 1], [0, 2, 0, 2], [0, 0, -2, 3], [0, 0, 0, 1]], float)
    b.json["nodes"] = [
        {"mesh": 0, "scale": [1, 2, 3], "name": "leaf"},
        {"children": [0], "rotation": quarter, "translation": [10, 0, 0]},
        {"children": [1], "matrix": matrix.T.ravel().tolist()},
    ]
    b.json["scenes"] = [{"nodes": [2]}]
    scene = load(b, tmp_path)
    rotated = np.array([[0, -1, 0, 10], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    want = matrix @ rotated @ np.diag([1, 2, 3, 1.0])
    np.testing.assert_allclose(scene.instances[0].world_from_object, want, atol=1e-6)
    assert np.linalg.det(scene.instances[0].world_from_object[:3, :3]) < 0  # mirrored, as the file says
    assert [n.parent for n in scene.nodes] == [1, 2, -1] and scene.instances[0].node == 0
    assert scene.nodes[2].matrix is not None and scene.instances[0].name == "leaf"


def test_one_mesh_under_many_nodes_stays_one(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    for x in (1, 2):
        b.json["scenes"][0]["nodes"].append(b.add("nodes", mesh=0, translation=[x, 0, 0]))
    scene = load(b, tmp_path)
    assert len(scene.meshes) == 1 and [i.mesh for i in scene.instances] == [0, 0, 0]
    assert [i.world_from_object[0, 3] for i in scene.instances] == [0, 1, 2] and scene.triangle_count() == 6


def test_meshes_that_differ_in_material_are_one_shape(tmp_path: Path) -> None:
    b = Builder()
    red, green, bumpy = (b.add("materials", name=n) for n in ("red", "green", "bumpy"))
    quad = b.quad()
    for material in (red, green, None, red, bumpy):
        b.scene({**quad, **({} if material is None else {"material": material})})
    b.json["materials"][bumpy]["normalTexture"] = {"index": b.add("textures", source=0)}
    b.add("images", bufferView=b.view(PNG), mimeType="image/png")
    scene = load(b, tmp_path)
    assert [i.mesh for i in scene.instances] == [0, 0, 0, 0, 1]  # a normal map brings tangents: another shape
    names = [scene.materials[(i.materials or (scene.meshes[i.mesh].primitives[0].material,))[0]].name
             for i in scene.instances]  # fmt: skip
    assert names == ["red", "green", "", "red", "bumpy"]
    assert piece(scene, 0).tangent is None and piece(scene, 1).tangent is not None


def test_gpu_instancing_with_normalised_rotations(tmp_path: Path) -> None:
    b = Builder()
    rotation = np.int16([[0, 0, 0, 32767], [0, 0, 23170, 23170]])
    attributes = {"TRANSLATION": b.accessor(np.float32([[1, 0, 0], [0, 2, 0]])),
                  "ROTATION": b.accessor(rotation, normalized=True),
                  "SCALE": b.accessor(np.float32([[1, 1, 1], [3, 1, 1]]))}  # fmt: skip
    b.scene(b.quad(), translation=[0, 0, 5], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    scene = load(b, tmp_path)
    assert len(scene.meshes) == 1 and len(scene.instances) == 2
    np.testing.assert_allclose(scene.instances[0].world_from_object[:3, 3], [1, 0, 5])
    want = np.array([[0, -1, 0, 0], [3, 0, 0, 2], [0, 0, 1, 5], [0, 0, 0, 1]])
    np.testing.assert_allclose(scene.instances[1].world_from_object, want, atol=1e-4)


def test_default_scene_only(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    b.json["scenes"] = [{"nodes": []}, {"nodes": [0], "name": "this"}, {"nodes": [0], "name": "other"}]
    b.json["scene"] = 1
    scene = load(b, tmp_path)
    assert scene.triangle_count() == 2
    assert scene.warnings == ('scene 0; scene "other": not loaded: it is not the default scene',)


def test_lights(tmp_path: Path) -> None:
    b = Builder()
    spot = {"type": "spot", "color": [1, 0.5, 0.25], "intensity": 30, "range": 8,
            "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}}  # fmt: skip
    b.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 7}, spot]}}
    quarter = [0.5**0.5, 0, 0, 0.5**0.5]  # -Z turned about +X points to +Y
    b.scene(b.quad())
    for light in (0, 1):
        node = b.add("nodes", rotation=quarter, translation=[1, 2, 3], scale=[2, 2, 2], name=f"n{light}",
                     extensions={"KHR_lights_punctual": {"light": light}})  # fmt: skip
        b.json["scenes"][0]["nodes"].append(node)
    sun, lamp = load(b, tmp_path).lights
    assert (sun.kind, sun.intensity, sun.color, sun.range) == ("directional", 7.0, (1.0, 1.0, 1.0), 0.0)
    np.testing.assert_allclose(sun.direction, [0, 1, 0], atol=1e-7)
    assert (lamp.kind, lamp.color, lamp.intensity, lamp.range) == ("spot", (1.0, 0.5, 0.25), 30.0, 8.0)
    assert (lamp.inner_cone, lamp.outer_cone, lamp.position, lamp.name, lamp.node) == (0.25, 0.5, (1, 2, 3), "n1", 2)
    assert lamp.angular_diameter == lamp.radius == 0.0


def test_cameras_are_rigid(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    b.add("cameras", type="perspective", name="eye", perspective={"yfov": 0.7, "znear": 0.1})
    b.add("cameras", type="orthographic", orthographic={"xmag": 3, "ymag": 2, "znear": 0, "zfar": 9})
    quarter = [0, 0.5**0.5, 0, 0.5**0.5]  # looks along -X
    for camera, scale in ((0, [3, 3, 3]), (1, [-1, 2, 5])):
        node = b.add("nodes", camera=camera, rotation=quarter, scale=scale, translation=[4, 5, 6], name="where")
        b.json["scenes"][0]["nodes"].append(node)
    eye, plan = load(b, tmp_path).cameras
    assert (eye.name, eye.fov_y, eye.near, eye.far, eye.node) == ("eye", 0.7, 0.1, 0.0, 1)
    assert (plan.name, plan.fov_y, plan.xmag, plan.ymag, plan.near, plan.far) == ("where", 0.0, 3.0, 2.0, 0.0, 9.0)
    for camera in (eye, plan):
        pose = camera.world_from_view
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) > 0
        np.testing.assert_allclose(pose @ [0, 0, -1, 0], [-1, 0, 0, 0], atol=1e-7)
        np.testing.assert_allclose(pose[:3, 3], [4, 5, 6])


# --- what moves


def test_skin_morph_and_animation(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad()
    quad["attributes"]["JOINTS_0"] = b.accessor(np.uint8([[0, 1, 0, 9]] * 4))
    quad["attributes"]["WEIGHTS_0"] = b.accessor(np.uint8([[255, 127, 128, 0]] * 4), normalized=True)
    quad["targets"] = [{"POSITION": b.accessor(QUAD * 2)}, {"NORMAL": b.accessor(QUAD)}]
    bind = np.tile(np.arange(16, dtype=np.float32), (2, 1))
    b.scene(quad, skin=0, weights=[0.5, 0.25], translation=[100, 0, 0])
    b.json["meshes"][0]["weights"] = [1, 0]
    b.json["scenes"][0]["nodes"] += [b.add("nodes", name="bone"), b.add("nodes")]
    b.add("skins", joints=[1, 2], inverseBindMatrices=b.accessor(bind))
    times = b.accessor(np.float32([0, 1]))
    turns = b.accessor(np.int8([[0, 0, 0, 127], [0, 127, 0, 0]]), normalized=True)
    spline = b.accessor(np.arange(18, dtype=np.float32).reshape(6, 3))
    weights = b.accessor(np.float32([1, 2, 3, 4]))
    b.add("animations", name="walk", samplers=[
        {"input": times, "output": turns, "interpolation": "STEP"},
        {"input": times, "output": spline, "interpolation": "CUBICSPLINE"},
        {"input": times, "output": weights},
    ], channels=[
        {"sampler": 0, "target": {"node": 1, "path": "rotation"}},
        {"sampler": 1, "target": {"node": 2, "path": "translation"}},
        {"sampler": 2, "target": {"node": 0, "path": "weights"}},
    ])  # fmt: skip
    scene = load(b, tmp_path)
    made, instance = piece(scene), scene.instances[0]
    np.testing.assert_array_equal(instance.world_from_object, np.eye(4))  # the node has no say over a skinned mesh
    assert instance.skin == 0 and scene.skins[0].joints == (1, 2)
    np.testing.assert_array_equal(
        scene.skins[0].inverse_bind[0], [*np.arange(16).reshape(4, 4).T[:3].tolist(), [0, 0, 0, 1]]
    )
    assert made.joints is not None and made.joints.dtype == np.uint16 and made.weights is not None
    np.testing.assert_allclose(made.weights.sum(1), 1, atol=1e-6)
    assert scene.meshes[0].morph_weights == (1.0, 0.0) and scene.nodes[0].morph_weights == (0.5, 0.25)
    np.testing.assert_array_equal(made.morph_targets[0].position, QUAD * 2)
    assert made.morph_targets[1].position is None and made.morph_targets[0].normal is None
    step, cubic, linear = scene.animations[0].channels
    assert (step.interpolation, cubic.interpolation, linear.interpolation) == ("STEP", "CUBICSPLINE", "LINEAR")
    np.testing.assert_array_equal(step.values, [[0, 0, 0, 1], [0, 1, 0, 0]])
    assert cubic.values.shape == (2, 3, 3) and linear.values.shape == (2, 2)
    np.testing.assert_array_equal(cubic.values[1, 1], [12, 13, 14])


def test_flat_shading_keeps_skin_and_morph_with_their_vertices(tmp_path: Path) -> None:
    b = Builder()
    attributes = {"POSITION": b.accessor(QUAD), "JOINTS_0": b.accessor(np.uint8([[k, 0, 0, 0] for k in range(4)])),
                  "WEIGHTS_0": b.accessor(np.float32([[1, 0, 0, 0]] * 4))}  # fmt: skip
    b.scene({"attributes": attributes, "indices": b.accessor(QUAD_INDEX), "targets": [{"POSITION": b.accessor(QUAD)}]})
    made = piece(load(b, tmp_path))
    assert made.joints is not None
    np.testing.assert_array_equal(made.position, QUAD[QUAD_INDEX])
    np.testing.assert_array_equal(made.joints[:, 0], QUAD_INDEX)
    np.testing.assert_array_equal(made.morph_targets[0].position, made.position)


# --- materials

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR4nGNgaGD4DwAChAGAJRc0xwAAAABJRU5ErkJggg=="
)


def textured(**material: Any) -> Builder:
    """A quad whose material may use texture 0, a 1 x 1 image."""
    b = Builder()
    b.scene(b.quad(material=0))
    b.add("materials", **material)
    b.add("textures", source=0, sampler=0)
    b.add("samplers", wrapS=33071, wrapT=33648, magFilter=9728, minFilter=9729)
    b.add("images", bufferView=b.view(PNG), mimeType="image/png", name="dot")
    return b


def test_material_without_and_with_factors(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad(), b.quad(material=0), b.quad(material=1), b.quad())
    b.add("materials")
    b.add("materials", name="m", pbrMetallicRoughness={"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5,
          "roughnessFactor": 0.25}, emissiveFactor=[1, 0.5, 0], alphaMode="MASK", alphaCutoff=0.7, doubleSided=True,
          extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 4}, "KHR_materials_unlit": {},
                      "KHR_materials_ior": {"ior": 1.33}, "KHR_materials_transmission": {"transmissionFactor": 0.9},
                      "KHR_materials_specular": {"specularFactor": 0.3, "specularColorFactor": [2, 1, 0]},
                      "KHR_materials_clearcoat": {
                          "clearcoatFactor": 0.6, "clearcoatRoughnessFactor": 0.2}})  # fmt: skip
    scene = load(b, tmp_path)
    none, default, full = scene.materials
    assert (none.metallic, none.roughness, none.base_color) == (0.0, 1.0, (1.0,) * 4)  # no material at all
    assert (default.metallic, default.roughness) == (1.0, 1.0)  # glTF's own default
    assert [p.material for p in scene.meshes[0].primitives] == [0, 1, 2, 0]
    assert full.base_color == (0.1, 0.2, 0.3, 0.4) and (full.metallic, full.roughness) == (0.5, 0.25)
    assert full.emissive == (4.0, 2.0, 0.0) and (full.alpha_mode, full.alpha_cutoff) == ("MASK", 0.7)
    assert full.double_sided and full.unlit and full.ior == 1.33 and full.transmission == 0.9 and full.name == "m"
    assert (full.specular, full.specular_color) == (0.3, (2.0, 1.0, 0.0))
    assert (full.clearcoat, full.clearcoat_roughness) == (0.6, 0.2)


def test_every_texture_slot_with_its_sampler(tmp_path: Path) -> None:
    info = {"index": 0}
    b = textured(
        pbrMetallicRoughness={"baseColorTexture": info, "metallicRoughnessTexture": info},
        normalTexture={"index": 0, "scale": 0.5}, occlusionTexture={"index": 0, "strength": 0.25, "texCoord": 1},
        emissiveTexture=info,
        extensions={
            "KHR_materials_specular": {"specularTexture": info, "specularColorTexture": info},
            "KHR_materials_clearcoat": {"clearcoatTexture": info, "clearcoatRoughnessTexture": info,
                                        "clearcoatNormalTexture": {"index": 0, "scale": 2}},
            "KHR_materials_transmission": {"transmissionTexture": info},
        },
    )  # fmt: skip
    from glhybrid.scene import TEXTURE_SLOTS

    scene = load(b, tmp_path)
    material = scene.materials[0]
    assert set(material.textures) == set(TEXTURE_SLOTS)
    assert (material.normal_scale, material.occlusion_strength, material.clearcoat_normal_scale) == (0.5, 0.25, 2.0)
    assert {slot: t.uv_set for slot, t in material.textures.items()} == {
        s: int(s == "occlusion") for s in TEXTURE_SLOTS
    }
    base = material.textures["base_color"]
    assert (base.wrap_u, base.wrap_v, base.nearest, base.mipmap) == ("clamp", "mirror", True, False)
    assert base.image.name == "dot" and base.image.texels.shape == (1, 1, 4)
    assert base.image is material.textures["occlusion"].image and base is material.textures["emissive"]
    assert any("no TEXCOORD_1" in w for w in scene.warnings)


def test_texture_transform_overrides_the_uv_set(tmp_path: Path) -> None:
    transform = {"offset": [0.1, 0.2], "rotation": np.pi / 2, "scale": [2, 3], "texCoord": 1}
    b = textured(pbrMetallicRoughness={"baseColorTexture": {
        "index": 0, "extensions": {"KHR_texture_transform": transform}}})  # fmt: skip
    b.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = 2
    texture = load(b, tmp_path).materials[0].textures["base_color"]
    assert texture.uv_set == 1 and texture.uv_transform is not None
    # Scaled, then turned counter-clockwise on the image (u to -v, which is up), then moved.
    np.testing.assert_allclose(texture.uv_transform @ [1, 0, 1], [0.1, 0.2 - 2], atol=1e-12)
    np.testing.assert_allclose(texture.uv_transform @ [0, 1, 1], [0.1 + 3, 0.2], atol=1e-12)


def test_texture_transforms_of_the_khronos_model_hit_their_markers() -> None:
    """Its markers lie where the arrow's tip must appear, so all of them must read the same texel."""
    path = Path(__file__).parents[3] / "shared/models/TextureTransformTest/TextureTransformTest.gltf"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    scene = load_gltf(path)
    tips = []
    for quad in ("Rotation", "Scale", "All"):
        texture = next(m for m in scene.materials if m.name == quad).textures["base_color"]
        marker = next(n for n in scene.nodes if n.name.startswith(f"{quad} - Correct"))
        uv = np.array([marker.translation[0] + 0.5, 0.5 - marker.translation[1], 1.0])
        assert texture.uv_transform is not None
        tips.append(texture.uv_transform @ uv)
    np.testing.assert_allclose(tips, [[0.778, 0.778]] * 3, atol=0.04)  # the last marker was placed by eye


def test_third_uv_set_is_reported(tmp_path: Path) -> None:
    scene = load(textured(pbrMetallicRoughness={"baseColorTexture": {"index": 0, "texCoord": 2}}), tmp_path)
    assert not scene.materials[0].textures
    assert any("TEXCOORD_2" in w for w in scene.warnings)


def test_normal_map_brings_tangents_given_ones_stay(tmp_path: Path) -> None:
    b = textured(normalTexture={"index": 0})
    made = piece(load(b, tmp_path)).tangent
    np.testing.assert_allclose(made, [[1, 0, 0, 1]] * 4, atol=1e-6)  # upright image: right is +X, up is +Y
    b = textured(normalTexture={"index": 0})
    given = np.float32([[0, 1, 0, -1]] * 4)
    b.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = b.accessor(given)
    np.testing.assert_array_equal(piece(load(b, tmp_path)).tangent, given)
    assert piece(load(textured(), tmp_path)).tangent is None


def test_tangents_follow_the_rotation_of_the_normal_map(tmp_path: Path) -> None:
    turned = {"index": 0, "extensions": {"KHR_texture_transform": {"rotation": np.pi / 2}}}
    tangent = piece(load(textured(normalTexture=turned), tmp_path)).tangent
    assert tangent is not None
    # u' = v: the image's right runs along +v on the surface, which is down.
    np.testing.assert_allclose(tangent, [[0, -1, 0, 1]] * 4, atol=1e-6)


def test_webp_and_optional_basisu(tmp_path: Path) -> None:
    b = textured(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    b.json["textures"][0]["extensions"] = {"KHR_texture_basisu": {"source": 1}}
    b.add("images", uri="a.ktx2", mimeType="image/ktx2")
    scene = load(b, tmp_path)
    assert "base_color" in scene.materials[0].textures
    assert scene.warnings == ("KHR_texture_basisu is not supported and ignored in 1 texture",)
    del b.json["textures"][0]["source"]
    with pytest.raises(LoadError, match="KHR_texture_basisu"):
        load(b, tmp_path)


def test_strict_lets_clean_files_pass(tmp_path: Path) -> None:
    assert load(textured(normalTexture={"index": 0}), tmp_path, strict=True).warnings == ()
