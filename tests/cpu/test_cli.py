"""The command line: what it refuses and how, what it hands to the renderer, what it prints and where."""

import io
import json
import signal
import subprocess
import sys
import time
import types
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import glhybrid
from glhybrid import cli, console
from glhybrid.errors import DeviceError, LoadError
from glhybrid.image import AOVS, Frame
from glhybrid.scene import Scene
from glhybrid.settings import Settings
from glhybrid.techniques import TECHNIQUES, parameters


class _Recorder:
    """Stands in for the loader and the renderer, and keeps what they were called with."""

    def __init__(self) -> None:
        self.loads: list[tuple[str, dict[str, Any]]] = []
        self.devices: list[str] = []
        self.renders: list[dict[str, Any]] = []
        self.closed = 0
        self.raises: BaseException | None = None
        self.scene = Scene("fake")

    def load(self, path: str, **options: Any) -> Scene:
        self.loads.append((path, options))
        return self.scene

    def renderer(self, device: str) -> "_Recorder":
        self.devices.append(device)
        return self

    def __enter__(self) -> "_Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.closed += 1

    def render(self, scene: Scene, **options: Any) -> Frame:
        assert scene is self.scene
        if self.raises is not None:
            raise self.raises
        self.renders.append(options)
        options["progress"]("frames", 1, 4)
        width, height = options["size"]
        names = ("radiance", *options["aovs"])
        arrays = {n: np.zeros(AOVS[n].shape(height, width, 1), AOVS[n].dtype) for n in names}
        receipt = {
            "scene": {"triangles": 1234567},
            "device": {"renderer": "llvmpipe", "software": True},
            "frame_ms": 12.34,
            "settings": options["settings"].to_dict(),
            "numbers": {"numpy": np.float32(0.5), "path": Path("x")},
        }
        return Frame(np.zeros((height, width, 3), np.uint8), arrays, receipt)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> _Recorder:
    recorder = _Recorder()
    module = types.ModuleType("glhybrid.renderer")
    module.Renderer = recorder.renderer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "glhybrid.renderer", module)
    monkeypatch.setattr(glhybrid, "load", recorder.load, raising=False)
    monkeypatch.chdir(tmp_path)
    return recorder


def _run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = cli.main(arguments)
    out, err = capsys.readouterr()
    return code, out, err


def test_render_with_defaults(fake: _Recorder, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, _ = _run(capsys, "render", "some/place/hall.glb")
    assert code == 0
    assert fake.loads == [("some/place/hall.glb", {"strict": False, "allow_outside": False, "smooth": False})]
    assert fake.devices == ["auto"] and fake.closed == 1
    (call,) = fake.renders
    assert call["size"] == (1280, 720) and call["camera"] is None and call["aovs"] == ()
    assert call["settings"] == Settings(aa=4)
    assert (tmp_path / "hall.png").is_file()
    assert out == "hall.png: 1280x720, 1,234,567 triangles, 12.3 ms a frame on llvmpipe (software)\n"


def test_every_flag_arrives(fake: _Recorder, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "look.toml").write_text('tone = "aces"\nsamples = 2\nseed = 1\nbounces = 1\n')
    code, out, err = _run(
        capsys, "render", "hall.glb", "-o", "a.exr", "--device", "egl:1", "--size", "64x36", "--camera", "2",
        "--shadows", "none", "--reflections", "env", "--samples", "3", "--bounces", "0", "--set", "seed=9",
        "--set", "exposure=-1", "--config", "look.toml", "--aov", "depth,normal", "--exr-float", "--strict", "--smooth",
        "--allow-outside", "--quiet",
    )  # fmt: skip
    assert (code, out, err) == (0, "", "")
    assert fake.loads[0][1] == {"strict": True, "allow_outside": True, "smooth": True} and fake.devices == ["egl:1"]
    (call,) = fake.renders
    want = Settings(
        shadows="none", reflections="env", samples=3, bounces=0, seed=9, exposure=-1.0, tone="aces", aa=1
    )  # fmt: skip
    assert call["settings"] == want  # --set over flags over --config; data is not antialiased
    assert (call["size"], call["camera"]) == ((64, 36), 2)
    assert set(call["aovs"]) == {"radiance", "depth", "normal"}
    OpenEXR = pytest.importorskip("OpenEXR")
    with OpenEXR.File("a.exr", separate_channels=True) as file:
        channels = {name: channel.pixels.dtype for name, channel in file.channels().items()}
    assert channels == dict.fromkeys(
        ["R", "G", "B", "depth.Z", "normal.X", "normal.Y", "normal.Z"], np.dtype(np.float32)
    )  # fmt: skip


def test_json_prints_the_receipt_and_nothing_else(fake: _Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = _run(capsys, "render", "hall.glb", "-o", "a.png", "--size", "8x8", "--json", "--camera", "main")
    receipt = json.loads(out)
    assert code == 0 and receipt["output"] == "a.png" and receipt["settings"]["aa"] == 4
    assert receipt["numbers"] == {"numpy": 0.5, "path": "x"}
    assert fake.renders[0]["camera"] == "main"


def test_a_picture_on_standard_output(fake: _Recorder, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    assert cli.main(["render", "hall.glb", "-o", "-", "--size", "8x8"]) == 0
    out, err = capfdbinary.readouterr()
    assert out.startswith(b"\x89PNG") and b"8x8" in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["rendr", "x"], 'did you mean "render"'),
        (["foo"], "render, scenes, settings, study, view; see glhybrid --help"),
        (["render"], "SCENE"),
        (["render", "x", "--sise", "3x3"], "--size"),
        (["render", "x", "--size", "3"], "1280x720"),
        (["render", "x", "--size", "0x9"], "from 1 to"),
        (["render", "x", "--size", "99999x9"], "from 1 to"),
        (["render", "x", "--samples", "many"], "many"),
        (["render", "x", "--samples", "0"], "samples = 0"),
        (["render", "x", "--shadows", "rai"], 'did you mean "ray"'),
        (["render", "x", "--set", "sampels=3"], 'did you mean "samples"'),
        (["render", "x", "--set", "seed"], "key=value"),
        (["render", "x", "--config", "absent.toml"], "absent.toml"),
        (["render", "x", "--aov", "dpeth", "-o", "a.exr"], 'did you mean "depth"'),
        (["render", "x", "--aov", "depth"], "PNG holds no AOVs"),
        (["render", "x", "-o", "a.jpg"], ".png, .exr, .npz"),
        (["render", "x", "-o", "no/where/a.png"], "mkdir -p no/where"),
        (["render", "x", "-o", "-", "--json"], "standard output"),
        (["render", "x", "y"], 'do with "y"'),
        (["render", "x", "-o", ""], "no suffix"),
        (["render", "x", "-o", "a" * 300 + ".png"], "at most 230 bytes"),
        (["render", "x", "--frames", "0:2", "-o", "{frame}" + "a" * 300 + ".png"], "at most 230 bytes"),
        (["bench", "--scale", "--svg", "no/where/a.svg"], "mkdir -p no/where"),
        (["study", "x", "-o", "out", "--samples", "0"], "samples = 0"),
        (["study", "x", "-o", "out", "--bounces", "-3"], "bounces = -3"),
    ],
)
def test_usage_errors_are_one_line_and_nothing_runs(
    fake: _Recorder, capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: Sequence[str], says: str
) -> None:
    code, out, err = _run(capsys, *arguments)
    assert code == 2 and out == ""
    assert err.startswith("glhybrid: error: ") and err.count("\n") == 1 and says in err
    assert not fake.loads and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (LoadError("x.glb: broken\nhere"), 2),
        (DeviceError("no OpenGL"), 3),
        (KeyboardInterrupt(), 130),
        (OSError(28, "No space left on device", "x.png"), 2),
        (MemoryError(), 2),
    ],
)
def test_failures_are_one_line_with_their_own_code_and_close_the_renderer(
    fake: _Recorder, capsys: pytest.CaptureFixture[str], tmp_path: Path, error: BaseException, code: int
) -> None:
    fake.raises = error
    got, out, err = _run(capsys, "render", "x.glb", "--quiet")
    assert (got, out) == (code, "") and err.startswith("glhybrid: error: ") and err.count("\n") == 1
    assert fake.closed == 1 and not list(tmp_path.iterdir())


def test_our_own_mistakes_are_not_hidden(fake: _Recorder) -> None:
    fake.raises = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        cli.main(["render", "x.glb"])


def test_ctrl_c_while_python_imports() -> None:
    code = (
        "import sys\nclass Interrupt:\n def find_spec(self, name, *_):\n  if name == 'cyclopts': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupt())\nfrom glhybrid.__main__ import main\nsys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed(closed: str) -> None:
    # As under some schedulers: results and messages lead nowhere, and nothing breaks that wants to write them.
    for arguments, code in (("scenes", 0), ("settings pcf", 0), ("render nothing.glb", 2), ("cache --json", 0)):
        line = f'"{sys.executable}" -m glhybrid {arguments} {closed}'
        done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == code and "Traceback" not in done.stderr, (line, done.stderr)
        assert done.stdout == "" or closed == "2>&-"


def test_ctrl_c_waits_while_kernels_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    # LLVM calls back into Python, and an interrupt raised in there is printed and lost: the run would go on.
    import numba

    from glhybrid import jit

    reached = []

    def njit(*_: Any, **__: Any) -> Any:
        def compile_it(function: Any) -> Any:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                reached.append("lost")
            reached.append("compiled")
            return function

        return compile_it

    monkeypatch.setattr(numba, "njit", njit)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # shells have jobs in the background ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            jit.kernel("void()")(lambda: None)
    finally:
        signal.signal(signal.SIGINT, before)
    assert reached == ["compiled"]


def test_a_scene_of_a_name_that_no_disk_holds(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("x" * 300, "x" * 5000, "y" * 300 + ".glb"):
        code, _, err = _run(capsys, "render", name)
        assert code == 2 and err.startswith("glhybrid: error: ") and err.count("\n") == 1, name


def test_load_warnings_are_told_and_counted(fake: _Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    fake.scene = replace(fake.scene, warnings=tuple(f"mesh {i} lost its lines" for i in range(7)))
    _, _, err = _run(capsys, "render", "x.glb", "--size", "4x4")
    assert "warning: mesh 0 lost its lines" in err and "mesh 5" not in err and "and 2 more" in err
    _, _, err = _run(capsys, "render", "x.glb", "--size", "4x4", "--quiet")
    assert err == ""


def test_scenes_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = _run(capsys, "scenes", "--json")
    assert code == 0
    listed = json.loads(out)
    code, out, _ = _run(capsys, "scenes")
    assert code == 0 and [line.split()[0] for line in out.splitlines()] == [s["name"] for s in listed]
    code, out, _ = _run(capsys, "--version")
    assert code == 0 and out.strip() == glhybrid.__version__


def test_every_setting_is_listed_as_set_takes_it(capsys: pytest.CaptureFixture[str]) -> None:
    """The first word of each line is a key and a value for --set: a default, or a technique's name."""
    code, out, _ = _run(capsys, "settings")
    words = [line.split()[0] for line in out.splitlines()]
    assert code == 0 and {word.partition("=")[0] for word in words} == set(Settings().to_dict()) | set(parameters())
    chosen = [f"{kind}={name}" for kind, table in TECHNIQUES.items() for name in table]
    assert [word for word in words if word.partition("=")[0] in TECHNIQUES] == chosen
    for word in words:
        made, (key, _, text) = Settings().with_overrides([word]), word.partition("=")
        if key in TECHNIQUES:
            assert getattr(made, key) == text
        else:
            given = {key: parameters()[key].default} if key in parameters() else {}
            assert made == Settings(parameters=given)
    code, out, _ = _run(capsys, "settings", "shadows.pcf", "--json")
    assert code == 0 and {row["key"] for row in json.loads(out)} == {k for k in parameters() if "shadows.pcf." in k}
    code, _, err = _run(capsys, "settings", "pfc")
    assert code == 2 and '"pfc"' in err and err.count("\n") == 1


def test_the_failure_library_is_listed_and_loads_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = _run(capsys, "scenes", "--failures", "--json")
    listed = json.loads(out)
    assert code == 0 and len(listed) > 10
    for row in listed:
        assert row["name"].startswith("failures/") and row["description"]
        scene = glhybrid.load(row["name"], strict=True)
        assert scene.study is not None and scene.study.title == row["description"]
    code, _, err = _run(capsys, "plan", "failures/acme")
    assert code == 2 and 'unknown built-in scene "failures/acme"; did you mean "failures/acne"?' in err
    code, _, err = _run(capsys, "plan", "failures/../atrium")
    assert code == 2


def test_progress_waits_a_second_then_draws_by_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    def drawn(shown: bool, terminal: bool = True, wait_for: tuple[str, str] | None = None) -> str:
        stderr = Terminal() if terminal else io.StringIO()
        monkeypatch.setattr(sys, "stderr", stderr)

        def wait(text: str) -> None:  # as long as it takes: rich is imported first
            end = time.monotonic() + 30
            while text not in stderr.getvalue() and time.monotonic() < end:
                time.sleep(0.02)

        with console.progress(shown) as show:
            show("loading", 0, 0)
            wait(wait_for[0]) if wait_for else time.sleep(0.1)  # nothing calls back meanwhile
            show("frames", 2, 4)
            wait(wait_for[1]) if wait_for else time.sleep(0.1)
        return stderr.getvalue()

    assert drawn(True) == ""  # sooner than the patience of a second
    monkeypatch.setattr(console, "PATIENCE_S", 0.01)
    text = drawn(True, wait_for=("loading", "50%"))
    assert "loading" in text and "frames" in text and "50%" in text
    assert drawn(False) == "" and drawn(True, terminal=False) == ""


def test_help_imports_nothing_heavy_and_import_is_light() -> None:
    code = (
        "import sys; import glhybrid; before = set(sys.modules)\n"
        "from glhybrid import cli\ncode = cli.main(['render', '--help'])\n"
        "heavy = {'numpy', 'moderngl', 'numba', 'trimesh', 'PIL', 'OpenEXR', 'xatlas'}\n"
        "assert not heavy & before, heavy & before\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\nsys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for flag in (
        "--device", "--size", "--camera", "--shadows", "--reflections", "--samples", "--bounces", "--set", "--config",
        "--json", "--quiet", "--aa", "--exr-float", "--aov", "--strict", "--allow-outside", "--output", "-o",
    ):  # fmt: skip
        assert flag in done.stdout, flag
    assert "--no-" not in done.stdout


def test_load_is_a_function_and_a_package() -> None:
    code = (
        "import glhybrid.load.builtin\nimport glhybrid\n"
        "assert callable(glhybrid.load)\nfrom glhybrid import load\nassert callable(load)\n"
        "assert glhybrid.load.builtin.scenes\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_python_m(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "glhybrid", "render", "x", "-o", "a.bmp"], capture_output=True, text=True, cwd=tmp_path,
        check=False,
    )  # fmt: skip
    assert done.returncode == 2 and "Traceback" not in done.stderr and "a.bmp" in done.stderr
