"""The study's further parts: curves over a parameter, what is gone, the paper again, scenes for other renderers."""

import os
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from study_stage import own_cache

import glhybrid as gh
from glhybrid.load.builtin import scene_path
from glhybrid.scene import Environment
from glhybrid.settings import Settings
from glhybrid.study import beside, curves, jobs, paper, reflected, run, stages
from glhybrid.study.measure import Clock
from glhybrid.study.peers import bundle, glb, panel
from glhybrid.study.progress import Meter

if TYPE_CHECKING:
    from glhybrid.context import Context
SIZE = (96, 72)


@pytest.fixture
def renderer(context: "Context") -> "Iterator[gh.Renderer]":
    with gh.Renderer(context=context) as opened:
        yield opened


def _errors(renderer: gh.Renderer, name: str, value: float, **settings: Any) -> float:
    curve = next(c for c in curves.CURVES if c.name == name)
    scene, camera = curve.stage(value)
    return curve.measure(renderer, scene, camera, SIZE, value)(Settings(aa=1, **settings))


@pytest.mark.parametrize(("name", "value"), [("origin", 1e6), ("scale", 1e-3), ("sun", 2.0), ("thickness", 0.003)])
def test_rays_hold_at_the_ends_of_the_curves_and_coarse_maps_do_not(
    renderer: gh.Renderer, name: str, value: float
) -> None:
    assert _errors(renderer, name, value, reflections="none") == 0
    coarse = {"shadows.map.resolution": 256, "shadows.map.slope_bias": 2.0}
    assert _errors(renderer, name, value, reflections="none", shadows="map", parameters=coarse) > 0.3


def test_the_lerp_is_right_on_a_mirror_and_wrong_on_rough_metal(renderer: gh.Renderer) -> None:
    exact = _errors(renderer, "roughness", 0.0, shadows="ray")
    rough = _errors(renderer, "roughness", 0.25, shadows="ray")
    assert exact < 0.01 < 0.05 < rough


def test_where_a_line_breaks() -> None:
    assert curves.breaks([1, 2, 3, 4], [0, 0.1, 0.6, 0.9], 0.5) == 3
    assert curves.breaks([1, 2, 3, 4], [0.9, 0.6, 0.1, 0], 0.5) == 2, "from where it is best, outwards"
    assert curves.breaks([1, 2], [0.1, None], 0.5) is None and curves.breaks([1], [None], 0.5) is None
    assert curves.breaks([1, 2], [0.7, 0.9], 0.5) == 1, "broken everywhere"


def test_what_has_gone_leaves_no_trace_without_a_memory(renderer: gh.Renderer) -> None:
    life, left = curves.ghosts(renderer, SIZE, Settings(aa=1))
    assert life == 0 and max(left) < 1e-3
    scene, camera = stages.leaving(1.0)
    before, after = (renderer.render(scene, camera, SIZE, Settings(aa=1, time=t))["radiance"] for t in (0.5, 1.5))
    assert np.abs(before - after).max() > 0.1, "the box is there, then not"


def test_what_is_not_timed_is_made_beside(
    context: "Context", renderer: gh.Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cases and curves made in other processes are found here, and are those that are made here. What cannot be made is
    said; of a process that ends, the rest is made by others."""
    if os.environ.get("GLHYBRID_TEST_FORMS"):
        pytest.skip("the forms of this context are not those of other processes")
    cases, told = ["terminator", "lattice-rays", "none such", "ao-leak"], []
    device = "software" if context.device.software else "auto"
    crew = beside.Crew(beside.Home(device, tmp_path / "beside", True), 2)
    with closing(crew):
        made_of = {name: crew.put(jobs.Failure(name)) for name in cases} | {
            "thickness": crew.put(jobs.Curve("thickness"))
        }
        crew.wait(lambda: told.append(1))
        assert all(future.done() for future in made_of.values()) and told
        assert [name for name, future in made_of.items() if future.exception()] == ["none such"]
        crew._running[0].kill()
        crew._running[0].wait()
        late = [crew.put(jobs.Failure("terminator")) for _ in range(2)]
        crew.wait(lambda: None)
        assert sum(future.exception() is None for future in late) >= 1 and all(future.done() for future in late)
    assert not list((tmp_path / "beside").rglob("none such*"))

    def made(folder: Path) -> list[dict[str, Any]]:
        names = [name for name in cases if name != "none such"]
        return run.failures(renderer, folder / "failures", Meter(None, False), pytest.fail, names)

    here = made(tmp_path / "here")
    monkeypatch.setattr(run.library, "run", lambda *_, **__: pytest.fail("was kept"))
    monkeypatch.setattr(curves, "Oracle", lambda *_: pytest.fail("was kept"))
    assert made(tmp_path / "beside") == here and len(here) >= 7
    curve = curves.make(renderer, "thickness", tmp_path / "beside" / "stability", True, Meter(None, False), pytest.fail)
    assert curve is not None and {"map", "ray"} <= {line["technique"] for line in curve["lines"]}
    assert (tmp_path / "beside" / "failures" / "terminator-0.png").is_file()


def test_processes_that_stand_still_are_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "COMMAND", "import time; time.sleep(100)")
    monkeypatch.setattr(beside, "STALL_S", 1.0)
    with closing(beside.Crew(beside.Home("software", tmp_path, True), 2)) as crew:
        one = crew.put(jobs.Failure("acne"))
        crew.wait(lambda: None, one)
        crew.wait(lambda: None)
        assert not one.done()


def test_the_ladder_shows_the_papers_bias(
    renderer: gh.Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in own_cache(tmp_path).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(paper, "ROUGHNESS", (0.25,))
    monkeypatch.setattr(paper, "QUICK_LADDER_SIZE", SIZE)
    found = paper.ladder(renderer, tmp_path, True, Clock(1, 0.0), Meter(None, False))
    by = {row["label"]: row for row in found["rows"]}
    assert 4 < by["ray-lerp"]["bias_percent"] < 16, "accuracy: +8 % on a scene like this"
    if "ray-glossy 16 spp" in by:
        assert abs(by["ray-glossy 16 spp"]["bias_percent"]) < 1.5
    monkeypatch.setattr(paper.reference, "converge", lambda *_, **__: pytest.fail("was kept"))
    assert paper.ladder(renderer, tmp_path, True, Clock(1, 0.0), Meter(None, False))["rows"] == found["rows"]


def test_table_1() -> None:
    def row(shadows: str, reflections: str, ms: float) -> dict[str, Any]:
        figures = dict.fromkeys(
            (
                "flip",
                "flip_at_rest",
                "flip_reflection",
                "flip_reflection_at_rest",
                "flip_shadow",
                "rel_mse",
                "bias_percent",
                "bias_error_percent",
            ),
            0.1,
        )
        return {
            "scene": "a", "shadows": shadows, "reflections": reflections, "axes": ["paper"], "label": "", "ms": ms,
            "parameters": {"x": 4}, **figures,
        }  # fmt: skip

    (line,) = paper.table([row("ray", "ray-lerp", 10.0), row("ray-soft", "ray-glossy", 16.0)], "ms")
    assert line["lead_percent"] == pytest.approx(60) and line["kim"]["frames_per_second"] == 100
    (alone,) = paper.table([row("ray", "ray-lerp", 10.0)], "ms")
    assert alone["many"] is None and alone["lead_percent"] is None


@pytest.mark.parametrize("name", ["showroom", "cornell"])
def test_a_scene_given_to_others_is_the_same_scene(renderer: gh.Renderer, tmp_path: Path, name: str) -> None:
    """The GLB, read back and drawn with the same lights, sky and camera, is the same picture but for spheres' edges."""
    path = scene_path(name)
    assert path is not None
    scene = gh.load(str(path))
    glb.write(scene, tmp_path / "scene.glb")
    again = gh.load(str(tmp_path / "scene.glb"))
    assert len(again.instances) == len(scene.instances)
    assert np.allclose(again.bounds(), scene.bounds(), atol=1e-4)
    again = again.replace(lights=scene.lights, environment=scene.environment)
    settings = Settings(aa=1)
    got, want = (renderer.render(s, scene.cameras[0], SIZE, settings)["radiance"] for s in (again, scene))
    assert renderer.flip.hdr(got, want).mean() < 0.04
    assert (np.abs(got - want).max(-1) < 0.02 * want.max(-1) + 1e-3).mean() > 0.85


def test_the_sky_given_to_others_is_turned_into_place() -> None:
    texels = np.random.default_rng(0).uniform(0, 1, (16, 32, 3)).astype(np.float32)
    for turn in (0.0, np.pi / 2):
        got = bundle.turned(Environment(texels, intensity=2.0, rotation=turn))
        for row, column in ((40, 100), (200, 17), (128, 400)):
            phi = (column + 0.5) / 512 * 2 * np.pi - np.pi
            direction = np.array([np.sin(phi), 0, -np.cos(phi)])
            c, s = np.cos(turn), np.sin(turn)
            x, z = c * direction[0] - s * direction[2], s * direction[0] + c * direction[2]  # scene.py: turned back
            u = (np.arctan2(x, -z) / (2 * np.pi) + 0.5) * 32 - 0.5
            v = (row + 0.5) / 256 * 16 - 0.5
            i, j = int(np.floor(u)), int(np.floor(v))
            corner = np.array([[texels[min(max(j + b, 0), 15), (i + a) % 32] for a in (0, 1)] for b in (0, 1)])
            fu, fv = u - i, v - j
            want = (corner[0, 0] * (1 - fu) + corner[0, 1] * fu) * (1 - fv) + (
                corner[1, 0] * (1 - fu) + corner[1, 1] * fu
            ) * fv
            assert np.allclose(got[row, column], 2 * want, atol=1e-5)


def test_8_bit_pictures_give_radiance_past_white() -> None:
    from glhybrid.study.peers import common

    truth = np.array([[[0.02, 0.5, 1.0]], [[3.0, 0.1, 12.0]]])

    def draw(gain: float) -> Any:
        x = np.clip(truth * gain, 0, 1)
        return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)

    assert np.allclose(common.bracketed(draw, 0.5), truth, rtol=0.12, atol=0.02)


def test_a_peer_that_is_absent_is_a_note(renderer: gh.Renderer, tmp_path: Path) -> None:
    notes: list[str] = []
    site = panel.Site(
        "x", gh.load(str(scene_path("cornell"))), None, SIZE, np.ones((72, 96, 3), np.float32), "", 0.0, tmp_path
    )  # type: ignore[arg-type]
    assert panel.ask(renderer, "no_such_renderer", site, 1, notes.append) is None
    assert notes == [
        "no_such_renderer is left out: no_such_renderer is not installed (pip install no_such_renderer, or set "
        "GLHYBRID_NO_SUCH_RENDERER_PYTHON to a Python that has it)"
    ]


def test_a_peer_may_live_in_another_python(
    renderer: gh.Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found by its variable; and what it imports of this package needs nothing but NumPy, which comes from its side."""
    panel.interpreter.cache_clear()
    monkeypatch.setenv("GLHYBRID_BPY_PYTHON", str(tmp_path / "python"))
    assert panel.missing("bpy").startswith(f"GLHYBRID_BPY_PYTHON is {tmp_path / 'python'}, which cannot be run")
    panel.interpreter.cache_clear()
    modules = tmp_path / "elsewhere"
    modules.mkdir()
    (modules / "bpy.py").write_text(FAKE_BPY)
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{modules}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    assert panel.missing("bpy") == ""
    scene, camera = stages.mirror_floor(0.25)
    site = panel.Site("floor", scene, camera, SIZE, np.ones((72, 96, 3), np.float32), "1", 0.0, tmp_path)
    notes: list[str] = []
    assert panel.ask(renderer, "bpy", site, 1, notes.append) is None
    panel.interpreter.cache_clear()
    assert notes == ["floor: bpy is left out: RuntimeError: asked for []"], (
        "bpy_process reached it, without our modules"
    )


FAKE_BPY = """
import sys
class Ops:
    def __getattr__(self, name):
        ours = [m for m in sys.modules if m.split(".")[0] in ("moderngl", "numba", "PIL")]
        raise RuntimeError(f"asked for {ours}")
ops = Ops()
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bpy", "pyrender", "filly"])
def test_peers_see_the_scene(renderer: gh.Renderer, tmp_path: Path, name: str) -> None:
    """Their pictures are of the same things in the same places; how far off they are follows from their models."""
    if reason := panel.missing(name):
        pytest.skip(reason)
    scene, camera = stages.mirror_floor(0.25)
    want = renderer.render(scene, camera, SIZE, Settings(reflections="reference", aa=1, samples=64))["radiance"]
    site = panel.Site("floor", scene, camera, SIZE, want, "1", 0.0, tmp_path)
    notes: list[str] = []
    row = panel.ask(renderer, name, site, 16, notes.append)
    assert row is not None, notes
    assert row["flip"] < {"bpy": 0.1, "filly": 0.45, "pyrender": 0.6}[name] and row["notes"]


@pytest.mark.slow
def test_mitsuba_sees_the_same_picture(renderer: gh.Renderer, tmp_path: Path) -> None:
    """Glossy metal, sky and unlit bodies mean the same in both; noise and antialiased edges remain."""
    if reason := panel.missing("mitsuba"):
        pytest.skip(reason)
    scene, camera = stages.mirror_floor(0.25)
    want = renderer.render(scene, camera, SIZE, Settings(reflections="reference", aa=4, bounces=8, samples=64))[
        "radiance"
    ]
    site = panel.Site("floor", scene, camera, SIZE, want, "1", 0.0, tmp_path)
    notes: list[str] = []
    row = panel.ask(renderer, "mitsuba", site, 64, notes.append)
    assert row is not None, notes
    assert row["flip"] < 0.1 and abs(row["bias_percent"]) < 2 and (tmp_path / row["images"]["flip"]).is_file()


def test_what_mirrors_show(renderer: gh.Renderer) -> None:
    """Rays show the right object everywhere; the sky alone only where there is one; screen space lies between."""
    scene, camera = stages.mirror_floor(0.0)
    mirrors = reflected.find(renderer, scene, camera, SIZE)
    assert mirrors is not None and 0.3 < mirrors.counted.mean() < 1
    exact = mirrors.ask(renderer, Settings(aa=1))
    assert exact.right_object_percent == exact.right_point_percent == 100
    assert exact.reflected_error_px is not None and exact.reflected_error_px < 1e-3
    assert exact.reflected_distance_error_percent == 0
    sky = mirrors.ask(renderer, Settings(aa=1, reflections="env"))
    truly = 100 * float(np.isinf(mirrors.distance[mirrors.counted]).mean())
    assert sky.right_object_percent == pytest.approx(truly) and 20 < truly < 95
    assert sky.right_point_percent == sky.right_object_percent and sky.reflected_error_px is None
    screen = mirrors.ask(renderer, Settings(aa=1, reflections="ssr"))
    assert sky.right_object_percent < screen.right_object_percent < 100
    assert screen.right_point_percent is not None and screen.reflected_error_px is not None
    assert sky.right_object_percent < screen.right_point_percent <= screen.right_object_percent
    assert screen.reflected_error_px < 0.5 < 2 * (screen.reflected_error_px_p95 or 0) + 1
    assert screen.reflected_distance_error_percent is not None and screen.reflected_distance_error_percent < 5
    rough, _ = stages.mirror_floor(0.9)
    unlit = rough.replace(instances=rough.instances[:1])
    assert reflected.find(renderer, unlit, camera, SIZE) is None


def test_codes_tell_objects_apart() -> None:
    codes = {reflected.code(n) for n in range(511)}
    assert len(codes) == 511 and (0, 0, 0) not in codes and reflected.code(511) == reflected.code(0)
