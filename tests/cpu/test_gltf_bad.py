# ruff: noqa: E501 -- the table of broken files has one case a line
"""Broken glTF: one LoadError that names the thing, never another exception, a hang or silent nonsense."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import PNG, QUAD, QUAD_INDEX, Builder, load, textured

from glhybrid.errors import LoadError
from glhybrid.load.gltf import load_gltf

Doc = dict[str, Any]


def whole() -> Builder:
    """An asset that uses every kind of reference, to break one at a time."""
    b = textured(normalTexture={"index": 0})
    quad = b.json["meshes"][0]["primitives"][0]
    quad["attributes"]["JOINTS_0"] = b.accessor(np.uint8([[0, 0, 0, 0]] * 4))
    quad["attributes"]["WEIGHTS_0"] = b.accessor(np.float32([[1, 0, 0, 0]] * 4))
    quad["targets"] = [{"POSITION": b.accessor(QUAD)}]
    sparse = {"count": 1, "indices": {"bufferView": b.view(b"\1"), "componentType": 5121},
              "values": {"bufferView": b.view(b"\0" * 12)}}  # fmt: skip
    b.json["accessors"][quad["targets"][0]["POSITION"]]["sparse"] = sparse
    b.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 1})
    b.json["nodes"][0]["skin"] = b.add(
        "skins", joints=[1], inverseBindMatrices=b.accessor(np.eye(4, dtype="f4").reshape(1, 16))
    )
    b.json["nodes"][0]["children"] = [b.add("nodes", camera=0)]
    b.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    b.json["nodes"][1]["extensions"] = {"KHR_lights_punctual": {"light": 0}}
    times = b.accessor(np.float32([0, 1]))
    b.add("animations", samplers=[{"input": times, "output": b.accessor(np.zeros((2, 3), np.float32))}],
          channels=[{"sampler": 0, "target": {"node": 1, "path": "translation"}}])  # fmt: skip
    b.json["scene"] = 0
    return b


def test_the_whole_asset_loads(tmp_path: Path) -> None:
    assert load(whole(), tmp_path, strict=True).triangle_count() == 2


def _set(*path: Any, value: Any) -> Callable[[Doc], None]:
    def change(document: Doc) -> None:
        at: Any = document
        for key in path[:-1]:
            at = at[key]
        if value is ...:
            del at[path[-1]]
        else:
            at[path[-1]] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)
BROKEN = {
    # references
    "accessor -> bufferView": (_set("accessors", 0, "bufferView", value=99), r'accessor 0: "bufferView" .* 99, the file has'),
    "bufferView -> buffer": (_set("bufferViews", 0, "buffer", value=7), r"bufferView 0: .* 7, the file has 1 \(0 to 0\)"),
    "node -> mesh": (_set("nodes", 0, "mesh", value=3), r"node 0: .*mesh 3, the file has 1"),
    "node -> camera": (_set("nodes", 1, "camera", value=1), "node 1: .*camera 1"),
    "node -> skin": (_set("nodes", 0, "skin", value=1), "node 0: .*skin 1"),
    "node -> child": (_set("nodes", 0, "children", value=[9]), "node 0: .*node 9"),
    "node -> light": (_set("nodes", 1, "extensions", "KHR_lights_punctual", "light", value=4), "light 4 does not exist"),
    "scene -> node": (_set("scenes", 0, "nodes", value=[5]), "scene 0: .*node 5"),
    "scene": (_set("scene", value=2), "scene 2"),
    "primitive -> indices": (_set(*PRIMITIVE, "indices", value=99), 'mesh "lamp", primitive 0: .*accessor 99'),
    "primitive -> POSITION": (_set(*PRIMITIVE, "attributes", "POSITION", value=99), "primitive 0, attributes: .*99"),
    "primitive -> target": (_set(*PRIMITIVE, "targets", 0, "POSITION", value=99), "primitive 0, target 0: .*99"),
    "primitive -> material": (_set(*PRIMITIVE, "material", value=1), 'mesh "lamp", primitive 0: .*material 1'),
    "material -> texture": (_set("materials", 0, "normalTexture", "index", value=1), "material 0, normalTexture: .*texture 1"),
    "texture -> image": (_set("textures", 0, "source", value=1), "texture 0: .*image 1"),
    "texture -> sampler": (_set("textures", 0, "sampler", value=1), "texture 0: .*sampler 1"),
    "image -> bufferView": (_set("images", 0, "bufferView", value=99), 'image "dot": .*bufferView 99'),
    "skin -> joint": (_set("skins", 0, "joints", value=[2]), "skin 0: .*node 2"),
    "skin -> matrices": (_set("skins", 0, "inverseBindMatrices", value=99), "skin 0: .*accessor 99"),
    "channel -> sampler": (_set("animations", 0, "channels", 0, "sampler", value=1), "animation 0, channel 0: sampler 1"),
    "channel -> node": (_set("animations", 0, "channels", 0, "target", "node", value=8), "channel 0, target: .*node 8"),
    "sampler -> input": (_set("animations", 0, "samplers", 0, "input", value=88), "animation 0, sampler 0: .*accessor 88"),
    "negative reference": (_set("nodes", 0, "mesh", value=-1), 'node 0: "mesh" is -1, must be >= 0'),
    # sizes
    "count": (_set("accessors", 0, "count", value=5), r"accessor 0: 5 elements end at byte 60 of bufferView 0, which has 48"),
    "huge count": (_set("accessors", 0, "count", value=1 << 62), "accessor 0: .* elements end at byte"),
    "empty count": (_set("accessors", 0, value={"componentType": 5126, "type": "VEC3", "count": 1 << 40}), "without a bufferView"),
    "float count": (_set("accessors", 0, "count", value=2.5), '"count" is 2.5, must be an integer'),
    "view past buffer": (_set("bufferViews", 0, "byteLength", value=1e300), "bufferView 0: ends at byte"),
    "stride": (_set("bufferViews", 0, "byteStride", value=4), "byteStride 4 .* is less than the 12 bytes of one VEC3"),
    "attribute counts": (_set("accessors", 1, "count", value=3), "NORMAL has 3 elements, must have 4"),
    "sparse index": (_set("accessors", 6, "count", value=1), "sparse, indices: index 1 is past the last element|POSITION has"),
    "buffer shorter": (_set("buffers", 0, "byteLength", value=10**6), r"buffer 0: must have 1000000 bytes, has \d+"),
    # values
    "component type": (_set("accessors", 0, "componentType", value=5124), "must be one of 5120 .BYTE"),
    "accessor type": (_set("accessors", 0, "type", value="VEC7"), '"type" is "VEC7", must be one of SCALAR'),
    "position type": (_set("accessors", 0, "type", value="VEC2"), "POSITION is VEC2 of FLOAT, must be VEC3"),
    "float index": (_set(*PRIMITIVE, "indices", value=0), "indices is VEC3 of FLOAT, must be SCALAR"),
    "mode": (_set(*PRIMITIVE, "mode", value=7), '"mode" is 7, must be 0 to 6'),
    "alpha mode": (_set("materials", 0, "alphaMode", value="GLASS"), '"alphaMode" is "GLASS", must be one of OPAQUE, MASK, BLEND'),
    "wrap": (_set("samplers", 0, "wrapS", value=1), "must be one of 10497, 33071, 33648"),
    "colour": (_set("materials", 0, "emissiveFactor", value=[1, 2]), "must be 3 numbers"),
    "infinite": (_set("nodes", 0, "translation", value=[1e308 * 10, 0, 0]), "bad JSON: Infinity|must be finite"),
    "rotation": (_set("nodes", 0, "rotation", value=[0, 0, 0, 0]), "must be a unit quaternion"),
    "matrix": (_set("nodes", 0, "matrix", value=[1.0] * 16), r"must be \[0, 0, 0, 1\] \(affine\)"),
    "yfov": (_set("cameras", 0, "perspective", "yfov", value=4), "must be between 0 and pi"),
    "light type": (_set("extensions", "KHR_lights_punctual", "lights", 0, "type", value="area"), "must be one of directional"),
    "interpolation": (_set("animations", 0, "samplers", 0, "interpolation", value="QUADRATIC"), "must be one of STEP, LINEAR"),
    "keys": (_set("animations", 0, "channels", 0, "target", "path", value="rotation"), "VEC3 of FLOAT, must be VEC4"),
    "morph weights": (_set("meshes", 0, "weights", value=[1, 2]), "has 2 morph weights, must have 1"),
    "node weights": (_set("nodes", 0, "weights", value=[1, 2]), "has 2 morph weights, its mesh has 1 targets"),
    "weights without joints": (_set(*PRIMITIVE, "attributes", "JOINTS_0", value=...), "must come together"),
    # shapes of JSON
    "list for object": (_set("nodes", 0, value=[1]), r"node 0: is \[1\], must be a JSON object"),
    "object for list": (_set("nodes", value={}), '"nodes" is {}, must be a list'),
    "string for number": (_set("nodes", 0, "mesh", value="0"), 'node 0: "mesh" is "0", must be an integer'),
    "bool for number": (_set("nodes", 0, "mesh", value=True), 'node 0: "mesh" is true, must be an integer'),
    "no attributes": (_set(*PRIMITIVE, "attributes", value=...), '"attributes" is missing'),
    "no asset": (_set("asset", value=...), '"asset" is missing'),
    "version 1": (_set("asset", "version", value="1.0"), 'asset.version is "1.0", only 2.x is read'),
    "newer": (_set("asset", "minVersion", value="2.1"), "needs glTF"),
    "required": (_set("extensionsRequired", value=["KHR_draco_mesh_compression"]), "without Draco compression"),
    "required, unknown": (_set("extensionsRequired", value=["ACME_teapots"]), 'needs the extension "ACME_teapots"'),
    # images
    "no image": (_set("images", 0, value={"name": "dot"}), 'has neither "uri" nor "bufferView"'),
    "absent image": (_set("images", 0, value={"uri": "no%20such.png"}), "image 0: there is no file .*no such.png"),
    "remote image": (_set("images", 0, value={"uri": "https://a.b/c.png"}), "is remote .* and never fetched"),
    "not an image": (_set("images", 0, "bufferView", value=0), 'image "dot".*cannot be decoded'),
    # loops
    "own child": (_set("nodes", 0, "children", value=[0]), "loop"),
    "loop": (_set("nodes", 1, "children", value=[0]), "loop"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_one_clear_error(tmp_path: Path, case: str) -> None:
    change, message = BROKEN[case]
    b = whole()
    document = b.document()
    change(document)
    b.json, b.document = document, lambda: document  # type: ignore[method-assign]
    with pytest.raises(LoadError, match=message) as caught:
        load(b, tmp_path)
    text = str(caught.value)
    assert text.startswith(str(tmp_path / "test.glb")) and "\n" not in text and len(text) < 400 + len(str(tmp_path))


def test_index_past_the_last_vertex(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad(), b.quad(), b.quad(indices=b.accessor(np.uint16([0, 1, 4810]))))
    with pytest.raises(
        LoadError, match=r'test.glb: mesh "lamp", primitive 2: index 4810 is past the last vertex \(3\)'
    ):
        load(b, tmp_path)


def test_joint_past_the_skin(tmp_path: Path) -> None:
    b = whole()
    quad = b.json["meshes"][0]["primitives"][0]
    quad["attributes"]["JOINTS_0"] = b.accessor(np.uint8([[3, 0, 0, 0]] * 4))
    with pytest.raises(LoadError, match='mesh "lamp" uses joint 3, skin 0 has 1'):
        load(b, tmp_path)


def test_two_parents(tmp_path: Path) -> None:
    b = whole()
    b.add("nodes", children=[1])
    with pytest.raises(LoadError, match="node 1: is a child of both node 0 and node 2"):
        load(b, tmp_path)


def test_a_world_matrix_that_overflows(tmp_path: Path) -> None:
    b = whole()
    b.json["nodes"][0]["scale"] = b.json["nodes"][1]["scale"] = [1e200, 1e200, 1e200]
    with pytest.raises(LoadError, match="node 1: its world matrix is not finite"):
        load(b, tmp_path)


def test_draco_without_fallback(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad(extensions={"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}})
    b.scene(quad)
    assert load(b, tmp_path).triangle_count() == 2  # the uncompressed form is there as well
    del b.json["accessors"][quad["attributes"]["POSITION"]]["bufferView"]
    with pytest.raises(LoadError, match="Draco"):
        load(b, tmp_path)


def test_meshopt_without_fallback(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    document = b.document()
    document["buffers"].append({"byteLength": 48, "extensions": {"EXT_meshopt_compression": {"fallback": True}}})
    document["bufferViews"][0]["buffer"] = 1
    b.document = lambda: document  # type: ignore[method-assign]
    with pytest.raises(LoadError, match="EXT_meshopt_compression"):
        load(b, tmp_path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "empty"),
        (b"\0" * 12, '"glTF"'),
        (b"glTF", "needs 12 bytes, the file has 4"),
        (b'{"a":' * 100_000, "nested too deeply"),
        (b'{"asset": {"version": NaN}}', "bad JSON"),
        (
            b'{"asset": {"version": "2.0"}, "nodes": [{"mesh": ' + b"9" * 5000 + b"}]}",
            "bad JSON|not exist|the file has",
        ),
        (b"\xff\xfe{}", '"glTF"'),
        (b'{"asset": {"version": "\\ud800"}}', "only 2.x"),
    ],
)
def test_not_a_model(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "x.glb"
    path.write_bytes(data)
    with pytest.raises(LoadError, match=message) as caught:
        load_gltf(path)
    str(caught.value).encode()  # printable, whatever was in the file


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(LoadError, match=r"no\.glb: there is no such file"):
        load_gltf(tmp_path / "no.glb")
    with pytest.raises(LoadError, match="is a folder"):
        load_gltf(tmp_path)


def test_image_of_no_texels(tmp_path: Path) -> None:
    b = textured(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    empty = PNG[:16] + b"\0\0\0\0" + PNG[20:]  # width 0
    b.json["images"][0]["bufferView"] = b.view(empty)
    with pytest.raises(LoadError, match='image "dot"'):
        load(b, tmp_path)


# --- noise


def _survives(path: Path) -> bool:
    """True if it loads, False if it is refused with one LoadError; anything else fails the test."""
    try:
        load_gltf(path)
    except LoadError as error:
        assert str(path) in str(error)
        str(error).encode()
        return False
    return True


@pytest.mark.parametrize("seed", range(4))
def test_flipped_bits_and_cut_files(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    good = np.frombuffer(whole().glb(), np.uint8)
    loaded = 0
    for case in range(100):
        data = good.copy()
        if case % 4 == 0:
            data = data[: rng.integers(len(data))]
        else:
            where = rng.integers(len(data), size=rng.integers(1, 6))
            data[where] ^= (1 << rng.integers(8, size=len(where))).astype(np.uint8)
        path = tmp_path / "fuzz.glb"
        path.write_bytes(data.tobytes())
        loaded += _survives(path)
    assert 0 < loaded < 100  # some damage only changes a colour; a cut file never loads


@pytest.mark.parametrize("seed", range(4))
def test_json_with_wrong_values_anywhere(tmp_path: Path, seed: int) -> None:
    """One value of the document replaced by another of any kind: the shape of the JSON is never trusted."""
    rng = np.random.default_rng(1000 + seed)
    source = whole()
    odd = [
        None,
        True,
        -1,
        0,
        1,
        3,
        2.5,
        1e300,
        -1e300,
        2**63,
        10**400,
        "",
        "x",
        "\ud800",
        [],
        [1],
        [[]],
        {},
        {"a": 1},
        [-1],
    ]
    for case in range(100):
        document = json.loads(json.dumps(source.document()))
        spots: list[tuple[Any, Any]] = []
        stack: list[Any] = [document]
        while stack:
            at = stack.pop()
            keys = at.keys() if isinstance(at, dict) else range(len(at))
            spots += [(at, key) for key in keys]
            stack += [at[key] for key in keys if isinstance(at[key], dict | list)]
        at, key = spots[rng.integers(len(spots))]
        at[key] = odd[rng.integers(len(odd))]
        source.document = lambda found=document: found  # type: ignore[method-assign]
        path = source.write(tmp_path, f"{case}.glb")
        del source.document  # type: ignore[method-assign]
        _survives(path)


def test_cut_at_every_length(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.primitive({"POSITION": b.accessor(QUAD)}, indices=b.accessor(QUAD_INDEX)))
    good = b.glb()
    path = tmp_path / "cut.glb"
    for length in range(len(good)):
        path.write_bytes(good[:length])
        assert not _survives(path)
