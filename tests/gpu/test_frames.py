"""Frames to files: resumed, never broken, and each the same however it was reached."""

import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from glhybrid import camera_path, sequence
from glhybrid.load import load
from glhybrid.renderer import Renderer
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (48, 40)


def run(renderer: Renderer, scene: Any, pattern: Path, frames: str, aovs: tuple[str, ...] = (), **more: Any) -> Any:
    move = sequence.turntable(scene, turn) if (turn := more.pop("turntable", 0)) else None
    made = sequence.make(scene, Settings(aa=1, exposure=0.0), frames, 12, move=move)
    return sequence.run(renderer, made, str(pattern), SIZE, aovs, **more)


def test_finished_frames_are_kept(context: "Context", models: Path, tmp_path: Path) -> None:
    scene = load(models / "CesiumMan/CesiumMan.glb")
    pattern = tmp_path / "man_{frame:03d}.png"
    with Renderer(context=context) as renderer:
        first = run(renderer, scene, pattern, "0:6:2")
        assert (first["written"], first["kept"]) == (3, 0)
        old = {p: p.stat().st_mtime_ns for p in tmp_path.iterdir()}
        dead = subprocess.Popen([sys.executable, "-c", ""])
        dead.wait()
        leftover = tmp_path / f".man_003.{dead.pid}.part.png"
        leftover.write_bytes(b"half")
        again = run(renderer, scene, pattern, "0:6")
        assert (again["written"], again["kept"]) == (3, 3)
        assert all(p.stat().st_mtime_ns == t for p, t in old.items()) and not leftover.exists()
        sought = renderer.render(scene, size=SIZE, settings=Settings(aa=1, exposure=0.0, time=5 / 12))
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"man_{i:03d}.png" for i in range(6)]
    pictures = [np.asarray(Image.open(tmp_path / f"man_{i:03d}.png")) for i in range(6)]
    np.testing.assert_array_equal(pictures[5], sought.rgb)
    assert all((a != b).any() for a, b in pairwise(pictures))


@pytest.mark.parametrize("turntable", [0, 30])
def test_motion_of_a_frame_does_not_depend_on_the_run(
    context: "Context", models: Path, tmp_path: Path, turntable: int
) -> None:
    scene = load(models / "CesiumMan/CesiumMan.glb")
    with Renderer(context=context) as renderer:
        run(renderer, scene, tmp_path / "a{frame}.npz", "3:6", ("motion",), turntable=turntable)
    with Renderer(context=context) as renderer:
        run(renderer, scene, tmp_path / "b{frame}.npz", "5:6", ("motion",), turntable=turntable)
    a, b = (np.load(tmp_path / f"{name}5.npz")["motion"] for name in "ab")
    np.testing.assert_array_equal(a, b)
    assert np.abs(a).max() > 0.3


def heed_interrupts() -> None:
    """Shells start what runs in the background deaf to SIGINT, and its children inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.slow
def test_a_killed_run_leaves_whole_frames(models: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "glhybrid", "render", str(models / "Fox/Fox.glb"), "--frames", "0:400", "--size",
               "64x48", "--aa", "1", "--quiet", "-o", str(tmp_path / "{frame:04d}.png")]  # fmt: skip
    for stop in (signal.SIGKILL, signal.SIGINT):
        before = len(list(tmp_path.glob("[0-9]*.png")))
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, preexec_fn=heed_interrupts)
        deadline = time.monotonic() + 60
        while len(list(tmp_path.glob("[0-9]*.png"))) < before + 5 and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(stop)
        code = process.wait(timeout=30)
        assert code == (-signal.SIGKILL if stop == signal.SIGKILL else 130)
        done = sorted(tmp_path.glob("[0-9]*.png"))
        # Files are written side by side: one of those under way may be missing where a later one is whole.
        missing = set(range(int(done[-1].stem) + 1)) - {int(p.stem) for p in done}
        assert before + 5 <= len(done) < 400 and len(missing) <= (os.cpu_count() or 1)
        for path in done:
            Image.open(path).load()


def test_frames_of_other_settings_are_made_anew(context: "Context", models: Path, tmp_path: Path) -> None:
    scene = load(models / "AnimatedMorphCube/AnimatedMorphCube.glb")
    pattern = tmp_path / "{frame}.png"

    def go(settings: Settings, of: Any = scene, **more: Any) -> tuple[int, int]:
        made = sequence.make(of, settings.replace(aa=1), "0:3", 12)
        done = sequence.run(renderer, made, str(pattern), SIZE, **more)
        return done["written"], done["kept"]

    with Renderer(context=context) as renderer:
        assert go(Settings()) == (3, 0) and go(Settings()) == (0, 3)
        assert go(Settings(exposure=1.0)) == (3, 0) and go(Settings(exposure=1.0)) == (0, 3)
        Image.new("RGB", SIZE).save(tmp_path / "1.png")  # not ours
        (tmp_path / "2.png").write_bytes(b"broken")
        assert go(Settings(exposure=1.0)) == (2, 1)
        assert go(Settings(exposure=1.0), scene.replace(lights=())) == (3, 0)  # the same file, changed in Python
        assert go(Settings(exposure=1.0), scene.replace(lights=()), overwrite=True) == (3, 0)


@pytest.mark.parametrize("suffix", [".apng", ".mp4"])
def test_a_movie_holds_the_frames(context: "Context", models: Path, tmp_path: Path, suffix: str) -> None:
    if suffix == ".mp4":
        av = pytest.importorskip("av")
    scene, path = load(models / "AnimatedMorphCube/AnimatedMorphCube.glb"), tmp_path / f"cube{suffix}"
    chosen = Settings(aa=1, exposure=0.0)
    with Renderer(context=context) as renderer:
        done = sequence.run(renderer, sequence.make(scene, chosen, "0:9:2", 12), str(path), SIZE)
        assert (done["written"], done["frames"]) == (5, [0, 9, 2]) and done["frames_per_second"] > 0
        single = renderer.render(scene, size=SIZE, settings=chosen.replace(time=4 / 12))
    if suffix == ".apng":
        with Image.open(path) as file:
            assert file.n_frames == 5 and file.info["duration"] == pytest.approx(167, abs=1)  # every second of 12
            file.seek(2)
            np.testing.assert_array_equal(np.asarray(file.convert("RGB")), single.rgb)
    else:
        with av.open(str(path)) as file:
            frames = [f.to_ndarray(format="rgb24") for f in file.decode(video=0)]
        assert len(frames) == 5 and np.abs(frames[2].astype(int) - single.rgb).mean() < 8
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_camera_path_over_a_clip(context: "Context", models: Path, tmp_path: Path) -> None:
    """Both move: the picture of a frame is that of its time from its place."""
    file = tmp_path / "path.toml"
    file.write_text("[[key]]\ntime=0\neye=[0,2,8]\ntarget=[0,0,0]\n[[key]]\ntime=1\neye=[8,2,0]\ntarget=[0,0,0]\n")
    scene = load(models / "AnimatedMorphCube/AnimatedMorphCube.glb")
    chosen, path = Settings(aa=1, exposure=0.0), camera_path.read(file)
    made = sequence.make(scene, chosen, "0:8:7", 12, move=path)
    with Renderer(context=context) as renderer:
        sequence.run(renderer, made, str(tmp_path / "{frame}.png"), SIZE)
        want = renderer.render(scene, path.at(7 / 12, 7, scene.cameras[0]), SIZE, chosen.replace(time=7 / 12))
    got = [np.asarray(Image.open(tmp_path / f"{n}.png")) for n in (0, 7)]
    np.testing.assert_array_equal(got[1], want.rgb)
    assert (got[0] != got[1]).any() and got[0].std() > 5
