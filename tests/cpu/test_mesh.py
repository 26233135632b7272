# ruff: noqa: E501 -- files in one line
"""OBJ, MTL, PLY, STL and OFF: what is read, and that broken files give one LoadError."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glhybrid.errors import LoadError
from glhybrid.load.mesh import load_mesh
from glhybrid.load.polygons import triangulate
from glhybrid.scene import Material, Scene, Triangles


def load(folder: Path, name: str, data: str | bytes, **options: bool) -> Scene:
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return load_mesh(path, **options)


def piece(scene: Scene, number: int = 0) -> Triangles:
    found = scene.meshes[0].primitives[number]
    assert isinstance(found, Triangles)
    return found


def corners(scene: Scene, number: int = 0) -> Any:
    """(T, 3, 3) positions, as lists."""
    p = piece(scene, number)
    return p.position[p.index].tolist()


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


# --- polygons


def test_concave_polygons_cover_their_area_once() -> None:
    arrow = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [1, 0.5, 0], [0, 2, 0]], float)
    rng = np.random.default_rng(0)
    for n in range(4, 40):
        angle = np.sort(rng.random(n)) * 2 * np.pi
        radius = rng.uniform(0.2, 1, n)
        star = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)], 1)
        for polygon in (arrow, star):
            for axes in ([0, 1, 2], [2, 0, 1], [1, 2, 0], [1, 0, 2]):  # in each plane, from both sides
                p = polygon[:, axes] + 100.0
                found, _ = triangulate(p, np.array([len(p)]))
                cross = np.cross(p[found[:, 1]] - p[found[:, 0]], p[found[:, 2]] - p[found[:, 0]])
                whole = np.cross(p - p[0], np.roll(p, -1, 0) - p[0]).sum(0)
                assert len(found) == len(p) - 2
                assert np.all(cross @ whole > -1e-9)  # none turned over, so equal areas mean no overlap
                np.testing.assert_allclose(cross.sum(0), whole, atol=1e-9)


def test_polygons_of_all_sizes_keep_their_order() -> None:
    p = np.random.default_rng(1).random((15, 3))
    found, polygon = triangulate(p, np.array([3, 1, 4, 2, 5]))
    assert polygon.tolist() == [0, 2, 2, 4, 4, 4]
    assert found[0].tolist() == [0, 1, 2] and set(found[1:3].ravel()) == {4, 5, 6, 7}
    assert set(found[3:].ravel()) == set(range(10, 15))


# --- OBJ


def test_obj_faces_of_every_form(tmp_path: Path) -> None:
    text = SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 2\n"
    want = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]]
    for face in ("1 2 3", "1/1 2/2 3/3", "1//1 2//1 3//1", "1/1/1 2/2/1 3/3/1", "-4 -3 -2", "-4/-3/-1 2/2/1 -2/-1/1",
                 "1 2/2 3/3/1", "+1 2 3 # a comment", "1 2 \\\n3"):  # fmt: skip
        scene = load(tmp_path, "a.obj", f"{text}f {face}\n")
        assert corners(scene) == want
        if face.startswith("1/1"):
            np.testing.assert_array_equal(piece(scene).uv0, [[0, 1], [1, 1], [1, 0]])  # v turned down
        if face.count("/1") >= 3 or "//" in face:
            np.testing.assert_array_equal(piece(scene).normal, [[0, 0, 1]] * 3)


def test_obj_relative_indices_count_from_where_they_stand(tmp_path: Path) -> None:
    face = "f -3 -2 -1\n"
    scene = load(tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + face + "v 0 0 5\nv 1 0 5\nv 0 1 5\n" + face)
    assert [t[0] for t in corners(scene)] == [[0, 0, 0], [0, 0, 5]]


def test_obj_shares_equal_corners_only(tmp_path: Path) -> None:
    text = SQUARE + "vt 0 0\nvt 1 1\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1/1/1 3/1/1 4/2/1\nf 1/2/1 3/1/1 4/2/1\n"
    assert len(piece(load(tmp_path, "a.obj", text)).position) == 5  # vertex 1 with two texture coordinates


def test_obj_flat_or_smooth(tmp_path: Path) -> None:
    roof = "v 0 0 0\nv 1 0 0\nv 1 1 1\nv 0 1 1\nv 1 2 0\nv 0 2 0\nf 1 2 3 4\nf 4 3 5 6\n"
    assert len(piece(load(tmp_path, "a.obj", roof)).position) == 12
    smooth = piece(load(tmp_path, "a.obj", roof, smooth=True))
    assert len(smooth.position) == 6
    np.testing.assert_allclose(smooth.normal[2:4], [[0, 0, 1]] * 2, atol=1e-6)


def test_obj_vertex_colours_are_srgb(tmp_path: Path) -> None:
    text = "v 0 0 0 1 0 0.5\nv 1 0 0 1 0 0.5\nv 0 1 0 1 0 0.5\nf 1 2 3\n"
    np.testing.assert_allclose(piece(load(tmp_path, "a.obj", text)).color, [[1, 0, 0.21404, 1]] * 3, atol=1e-5)


def test_obj_encodings(tmp_path: Path) -> None:
    text = SQUARE + "o ü\nf 1 2 3\n"
    for data in (text.encode("utf-8-sig"), text.encode("latin-1"), text.replace("\n", "\r\n").encode(),
                 b"\xfe\xff" + text.encode("utf-16-be"), b"\xff\xfe" + text.encode("utf-16-le")):  # fmt: skip
        assert load(tmp_path, "a.obj", data).triangle_count() == 1


MTL = """# a comment
newmtl shiny red
Kd 0.5 0.25 0.125
Ks 1 1 1
Ns 198
d 0.5
Ke 1 2 3
Ni 1.33
newmtl matte
Ks 0 0 0
Kd 1 1 1
newmtl gold
Pr 0.3
Pm 1
"""


def test_mtl_numbers(tmp_path: Path) -> None:
    (tmp_path / "the materials.mtl").write_text(MTL)
    text = SQUARE + "mtllib the materials.mtl\n" + "".join(
        f"usemtl {name}\nf 1 2 3\n" for name in ("matte", "shiny red", "gold", "matte", "unknown"))  # fmt: skip
    scene = load(tmp_path, "a.obj", text)
    matte, red, gold, unknown = scene.materials
    assert [len(p.index) for p in scene.meshes[0].primitives] == [2, 1, 1, 1]  # type: ignore[union-attr]
    assert [p.material for p in scene.meshes[0].primitives] == [0, 1, 2, 3]
    assert red.base_color == (0.5, 0.25, 0.125, 0.5) and red.alpha_mode == "BLEND" and red.emissive == (1, 2, 3)
    assert red.roughness == pytest.approx((2 / 200) ** 0.25) and red.ior == 1.33 and red.specular == 1.0
    assert (matte.specular, matte.roughness) == (0.0, 1.0) and (gold.roughness, gold.metallic) == (0.3, 1.0)
    assert (unknown.base_color, unknown.roughness) == (Material().base_color, 1.0)
    assert scene.warnings == ('material "unknown": is in no material library: drawn in white',)


def write_image(path: Path, *color: int, size: tuple[int, int] = (2, 2)) -> None:
    from PIL import Image

    Image.new({1: "L", 3: "RGB", 4: "RGBA"}[len(color)], size, color if len(color) > 1 else color[0]).save(path)


def test_mtl_maps(tmp_path: Path) -> None:
    (tmp_path / "tex").mkdir()
    write_image(tmp_path / "tex/the colour.png", 10, 20, 30)
    write_image(tmp_path / "cut.png", 0, size=(4, 4))
    write_image(tmp_path / "bump.png", 128, 128, 255)
    write_image(tmp_path / "height.png", 99)
    write_image(tmp_path / "rough.png", 77)
    (tmp_path / "a.mtl").write_text(
        "newmtl m\nKd 0 0 0\nmap_Kd -s 2 3 1 -o 0.1 0.2 -clamp on tex\\the colour.png\nmap_d cut.png\n"
        "map_Bump -bm 0.5 bump.png\nmap_Pr rough.png\nmap_Ks cut.png\nnewmtl n\nmap_bump height.png\n"
    )
    uv = "vt 0 0\nvt 1 0\nvt 1 1\n"
    face = "f 1/1 2/2 3/3\n"
    scene = load(tmp_path, "a.obj", f"mtllib a.mtl\n{SQUARE}{uv}usemtl m\n{face}usemtl n\n{face}")
    m = scene.materials[0]
    base = m.textures["base_color"]
    assert m.base_color == (1, 1, 1, 1) and m.alpha_mode == "MASK"
    assert base.image.texels[0, 0].tolist() == [10, 20, 30, 0]  # the cut-out's grey became the alpha
    assert base.uv_transform is not None and base.wrap_u == "clamp"
    np.testing.assert_allclose(base.uv_transform @ [0, 1, 1], [0.1, 1 - 0.2], atol=1e-12)  # bottom left moves up
    assert m.normal_scale == 0.5 and piece(scene).tangent is not None
    rough = m.textures["metallic_roughness"].image.texels
    assert rough[0, 0].tolist() == [255, 77, 255, 255] and m.roughness == 1.0 and m.metallic == 0.0
    assert [w.split(": ")[1].split(" ")[0] for w in scene.warnings] == ["map_Ks", "its", "its"]


def test_mtl_file_absent_image_absent_or_outside(tmp_path: Path) -> None:
    scene = load(tmp_path, "a.obj", f"mtllib no.mtl\n{SQUARE}f 1 2 3\n")
    assert scene.warnings == ('material library "no.mtl" is not there',)
    with pytest.raises(LoadError, match=r"no\.mtl"):
        load(tmp_path, "a.obj", f"mtllib no.mtl\n{SQUARE}f 1 2 3\n", strict=True)
    use = f"mtllib m.mtl\nusemtl m\n{SQUARE}f 1 2 3\n"
    (tmp_path / "m.mtl").write_text("newmtl m\nmap_Kd no.png\n")
    with pytest.raises(LoadError, match=r'm\.mtl: material "m": there is no file .*no\.png'):
        load(tmp_path, "a.obj", use)
    write_image(tmp_path / "out.png", 1, 2, 3)
    (tmp_path / "in").mkdir()
    (tmp_path / "in/m.mtl").write_text("newmtl m\nmap_Kd ../out.png\n")
    with pytest.raises(LoadError, match="leaves the folder"):
        load(tmp_path / "in", "a.obj", use)
    assert load(tmp_path / "in", "a.obj", use, allow_outside=True).materials[0].textures


def test_hash_covers_what_the_file_names(tmp_path: Path) -> None:
    use = f"mtllib m.mtl\nusemtl m\n{SQUARE}f 1 2 3\n"
    hashes = set()
    for color in ("1 0 0", "0 1 0"):
        (tmp_path / "m.mtl").write_text(f"newmtl m\nKd {color}\n")
        hashes.add(load(tmp_path, "a.obj", use).sha256)
    assert len(hashes) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no faces"),
        ("f 1 2 9\n", 'line 5: "9" refers to v 9; the file has 4'),
        ("f 1 2 0\n", 'line 5: "0" refers to v 0; OBJ counts from 1'),
        ("f -5 1 2\n", 'line 5: "-5" refers to v -5; the file has 4'),
        ("f 1/1 2 3\n", 'line 5: "1/1" refers to vt 1; the file has 0'),
        ("f 1//7 2 3\n", 'line 5: "1//7" refers to vn 7'),
        ("f 1 2 x\n", 'line 5: "x" must be v, v/vt'),
        ("f 1 2 3/1/1/1\n", 'line 5: "3/1/1/1" must be'),
        ("f 1 2 3.5\n", 'line 5: "3.5" must be'),
        ("f 1 2 99999999999999999999999\n", "line 5: "),
        ("v 1 2\n", 'line 5: "v" has 2 numbers, must have 3 or more'),
        ("v 1 2 z\n", 'line 5: "z" is not a number'),
        ("vn 1 2\nf 1 2 3\n", 'line 5: "vn" has 2 numbers'),
        ("l 1 2\n", "holds no faces"),
    ],
)
def test_broken_obj(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(LoadError, match=r"a\.obj: ") as caught:
        load(tmp_path, "a.obj", SQUARE + text)
    assert message in str(caught.value)


# --- PLY


def ply(kind: str, faces: list[list[int]], extra: str = "", count: int | None = None) -> bytes:
    """The square as PLY of a kind, with polygons."""
    vertices = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    head = f"ply\nformat {kind} 1.0\ncomment x\nelement vertex 4\n" + "".join(f"property float {a}\n" for a in "xyz")
    head += f"element face {len(faces) if count is None else count}\nproperty list uchar int vertex_indices\n{extra}end_header\n"
    if kind == "ascii":
        rows = [" ".join(map(str, v)) for v in vertices.tolist()] + [" ".join(map(str, [len(f), *f])) for f in faces]
        return (head + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in kind else ">"
    body = vertices.astype(order + "f4").tobytes()
    return head.encode() + body + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)


KINDS = ("ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "faces", [[[0, 1, 2]], [[0, 1, 2], [0, 2, 3]], [[0, 1, 2, 3]], [[0, 1, 2], [0, 1, 2, 3], [1, 2, 3]]]
)
def test_ply_kinds_and_polygons(tmp_path: Path, kind: str, faces: list[list[int]]) -> None:
    scene = load(tmp_path, "a.ply", ply(kind, faces))
    p = piece(scene)
    firsts = [f[:1] + f[k : k + 2] for f in faces for k in range(1, len(f) - 1)]
    square = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(p.position[p.index], square[firsts])
    np.testing.assert_allclose(p.normal, np.tile([0, 0, 1], (len(p.normal), 1)), atol=1e-7)
    assert scene.warnings == () and len(scene.sha256) == 64


@pytest.mark.parametrize("kind", KINDS)
def test_broken_ply(tmp_path: Path, kind: str) -> None:
    good = ply(kind, [[0, 1, 2], [0, 1, 2, 3]])
    for length in range(len(good) - 1 - (kind == "ascii")):
        with pytest.raises(LoadError, match=r"a\.ply: "):
            load(tmp_path, "a.ply", good[:length])
    for faces in ([[0, 1, 4]], [[0, 1, -1]]):
        with pytest.raises(LoadError, match=r"face 0: vertex -?\d is past the last \(3\)"):
            load(tmp_path, "a.ply", ply(kind, faces))
    for count in (3, 10**12):
        with pytest.raises(LoadError, match='element "face"'):
            load(tmp_path, "a.ply", ply(kind, [[0, 1, 2]], count=count))
    with pytest.raises(LoadError, match="has no meaning in a PLY header"):
        load(tmp_path, "a.ply", ply(kind, [[0, 1, 2]], extra="property floaty q\n"))
    with pytest.raises(LoadError, match="no faces"):
        load(tmp_path, "a.ply", ply(kind, []))


def test_ply_properties(tmp_path: Path) -> None:
    text = ("ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {n}\n" for n in ("x", "y", "z", "nx", "ny", "nz", "s", "t"))
            + "".join(f"property uchar {n}\n" for n in ("red", "green", "blue", "alpha")) + "property float quality\n"
            "element face 1\nproperty list uchar int vertex_index\nproperty uchar red\nelement edge 1\nproperty int a\nend_header\n"
            "0 0 0 0 0 2 0 0 255 0 188 51 9\n1 0 0 0 0 2 1 0 255 0 188 51 9\n0 1 0 0 0 2 0 1 255 0 188 51 9\n3 0 1 2 7\n5\n")  # fmt: skip
    scene = load(tmp_path, "a.ply", text)
    p = piece(scene)
    np.testing.assert_array_equal(p.normal, [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(p.uv0, [[0, 1], [1, 1], [0, 0]])
    np.testing.assert_allclose(p.color, [[1, 0, 0.50289, 0.2]] * 3, atol=1e-4)
    assert scene.warnings == (
        'element "edge" is not drawn', 'vertex property "quality" is not used', 'face property "red" is not used',
    )  # fmt: skip
    with pytest.raises(LoadError, match="strict"):
        load(tmp_path, "a.ply", text, strict=True)


# --- STL, OFF and the rest


def binary_stl(count: int, head: bytes = b"made by hand") -> bytes:
    rows = np.zeros(2, [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corner"] = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    return head.ljust(80, b"\0") + struct.pack("<I", count) + rows.tobytes()


TEXT_STL = """solid a square
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 1 1 0
 endloop
endfacet
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1e0 1 0
  vertex 0 1 0
 endloop
endfacet
endsolid a square
"""


@pytest.mark.parametrize(
    "data", [binary_stl(2), binary_stl(2, b"solid, but binary"), TEXT_STL], ids=["binary", "solid", "text"]
)
def test_stl(tmp_path: Path, data: bytes | str) -> None:
    smooth = load(tmp_path, "a.stl", data, smooth=True)
    assert corners(smooth) == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    assert len(piece(smooth).position) == 4  # equal corners share a vertex
    assert len(piece(load(tmp_path, "a.stl", data)).position) == 6


def test_broken_stl(tmp_path: Path) -> None:
    for data in (b"", b"solid", binary_stl(3), binary_stl(2)[:-1], TEXT_STL[:150].encode(), b"hello " * 20,
                 TEXT_STL.replace("1e0", "one").encode()):  # fmt: skip
        with pytest.raises(LoadError, match=r"a\.stl: "):
            load(tmp_path, "a.stl", data)


def test_off(tmp_path: Path) -> None:
    points = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    scene = load(tmp_path, "a.off", f"OFF # square\n\n4 2 0\n{points}3 0 1 2\n3 0 2 3 255 0 0\n")
    assert corners(scene) == [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    assert scene.warnings == ("face colours are not used",)
    assert load(tmp_path, "a.off", f"OFF 4 1 0\n{points}4 0 1 2 3\n").triangle_count() == 2
    colored = "COFF\n3 1 0\n" + "".join(f"{x} {y} 0 255 0 188 255\n" for x, y in ((0, 0), (1, 0), (0, 1))) + "3 0 1 2\n"
    np.testing.assert_allclose(piece(load(tmp_path, "a.off", colored)).color, [[1, 0, 0.50289, 1]] * 3, atol=1e-4)
    for text in ("", "OFX\n", "OFF\n4 2 0\n0 0 0\n", f"OFF\n4 1 0\n{points}3 0 1\n", f"OFF\n4 1 0\n{points}3 0 1 9\n",
                 f"OFF\n4 1 0\n{points}3 0 1 x\n", "OFF\n-4 1 0\n", f"OFF\n4 0 0\n{points}", f"OFF\n4 1 0\n{points}-3 0 1 2\n"):  # fmt: skip
        with pytest.raises(LoadError, match=r"a\.off: "):
            load(tmp_path, "a.off", text)


def test_other_formats_and_missing_files(tmp_path: Path) -> None:
    with pytest.raises(LoadError, match=r'unknown mesh format "\.plz"; did you mean "\.ply"\?'):
        load_mesh(tmp_path / "a.plz")
    with pytest.raises(LoadError, match="there is no such file"):
        load_mesh(tmp_path / "a.ply")
    (tmp_path / "b.obj").mkdir()
    with pytest.raises(LoadError, match="is a folder"):
        load_mesh(tmp_path / "b.obj")


@pytest.mark.parametrize("seed", range(3))
def test_flipped_bits(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    (tmp_path / "a.mtl").write_text(MTL)
    sources = {"a.ply": ply("ascii", [[0, 1, 2, 3]]), "b.ply": ply("binary_little_endian", [[0, 1, 2], [0, 1, 2, 3]]),
               "a.stl": binary_stl(2), "b.stl": TEXT_STL.encode(), "a.off": b"OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
               "a.obj": f"mtllib a.mtl\n{SQUARE}vt 0 1\nusemtl gold\nf 1/1 2/1 3/1 4/1\n".encode(), "a.mtl": MTL.encode()}  # fmt: skip
    for name, source in sources.items():
        for _ in range(60):
            data = np.frombuffer(source, np.uint8).copy()
            where = rng.integers(len(data), size=rng.integers(1, 4))
            data[where] ^= (1 << rng.integers(8, size=len(where))).astype(np.uint8)
            (tmp_path / name).write_bytes(data.tobytes())
            path = tmp_path / ("a.obj" if name == "a.mtl" else name)
            if name == "a.mtl":
                path.write_bytes(sources["a.obj"])
            try:
                load_mesh(path)
            except LoadError as error:
                assert str(tmp_path) in str(error)
