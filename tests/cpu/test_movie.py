"""Movies: every picture in its place and at its time, whole or not there at all."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageSequence

from glhybrid import movie
from glhybrid.errors import OutputError
from glhybrid.image import Frame, metadata
from glhybrid.movie import Movie
from glhybrid.resume import fingerprint_of, scene_digest
from glhybrid.scene import Image as SceneImage
from glhybrid.scene import Light, Material, Scene, Texture

RECEIPT = {"settings": {"shadows": "ray"}, "scene": {"sha256": "ab"}}
FLAT = [(200, 60, 30), (30, 180, 90), (20, 40, 220), (255, 255, 255), (0, 0, 0), (128, 128, 128), (188, 188, 188)]


def pictures(size: tuple[int, int] = (48, 32)) -> list[Any]:
    """Flat colours with a bar that wanders, so that neither order nor rows can be mixed up unseen."""
    made = []
    for k, color in enumerate(FLAT):
        rgb = np.empty((size[1], size[0], 3), np.uint8)
        rgb[:] = color
        rgb[: 8 * (k % 3 + 1), :8] = (250, 250, 0)
        made.append(rgb)
    return made


def write(path: Path, fps: float = 24.0) -> list[Any]:
    made = pictures()
    with Movie(path, fps, len(made), RECEIPT) as file:
        for rgb in made:
            file.add(rgb)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    return made


@pytest.mark.parametrize("suffix", [".webp", ".gif", ".apng"])
def test_pillow_reads_them_back(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    made = write(path)
    with Image.open(path) as file:
        got = [(np.asarray(f.convert("RGB")).astype(int), f.info["duration"]) for f in ImageSequence.Iterator(file)]
    assert len(got) == len(made)
    worst = {".apng": 0, ".gif": 2, ".webp": 12}[suffix]  # lossless; 256 colours; lossy, worst where a bar ends
    for (rgb, _), want in zip(got, made, strict=True):
        assert np.abs(rgb - want)[16:, 16:].max() <= min(worst, 4)
        assert np.abs(rgb - want).mean() <= worst / 2
    ends = np.cumsum([d for _, d in got])
    np.testing.assert_allclose(ends, np.arange(1, 8) * 1000 / 24, atol=5.001 if suffix == ".gif" else 0.501)


def test_apng_starts_as_a_plain_png_with_its_settings(tmp_path: Path) -> None:
    path = tmp_path / "a.apng"
    write(path)
    with Image.open(path) as file:
        assert file.info["Settings"] == metadata(RECEIPT)["Settings"] and file.info["loop"] == 0


def test_mp4_keeps_colours_and_times(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "a.mp4"
    made = write(path, 30000 / 1001)
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        assert abs(float(stream.average_rate) - 30000 / 1001) < 1e-4 and "shadows" in file.metadata["comment"]
        frames = list(file.decode(video=0))
    assert [round(f.time * 30000 / 1001, 3) for f in frames] == list(range(len(made)))
    assert (frames[0].colorspace, frames[0].color_range) == (1, 1)  # BT.709, limited
    for frame, want in zip(frames, made, strict=True):
        # Limited range has 219 steps for 256: up to 2 by rounding, and as much by coding.
        planes = frame.reformat(format="rgb24", src_colorspace="ITU709", dst_color_range="JPEG").to_ndarray()
        assert np.abs(planes.astype(int) - want)[18:, 18:].max() <= 4


def test_refused_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path, size, fps, says in (
        ("a.gif", (64, 48), 60, "at most 50"), ("a.gif", (70000, 1), 10, "more than .gif holds"),
        ("a.webp", (20000, 10), 10, "more than .webp holds"),
    ):  # fmt: skip
        with pytest.raises(OutputError, match=says):
            movie.check(path, size, fps)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(OutputError, match=r"pip install 'glhybrid\[video\]'"):
        movie.check("a.mp4", (64, 48), 24)


def test_mp4_needs_even_sides() -> None:
    pytest.importorskip("av")
    with pytest.raises(OutputError, match="--size 66x48"):
        movie.check("a.mp4", (65, 48), 24)


@pytest.mark.parametrize("suffix", [".webp", ".apng", ".gif"])
def test_given_up_half_way_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"the one before")
    with pytest.raises(KeyboardInterrupt), Movie(path, 24, 7, RECEIPT) as file:
        file.add(pictures()[0])
        raise KeyboardInterrupt
    assert path.read_bytes() == b"the one before" and len(list(tmp_path.iterdir())) == 1


def test_an_encoder_that_fails_says_so_and_stops_nobody(tmp_path: Path) -> None:
    def add() -> None:
        with Movie(tmp_path / "gone" / "a.webp", 24, 100, RECEIPT) as file:
            for _ in range(100):
                file.add(pictures()[0])

    with pytest.raises(OutputError, match="cannot be written"):
        add()


@pytest.mark.parametrize("suffix", [".webp", ".mp4"])
def test_a_killed_process_leaves_no_broken_movie(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mp4":
        pytest.importorskip("av")
    code = (
        "import os, sys, numpy as np; from pathlib import Path; from glhybrid.movie import Movie\n"
        f"with Movie(Path({str(tmp_path)!r}) / 'a{suffix}', 24, 90, {{}}) as m:\n"
        "    for k in range(90):\n"
        "        m.add(np.full((64, 64, 3), k, np.uint8))\n"
        "        if k == 40: os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], env=os.environ).returncode == -9
    left = list(tmp_path.iterdir())
    assert not (tmp_path / f"a{suffix}").exists() and all(".part" in p.name for p in left)


@pytest.mark.parametrize("suffix", [".png", ".exr", ".npz"])
def test_fingerprints_lie_in_the_files(tmp_path: Path, suffix: str) -> None:
    radiance = np.zeros((4, 6, 3), np.float32)
    frame = Frame(np.zeros((4, 6, 3), np.uint8), {"radiance": radiance}, {"fingerprint": "12ab" * 16})
    path = tmp_path / f"a{suffix}"
    frame.save(path)
    assert fingerprint_of(path) == "12ab" * 16
    if suffix == ".npz":
        assert np.load(path)["radiance"].shape == (4, 6, 3)
    Frame(np.zeros((4, 6, 3), np.uint8), {"radiance": radiance}).save(path)
    assert fingerprint_of(path) is None
    path.write_bytes(path.read_bytes()[:30])
    assert fingerprint_of(path) is None and fingerprint_of(tmp_path / f"gone{suffix}") is None


def test_a_digest_is_of_the_contents() -> None:
    def scene(value: int = 7, color: float = 0.5, path: Path | None = None) -> Scene:
        texels = np.full((2, 2, 4), value, np.uint8)
        material = Material(base_color=(color, 1, 1, 1), textures={"base_color": Texture(SceneImage(texels))})
        return Scene("a", materials=(material, material), lights=(Light("point"),), path=path, sha256=str(path))

    same = scene_digest(scene())
    assert same == scene_digest(scene(path=Path("elsewhere")))
    others = {
        scene_digest(s) for s in (scene(8), scene(color=0.6), scene().replace(lights=()), scene().replace(name="b"))
    }
    assert len(others) == 4 and same not in others
