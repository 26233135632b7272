"""The glTF reader: bytes, accessors and primitives, each on the smallest asset that holds it."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from gltf_builder import PNG, QUAD, QUAD_INDEX, QUAD_UV, Builder, load, piece

from glhybrid.errors import LoadError
from glhybrid.load.gltf import load_gltf

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
