"""A small study end to end: what it writes, what its figures say, that it goes on where it was stopped."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image
from study_stage import SIZE, own_cache, stage

import glhybrid as gh
from glhybrid.errors import GlhybridError, OutputError, SettingError
from glhybrid.image import Frame
from glhybrid.study import measure, run, scene_study
from glhybrid.study.beside import Crew
from glhybrid.study.comparing import Comparing
from glhybrid.study.scene_study import SceneStudy
from glhybrid.study.sweep import Cell

if TYPE_CHECKING:
    from glhybrid.context import Context


def _run(folder: Path, monkeypatch: pytest.MonkeyPatch, context: "Context", **extra: object) -> run.Study:
    for name, value in own_cache(folder).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(run, "Renderer", lambda **_: gh.Renderer(context=context))
    # However busy the machine is, nothing is left out for time.
    usual = scene_study.effort
    monkeypatch.setattr(scene_study, "effort", lambda *args: replace(usual(*args), variants_s=np.inf))
    options = {"quick": True, "sizes": (SIZE,), "samples": 8, "only": ("map", "ray", "env", "ray-lerp"), "parts": ()}
    return run.run(("stage",), folder / "out", load=lambda _: stage(), **(options | extra))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory, _shared_context: "Context") -> tuple[Path, run.Study]:
    """The folder of a whole study, and what it gave."""
    _shared_context.make_current()
    folder = tmp_path_factory.mktemp("studied")
    with pytest.MonkeyPatch.context() as patch:
        return folder, _run(folder, patch, _shared_context, command="glhybrid study stage -o out")


def test_a_study_end_to_end_and_again(
    studied: tuple[Path, run.Study], monkeypatch: pytest.MonkeyPatch, context: "Context"
) -> None:
    folder, first = studied
    out = folder / "out"
    results = json.loads((out / "results.json").read_text())
    assert results["rows"] and results["machine"]["device"]["renderer"]
    wanted = {
        "scene", "shadows", "reflections", "parameters", "frame_ms", "trace_ms", "bytes", "flip", "rel_mse", "psnr",
        "wrong_shadow_percent", "flicker", "pareto",
    }  # fmt: skip
    for row in results["rows"]:
        assert wanted <= row.keys()
        assert row["frame_ms"] > 0 and row["bytes"] > 0 and 0 < row["flip"] < 1
        for name in row["images"].values():
            assert (out / "stage" / name).stat().st_size > 0
    assert any(row["pareto"] for row in results["rows"])
    by = {(r["shadows"], r["reflections"], bool(r["parameters"])): r for r in results["rows"]}
    ray, depth = by["ray", "ray-lerp", False], by["map", "ray-lerp", False]
    assert ray["wrong_shadow_percent"] == 0 and ray["flip_shadow"] == 0, "a hard sun: rays are the truth"
    assert depth["wrong_shadow_percent"] > 0 and depth["flip_shadow"] > 0
    for row in results["rows"]:
        assert (row["flip_at_rest"] is not None) == (row["ao"] == "ray" and not row["parameters"]), "random rays"
    assert ray["flip_rate_percent"] == 0 and ray["flicker"] < 0.05
    assert by["ray", "env", False]["flip_reflection"] > ray["flip_reflection"], "env reflects what is not there"
    assert ray["trace_ms"] < ray["frame_ms"] * 2 and set(ray["passes"]) >= {"gbuffer", "shadow", "reflect", "composite"}
    lines = (out / "results.csv").read_text().splitlines()
    assert len(lines) == len(results["rows"]) + 1
    page = (out / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)', page) and "@import" not in page and "url(" not in page, "offline"
    assert "glhybrid study stage -o out" in page and "<svg" in page and page.count("data:image/webp") > 6
    assert (out / "charts" / "stage-picture.svg").is_file()
    # Again: nothing is measured, every figure is as it was.
    monkeypatch.setattr(measure, "time_frames", lambda *_: pytest.fail("was kept"))
    second = _run(folder, monkeypatch, context)
    assert [r["frame_ms"] for r in second.rows] == [r["frame_ms"] for r in first.rows]


def test_several_sizes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: "Context") -> None:
    """Each is studied like one alone, in a folder of its own, and shown; one that is added finds the others kept."""
    sizes = ((64, 48), (96, 64))
    options = {"only": ("ray", "ray-lerp"), "sizes": sizes}
    first = _run(tmp_path, monkeypatch, context, **options)
    names = ["stage 64x48", "stage 96x64"]
    assert list(first.scenes) == names and [tuple(s["size"]) for s in first.scenes.values()] == list(sizes)
    assert first.machine["sizes"] == [list(size) for size in sizes]
    by_scene = [
        {row["label"] for row in first.rows if row["scene"] == name and row["axes"] != ["pairs"]} for name in names
    ]
    assert by_scene[0] == by_scene[1] and len(by_scene[0]) > 2
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    for name, (width, height) in zip(names, sizes, strict=True):
        rows = [row for row in results["rows"] if row["scene"] == name]
        assert any(row["pareto"] for row in rows), "a front of its own"
        for row in rows:
            assert row["size"] == [width, height]
            with Image.open(tmp_path / "out" / name / row["images"]["png"]) as drawn:
                assert drawn.size == (width, height)
    page = (tmp_path / "out" / "report.html").read_text()
    for name in names:
        assert f"<h2>{name}</h2>" in page and (tmp_path / "out" / "charts" / f"{name}-picture.svg").is_file()
    (chart,) = re.findall(r'<svg class="chart"[^>]*aria-label="stage: frame time over pixels.*?</svg>', page, re.S)
    assert "ray + ray-lerp (" in chart and "stage</b> at 64 × 48, 96 × 64." in page
    # Stopped after its first size, and asked for one more: what is there is kept, the rest is made.
    real, calls = measure.time_frames, []
    monkeypatch.setattr(measure, "time_frames", lambda *args: calls.append(args) or real(*args))
    third = _run(tmp_path, monkeypatch, context, only=options["only"], sizes=(*sizes, (48, 48)))
    assert calls and {args[3] for args in calls} == {(48, 48)}
    kept = {(row["scene"], row["label"]): row["frame_ms"] for row in third.rows}
    for row in first.rows:
        assert kept[row["scene"], row["label"]] == row["frame_ms"]
    assert len(third.rows) == len(first.rows) + len(calls)


@pytest.mark.parametrize("processes", [0, 2])
def test_a_stopped_study_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: "Context", processes: int
) -> None:
    """Stopped in its third cell: the first two are kept, and nothing is half-written; also where pictures are compared
    by processes, which may not be done with them."""
    monkeypatch.setattr(scene_study, "PATIENCE_S", 100.0)  # however busy the machine is
    monkeypatch.setattr(SceneStudy, "_processes", processes)
    real, calls = measure.time_frames, []

    def stopping(*args: object) -> measure.Times:
        calls.append(args)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(measure, "time_frames", stopping)
    with pytest.raises(KeyboardInterrupt):
        _run(tmp_path, monkeypatch, context)
    kept = sorted(p.name for p in (tmp_path / "out" / "stage").glob("*.json"))
    assert len(kept) == 3, "two cells and the reference"
    assert not list((tmp_path / "out").rglob("*.part*"))
    assert len(json.loads((tmp_path / "out" / "results.json").read_text())["rows"]) == 2, "what there is, is shown"
    assert (tmp_path / "out" / "report.html").is_file()
    monkeypatch.setattr(SceneStudy, "_processes", 0)  # who goes on needs none
    study = _run(tmp_path, monkeypatch, context)
    assert len(calls) == 3 + len(study.rows) - 2


def test_a_killed_study_goes_on(tmp_path: Path) -> None:
    """The real thing, killed without warning while it measures: what was finished is kept as it was, the rest made."""
    scene = tmp_path / "post.toml"
    scene.write_text(POST)
    environment = os.environ | own_cache(tmp_path) | {"GLHYBRID_TUNING": "off"}
    command = [
        sys.executable, "-m", "glhybrid", "study", str(scene), "--quick", "--size", "48x36", "--samples", "4",
        "--techniques", "map,ray,env", "-o", str(tmp_path / "out"), "--quiet",
    ]  # fmt: skip
    folder = tmp_path / "out" / "post"
    # Its further parts would take minutes: it is killed before them, and asked for none the second time.
    running = subprocess.Popen(command, env=environment)
    deadline = time.perf_counter() + 120
    while len(list(folder.glob("*.json"))) < 3 and running.poll() is None and time.perf_counter() < deadline:
        time.sleep(0.02)
    running.kill()
    assert running.wait() == -signal.SIGKILL
    kept = {path: path.read_bytes() for path in folder.glob("*.json") if ".part" not in path.name}
    assert 3 <= len(kept) < 7
    options = {"quick": True, "sizes": ((48, 36),), "samples": 4, "only": ("map", "ray", "env"), "parts": ()}
    environment_now = pytest.MonkeyPatch()
    for name in (*own_cache(tmp_path), "GLHYBRID_TUNING"):
        environment_now.setenv(name, environment[name])
    study = run.run((str(scene),), tmp_path / "out", **options)  # type: ignore[arg-type]
    environment_now.undo()
    assert all(path.read_bytes() == data for path, data in kept.items())
    made = [path for path in folder.glob("*.json") if ".part" not in path.name]  # the kill may have left one of these
    assert len(made) == len(study.rows) + 1 > len(kept)


AS_ON_A_GPU = """
import sys
from types import SimpleNamespace
from glhybrid import cli
from glhybrid.study import run
from glhybrid.study.scene_study import SceneStudy

usual, gpu = run._beside, SimpleNamespace(context=SimpleNamespace(device=SimpleNamespace(software=False)), tuning=1)
run._beside = lambda _, *rest: usual(gpu, *rest)
run.threads_available = lambda: 4
run.PARTS = ()
SceneStudy._processes = 2
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.mark.parametrize("cells", [0, 2])
def test_an_interrupted_study_says_so_and_goes_on(tmp_path: Path, cells: int) -> None:
    """Ctrl-C in a terminal goes to the whole process group, while the reference converges or cells are measured; with
    processes that compile ahead and compare: one line, exit code 130, nobody left behind, and the same command goes on.
    """
    scene, folder = tmp_path / "post.toml", tmp_path / "out" / "post"
    scene.write_text(POST)
    environment = os.environ | own_cache(tmp_path) | {"GLHYBRID_TUNING": "off"}
    command = [
        sys.executable, "-c", AS_ON_A_GPU, "study", str(scene), "--quick", "--size", "48x36", "--samples", "64",
        "--techniques", "ray,env", "-o", str(tmp_path / "out"),
    ]  # fmt: skip

    def begin() -> "subprocess.Popen[str]":
        return subprocess.Popen(
            command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip

    running, deadline = begin(), time.perf_counter() + 120

    def kept() -> dict[Path, bytes]:
        rows = [path for path in folder.glob("*.json") if ".part" not in path.name and path.name != "reference.json"]
        return {path: path.read_bytes() for path in rows}

    helpers: set[int] = set()
    while time.perf_counter() < deadline and running.poll() is None:
        helpers |= _children(running.pid)
        if len(kept()) >= cells and len(helpers) >= 2:
            break
        time.sleep(0.02)
    os.killpg(running.pid, signal.SIGINT)
    said, errors = running.communicate(timeout=60)
    assert running.returncode == 130 and not said, errors
    lines = errors.splitlines()
    assert all(line.startswith("glhybrid: ") for line in lines), errors
    assert lines[-1] == "glhybrid: error: interrupted" and sum("stopped; the same command" in x for x in lines) <= 1
    deadline = time.perf_counter() + 20  # who was only just started looks for us first
    while left := [pid for pid in helpers if Path(f"/proc/{pid}").exists()]:
        assert time.perf_counter() < deadline, f"left behind: {left}"
        time.sleep(0.05)
    assert helpers
    before = kept()
    assert len(before) >= cells and not list((tmp_path / "out").rglob("*.part*"))
    if not cells:
        return
    again = begin()
    _, errors = again.communicate(timeout=120)
    assert again.returncode == 0, errors
    after = kept()
    assert len(after) > len(before) and all(after[path] == data for path, data in before.items())


def _children(parent: int) -> set[int]:
    return {int(pid) for task in Path(f"/proc/{parent}/task").glob("*/children") for pid in task.read_text().split()}


POST = """
[camera.main]
eye = [3, 2, 4]
target = [0, 0.4, 0]
[environment]
constant = [0.5, 0.5, 0.5]
[[light]]
kind = "directional"
direction = [-0.6, -0.7, -0.4]
intensity = 3
[[object]]
shape = "plane"
size = [8, 8]
[[object]]
shape = "box"
size = [0.8, 1, 0.8]
translate = [0, 0.5, 0]
"""


def test_pictures_compared_beside_are_compared_alike(
    studied: tuple[Path, run.Study], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: "Context"
) -> None:
    """In other processes, as on a GPU: the same figures to the bit, and the same rows in the same order."""
    here = studied[1]
    monkeypatch.setattr(scene_study.SceneStudy, "_processes", 2)
    beside = _run(tmp_path / "beside", monkeypatch, context)
    names = ("flip", "flip_shadow", "flip_reflection", "rel_mse", "psnr", "ssim", "wrong_shadow_percent", "images")
    labels = [[r["label"] for r in study.rows if r["axes"] != ["pairs"]] for study in (here, beside)]
    assert labels[0] == labels[1], "pairs depend on times"
    found = {row["cell"]: row for row in beside.rows}
    shared = [(row, found[row["cell"]]) for row in here.rows if row["cell"] in found]
    assert len(shared) > 5
    for one, other in shared:
        assert {name: one[name] for name in names} == {name: other[name] for name in names}
    assert len(list((tmp_path / "beside" / "out" / "stage").glob("*.flip.png"))) == len(beside.rows)


def test_a_crew_makes_programs_and_what_is_not_timed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: "Context"
) -> None:
    """As on a GPU: cells find their programs compiled, failure cases are only found, and frames are timed alone."""
    if os.environ.get("GLHYBRID_TEST_FORMS"):
        pytest.skip("the forms of this context are not those of other processes")
    usual, gpu = run._beside, SimpleNamespace(context=SimpleNamespace(device=SimpleNamespace(software=False)), tuning=1)
    device, opened, crews = "software" if context.device.software else "auto", [], []

    @contextmanager
    def beside(renderer: gh.Renderer, __: str, output: Path, quick: bool) -> Iterator[Crew]:
        assert renderer.tuning  # measured before others use the device, or they choose other programs
        with usual(gpu, device, output, quick) as crew:  # type: ignore[arg-type]
            assert crew is not None
            crews.append(crew)
            yield crew

    def keeping(**_: object) -> gh.Renderer:
        opened.append(gh.Renderer(device=device, keep_programs=True))
        return opened[-1]

    real_measure, real_times, compiled, states = SceneStudy._measure, measure.unpaced, [], []

    def counting(self: SceneStudy, cell: Cell, *rest: object) -> object:
        programs = opened[0].context.programs
        assert programs is not None
        before = programs.compiled
        row = real_measure(self, cell, *rest)  # type: ignore[arg-type]
        compiled.append((cell.label, programs.compiled - before))
        return row

    def timing(*args: Any) -> object:
        states.append(all(_state(popen.pid) == "T" for popen in crews[0]._running))
        return real_times(*args)

    monkeypatch.setattr(run, "_beside", beside)
    monkeypatch.setattr(run, "Renderer", keeping)
    monkeypatch.setattr(run, "threads_available", lambda: 4)
    monkeypatch.setattr(run.library, "cases", lambda: ["terminator"])
    monkeypatch.setattr(run.library, "run", lambda *_, **__: pytest.fail("was made beside"))
    monkeypatch.setattr(SceneStudy, "_measure", counting)
    monkeypatch.setattr(measure, "unpaced", timing)
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path / "cache"))
    study = run.run(
        ("stage",), tmp_path / "out", quick=True, sizes=(SIZE,), samples=8, only=("ray", "map", "ray-lerp"),
        parts=("failures",), load=lambda _: stage(),
    )  # fmt: skip
    assert [row["verdict"] for row in study.failures] == ["fails as expected", "holds"]
    assert list(study.seconds)[:3] == ["stage: reference", "stage: techniques", "waiting for 2 processes beside"]
    assert len(compiled) == len(study.rows) > 2 and not sum(count for _, count in compiled), compiled
    assert len(states) == len(study.rows) and all(states), states
    assert all(popen.poll() is not None for popen in crews[0]._running), "all have ended"
    assert not list((tmp_path / "out").rglob("*.part*"))


def _state(process: int) -> str:
    """As Linux has it: T is stopped."""
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]


def test_a_process_that_compares_says_what_is_wrong(tmp_path: Path) -> None:
    truth = measure.Truth(np.ones((16, 16, 3), np.float32), None, np.ones((16, 16), np.float32))
    frame = Frame(
        np.zeros((16, 16, 3), np.uint8),
        {"radiance": np.ones((16, 16, 3), np.float32), "visibility": np.ones((16, 16, 0), np.float32)},
    )
    beside, maps = Comparing(truth, 1), measure.ErrorMaps(np.full((16, 16), 0.25, np.float32))
    try:
        assert beside.submit(frame, maps, tmp_path, "one").result(60)["flip"] == 0.25
        with pytest.raises(OutputError):
            beside.submit(frame, maps, tmp_path / "nowhere", "one").result(60)
        assert beside.submit(frame, maps, tmp_path, "two").result(60)["images"]["png"] == "two.png"
        beside._all[0]._popen.kill()
        with pytest.raises(GlhybridError, match="has ended"):
            beside.submit(frame, maps, tmp_path, "three").result(60)
    finally:
        beside.close()


def test_bad_input_is_refused_before_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: "Context") -> None:
    with pytest.raises(SettingError, match="unknown technique"):
        _run(tmp_path, monkeypatch, context, only=("magic",))
    with pytest.raises(SettingError, match="camera"):
        _run(tmp_path, monkeypatch, context, camera="nowhere")
    with pytest.raises(SettingError, match="16 pixels"):
        _run(tmp_path, monkeypatch, context, sizes=((8, 8),))
    (tmp_path / "out").mkdir(exist_ok=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        run.run(("stage",), tmp_path / "file", load=lambda _: stage())
