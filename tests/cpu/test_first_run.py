"""A first run ever: no compiler is waited for, and the run after it finds what another process has compiled."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bvh_shapes import rays, rods, same, soup

from glhybrid import jit, kernels, plan, reference
from glhybrid.bench import scenes
from glhybrid.bvh import blas, build_blas, build_tlas
from glhybrid.errors import SettingError
from glhybrid.kernels import LOADING_S, Kernels
from glhybrid.load.shapes import box
from glhybrid.scene import Instance, Mesh, Scene
from glhybrid.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
PATIENCE_S = 240  # of a process that is last in line, on a machine that is busy
RUN = """
import json, logging, sys
import numpy as np
logging.basicConfig(level="INFO")
from bvh_shapes import rods
from test_swarm import crowd
from glhybrid import motion
from glhybrid.bvh import build_tlas, load_or_build
from glhybrid.bvh.top import MovingTop
tree = load_or_build(rods())
made = motion.Motion(scene := crowd(count=20), scene.animations[0])
moment = made.at(0.3, world := made.resting())
middle = np.random.default_rng(0).random((20, 1, 3))
boxes = np.concatenate([middle, middle + 0.1], axis=1)
top = MovingTop(build_tlas(boxes, moving=True), 0)
top.refit(boxes)
top.refit(boxes + 0.01, np.arange(20))
print(json.dumps({"quick": tree.quick, "cost": tree.sah_cost, "numba": "numba" in sys.modules}))
"""


def run(folder: Path, script: str = RUN, **variables: str) -> tuple[dict[str, Any], str]:
    """Of a process with its own cache folder: what it printed, and its log."""
    environment = {k: v for k, v in os.environ.items() if k not in ("GLHYBRID_COMPILE", "NUMBA_CACHE_DIR")}
    environment |= {"GLHYBRID_CACHE": str(folder), "PYTHONPATH": f"{ROOT}{os.pathsep}{HERE}{os.pathsep}{HERE.parent}"}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment | variables, check=True, timeout=PATIENCE_S,
        capture_output=True, text=True, cwd=HERE,
    )  # fmt: skip
    return json.loads(done.stdout), done.stderr


def test_a_first_run_waits_for_no_compiler_and_the_next_one_has_it(tmp_path: Path) -> None:
    first, said = run(tmp_path)
    assert first["quick"] and not first["numba"] and said.count("in a process beside") == 1, said
    assert not list(tmp_path.glob("bvh/*")), "a quick tree is not kept"
    again, said = run(tmp_path)  # while the other process is at work, or soon after
    end = time.monotonic() + PATIENCE_S
    while not list(tmp_path.glob("numba/TREES-*.ready")):
        assert time.monotonic() < end, "nothing was compiled"
        time.sleep(0.2)
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb[ic]")}
    assert len(kept) > 10 and not list(tmp_path.rglob("*.part"))
    assert again["cost"] in (first["cost"], build_blas(rods()).sah_cost)
    later, said = run(tmp_path)
    assert not later["quick"] and "compil" not in said and list(tmp_path.glob("bvh/*.blas"))
    assert later["cost"] == build_blas(rods()).sah_cost < first["cost"]
    assert {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb[ic]")} == kept, "compiled again"
    last, said = run(tmp_path)  # the tree is kept, so Numba is not even loaded
    assert last == later | {"numba": False}


@pytest.fixture
def trees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Kernels]:
    """A set like TREES in a process that has loaded nothing, on a machine where nothing is compiled."""
    kernels.TREES.load()  # what others are held against
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("GLHYBRID_COMPILE", "aside")
    (tmp_path / "numba").mkdir()
    yield Kernels("TREES", "a test", ("glhybrid.bvh.build",), 5.0)


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Processes that would have been started."""
    commands: list[str] = []
    monkeypatch.setattr(kernels, "_start", lambda command, lock: commands.append(command))
    return commands


def test_kernels_are_loaded_once_that_is_less_than_what_was_spent(trees: Kernels, started: list[str]) -> None:
    assert not any(trees.pay(0.4) for _ in range(12)) and trees.pay(0.4)  # 5 s to compile
    assert trees.spent == pytest.approx(4.8) and len(started) == 1
    trees.spent = 0.0
    assert not trees.pay(4.9, better=True) and trees.pay(5.1, better=True)
    mark = trees._mark()
    assert mark is not None and not trees.ready()
    mark.touch()
    trees.spent = 0.0
    assert trees.ready() and trees.pay(0.001, better=True) and trees.pay(LOADING_S + 0.01)
    assert not trees.pay(LOADING_S / 2) and not trees.pay(LOADING_S / 3) and trees.pay(LOADING_S / 3)
    trees.loaded = True
    assert trees.pay()


def test_small_pieces_add_up_and_are_not_thought_over_each_time(
    trees: Kernels, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(trees, "pay", lambda: asked.append(trees.spent))
    for _ in range(1000):
        trees.due()
        trees.spent += 0.001
    assert 10 < len(asked) < 25


def test_what_plays_goes_on_while_kernels_are_loaded(trees: Kernels, monkeypatch: pytest.MonkeyPatch) -> None:
    let, loads = threading.Event(), []

    def load() -> None:
        loads.append(threading.current_thread())
        assert let.wait(60)

    monkeypatch.setattr(trees, "load", load)
    mark = trees._mark()
    assert mark is not None
    mark.touch()
    for trees.spent in (LOADING_S / 2, 2 * LOADING_S, 3 * LOADING_S):
        assert not trees.due()
    let.set()
    (thread,) = loads
    assert thread is not threading.main_thread() and not thread.daemon
    thread.join(60)
    monkeypatch.setenv("GLHYBRID_COMPILE", "first")
    trees.spent = 4 * LOADING_S
    assert trees.due(), "who asks for that waits"


def test_nobody_compiles_what_another_process_is_compiling(trees: Kernels, started: list[str]) -> None:
    ended: list[int | None] = [None]
    trees._process = type("Process", (), {"poll": lambda self: ended[0]})()  # type: ignore[assignment]
    assert not trees.pay(99.0) and trees.pay(99.0, better=True)
    ended[0] = 1
    assert trees.pay(0.1)


@pytest.mark.parametrize("why", ["off", "never", "busy", "embedded", "no folder", "left alone", "worthless"])
def test_no_process_is_started_where_it_is_of_no_use(
    why: str, trees: Kernels, started: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert not Kernels("TREES", "a test", ("glhybrid.bvh.build",), 5.0).pay(1.0, better=True) and len(started) == 1
    if why == "off":
        monkeypatch.setenv("GLHYBRID_CACHE", "off")
    elif why == "never":
        monkeypatch.setenv("GLHYBRID_COMPILE", "never")
    elif why == "embedded":
        monkeypatch.setattr(sys, "executable", "/opt/painter/bin/painter")
    elif why == "no folder":
        monkeypatch.setenv("GLHYBRID_CACHE", "/proc/nowhere")
    if why == "busy":
        with kernels.locked(tmp_path / "numba"):
            assert not trees.pay(1.0, better=True)
    elif why == "left alone":
        with trees.left_alone():
            assert not trees.pay(9.0, better=True) and trees.spent == 0
    else:
        assert not trees.pay(1.0 if why != "worthless" else 0.1, better=why != "worthless")
    assert len(started) == 1


def test_one_process_compiles_at_a_time(tmp_path: Path) -> None:
    """It has the lock until it ends, however it does, and is no more in this one's way."""
    with kernels.locked(tmp_path) as lock:
        with pytest.raises(OSError), kernels.locked(tmp_path):
            pass
        process = kernels._start("import time; time.sleep(300)", lock)
    with pytest.raises(OSError), kernels.locked(tmp_path):
        pass
    process.kill()
    process.wait(60)
    with kernels.locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_the_process_beside_is_detached_and_reaped(tmp_path: Path) -> None:
    told = tmp_path / "told"
    code = f"import os, sys; open({str(told)!r}, 'w').write(f'{{os.getsid(0) == os.getpid()}}')"
    script = f"""
import json, os, threading
from glhybrid import kernels
kernels._start({code!r}, 0)
for thread in threading.enumerate():
    if thread.name == "glhybrid: kernels":
        thread.join(60)
try:
    os.waitpid(-1, os.WNOHANG)
    left = True
except ChildProcessError:
    left = False
print(json.dumps({{"left": left}}))
"""
    assert run(tmp_path, script, PYTHONWARNINGS="error") == ({"left": False}, "")
    assert told.read_text() == "True"


def test_what_it_cannot_be_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_COMPILE", "beside")
    with pytest.raises(SettingError, match="aside, first, never"):
        kernels.mode()


def test_marks_tell_sources_and_machines_apart(trees: Kernels, monkeypatch: pytest.MonkeyPatch) -> None:
    marks = {trees._mark(), Kernels("TREES", "", ("glhybrid.bvh.leaves",), 5.0)._mark()}
    monkeypatch.setattr(kernels, "_machine", lambda: ("another",))
    marks.add(trees._mark())
    monkeypatch.setattr(jit, "folder", lambda: None)
    assert len(marks) == 3 and trees._mark() is None


def test_quick_trees_are_whole(trees: Kernels, started: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Spheres and ids too, and what the compiled builder would have split; the same hits."""
    rng = np.random.default_rng(3)
    triangles, balls = soup(2500, 5), np.concatenate([rng.random((50, 3)), rng.random((50, 1)) * 0.05], 1)
    given: Any = dict(triangle=np.arange(2500, dtype=np.uint32) + 7, spheres=balls.astype(np.float32), split=True)
    want = build_blas(triangles, **given)
    monkeypatch.setattr(blas, "TREES", trees)
    got = build_blas(triangles, **given)
    assert got.quick and not want.quick and len(started) == 1
    got.validate()
    origins, directions = rays(triangles, 2000, 5)
    hits = [reference.traverse(tree, origins, directions) for tree in (got, want)]
    assert np.array_equal(hits[0].t, hits[1].t) and np.array_equal(hits[0].triangle, hits[1].triangle)
    assert same(got, build_blas(triangles, **given))
    assert not build_blas(triangles[:500]).quick, "of a small one there is no better"


@pytest.mark.parametrize("moving", [False, True], ids=["static", "moving"])
def test_quick_top_trees_are_whole(
    moving: bool, trees: Kernels, started: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from glhybrid.bvh import tlas

    low = np.random.default_rng(1).random((3000, 1, 3))
    boxes = np.concatenate([low, low + 0.01], axis=1)
    want = build_tlas(boxes, moving)
    monkeypatch.setattr(tlas, "TREES", trees)
    got = build_tlas(boxes, moving)
    got.validate()
    assert len(started) == (not moving)  # one that moves is as good
    assert got.sah_cost < (1.03 if moving else 1.2) * want.sah_cost and got.depth <= want.depth + 4
    assert np.array_equal(got.nodes, build_tlas(boxes, moving).nodes)


def test_a_plan_says_whose_trees_there_will_be(
    trees: Kernels, started: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "TREES", trees)
    large, small = (
        scenes.make("spheres", 3000),
        Scene("box", meshes=(Mesh("box", (box(),)),), instances=(Instance(0, np.eye(4)),)),
    )

    def said(scene: Scene, **settings: Any) -> bool:
        return kernels.QUICK in plan.describe(scene, Settings(**settings))["reasons"]

    assert said(large) and not said(small) and not said(large, shadows="map", reflections="env", primary="raster")
    monkeypatch.setenv("GLHYBRID_COMPILE", "first")
    assert not said(large)
    monkeypatch.setenv("GLHYBRID_COMPILE", "aside")
    mark = trees._mark()
    assert mark is not None
    mark.touch()
    assert not said(large) and not started
