"""Images to (H, W, 4) bytes: every kind of pixel, and files that are none."""

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import Builder

from glhybrid.errors import LoadError
from glhybrid.load.gltf import load_gltf
from glhybrid.load.images import load_image

Pillow = pytest.importorskip("PIL.Image")


def encoded(array: Any, form: str = "PNG", **options: Any) -> bytes:
    out = io.BytesIO()
    Pillow.fromarray(np.asarray(array)).save(out, form, **options)
    return out.getvalue()


def png16(values: np.ndarray) -> bytes:
    """A 16-bit PNG of (H, W, C), written by hand: Pillow cannot write RGB of that depth."""
    import struct
    import zlib

    height, width, channels = values.shape
    rows = b"".join(b"\0" + values[y].astype(">u2").tobytes() for y in range(height))

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 16, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


RGBA = np.random.default_rng(0).integers(0, 256, (3, 5, 4), np.uint8)


def test_kinds_of_pixels() -> None:
    grey = RGBA[..., 0]
    opaque = np.full_like(grey, 255)
    np.testing.assert_array_equal(load_image(encoded(RGBA), "x").texels, RGBA)
    np.testing.assert_array_equal(load_image(encoded(RGBA[..., :3]), "x").texels, np.dstack([RGBA[..., :3], opaque]))
    np.testing.assert_array_equal(load_image(encoded(grey), "x").texels, np.dstack([grey, grey, grey, opaque]))
    np.testing.assert_array_equal(load_image(encoded(RGBA[..., :2]), "x").texels, RGBA[..., [0, 0, 0, 1]])
    assert (
        load_image(encoded(RGBA[..., :3], "WEBP", lossless=True), "x").texels[0, 0, :3].tolist()
        == RGBA[0, 0, :3].tolist()
    )
    bits = encoded(grey > 127)
    assert set(np.unique(load_image(bits, "x").texels[..., 0])) == {0, 255}


def test_palette_with_transparency() -> None:
    image = Pillow.new("P", (2, 1))
    image.putpalette([10, 20, 30, 40, 50, 60])
    image.putpixel((1, 0), 1)
    out = io.BytesIO()
    image.save(out, "PNG", transparency=1)
    assert load_image(out.getvalue(), "x").texels.tolist() == [[[10, 20, 30, 255], [40, 50, 60, 0]]]


def test_cmyk_jpeg_and_orientation_tag() -> None:
    out = io.BytesIO()
    Pillow.new("CMYK", (8, 8), (0, 255, 255, 0)).save(out, "JPEG")
    assert np.abs(load_image(out.getvalue(), "x").texels[4, 4].astype(int) - [255, 0, 0, 255]).max() < 4
    exif = Pillow.Exif()
    exif[0x0112] = 6  # turned by 90 degrees, which glTF ignores
    turned = encoded(np.zeros((4, 9, 3), np.uint8), "JPEG", exif=exif)
    assert load_image(turned, "x").texels.shape == (4, 9, 4)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_sixteen_bits_are_reduced_with_a_word(channels: int) -> None:
    values = np.array([0, 128, 257, 32768, 65535], np.uint16)[None, :, None].repeat(channels, axis=2)
    said: list[str] = []
    texels = load_image(png16(values), "x", said.append).texels
    assert said == ["16 bits a channel are reduced to 8"]
    assert np.abs(texels[0, :, 0] - values[0, :, 0] / 257).max() <= 1.0
    assert (texels[0, 0, 0], texels[0, -1, 0]) == (0, 255)


def test_eight_bits_need_no_word() -> None:
    said: list[str] = []
    for array in (RGBA, RGBA[..., :3], RGBA[..., 0]):
        load_image(encoded(array), "x", said.append)
    assert said == []


def test_not_an_image(tmp_path: Path) -> None:
    good = encoded(np.random.default_rng(0).integers(0, 256, (40, 40, 3), np.uint8))
    for data in (b"", b"hello", good[:8], good[:30], good[: len(good) // 2], good[:16] + b"\0" * 8 + good[24:]):
        with pytest.raises(LoadError, match=r"^the thing: "):
            load_image(data, "the thing")
    with pytest.raises(LoadError, match=r"the thing: there is no file .*no\.png"):
        load_image(tmp_path / "no.png", "the thing")


def test_too_large() -> None:
    with pytest.raises(LoadError, match="16385 x 1 texels; both sides must be 1 to 16384"):
        load_image(encoded(np.zeros((1, 16385), np.uint8)), "x")
    with pytest.raises(LoadError, match=r"^x: more than [\d,]+ texels, which is the limit of an image: resize it$"):
        load_image(claiming(16000, 16000), "x")


def claiming(width: int, height: int) -> bytes:
    """A PNG whose header tells that size."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = struct.pack(">I", zlib.crc32(head)) + struct.pack(">I", 9) + b"IDAT" + bytes(9)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + data


def test_large_ones_need_no_word() -> None:
    """Pillow warns of a hundred million texels, which some maps have; here that would be an error."""
    with pytest.raises(LoadError, match="cannot be decoded"):  # cut short
        load_image(claiming(10000, 10000), "x")


def test_no_helper_programs_are_run() -> None:
    """EPS would be handed to Ghostscript: not among the formats read."""
    with pytest.raises(LoadError, match="not one of the formats read here"):
        load_image(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "x")


def test_damaged_images_give_one_error() -> None:
    rng = np.random.default_rng(7)
    noise = rng.integers(0, 256, (16, 16, 4), np.uint8)
    for source in (
        encoded(noise),
        encoded(noise[..., :3], "JPEG"),
        encoded(noise, "WEBP"),
        png16(noise.astype(np.uint16)),
    ):
        for _ in range(60):
            data = np.frombuffer(source, np.uint8).copy()
            data[rng.integers(len(data), size=4)] ^= np.uint8(1 << rng.integers(8))
            try:
                assert load_image(data[: rng.integers(1, len(data) + 1)].tobytes(), "x").texels.shape[2] == 4
            except LoadError as error:
                assert str(error).startswith("x: ")


def test_warnings_name_the_image_in_a_fixed_order(tmp_path: Path) -> None:
    b = Builder()
    for k in range(6):
        b.add(
            "images", bufferView=b.view(png16(np.full((64 if k % 2 else 1, 64, 3), k, np.uint16))), mimeType="image/png"
        )
        b.add("textures", source=k)
        b.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": k}})
    b.scene(*(b.quad(material=k) for k in range(6)))
    path = b.write(tmp_path)
    for _ in range(3):
        scene = load_gltf(path)
        assert scene.warnings == ("image 0; image 1; image 2 and 3 more: 16 bits a channel are reduced to 8",)
    assert [m.textures["base_color"].image.texels.shape[0] for m in scene.materials] == [1, 64] * 3


def test_one_image_in_two_textures_is_decoded_once(tmp_path: Path) -> None:
    b = Builder()
    b.add("images", bufferView=b.view(encoded(RGBA)), mimeType="image/png")
    b.add("samplers", wrapS=33071)
    b.add("textures", source=0)
    b.add("textures", source=0, sampler=0)
    for k in range(2):
        b.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": k}})
    b.scene(*(b.quad(material=k) for k in range(2)))
    first, second = (m.textures["base_color"] for m in load_gltf(b.write(tmp_path)).materials)
    assert first.image is second.image and (first.wrap_u, second.wrap_u) == ("repeat", "clamp")


def test_webp_texture(tmp_path: Path) -> None:
    b = Builder()
    b.add("images", bufferView=b.view(encoded(RGBA, "WEBP", lossless=True, exact=True)), mimeType="image/webp")
    b.json["extensionsRequired"] = b.json["extensionsUsed"] = ["EXT_texture_webp"]
    b.add("textures", extensions={"EXT_texture_webp": {"source": 0}})
    b.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    b.scene(b.quad(material=0))
    scene = load_gltf(b.write(tmp_path), strict=True)
    np.testing.assert_array_equal(scene.materials[0].textures["base_color"].image.texels, RGBA)
