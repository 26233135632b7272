"""Everything that can be wrong with an animation: one clear error, or the documented rule; never a broken pose."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_builder import Builder, load, piece

from glhybrid import cli
from glhybrid.deform import at_time
from glhybrid.errors import LoadError, SettingError
from glhybrid.load import load as load_file
from glhybrid.pose import clip_span, evaluate, find_clip, notes


def figure() -> Builder:
    """A quad on two joints, and a clip that lifts the second one by 1 m in 1 s."""
    b = Builder()
    quad = b.quad()
    quad["attributes"]["JOINTS_0"] = b.accessor(np.uint8([[0, 0, 0, 0]] * 2 + [[1, 0, 0, 0]] * 2))
    quad["attributes"]["WEIGHTS_0"] = b.accessor(np.float32([[1, 0, 0, 0]] * 4))
    b.scene(quad, skin=0)
    b.json["scenes"][0]["nodes"] += [b.add("nodes", name="hip"), b.add("nodes", name="head")]
    b.add("skins", joints=[1, 2])
    add_clip(b, "lift", 2, "translation", [0, 1], [[0, 0, 0], [0, 1, 0]])
    return b


def add_clip(b: Builder, name: str, node: Any, path: str, times: Any, values: Any, **more: Any) -> None:
    sampler = {"input": b.accessor(np.float32(times)), "output": b.accessor(np.float32(values)), **more}
    target = {"path": path} if node is None else {"path": path, "node": node}
    b.add("animations", name=name, samplers=[sampler], channels=[{"sampler": 0, "target": target}])


def top(b: Builder, folder: Path, time: float, clip: str | None = None) -> float:
    return float(piece(at_time(load(b, folder), time, clip)).position[:, 1].max())


def test_the_figure_itself(tmp_path: Path) -> None:
    assert [top(figure(), tmp_path, t) for t in (0, 0.5, 1)] == [1, 1.5, 2]
    assert load(figure(), tmp_path, strict=True).animations[0].name == "lift"


def weights(rows: Any) -> Callable[[Builder], None]:
    def change(b: Builder) -> None:
        b.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = b.accessor(np.float32(rows))

    return change


def joint(number: int) -> Callable[[Builder], None]:
    return lambda b: b.json["skins"][0].update(joints=[1, number])


def clip(*given: Any, **more: Any) -> Callable[[Builder], None]:
    def change(b: Builder) -> None:
        b.json["animations"] = []
        add_clip(b, "bad", *given, **more)

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (joint(9), "skin 0: .*node 9"),
        (clip(8, "translation", [0, 1], [[0] * 3] * 2), "channel 0, target: .*node 8"),
        (clip(2, "translation", [0, 1], [[0] * 3] * 3), "has 9 numbers for 2 LINEAR keys of translation, must have 6"),
        (clip(2, "translation", [1, 0], [[0] * 3] * 2), "must not go back"),
        (clip(2, "translation", [0, np.nan], [[0] * 3] * 2), "times must be finite"),
        (clip(2, "translation", [0, 1], [[0, np.inf, 0]] * 2), "values must be finite"),
        (clip(2, "rotation", [0, 1], [[0] * 3] * 2), "must be VEC4"),
        (clip(2, "translation", [0, 1], [[0] * 3] * 2, interpolation="BEZIER"), "must be one of STEP, LINEAR"),
        (clip(2, "translation", [0, 1], [[0] * 3] * 2, interpolation="CUBICSPLINE"), "must have 18"),
        (lambda b: b.json["skins"][0].update(joints=[]), "skin 0: .*no joints|joints"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, change: Callable[[Builder], None], says: str) -> None:
    b = figure()
    change(b)
    with pytest.raises(LoadError, match=says):
        load(b, tmp_path)


@pytest.mark.parametrize(
    ("change", "warns", "height"),
    [
        # Weights are scaled to add up to 1: half of each joint stays half. A vertex without any keeps its place.
        (weights([[2, 0, 0, 0]] * 2 + [[3, 3, 0, 0]] * 2), "scaled", 1.5),
        (weights([[0, 0, 0, 0]] * 4), "", 1.0),
        (weights([[1, 0, 0, 0]] * 2 + [[np.nan, 1, 0, 0]] * 2), "", 1.0),
        # Channels of no node or of something that cannot be played are left out; the rest of the clip plays.
        (clip(None, "translation", [0, 1], [[0] * 3] * 2), "moves no node", 1.0),
        (clip(2, "pointer", [0, 1], [[0] * 3] * 2), "moves pointer", 1.0),
        (clip(2, "weights", [0, 1], [0, 1]), "no morph targets", 1.0),
        # A clip of no length has one pose at any time; so has one with all keys at one time, its last.
        (clip(2, "translation", [0.3], [[0, 2, 0]]), "", 3.0),
        (clip(2, "translation", [0.3, 0.3], [[0, 2, 0], [0, 4, 0]]), "", 5.0),
        # A rotation without length turns nothing.
        (clip(2, "rotation", [0, 1], [[0] * 4] * 2), "", 1.0),
    ],
)
def test_files_that_are_mended(tmp_path: Path, change: Any, warns: str, height: float) -> None:
    b = figure()
    change(b)
    scene = load(b, tmp_path)
    assert any(warns in w for w in scene.warnings) or not warns
    still = piece(at_time(scene, 1.0))
    assert np.isfinite(still.position).all() and np.isfinite(still.normal).all()
    assert float(still.position[:, 1].max()) == pytest.approx(height, abs=1e-6)
    if warns:
        with pytest.raises(LoadError, match="strict"):
            load_file(b.write(tmp_path), strict=True)


def test_times_outside_are_held_and_said(tmp_path: Path) -> None:
    assert (top(figure(), tmp_path, -5), top(figure(), tmp_path, 99)) == (1, 2)
    scene = load(figure(), tmp_path)
    assert notes(scene, 99, None) == ['time 99 s is outside clip "lift" (0 to 1 s): its nearest keys hold']


def test_several_clips(tmp_path: Path) -> None:
    """One by name or number, of equal names the first; or all at once, the last one winning where two move one thing."""
    b = figure()
    add_clip(b, "lift", 2, "translation", [0, 2], [[0, 0, 0], [0, 4, 0]])
    add_clip(b, "slide", 0, "translation", [0, 1], [[0, 0, 0], [5, 0, 0]])
    add_clip(b, "", 1, "translation", [0, 1], [[0, 0, 0], [0, 0, 3]])
    scene = load(b, tmp_path)
    assert [find_clip(scene, n) for n in (None, "lift", "0", "1", "slide", "3")] == [
        scene.animations[i] for i in (0, 0, 0, 1, 2, 3)
    ]
    assert [top(b, tmp_path, 1, n) for n in ("0", "1", "all")] == [2, 3, 3]
    together = find_clip(scene, "all")
    assert together is not None and clip_span(together) == (0, 2)
    assert evaluate(scene, 1, together).world[1, 2, 3] == 3
    assert "all clips" in notes(scene, 3, "all")[0]
    with pytest.raises(SettingError, match='unknown clip "slid"; did you mean "slide"'):
        find_clip(scene, "slid")
    with pytest.raises(SettingError, match="known: none"):
        find_clip(scene.replace(animations=()), "7")


@pytest.mark.parametrize("arguments", [("--clip", "wlak"), ("--frames", "0:2", "--clip", "7"), ("--time", "nan")])
def test_on_the_command_line(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    figure().write(tmp_path)
    assert cli.main(["render", "test.glb", "--size", "16x16", *arguments]) == 2
    out, err = capsys.readouterr()
    assert not out and "Traceback" not in err and not list(tmp_path.glob("*.png"))
