"""Environment maps: every way a Radiance file can be written, OpenEXR, what is refused, and the analytic sky."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from glhybrid.errors import LoadError
from glhybrid.load import sky
from glhybrid.load.environment import read_environment
from glhybrid.scene import F32, U8

MODELS = Path(__file__).resolve().parents[3] / "shared" / "models" / "environments"


def encode(radiance: F32) -> U8:
    """(H, W, 4) RGBE, the mantissas cut off as Radiance does."""
    peak = radiance.max(2)
    mantissa, exponent = np.frexp(peak)
    scale = np.where(peak > 0, mantissa * 256 / np.maximum(peak, 1e-38), 0)
    rgbe = np.zeros((*peak.shape, 4), np.uint8)
    rgbe[..., :3] = radiance * scale[..., None]
    rgbe[..., 3] = np.where(peak > 0, exponent + 128, 0)
    return rgbe


def flat(rgbe: U8) -> bytes:
    return rgbe.tobytes()


def old_rle(rgbe: U8) -> bytes:
    out = bytearray()
    for row in rgbe:
        x = 0
        while x < len(row):
            n = 1
            while x + n < len(row) and (row[x + n] == row[x]).all():
                n += 1
            out += row[x].tobytes()
            more = n - 1
            while more:  # low byte first, each further code counts 256 times as much
                out += bytes([1, 1, 1, more & 255])
                more >>= 8
            x += n
    return bytes(out)


def new_rle(rgbe: U8) -> bytes:
    out = bytearray()
    for row in rgbe:
        out += bytes([2, 2, len(row) >> 8, len(row) & 255])
        for plane in row.T:
            x = 0
            while x < len(row):
                n = 1
                while n < 127 and x + n < len(row) and plane[x + n] == plane[x]:
                    n += 1
                if n > 2:
                    out += bytes([128 + n, plane[x]])
                else:
                    n = min(5, len(row) - x)
                    out += bytes([n]) + plane[x : x + n].tobytes()
                x += n
    return bytes(out)


def write(path: Path, body: bytes, resolution: str, header: str = "FORMAT=32-bit_rle_rgbe\n") -> Path:
    path.write_bytes(f"#?RADIANCE\n# a comment\n{header}\n{resolution}\n".encode() + body)
    return path


@pytest.fixture
def picture() -> U8:
    """Noise, long runs, black and a wide range of exponents; 300 wide, so runs pass 127 and 255."""
    random = np.random.default_rng(5)
    radiance = np.exp(random.normal(0, 4, (9, 300, 3))).astype(np.float32)
    radiance[2:5, 10:290] = (0.5, 2.0, 8.0)
    radiance[6] = 0
    return encode(radiance)


def decoded(rgbe: U8) -> F32:
    value = rgbe[..., :3] * np.ldexp(1.0, rgbe[..., 3].astype(int) - 136)[..., None]
    return np.where(rgbe[..., 3:] > 0, value, 0).astype(np.float32)


@pytest.mark.parametrize("code", [flat, old_rle, new_rle])
def test_rgbe_codes(tmp_path: Path, picture: U8, code: Callable[[U8], bytes]) -> None:
    texels, warnings = read_environment(write(tmp_path / "a.hdr", code(picture), "-Y 9 +X 300"))
    assert texels.dtype == np.float32 and texels.flags.c_contiguous and warnings == ()
    assert np.array_equal(texels, decoded(picture))


def test_mixed_codes_by_line(tmp_path: Path, picture: U8) -> None:
    body = flat(picture[:3]) + new_rle(picture[3:6]) + old_rle(picture[6:])
    texels, _ = read_environment(write(tmp_path / "a.hdr", body, "-Y 9 +X 300"))
    assert np.array_equal(texels, decoded(picture))


@pytest.mark.parametrize("first", ["-Y", "+Y", "-X", "+X"])
@pytest.mark.parametrize("second", ["-", "+"])
def test_orientations(tmp_path: Path, picture: U8, first: str, second: str) -> None:
    want = decoded(picture)
    stored = picture if first[1] == "Y" else picture.swapaxes(0, 1)
    signs = {first[1]: first[0], "X" if first[1] == "Y" else "Y": second}
    stored = stored[:: -1 if signs[first[1]] == ("+" if first[1] == "Y" else "-") else 1]
    stored = stored[:, :: -1 if second == ("-" if first[1] == "Y" else "+") else 1]
    stored = np.ascontiguousarray(stored)
    line = f"{first} {stored.shape[0]} {second}{'X' if first[1] == 'Y' else 'Y'} {stored.shape[1]}"
    texels, _ = read_environment(write(tmp_path / "a.hdr", new_rle(stored), line))
    assert np.array_equal(texels, want)


def test_exposure_lines_are_divided_out(tmp_path: Path, picture: U8) -> None:
    header = "FORMAT=32-bit_rle_rgbe\nEXPOSURE=2\nEXPOSURE= 4.0\n"
    texels, _ = read_environment(write(tmp_path / "a.hdr", flat(picture), "-Y 9 +X 300", header))
    assert np.allclose(texels, decoded(picture) / 8, rtol=1e-6)


def test_a_run_code_of_narrow_images_is_a_pixel(tmp_path: Path) -> None:
    """Under 8 pixels there is no new code: (2, 2, ...) is a colour."""
    rgbe = np.array([[[2, 2, 0, 130], [9, 9, 9, 129]]], np.uint8)
    texels, _ = read_environment(write(tmp_path / "a.hdr", flat(rgbe), "-Y 1 +X 2"))
    assert np.array_equal(texels, decoded(rgbe))


@pytest.mark.parametrize(
    ("body", "resolution", "header", "says"),
    [
        (b"", "-Y 9 +X 300", "FORMAT=32-bit_rle_rgbe\n", "ends within scanline 0 of 9"),
        (b"\2\2\1\x2c\x81", "-Y 1 +X 300", "FORMAT=32-bit_rle_rgbe\n", "ends within scanline 0 of 1"),
        (b"\2\2\1\x2c" + b"\xff\7" * 900, "-Y 1 +X 300", "FORMAT=32-bit_rle_rgbe\n", "past the end of the line"),
        (b"\2\2\0\x40" + b"\xff\7" * 90, "-Y 1 +X 300", "FORMAT=32-bit_rle_rgbe\n", "says it has 64 pixels, not 300"),
        (b"\2\2\1\x2c\0" + b"\7" * 900, "-Y 1 +X 300", "FORMAT=32-bit_rle_rgbe\n", "is damaged there"),
        (b"\1\1\1\5" * 3, "-Y 1 +X 3", "FORMAT=32-bit_rle_rgbe\n", "does not fit"),
        (b"\7\7\7\7" + b"\1\1\1\0" * 9, "-Y 1 +X 300", "FORMAT=32-bit_rle_rgbe\n", "without an end"),
        (b"", "-Y 9 +Y 300", "FORMAT=32-bit_rle_rgbe\n", "resolution line"),
        (b"", "-Y 999999 +X 8", "FORMAT=32-bit_rle_rgbe\n", "between 1 and 16384"),
        (b"", "-Y 0 +X 8", "FORMAT=32-bit_rle_rgbe\n", "between 1 and 16384"),
        (b"", "-Y 9 +X 300", "FORMAT=32-bit_rle_xyze\n", "32-bit_rle_xyze"),
        (b"", "-Y 9 +X 300", "EXPOSURE=x\n", "EXPOSURE=x"),
    ],
)
def test_bad_hdr(tmp_path: Path, body: bytes, resolution: str, header: str, says: str) -> None:
    with pytest.raises(LoadError) as caught:
        read_environment(write(tmp_path / "bad.hdr", body, resolution, header))
    assert "bad.hdr" in str(caught.value) and says in str(caught.value)


def test_every_truncation_is_one_clear_error(tmp_path: Path, picture: U8) -> None:
    whole = write(tmp_path / "a.hdr", new_rle(picture), "-Y 9 +X 300").read_bytes()
    cut = tmp_path / "cut.hdr"
    for n in [*range(0, 120), *range(120, len(whole), 97)]:
        cut.write_bytes(whole[:n])
        with pytest.raises(LoadError, match=r"cut\.hdr"):
            read_environment(cut)


def exr(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    import OpenEXR

    with OpenEXR.File({"type": OpenEXR.scanlineimage} | header, channels) as file:
        file.write(str(path))
    return path


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr(tmp_path: Path, dtype: type) -> None:
    planes = {c: np.random.default_rng(i).random((4, 8)).astype(dtype) for i, c in enumerate("RGB")}
    texels, warnings = read_environment(exr(tmp_path / "a.exr", {**planes, "A": planes["R"]}))
    assert warnings == () and texels.dtype == np.float32
    assert np.array_equal(texels, np.stack([planes[c] for c in "RGB"], -1).astype(np.float32))
    grey, _ = read_environment(exr(tmp_path / "y.exr", {"Y": planes["R"]}))
    assert np.array_equal(grey, np.repeat(planes["R"][..., None], 3, 2).astype(np.float32))


def test_texels_that_are_no_light_become_0_and_are_counted(tmp_path: Path) -> None:
    red = np.ones((4, 8), np.float32)
    red[0, 0], red[1, 1], red[2, 2] = np.nan, np.inf, -1
    one = np.ones((4, 8), np.float32)
    texels, warnings = read_environment(exr(tmp_path / "a.exr", {"R": red, "G": one, "B": one}))
    assert len(warnings) == 1 and "a.exr" in warnings[0] and "3 of 32" in warnings[0]
    assert np.isfinite(texels).all() and texels.min() == 0 and texels[0, 0].tolist() == [0, 1, 1]


def test_bad_exr(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    half = np.ones((4, 8), np.float16)
    cases = {
        "an environment needs R, G and B": exr(tmp_path / "rg.exr", {"R": half, "G": half}),
        "half or float": exr(tmp_path / "uint.exr", {c: half.astype(np.uint32) for c in "RGB"}),
    }
    whole = exr(tmp_path / "whole.exr", {c: half for c in "RGB"}).read_bytes()
    for n in (5, 60, len(whole) // 2, len(whole) - 4):
        cut = tmp_path / f"cut{n}.exr"
        cut.write_bytes(whole[:n])
        cases[f"cut{n}.exr: damaged or cut short"] = cut
    (tmp_path / "text.exr").write_text("hello")
    cases["not an OpenEXR image"] = tmp_path / "text.exr"
    cases["cannot be read"] = tmp_path / "absent.exr"
    (tmp_path / "sky.png").write_text("hello")
    cases['not ".png"'] = tmp_path / "sky.png"
    capfd.readouterr()
    for says, path in cases.items():
        with pytest.raises(LoadError) as caught:
            read_environment(path)
        assert path.name in str(caught.value) and says in str(caught.value)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", ""), "the OpenEXR library wrote to the terminal"


def test_multipart_exr_is_refused(tmp_path: Path) -> None:
    import OpenEXR

    half = np.ones((4, 8), np.float16)
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {c: half for c in "RGB"}, name) for name in ("a", "b")]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "two.exr"))
    with pytest.raises(LoadError, match="2 parts"):
        read_environment(tmp_path / "two.exr")


@pytest.mark.parametrize(
    ("name", "shape", "mean", "peak"),
    [
        ("venice_sunset_1k.hdr", (512, 1024, 3), (0.40466, 0.41625, 0.57336), 6496.0),
        ("studio_small_03_1k.hdr", (512, 1024, 3), (1.63378, 1.88099, 2.12792), 3568.0),
        ("royal_esplanade_256.hdr", (128, 256, 3), (1.22601, 0.96571, 0.87778), 12608.0),
        ("provence_studio_1k.exr", (512, 1024, 3), (0.71973, 0.70979, 0.72703), 115.5),
    ],
)
def test_real_maps(name: str, shape: tuple[int, ...], mean: tuple[float, ...], peak: float) -> None:
    if not (MODELS / name).exists():
        pytest.skip("the shared environment maps are not here")
    texels, warnings = read_environment(MODELS / name)
    assert texels.shape == shape and warnings == ()
    assert np.allclose(texels.mean((0, 1)), mean, rtol=1e-3) and texels.max() == pytest.approx(peak)
    if "venice" in name:  # a photograph taken upright: the sky is brighter than the ground
        assert texels[:200].mean() > 2 * texels[-200:].mean()


# The analytic sky ------------------------------------------------------------------------------------------------


def horizontal_illuminance(texels: F32) -> float:
    height = len(texels)
    polar = (np.arange(height // 2) + 0.5) / height * np.pi
    luminance = texels[: height // 2] @ np.array([0.2126, 0.7152, 0.0722])
    return float((luminance.mean(1) * np.cos(polar) * np.sin(polar)).sum() * np.pi / height * 2 * np.pi)


@pytest.mark.parametrize("turbidity", [1.0, 2.5, 6.0, 10.0])
@pytest.mark.parametrize("elevation", [-5.0, 0.0, 3.0, 30.0, 90.0])
def test_sky_is_finite_positive_and_without_seams(elevation: float, turbidity: float) -> None:
    texels = sky.sky_map(np.radians(elevation), 1.0, turbidity, width=128)
    assert texels.shape == (64, 128, 3) and texels.dtype == np.float32
    assert np.isfinite(texels).all() and texels.min() >= 0 and texels.max() < 2000
    seam = np.abs(texels[:, 0] - texels[:, -1]).max()
    assert seam <= np.abs(np.diff(texels, axis=1)).max() + 1e-6


def test_sky_is_as_bright_as_the_real_one() -> None:
    """Clear-sky illuminances (IES): about 100 klux direct and 10 to 20 klux diffuse at 60 degrees, far less at 5."""
    light = sky.sun_light(np.radians(60), 0.0, 2.5)
    lux = light.intensity * float(np.dot(light.color, (0.2126, 0.7152, 0.0722)))
    assert 85 < lux < 115
    assert 8 < horizontal_illuminance(sky.sky_map(np.radians(60), 0.0, 2.5)) < 26
    low = [sky.sun_light(np.radians(e), 0.0, 3.0) for e in (60, 30, 10, 3)]
    assert all(a.intensity > b.intensity for a, b in pairwise(low))
    redness = [light.color[0] / light.color[2] for light in low]
    assert redness == sorted(redness) and redness[0] < 2 < redness[-1]
    day = sky.sky_map(np.radians(50), 0.0, 2.0)
    assert day[10, 0, 2] > 2 * day[10, 0, 0], "a clear zenith is blue"


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 181.3, 270.0, -45.0])
def test_sun_stands_where_the_sky_is_brightest(azimuth: float) -> None:
    elevation = np.radians(35)
    texels = sky.sky_map(elevation, np.radians(azimuth), 3.0)
    height, width = texels.shape[:2]
    row, column = np.unravel_index(texels.sum(2).argmax(), (height, width))
    polar, turn = (row + 0.5) / height * np.pi, (column + 0.5) / width * 2 * np.pi - np.pi
    toward = sky.sun_direction(elevation, np.radians(azimuth))
    across = turn - np.arctan2(toward[0], -toward[2])
    assert abs(np.degrees((across + np.pi) % (2 * np.pi) - np.pi)) < 0.8  # a texel is 0.7 degrees
    assert -1 < 35 - (90 - np.degrees(polar)) < 3  # there is more air, and so more light, just below the sun
    light = sky.sun_light(elevation, np.radians(azimuth))
    assert np.allclose(light.direction, -toward, atol=1e-12)


def test_ground_is_smooth_and_takes_its_colour() -> None:
    texels = sky.sky_map(np.radians(30), 0.0, 3.0, (0.4, 0.0, 0.0))
    below = texels[128:]
    assert below[-1, 0, 0] > 1 and below[-1, 0, 1] < 1e-6
    column = texels[:, 200].sum(1)
    assert np.abs(np.diff(column)).max() < 0.25 * column.max()


def test_studio_boxes_are_where_they_should_be() -> None:
    boxes = [sky.SoftBox(np.radians(90), np.radians(30), (np.radians(20), np.radians(40)), (5.0, 4.0, 3.0), 0.1)]
    texels = sky.studio_map(boxes, (0.1, 0.1, 0.1), (0.3, 0.3, 0.3), width=256)
    row, column = int(60 / 180 * 128), int(0.75 * 256)  # 30 degrees up, to the right of the centre
    assert np.allclose(texels[row, column], (5, 4, 3))
    assert texels[row, 64].max() < 0.31 and texels[0, 0, 0] > texels[-1, 0, 0]
    solid = (np.sin((np.arange(128) + 0.5) / 128 * np.pi)[:, None] * (texels[..., 0] > 2.6)).sum() * (np.pi / 128) ** 2
    tan_x, tan_y = np.tan(np.radians(10)) * 0.95, np.tan(np.radians(20)) * 0.95
    assert solid == pytest.approx(4 * np.arcsin(tan_x * tan_y / np.sqrt((1 + tan_x**2) * (1 + tan_y**2))), rel=0.06)
