"""Output: the table of AOVs, PNG, EXR and NPZ read back bit for bit, and refusals that leave nothing behind."""

import io
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glhybrid import image
from glhybrid.errors import OutputError, SettingError
from glhybrid.image import AOVS, Frame

HEIGHT, WIDTH, LIGHTS = 5, 7, 2
RECEIPT = {"settings": {"shadows": "ray"}, "scene": {"sha256": "abc"}}


def _values(name: str) -> NDArray[Any]:
    """Different in every element, with the extremes of the type."""
    aov = AOVS[name]
    shape = aov.shape(HEIGHT, WIDTH, LIGHTS)
    array = np.arange(np.prod(shape)).reshape(shape).astype(aov.dtype)
    if aov.dtype == "float32":
        array = (array / 7 - 3).astype(np.float32)
        array.flat[0] = np.inf if name != "radiance" else 1.0
    else:
        array.flat[0] = np.iinfo(aov.dtype).max
    return array


def _frame(*names: str) -> Frame:
    rgb = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3)
    return Frame(rgb, {name: _values(name) for name in names}, dict(RECEIPT))


def _no_leftovers(folder: Path, *expected: str) -> None:
    assert sorted(p.name for p in folder.iterdir()) == sorted(expected)


def test_the_table_is_the_documented_contract() -> None:
    assert list(AOVS) == [
        "radiance", "depth", "distance", "position", "normal", "normal_geometric", "albedo", "roughness", "metallic",
        "emissive", "instance_id", "material_id", "triangle_id", "motion", "visibility", "occlusion",
        "reflection", "reflection_hit", "reason", "reason_shadows", "reason_ao", "bvh_steps",
    ]  # fmt: skip
    for name, aov in AOVS.items():
        want = {"depth": np.inf, "distance": np.inf, "radiance": None, "occlusion": 1}.get(name, 0)
        assert aov.miss == (0xFFFFFFFF if name.endswith("_id") else want), name
        assert aov.dtype == (
            "uint8" if "reason" in name else "uint32" if "_id" in name or "steps" in name else "float32"
        )
        assert aov.meaning and aov.unit
    assert [AOVS[n].channels for n in ("normal", "depth", "albedo", "instance_id")] == [
        ("X", "Y", "Z"), ("Z",), ("R", "G", "B"), ("id",),
    ]  # fmt: skip


@pytest.mark.parametrize("exr_float", [False, True])
def test_exr_holds_every_aov_exactly(tmp_path: Path, exr_float: bool) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    frame = _frame(*AOVS)
    assert frame.save(tmp_path / "a.exr", exr_float=exr_float) == []
    _no_leftovers(tmp_path, "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        got = {name: channel.pixels for name, channel in file.channels().items()}
        header = dict(file.header())
    want: dict[str, NDArray[Any]] = {}
    for i, part in enumerate("RGB"):
        want[part] = frame["radiance"][..., i].astype(np.float32 if exr_float else np.float16)
    for name, aov in AOVS.items():
        if name == "radiance":
            continue
        parts = aov.channels or [str(i) for i in range(LIGHTS)]
        planes = frame[name].reshape(HEIGHT, WIDTH, len(parts))
        for i, part in enumerate(parts):
            want[f"{name}.{part}"] = planes[..., i].astype(np.float32 if aov.dtype == "float32" else np.uint32)
    assert sorted(got) == sorted(want)
    for name, pixels in want.items():
        assert got[name].dtype == pixels.dtype, name
        np.testing.assert_array_equal(got[name], pixels, err_msg=name)  # row 0 first, as it is in the array
    assert json.loads(header["settings"]) == RECEIPT["settings"] and header["scene"] == "abc"
    assert header["software"].startswith("glhybrid ")


def test_radiance_past_halfs_range_is_cut_and_reported(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    frame = _frame("radiance")
    frame.arrays["radiance"][0, 0] = (1e6, 1, 2)
    (warning,) = frame.save(tmp_path / "a.exr")
    assert "1 pixels" in warning and "1e+06" in warning and "--exr-float" in warning
    assert frame.receipt["warnings"] == [warning]
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert file.channels()["R"].pixels[0, 0] == 65504
    assert frame.save(tmp_path / "b.exr", exr_float=True) == []
    with OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True) as file:
        assert file.channels()["R"].pixels[0, 0] == np.float32(1e6)


def test_npz_holds_arrays_by_name(tmp_path: Path) -> None:
    frame = _frame(*AOVS)
    frame.save(tmp_path / "a.npz", aov=["depth", "instance_id", "visibility"])
    _no_leftovers(tmp_path, "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as got:
        assert sorted(got.files) == ["depth", "instance_id", "radiance", "visibility"]
        for name in got.files:
            assert got[name].dtype == frame[name].dtype
            np.testing.assert_array_equal(got[name], frame[name])


def test_png_is_the_picture_tagged_srgb(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    from PIL import Image

    frame = _frame()
    frame.save(str(tmp_path / "A.PNG"))  # suffixes in any case
    frame.save("-")
    piped = capfdbinary.readouterr().out
    written = (tmp_path / "A.PNG").read_bytes()
    assert written == piped == frame._repr_png_()
    with Image.open(io.BytesIO(written)) as got:
        got.load()
        np.testing.assert_array_equal(np.asarray(got), frame.rgb)
        assert got.mode == "RGB" and got.info["srgb"] == 0
        assert json.loads(got.info["Settings"]) == RECEIPT["settings"]
    assert frame.size == (WIDTH, HEIGHT)


def test_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path, says in (
        (tmp_path / "a.jpg", r"supported: \.png, \.exr, \.npz"),
        (tmp_path / "a", "no suffix"),
        (tmp_path / "no" / "a.png", f"mkdir -p {tmp_path / 'no'}"),
        (tmp_path / "file" / "a.png", "is not a folder"),
        (tmp_path / "folder.png", "is a folder"),
    ):
        (tmp_path / "file").touch()
        (tmp_path / "folder.png").mkdir(exist_ok=True)
        with pytest.raises(OutputError, match=says) as caught:
            image.check_output(path)
        assert str(path) in str(caught.value)
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *_: False)  # root may write anywhere
        with pytest.raises(OutputError, match="cannot be written to"):
            image.check_output(tmp_path / "a.png")
        patch.setattr(sys.stdout, "isatty", lambda: True)
        with pytest.raises(OutputError, match="terminal"):
            image.check_output("-")
    with pytest.raises(SettingError, match="PNG holds no AOVs"):
        image.check_output("a.png", ("depth",))
    with pytest.raises(SettingError, match=r"did you mean .depth"):
        image.check_output("a.exr", ("dpeth",))
    with pytest.raises(SettingError, match=r"has no .normal.*it has: depth"):
        _frame("depth")["normal"]
    with pytest.raises(SettingError, match="radiance"):
        _frame("depth").save(tmp_path / "a.exr")


@pytest.mark.parametrize("suffix", ["png", "exr", "npz"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    target = tmp_path / f"a.{suffix}"
    target.write_bytes(b"before")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left on device") as caught:
        _frame("radiance").save(target)
    assert str(target) in str(caught.value)
    _no_leftovers(tmp_path, target.name)
    assert target.read_bytes() == b"before"


def test_writing_where_the_kernel_says_no() -> None:
    if not Path("/proc/self").exists():
        pytest.skip("no /proc")
    for name in ("a.png", "a.exr", "a.npz"):  # not even root writes there
        with pytest.raises(OutputError, match=f"/proc/{name}: cannot be written"):
            _frame("radiance").save(f"/proc/{name}")


def test_a_frame_keeps_to_the_table() -> None:
    rgb = np.zeros((2, 3, 3), np.uint8)
    for wrong in (
        {"depth": np.zeros((2, 3), np.float64)},
        {"depth": np.zeros((3, 2), np.float32)},
        {"instance_id": np.zeros((2, 3), np.int32)},
        {"normal": np.zeros((2, 3), np.float32)},
    ):
        with pytest.raises(AssertionError):
            Frame(rgb, wrong)  # type: ignore[arg-type]
