"""The study without a device: which cells, fronts, figures of pictures, what is kept, charts."""

import itertools
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glhybrid import cli, techniques
from glhybrid.errors import OutputError, SettingError
from glhybrid.scene import Light, Material, Scene
from glhybrid.settings import Settings
from glhybrid.study import direct, pareto, picture, robust, run, stability, store, sweep
from glhybrid.study.progress import Meter, spoken
from glhybrid.study.report import axis, charts
from glhybrid.study.sweep import Cell
from glhybrid.techniques import Parameter, Technique

# Cells ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quick", [True, False])
@pytest.mark.parametrize("kind", list(techniques.TECHNIQUES))
def test_an_axis_has_every_technique_and_only_valid_settings(kind: str, quick: bool) -> None:
    cells = sweep.axis(kind, quick=quick)
    names = {cell.techniques[kind] for cell in cells}
    assert names == set(techniques.TECHNIQUES[kind]) - {"reference"}
    assert len({cell.key for cell in cells}) == len(cells) == len({cell.stem for cell in cells})
    for cell in cells:
        settings = cell.settings(Settings())  # raises where a value is out of range
        assert settings.aa == 1 and getattr(settings, kind) == cell.techniques[kind]
        others = {k: v for k, v in cell.techniques.items() if k != kind}
        assert all(v == getattr(Settings(), k) for k, v in others.items()), "one thing at a time"
    plain = [cell for cell in cells if not cell.parameters]
    assert {cell.techniques[kind] for cell in plain} == names, "each at its defaults"


def test_a_technique_that_is_registered_is_swept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is listed by hand: a new technique, its counts, its declared values and its samples all become cells."""
    new = Technique(
        "reflections", "new", "", stochastic=True, traced=True,
        parameters=(
            Parameter("samples", 4, "rays", 1, 1024), Parameter("steps", 64, "a count", 1, 100), Parameter("width", 0.5, "not a count"),
            Parameter("thick", 0.1, "declared", sweep=(0.1, 0.4)), Parameter("on", True, "a switch"),
            Parameter("still", 8, "a count that is no cost", sweep=()),
        ),
    )  # fmt: skip
    monkeypatch.setitem(techniques.REFLECTIONS, "new", new)
    cells = [c for c in sweep.axis("reflections", quick=False) if c.techniques["reflections"] == "new"]
    values = {k: v for c in cells for k, v in c.parameters.items()}
    assert values.keys() == {"reflections.new.steps", "reflections.new.thick", "reflections.new.samples"}
    swept = [c.parameters["reflections.new.steps"] for c in cells if "reflections.new.steps" in c.parameters]
    assert swept == [16, 100]  # a quarter of 64, and four times as far as it goes
    counts = [c.parameters["reflections.new.samples"] for c in cells if "reflections.new.samples" in c.parameters]
    assert sorted([*counts, 4]) == list(sweep.SAMPLE_COUNTS)
    assert cells[0].traced and cells[0].stochastic and cells[0].name("reflections") == "new"
    assert {"new 1 spp", "new 64 spp"} <= {c.name("reflections") for c in cells}
    steps = next(c for c in cells if c.parameters.get("reflections.new.steps") == 16)
    assert steps.name("reflections") == "new steps 16" and steps.name("shadows") == "ray"


def test_only_some_techniques() -> None:
    assert sweep.check_names([" csm", "", "ray", "csm"]) == ("csm", "ray")
    with pytest.raises(SettingError, match='unknown technique for a study "cms"; did you mean "csm"'):
        sweep.check_names(["cms"])
    with pytest.raises(SettingError, match="reference"):
        sweep.check_names(["reference"])
    assert {c.techniques["shadows"] for c in sweep.axis("shadows", quick=True, only=("csm",))} == {"csm"}


def test_pairs_are_of_both_fronts_and_new() -> None:
    base = sweep.defaults()
    shadows = [Cell(base | {"shadows": n}) for n in ("none", "csm", "ray")]
    shadows.append(Cell(base | {"shadows": "pcf"}, {"shadows.pcf.taps": 4}))
    reflections = [Cell(base | {"reflections": n}) for n in ("env", "ray-lerp")]
    found = sweep.pairs({"shadows": shadows, "reflections": reflections})
    labels = {cell.label for cell in found}
    assert labels == {"none + env", "csm + env", "pcf taps 4 + env"}, "with ray-lerp or ray they are on the axes"
    assert len(sweep.pairs({"shadows": shadows, "reflections": reflections}, limit=2)) == 2


def test_axes_that_change_nothing_are_skipped() -> None:
    assert set(sweep.skipped_axes(Scene("empty"))) == {"shadows", "reflections", "ao"}
    lit = Scene("lit", lights=(Light("directional"),), materials=(Material(roughness=1.0),))
    assert set(sweep.skipped_axes(lit)) == {"reflections", "ao"}


# Fronts ---------------------------------------------------------------------------------------------------------------


def test_the_front_is_what_nothing_beats() -> None:
    time, error = [1, 2, 3, 4, 5, 2, float("nan")], [9, 5, 6, 2, 2, 5, 0]
    assert pareto.front(time, error) == [0, 1, 3], "equal points count once; not-a-number never"
    assert pareto.front([10, 10.1], [2, 1]) == [1], "one per cent is the clock's noise: the better one wins"
    assert pareto.front([10, 11], [2, 1]) == [0, 1]
    assert pareto.front([], []) == []
    assert pareto.front([1, 2, 3, 4], [0.2, 0.199, 0.1985, 0.1978]) == [0, 3], "what nobody can see is not paid for"


def test_the_front_against_brute_force() -> None:
    rng = np.random.default_rng(3)
    time, error = rng.integers(1, 30, 200).astype(float), rng.integers(0, 30, 200).astype(float)
    got = set(pareto.front(time, error, same_time=0.0, same_error=0.0))
    for i in range(200):
        beaten = ((time <= time[i]) & (error <= error[i]) & ((time < time[i]) | (error < error[i]))).any()
        twin = ((time == time[i]) & (error == error[i]) & (np.arange(200) < i)).any()
        assert (i in got) == (not beaten and not twin)


def test_the_cheapest_under_a_bar() -> None:
    assert pareto.cheapest_under([5, 3, 1], [0.01, 0.04, 0.2], 0.05) == 1
    assert pareto.cheapest_under([5, 3, 1], [0.01, 0.04, 0.2], 0.001) is None


# Pictures -------------------------------------------------------------------------------------------------------------


def test_figures_of_known_differences() -> None:
    rng = np.random.default_rng(0)
    want = rng.uniform(0.2, 1.0, (48, 64, 3)).astype(np.float32)
    flip = rng.uniform(0, 1, (48, 64)).astype(np.float32)
    same = picture.compare(want, want, flip)
    assert same.rel_mse == same.bias_percent == 0 and same.psnr == np.inf and same.ssim == pytest.approx(1)
    assert same.flip == pytest.approx(float(flip.mean()), rel=1e-6)
    brighter = picture.compare(want * 1.1, want, flip)
    assert brighter.bias_percent == pytest.approx(10, abs=1e-3)
    # relMSE of a constant factor: 0.01 w^2 / (w^2 + floor)
    mean = float((want @ picture.LUMINANCE).mean())
    expected = float((0.01 * want.astype(float) ** 2 / (want.astype(float) ** 2 + 0.01 * mean**2)).mean())
    assert brighter.rel_mse == pytest.approx(expected, rel=1e-4)
    noisy = picture.compare(np.abs(want + rng.normal(0, 0.3, want.shape).astype(np.float32)), want, flip)
    assert noisy.ssim < 0.8 and noisy.psnr < 25


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e5])
def test_the_unit_of_light_does_not_matter(unit: float) -> None:
    rng = np.random.default_rng(1)
    want = rng.uniform(0, 1, (32, 32, 3)).astype(np.float32)
    got = (want * rng.uniform(0.8, 1.2, want.shape)).astype(np.float32)
    flip, factor = np.zeros((32, 32), np.float32), np.float32(unit)
    base, scaled = picture.compare(got, want, flip), picture.compare(got * factor, want * factor, flip)
    for name, value in base.to_dict().items():
        assert scaled.to_dict()[name] == pytest.approx(value, rel=2e-3), name


def test_a_mean_that_a_few_paths_do_not_decide() -> None:
    """Where parts agree it is their mean to the bit; one speck among sixteen is left out; an even chance is not."""
    rng = np.random.default_rng(2)
    calm = rng.uniform(0.9, 1.1, (16, 70, 5, 3)).astype(np.float32)
    assert np.allclose(robust.mean_of_means(calm), calm.mean(0), rtol=1e-5)
    struck = calm.copy()
    struck[3, 10, 2] = 1e4
    got = robust.mean_of_means(struck)
    assert np.abs(got - 1).max() < 0.1 and struck.mean(0).max() > 600
    lamp = np.linspace(0, 2, 16, dtype=np.float32)[:, None, None, None] * np.ones((16, 4, 4, 3), np.float32)
    assert np.allclose(robust.mean_of_means(lamp), 1), "both ends are left out alike"
    assert (robust.mean_of_means(np.zeros((16, 2, 2, 3), np.float32)) == 0).all()


def test_light_that_is_noisy_everywhere_is_not_lost() -> None:
    """Every pixel's parts differ by a factor, as light does that few paths bring: the picture is no darker for it."""
    rng = np.random.default_rng(5)
    truth = np.repeat(np.linspace(0.5, 2, 60, dtype=np.float32)[None, :, None], 40, 0) * np.ones(3, np.float32)
    noise = rng.lognormal(-0.5, 1.0, (16, 40, 60, 1)).astype(np.float32)  # its mean is 1, its median 0.61
    got = robust.mean_of_means(truth * noise)
    assert got.mean() == pytest.approx(truth.mean(), rel=0.02)
    struck = truth * noise
    struck[7, 20, 30] = 5e4
    assert robust.mean_of_means(struck).max() < 10


def test_what_is_left_out_falls_with_the_paths() -> None:
    """Light that one path in 200 finds: parts of 20 paths lose most of it, parts of 20,000 none."""
    rng = np.random.default_rng(4)
    means = [
        robust.mean_of_means(np.repeat(rng.binomial(paths, 0.005, (16, 30, 30, 1)) / (0.005 * paths), 3, -1)).mean()
        for paths in (20, 200, 2000, 20000)
    ]
    assert means[0] < 0.3 and means[-1] == pytest.approx(1, abs=0.01)
    assert np.all(np.diff(means) > -0.01), means


def test_magma_ends() -> None:
    colours = picture.magma(np.array([[0.0, 1.0, np.nan]]))
    assert colours[0, 0].tolist() == [0, 0, 4] and colours[0, 1].tolist() == colours[0, 2].tolist() == [252, 253, 191]


# Lights with a size ---------------------------------------------------------------------------------------------------


def test_points_of_a_lamp_look_like_an_even_disc_from_anywhere() -> None:
    """The share of points within a radius of the middle, seen along any direction, is that of an even disc: r^2."""
    lamp = Light("point", position=(1.0, 2.0, 3.0), radius=0.5)
    at = np.array([p.position for p in direct.spread_over(lamp, 4000)]) - lamp.position
    rng = np.random.default_rng(0)
    for _ in range(5):
        axis_ = rng.normal(size=3)
        axis_ /= np.linalg.norm(axis_)
        away = np.linalg.norm(at - (at @ axis_)[:, None] * axis_, axis=1) / 0.5
        for r in (0.3, 0.6, 0.9):
            assert (away < r).mean() == pytest.approx(r * r, abs=0.015)


def test_points_of_a_sun() -> None:
    sun = Light("directional", direction=(0.0, -1.0, 0.0), angular_diameter=np.radians(2))
    spread = direct.spread_over(sun, 500)
    angle = np.arccos([-np.array(s.direction)[1] for s in spread])
    assert angle.max() <= np.radians(1) and (angle < np.radians(0.5)).mean() == pytest.approx(0.25, abs=0.01)
    assert all(s.angular_diameter == 0 for s in spread)
    assert len(direct.spread_over(Light("spot"), 64)) == 1, "a hard light is one"


# Kept cells -----------------------------------------------------------------------------------------------------------


def test_a_cell_is_kept_under_its_key_with_its_images(tmp_path: Path) -> None:
    path = tmp_path / "cell.json"
    row = {"flip": np.float32(0.5), "psnr": float("inf"), "images": {"png": "cell.png"}, "key": "a"}
    store.write_json(path, row)
    assert store.read(path, "a") is None, "its image is not there"
    (tmp_path / "cell.png").write_bytes(b"x")
    assert store.read(path, "a") == {"flip": 0.5, "psnr": None, "images": {"png": "cell.png"}, "key": "a"}
    assert store.read(path, "b") is None
    path.write_text(path.read_text()[:-9])
    assert store.read(path, "a") is None, "cut short"
    assert store.fingerprint(1, {"a": 2}) != store.fingerprint(1, {"a": 3})


def test_csv(tmp_path: Path) -> None:
    store.write_csv(tmp_path / "r.csv", [{"a": 1, "b": {"x": 2.5}}, {"a": None, "c": [1]}])
    assert (tmp_path / "r.csv").read_text().splitlines() == ["a,b,c", '1,"{""x"": 2.5}",', ",,[1]"]


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written to"):
        store.prepare(tmp_path / "file" / "out")


# Progress and stability -----------------------------------------------------------------------------------------------


def test_the_meter_counts_and_tells_what_is_left() -> None:
    seen: list[tuple[str, int, int]] = []
    meter = Meter(lambda *a: seen.append(a), lines=False)
    meter.expect(10)
    assert meter.left_s() is None
    meter.begin("kept")
    meter.end(4, free=True)
    assert meter.left_s() is None, "what was kept says nothing about time"
    meter.begin("made")
    meter.end(2)
    left = meter.left_s()
    assert left is not None and left >= 0 and seen[-1] == ("made", 600, 1000)
    assert [spoken(s) for s in (0.2, 65, 130, 7300)] == ["1 s", "65 s", "2 min", "2 h 2 min"]


def test_half_life() -> None:
    assert stability.half_life([0.0, 0.0]) == 0
    assert stability.half_life([0.9**k for k in range(40)]) == 29  # ln .05 / ln .9 = 28.4
    assert stability.half_life([1.0] * 8) is None


# Charts ---------------------------------------------------------------------------------------------------------------


def test_axes_show_all_values() -> None:
    log = axis.fit([0.01, 3, 0], 400, 20)
    assert log.zero is not None and log.at(0) == log.zero > log.at(0.01) > log.at(3) > 20
    assert all(log.low <= t <= log.high for t in log.ticks()) and len(log.ticks()) >= 3
    assert axis.fit([5, 5.1], 0, 100).high / axis.fit([5, 5.1], 0, 100).low >= 4
    linear = axis.fit([0, 90], 0, 100, log=False)
    assert linear.ticks()[0] == 0 and linear.ticks()[-1] <= linear.high
    assert [axis.shown(v) for v in (0, 0.0123456, 12.3456, 12345.6, 1e-6)] == ["0", "0.0123", "12.3", "12,346", "10⁻⁶"]
    # Equal pictures, as those of a black scene are, have an endless PSNR.
    assert [axis.shown(v) for v in (float("inf"), float("-inf"), float("nan"))] == ["∞", "-∞", "none"]


def _points(count: int) -> list[charts.Point]:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(1, 20, count), rng.uniform(0.01, 0.2, count)
    on = set(pareto.front(x, y))
    return [
        charts.Point(a, b, f"technique <{i}> & co", "raster", i in on)
        for i, (a, b) in enumerate(zip(x, y, strict=True))
    ]


def test_a_scatter_is_sound_svg_with_every_point_and_the_front_named() -> None:
    points = _points(30)
    root = ET.fromstring(
        charts.standalone(charts.scatter(points, title="a < b", x_label="ms", y_label="FLIP", floor=0.02))
    )
    ns = "{http://www.w3.org/2000/svg}"
    assert len(root.findall(f".//{ns}rect[@x]")) == 30
    names = [t.text for t in root.findall(f".//{ns}text") if "name" in (t.get("class") or "")]
    assert sorted(names) == sorted(p.label for p in points if p.front)


@pytest.mark.parametrize("floor", [None, 1e-4, 0.02])
def test_labels_cover_neither_each_other_nor_the_floors(floor: float | None) -> None:
    corner = [
        charts.Point(20 + k, 0.0099 - 1e-4 * k, f"a long name in the corner {k}", "random", True) for k in range(4)
    ]
    points = [*_points(25), *corner]
    words = {"floor": floor, "floor_label": "noise of the reference"}
    root = ET.fromstring(charts.standalone(charts.scatter(points, title="", x_label="", y_label="", **words)))
    boxes = []
    for t in root.iter("{http://www.w3.org/2000/svg}text"):
        if "halo" in (t.get("class") or "") or (t.text or "").startswith("noise"):
            x, y, wide = float(t.get("x", 0)), float(t.get("y", 0)), len(t.text or "") * 5.5
            x -= wide if t.get("text-anchor") == "end" else 0
            boxes.append((x, y - 11, x + wide, y + 3))
    assert len(boxes) > 5
    for i, a in enumerate(boxes):
        for b in boxes[i + 1 :]:
            assert min(a[2], b[2]) <= max(a[0], b[0]) or min(a[3], b[3]) <= max(a[1], b[1]), (a, b)


def test_curves_mark_where_a_line_breaks() -> None:
    lines = [
        charts.Line("map", [1, 10, 100], [0.1, 0.2, 9.0], breaks=100),
        charts.Line("ray", [1, 10, 100], [0.0, 0.0, float("nan")]),
    ]
    svg = charts.curves(lines, title="t", x_label="m", y_label="%", bar=1.0)
    root = ET.fromstring(svg)
    (ring,) = root.findall(".//circle")
    assert "map breaks at 100" in (ring[0].text or "")
    assert {"map", "ray"} <= {t.text for t in root.iter("text")}


def test_names_of_lines_stay_inside_and_apart() -> None:
    placed = charts._stack([100.0, 402.0, 402.0, 402.0, 405.0], 412.0)
    assert placed[0] == 100 and max(placed) <= 412
    assert all(b - a >= charts.LINE for a, b in itertools.pairwise(placed))


@pytest.mark.parametrize("points", [[], [charts.Point(1.0, 0.0, "one", "traced", True)]])
def test_charts_of_little(points: list[Any]) -> None:
    ET.fromstring(charts.scatter(points, title="", x_label="", y_label=""))


def test_results_are_json(tmp_path: Path) -> None:
    store.write_json(tmp_path / "x.json", {"a": (1, np.float64("nan")), "b": Path("c"), 3: {True}})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [1, None], "b": "c", "3": [True]}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--techniques", "cms"), 'unknown technique for a study "cms"; did you mean "csm"'),
        (("--size", "8x8"), "at least 16 pixels"),
        (("--size", "64x48,8x8"), "at least 16 pixels"),
        (("--reference-seconds", "0"), "more than 0 seconds"),
        (("--reference-seconds", "nan"), "more than 0 seconds"),
        (("--camera", "nowhere"), "nowhere"),
        ((), "no-such-scene"),
    ],
)
def test_the_command_line_refuses_before_any_work(
    arguments: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = "no-such-scene.glb" if not arguments else "cornell"
    assert cli.main(["study", scene, "-o", str(tmp_path / "out"), "--quick", *arguments]) == 2
    err = capsys.readouterr().err
    assert said in err and err.startswith("glhybrid: error:") and "Traceback" not in err


def test_a_folder_that_is_a_file_is_an_error_of_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").write_text("")
    assert cli.main(["study", "cornell", "-o", str(tmp_path / "out")]) == 2
    assert "cannot be written to" in capsys.readouterr().err


def test_files_of_one_name_have_folders_of_their_own() -> None:
    loaded = run._load(["a/scene.gltf", "b/scene.gltf", "plaza"], lambda name: Scene(name))
    assert list(loaded) == ["scene", "scene-2", "plaza"] and loaded["scene-2"].name == "b/scene.gltf"
