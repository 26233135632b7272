"""Every file of the shared test models: either it loads as its table says, or it is refused with one LoadError."""

import re
from pathlib import Path

import numpy as np
import pytest

from glhybrid.errors import LoadError
from glhybrid.load.gltf import load_gltf
from glhybrid.load.mesh import load_mesh
from glhybrid.scene import Scene, Triangles

MODELS = Path(__file__).resolve().parents[3] / "shared" / "models"
if not MODELS.is_dir():
    pytest.skip(f"the test models are not at {MODELS}", allow_module_level=True)


def load(path: Path, **options: bool) -> Scene:
    read = load_gltf if path.suffix in (".gltf", ".glb") else load_mesh
    return read(path, **options)


def listed_counts() -> dict[str, int]:
    """Triangles by path, from the table of the models' own README."""
    rows = re.findall(r"^\| `([^`]+\.(?:glb|gltf|obj|ply))` \|.*?\| ([\d,]+) \| ([\d,]+) \|", README, re.M)
    return {path: int(triangles.replace(",", "")) for path, triangles, _ in rows}


README = (MODELS / "README.md").read_text()
COUNTS = listed_counts()
# The table counts a box once; the file draws 125 through EXT_mesh_gpu_instancing.
COUNTS["SimpleInstancing/SimpleInstancing.glb"] *= 125
EXPECTED_WARNINGS = {  # by part of the path: what the model holds and we do not draw; all others load strictly
    "ToyCar": ["KHR_materials_sheen is not supported and ignored in 1 material"],
    "MultipleScenes": ["scene 0: not loaded: it is not the default scene"],
    "MeshPrimitiveModes": [f'mesh "mesh with {m}", primitive 0: {m} are not drawn'
                           for m in ("POINTS", "LINES", "LINE_LOOP", "LINE_STRIP")],
    "StanfordBunny": ['vertex property "confidence" is not used', 'vertex property "intensity" is not used'],
}  # fmt: skip


def check_contract(scene: Scene) -> None:
    """What scene.py promises about every array and index."""
    for mesh in scene.meshes:
        assert mesh.primitives
        for p in mesh.primitives:
            assert isinstance(p, Triangles)
            v = len(p.position)
            assert p.position.shape == (v, 3) and p.normal.shape == (v, 3) and p.index.shape[1] == 3 and len(p.index)
            assert p.index.dtype == np.uint32 and p.index.max() < v and 0 <= p.material < len(scene.materials)
            for array, width in ((p.uv0, 2), (p.uv1, 2), (p.color, 4), (p.tangent, 4)):
                assert array is None or array.shape == (v, width)
            for array in (p.position, p.normal, p.uv0, p.uv1, p.color, p.tangent, p.weights):
                assert array is None or (array.dtype == np.float32 and array.flags.c_contiguous)
            np.testing.assert_allclose(np.linalg.norm(p.normal, axis=1), 1.0, atol=1e-3)
            assert p.joints is None or (p.joints.dtype == np.uint16 and p.joints.shape == p.weights.shape)  # type: ignore[union-attr]
            if "normal" in scene.materials[p.material].textures:
                assert p.tangent is not None
            if p.tangent is not None:
                np.testing.assert_allclose(np.linalg.norm(p.tangent[:, :3], axis=1), 1.0, atol=1e-3)
                assert set(np.unique(p.tangent[:, 3])) <= {-1.0, 1.0}
            assert len(p.morph_targets) == len(mesh.morph_weights)
    for instance in scene.instances:
        assert 0 <= instance.mesh < len(scene.meshes) and np.isfinite(instance.world_from_object).all()
        assert -1 <= instance.node < len(scene.nodes) and -1 <= instance.skin < len(scene.skins)
    for node in scene.nodes:
        assert -1 <= node.parent < len(scene.nodes)
    for skin in scene.skins:
        assert max(skin.joints) < len(scene.nodes) and skin.inverse_bind.shape == (len(skin.joints), 4, 4)
    for channel in (c for a in scene.animations for c in a.channels):
        assert channel.node < len(scene.nodes) and len(channel.values) == len(channel.times)
    for material in scene.materials:
        for texture in material.textures.values():
            assert texture.image.texels.dtype == np.uint8 and texture.image.texels.shape[2] == 4
    assert len(scene.sha256) == 64 and scene.path is not None


@pytest.mark.parametrize("name", COUNTS)
def test_triangle_count(name: str) -> None:
    wanted = next((w for part, w in EXPECTED_WARNINGS.items() if part in name), [])
    scene = load(MODELS / name, strict=not wanted)
    assert list(scene.warnings) == wanted
    assert scene.triangle_count() == COUNTS[name]
    check_contract(scene)


def test_features_that_models_are_there_for() -> None:
    lamp = load(MODELS / "LightsPunctualLamp/LightsPunctualLamp.gltf")
    assert [light.kind for light in lamp.lights] == ["point"] * 5
    assert any(m.transmission > 0 for m in lamp.materials)
    car = load(MODELS / "ToyCar/ToyCar.gltf")
    assert len(car.cameras) == 8 and any(m.clearcoat > 0 for m in car.materials)
    sponza = load(MODELS / "Sponza/Sponza.glb")
    assert sum(m.alpha_mode == "MASK" for m in sponza.materials) >= 2
    assert len({id(t.image) for m in sponza.materials for t in m.textures.values()}) == 23
    mirrored = load(MODELS / "NegativeScaleTest/NegativeScaleTest.glb")
    assert any(np.linalg.det(i.world_from_object[:3, :3]) < 0 for i in mirrored.instances)
    spheres = load(MODELS / "MetalRoughSpheresNoTextures/MetalRoughSpheresNoTextures.glb")
    assert len(spheres.meshes) == 5 and len({i.materials for i in spheres.instances}) == 98  # one sphere, 98 materials
    fox = load(MODELS / "Fox/Fox.glb")
    assert [a.name for a in fox.animations] == ["Survey", "Walk", "Run"] and fox.instances[0].skin == 0
    assert load(MODELS / "SimpleMorph/SimpleMorph.gltf").meshes[0].morph_weights == (0.5, 0.5)
    boxes = load(MODELS / "MultiUVTest/MultiUVTest.glb")
    assert {t.uv_set for t in boxes.materials[0].textures.values()} == {0, 1}
    cubic = load(MODELS / "InterpolationTest/InterpolationTest.glb")
    shapes = {c.interpolation: c.values.shape[1:] for a in cubic.animations for c in a.channels}
    assert shapes.keys() == {"STEP", "LINEAR", "CUBICSPLINE"} and shapes["CUBICSPLINE"][0] == 3


@pytest.mark.parametrize(
    "name",
    ["DreamApartment/dream-apartment.glb", "FlightHelmet/FlightHelmet.gltf", "BoxInterleaved/BoxInterleaved.glb",
     "AlphaBlendModeTest/AlphaBlendModeTest.glb", "CornellBox/CornellBox.glb", "Zdm2/zdm2.glb"],
)  # fmt: skip
def test_triangles_against_trimesh(name: str) -> None:
    """World positions of all triangles, in any order, equal trimesh's where trimesh reads the file rightly."""
    trimesh = pytest.importorskip("trimesh")
    theirs = trimesh.load_scene(str(MODELS / name), process=False).to_geometry().triangles.reshape(-1, 9)
    scene = load(MODELS / name)
    ours = np.concatenate([
        p.position[p.index] @ i.world_from_object[:3, :3].T + i.world_from_object[:3, 3]
        for i in scene.instances for p in scene.meshes[i.mesh].primitives if isinstance(p, Triangles)
    ]).reshape(-1, 9)  # fmt: skip
    assert ours.shape == theirs.shape
    scale = np.abs(theirs).max()

    def ordered(rows: np.ndarray) -> np.ndarray:
        rounded = np.round(rows / scale * 1e4).astype(np.int64)
        return np.array(rows[np.lexsort(rounded.T)])

    difference = np.abs(ordered(ours) - ordered(np.asarray(theirs))).max(axis=1)
    assert np.mean(difference > 1e-4 * scale) < 1e-3  # rows that rounding put in another order


# The Khronos validator's files. "loads": nothing in them changes a picture, or what is wrong is passed by; a phrase:
# it loads with that warning; a phrase after "refused:": the LoadError says so.
VALIDATOR = {
    "accessor_data/get_elements.gltf": "loads",  # no mesh uses the accessors, as in the next nine
    "accessor_data/get_elements_matrix.gltf": "loads",
    "accessor_data/get_elements_sparse.gltf": "loads",
    "accessor_data/invalid_elements_float.gltf": "loads",
    "accessor_data/out_of_range_elements_float.gltf": "loads",  # min and max are not used: we take bounds from the data
    "accessor_data/out_of_range_elements_sint16.gltf": "loads",
    "accessor_data/out_of_range_elements_sint8.gltf": "loads",
    "accessor_data/out_of_range_elements_uint16.gltf": "loads",
    "accessor_data/out_of_range_elements_uint32.gltf": "loads",
    "accessor_data/out_of_range_elements_uint8.gltf": "loads",
    "buffer/custom_property.gltf": "loads",
    "buffer/data_uri.glb": "loads",
    "buffer/empty_array.gltf": "loads",
    "buffer/empty_object.gltf": 'refused: "byteLength" is missing',
    "buffer/extra_padding.glb": "loads",  # too many bytes harm nobody
    "buffer/invalid_object.gltf": "refused: must be a JSON object",
    "buffer/invalid_uri_data.glb": "refused: is no data uri",
    "buffer/invalid_uri_data.gltf": "loads",  # ";;base64": what is meant is plain
    "buffer/invalid_uri_data_bytelength.gltf": "refused: must have 2 bytes, has 1",
    "buffer/invalid_uri_data_mime.gltf": "loads",
    "buffer/invalid_uri_scheme.gltf": "refused: there is no file",
    "buffer/no_bin_chunk.glb": "loads",  # a buffer without bytes is an error once something reads it
    "buffer/non_relative_uri.gltf": "refused: never fetched",
    "buffer/not_found.gltf": "refused: there is no file",
    "buffer/valid.glb": "loads",
    "buffer/valid.gltf": "loads",
    "buffer/valid_placeholder.glb": "loads",
    "buffer/wrong_bytelength.glb": "refused: must have 17 bytes, has 16",
    "buffer/zero_bytelength.gltf": 'refused: "byteLength" is 0',
    "glb/bom.glb": "byte order mark",
    "glb/chunk_too_big.glb": "refused: cut short",
    "glb/empty_file.glb": "refused: empty",
    "glb/empty_json_chunk.glb": "refused: holds no JSON",
    "glb/empty_json_object.glb": 'refused: "asset" is missing',
    "glb/extra_data.glb": "1 bytes after the end",
    "glb/invalid_json_chunk.glb": "refused: bad JSON",
    "glb/invalid_magic.glb": 'refused: a GLB with "glTF"',
    "glb/invalid_version.glb": "refused: GLB version 0, only 2 is read",
    "glb/json_and_two_buffers.glb": "chunk 2 repeats",
    "glb/length_mismatch.glb": "refused: says 49 bytes, the file has 48",
    "glb/misplaced_bin_chunk.glb": "loads",  # an unknown chunk before the BIN one
    "glb/no_header.glb": "refused: cut short",
    "glb/only_bin_chunk.glb": "refused: the first GLB chunk has type 0x004e4942, must be JSON",
    "glb/only_header.glb": "refused: no JSON chunk",
    "glb/truncated_chunk_data.glb": "refused: says 48 bytes, the file has 47",
    "glb/truncated_chunk_header.glb": "refused: its header needs 8 bytes, 1 are left",
    "glb/two_bin_chunks.glb": "refused: must be JSON",
    "glb/two_empty_bin_chunks.glb": "refused: must be JSON",
    "glb/two_empty_json_chunks.glb": "refused: holds no JSON",
    "glb/two_images.glb": "loads",
    "glb/two_valid_json_chunks.glb": "chunk 1 repeats",
    "glb/unaligned_chunk.glb": "loads",
    "glb/unknown_chunk.glb": "refused: must be JSON",
    "glb/valid.glb": "loads",
    "glb/valid_buffer.glb": "loads",
    "glb/zero_chunk_header.glb": "refused: must be JSON",
    "glb/zero_length.glb": "refused: no JSON chunk",
    "mesh_data/colors_non_clamped.gltf": "COLOR_0 outside 0 to 1 was clamped",
    "mesh_data/index_buffer_degenerate_triangle.gltf": "no nodes",  # the geometry stage drops and counts it
    "mesh_data/index_buffer_oob.gltf": "refused: index 5 is past the last vertex (3)",
    "mesh_data/index_buffer_primitive_restart.gltf": "index 255 would restart",
    "mesh_data/joints_no_weights.gltf": "POINTS are not drawn",
    "mesh_data/joints_weights_complex.gltf": "POINTS are not drawn",
    "mesh_data/normals_tangents_non_unit_invalid_sign.gltf": "TANGENT has a handedness other than 1 and -1",
    "node/custom_property.gltf": "loads",
    "node/empty_array.gltf": "loads",
    "node/empty_children_array.gltf": "loads",
    "node/infinite_transform.gltf": "refused: must be finite",
    "node/matrix_default.gltf": "loads",
    "node/matrix_indecomposable.gltf": "refused: affine",
    "node/matrix_trs.gltf": "has a matrix and translation",
    "node/node_empty.gltf": "EXT_extension_unknown is not supported and ignored in 1 node",
    "node/node_loop.gltf": "refused: loop",
    "node/node_loop_scene.gltf": "refused: one parent",
    "node/node_parent_override.gltf": "refused: one parent",
    "node/node_skin_without_skinned_mesh.gltf": "its mesh lacks JOINTS_0",
    "node/node_skinned_mesh_without_skin.gltf": "loads",
    "node/node_weights_invalid.gltf": "refused: 2 morph weights, its mesh has 1 targets",
    "node/node_weights_override.gltf": "loads",
    "node/rotation_non_unit.gltf": "was normalised",
    "node/skin_with_no_mesh.gltf": "loads",
    "node/unresolved_camera.gltf": "refused: camera 0",
    "node/unresolved_child_node.gltf": "refused: node 1",
    "node/unresolved_mesh.gltf": "refused: mesh 0",
    "node/unresolved_skin.gltf": "refused: skin 0",
    "node/valid.gltf": "loads",
    "node/weights_with_no_mesh.gltf": "has morph weights and no mesh",
}
ASSIMP = {
    "IncorrectVertexArrays/Cube.gltf": "the last 2 of its vertices make no triangle",
    "IndexOutOfRange/AllIndicesOutOfRange.gltf": "refused: index 65535 is past the last vertex (23)",
    "IndexOutOfRange/IndexOutOfRange.gltf": "refused: index 255 is past the last vertex (23)",
    "MissingBin/BoxTextured.gltf": "refused: there is no file",
    "RecursiveNodes/RecursiveNodes.gltf": "refused: loop",
    "OBJ/box_UTF16BE.obj": "no material library",
    "OBJ/box_longline.obj": "no material library",
    "OBJ/box_without_lineending.obj": "no material library",
    "OBJ/concave_polygon.obj": "loads",
    "OBJ/cube_usemtl.obj": 'material "mtl3": is in no material library',
    "OBJ/cube_with_vertexcolors.obj": "loads",
    "OBJ/mtl_different_folder.obj": "refused: there is no file",  # image.jpg beside the MTL
    "OBJ/multiple_spaces.obj": "loads",
    "OBJ/number_formats.obj": 'refused: line 11: "3.1+e2" is not a number',
    "OBJ/point_cloud.obj": "refused: holds no faces",
    "OBJ/testline.obj": "refused: holds no faces",
    "OBJ/testmixed.obj": "6 lines are not drawn",
    "PLY/cube.ply": "loads",
    "PLY/cube_binary.ply": "loads",
    "PLY/cube_binary_header_with_RN_newline.ply": "loads",
    "PLY/cube_binary_starts_with_nl.ply": "loads",
    "PLY/cube_uv.ply": "loads",
    "PLY/float-color.ply": "loads",
    "PLY/points.ply": "refused: holds no faces",
    "invalid/crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply": "refused: no PLY header",
    "invalid/empty.obj": "refused: holds no faces",
    "invalid/empty.ply": "refused: no PLY header",
    "invalid/malformed.obj": 'refused: line 23: "12" refers to v 12; the file has 8',
    "invalid/malformed2.obj": "1 faces with fewer than three corners",
}
TINYGLTF = {
    "integer-out-of-bounds.gltf": "refused: bufferView 0: ends at byte",
    "invalid-buffer-index.gltf": "refused: buffer 1",
    "invalid-buffer-view-index.gltf": "refused: bufferView 1",
    "invalid-primitive-indices.gltf": "refused: bufferView 1",
}
TABLES = {"glTF-Validator": VALIDATOR, "assimp-models": ASSIMP, "tinygltf-bounds": TINYGLTF}


@pytest.mark.parametrize("folder", TABLES)
def test_tables_are_complete(folder: str) -> None:
    suffixes = (".gltf", ".glb", ".obj", ".ply")
    there = {p.relative_to(MODELS / folder).as_posix() for p in (MODELS / folder).rglob("*") if p.suffix in suffixes}
    assert there == TABLES[folder].keys()


@pytest.mark.parametrize(("folder", "name"), [(f, n) for f, table in TABLES.items() for n in table])
def test_broken_and_odd_files(folder: str, name: str) -> None:
    path, verdict = MODELS / folder / name, TABLES[folder][name]
    if verdict.startswith("refused: "):
        with pytest.raises(LoadError, match=re.escape(verdict.removeprefix("refused: "))) as caught:
            load(path)
        assert str(path.parent) in str(caught.value) and "\n" not in str(caught.value)
        return
    scene = load(path)
    check_contract(scene)
    remarks = [w for w in scene.warnings if "nothing to draw" not in w and "no nodes" not in w]
    if verdict == "loads":
        assert remarks == []
    else:
        assert any(verdict in w for w in scene.warnings)


GENERATED = sorted((MODELS / "glTF-Asset-Generator").rglob("*.gltf"))


@pytest.mark.parametrize("path", GENERATED, ids=lambda p: p.stem)
def test_generated_assets(path: Path) -> None:
    if "NegativeScale" in path.name:  # all of them name a texture that is not there
        with pytest.raises(LoadError, match="image 1: there is no file"):
            load(path)
        return
    scene = load(path)
    check_contract(scene)
    points_or_lines = re.search(r"PrimitiveMode_(0[0-3]|0[7-9]|10)$", path.stem)
    assert bool(scene.warnings) == bool(points_or_lines) == (scene.triangle_count() == 0)


def test_all_generated_assets_are_there() -> None:
    assert len(GENERATED) == 78


def test_primitive_modes_draw_the_same_square() -> None:
    """Strips, fans and lists of the Asset Generator, with and without indices, show one square that faces +Z."""
    areas = {}
    for number in (4, 5, 6, 11, 12, 13, 14, 15):
        scene = load(MODELS / f"glTF-Asset-Generator/Mesh_PrimitiveMode/Mesh_PrimitiveMode_{number:02}.gltf")
        p = scene.meshes[0].primitives[0]
        assert isinstance(p, Triangles)
        corner = p.position[p.index].astype(np.float64)
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert np.all(cross[:, 2] > 0)
        areas[number] = cross[:, 2].sum() / 2
    np.testing.assert_allclose(list(areas.values()), areas[4], rtol=1e-5)
