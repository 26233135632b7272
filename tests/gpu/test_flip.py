"""FLIP on the device against the authors' own program."""

from typing import Any

import numpy as np
import pytest

import glhybrid as gh
from glhybrid import flip
from glhybrid.flip import Flip
from glhybrid.scene import F32

# Both are float32, summed in another order. Where two pixels differ by next to nothing, the power 0.7 and the root over
# edges make 1e-4 of a rounding of 1e-7 (in white, beyond the edge of what differs: 8e-4; elsewhere 3e-5 at most). Means
# average that, where pictures are not flat (measured: 6e-5 of two flat ones, else under 1e-6).
MEAN, FLAT, MAP = 1e-5, 1e-4, 2e-3


def authors(got: F32, want: F32) -> F32:
    """(H, W) by flip-evaluator, of light in units of the reference's mean, as flip.py has it."""
    evaluator = pytest.importorskip("flip_evaluator", reason="the authors' flip-evaluator is not installed")
    mean = np.float32((want.astype(np.float64) @ flip.LUMINANCE).mean())
    a, b = (np.clip(np.nan_to_num(x / mean), 0, flip.MOST).astype(np.float32) for x in (got, want))
    return np.asarray(evaluator.evaluate(b, a, "HDR", applyMagma=False)[0])[..., 0]


def held(found: F32, other: F32, mean: float = MEAN) -> None:
    """Asserts that two maps are equal, as far as rounding lets them."""
    assert found.shape == other.shape and found.dtype == np.float32 and found.min() >= 0 and found.max() <= 1
    assert abs(float(found.mean()) - float(other.mean())) <= mean and np.abs(found - other).max() <= MAP


def pair(size: tuple[int, int], seed: int = 0, spread: float = 1.0) -> tuple[F32, F32]:
    """Noise over six orders of magnitude, with edges, equal parts, colours and black."""
    rng, (width, height) = np.random.default_rng(seed), size
    want = rng.lognormal(0, spread, (height, width, 3)).astype(np.float32)
    want[: height // 3] *= 1e-3
    want[:, : width // 4] *= (3, 0.1, 0.01)
    want[height // 2 :, width // 2 :] = (0.2, 0.3, 0.9)
    want[-(height // 5) :, : width // 5] = 0
    got = want * rng.lognormal(0, 0.2, want.shape).astype(np.float32)
    got[:, width // 3 : width // 2] = want[:, width // 3 : width // 2]
    got[height // 4 : height // 3] = (0.5, 0, 0)
    return got, want


@pytest.mark.parametrize("size", [(160, 90), (61, 37), (8, 8), (1, 1), (1, 40), (40, 1), (3, 2), (130, 9)])
def test_noise_is_seen_as_by_the_authors(renderer: gh.Renderer, size: tuple[int, int]) -> None:
    """Of sizes that are no multiple of a block, and smaller than the filters: borders count as they do there."""
    got, want = pair(size, seed=sum(size))
    found, other = renderer.flip.hdr(got, want), authors(got, want)
    held(found, other, MEAN if found.size > 1000 else FLAT)
    assert size[0] * size[1] < 100 or other.max() > 0.5 > other.min()


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e5])
def test_the_unit_of_light_does_not_matter(renderer: gh.Renderer, unit: float) -> None:
    got, want = pair((96, 64), 5)
    base, scaled = renderer.flip.hdr(got, want), renderer.flip.hdr(got * np.float32(unit), want * np.float32(unit))
    assert np.abs(base - scaled).max() < MAP


def test_renders_are_seen_as_by_the_authors(renderer: gh.Renderer) -> None:
    scene = gh.load("cornell")
    want, got, again = (
        renderer.render(scene, None, (160, 90), gh.Settings(aa=1, **kinds))["radiance"]  # type: ignore[arg-type]
        for kinds in ({}, {"shadows": "none", "reflections": "env"}, {})
    )
    found = renderer.flip.hdr(got, want)
    held(found, authors(got, want))
    assert found.mean() > 0.01 and not renderer.flip.hdr(again, want).any(), "equal pictures are equal"


@pytest.mark.parametrize("black", [0.3, 0.6, 1 - 1 / (32 * 24)])
def test_exposures_are_the_authors(renderer: gh.Renderer, black: float) -> None:
    """Those of pictures that are half black too, whose median says nothing."""
    evaluator = pytest.importorskip("flip_evaluator", reason="the authors' flip-evaluator is not installed")
    rng = np.random.default_rng(7)
    want = rng.lognormal(0, 2, (24 * 32, 3)).astype(np.float32)
    want[: int(black * len(want))] = 0
    want = want.reshape(24, 32, 3) / np.float32((want @ flip.LUMINANCE).mean())
    told: dict[str, Any] = evaluator.evaluate(want, want, "HDR", applyMagma=False)[2]
    found = np.log2(flip.exposures(want @ flip.LUMINANCE))
    assert len(found) == told["numExposures"]
    assert found[[0, -1]] == pytest.approx([told["startExposure"], told["stopExposure"]], abs=1e-4)
    got = want * rng.uniform(0.7, 1.3, want.shape).astype(np.float32)
    held(renderer.flip.hdr(got, want), authors(got, want))


def test_black_white_and_what_is_not_finite(renderer: gh.Renderer) -> None:
    black = np.zeros((20, 20, 3), np.float32)
    lit = black.copy()
    lit[:10] = 1
    assert not renderer.flip.hdr(black, black).any()
    assert renderer.flip.hdr(lit, black).mean() == 0.5, "no exposure shows a black reference"
    for got, want in ((black, lit), (np.ones_like(lit), lit), (black, np.ones_like(lit)), (1e9 * lit, lit)):
        held(renderer.flip.hdr(got, want), authors(got, want), FLAT)
    got, want = pair((40, 30), 3)
    got[3, 3], got[20, 7], got[9, 30], got[15, 15] = np.nan, np.inf, -np.inf, -1
    found = renderer.flip.hdr(got, want)
    held(found, authors(got, want))
    assert np.isfinite(found).all()
    want[5, 5], want[6, 6] = np.nan, np.inf
    found = renderer.flip.hdr(got, want)
    assert np.isfinite(found).all() and found.max() <= 1


def test_what_comes_of_a_reference_is_kept_or_made_anew(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    got, want = pair((61, 37), 9)
    kept = renderer.flip.reference(want)
    maps = [renderer.flip.map(picture, kept) for picture in (got, want, got[::-1].copy(), got)]
    assert len(kept.kept) == len(kept.exposures) > 2
    assert np.array_equal(maps[0], maps[3]) and not maps[1].any() and not np.array_equal(maps[0], maps[2])
    monkeypatch.setattr(flip, "KEPT_BYTES", 0)
    anew = renderer.flip.reference(want)
    assert np.array_equal(renderer.flip.map(got, anew), maps[0]) and not anew.kept
    other = renderer.flip.reference(pair((30, 50), 2)[1])  # another size in between
    renderer.flip.map(pair((30, 50), 2)[0], other)
    assert np.array_equal(renderer.flip.map(got, kept), maps[0])
    for reference in (kept, anew, other):
        reference.release()
        reference.release()


def test_pictures_that_do_not_fit_are_refused(renderer: gh.Renderer) -> None:
    want = np.ones((20, 30, 3), np.float32)
    for got, said in ((want[1:], "30x19 and a reference of 30x20"), (want[..., 0], r"shape \(20, 30\)")):
        with pytest.raises(gh.SettingError, match=said):
            renderer.flip.hdr(got, want)
    with pytest.raises(gh.SettingError, match="30x20 and a reference of 8x8"):
        renderer.flip.hdr(want, np.zeros((8, 8, 3), np.float32))


def test_it_costs_nothing_where_it_is_not_used(context: Any) -> None:
    with gh.Renderer(context=context) as made:
        made.render(gh.load("cornell"), None, (32, 18), gh.Settings(aa=1))
        assert "flip" not in vars(made) and not any("flip" in name for name in made.shaders.names)
        assert isinstance(made.flip, Flip) and not made.flip._images


def test_filters_are_those_of_the_papers() -> None:
    """The tables of lib/flip.glsl, against the formulas of both papers in float64."""
    tables = _tables()
    degrees = 0.7 * 3840 / 0.7 * np.pi / 180
    reach = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi**2)) * degrees))
    x = np.arange(-reach, reach + 1) / degrees
    rows = []
    for (a1, b1), (a2, b2) in (((1, 0.0047), (0, 1e-5)), ((1, 0.0053), (0, 1e-5)), ((34.1, 0.04), (13.5, 0.025))):
        square = x[:, None] ** 2 + x**2
        whole = sum(a * np.sqrt(np.pi / b) * np.exp(-(np.pi**2) * square / b) for a, b in ((a1, b1), (a2, b2)))
        rows.append(whole / whole.sum())
    half = tables["SENSITIVITY"]
    mirrored = np.concatenate([half[:0:-1], half])
    assert len(half) == reach + 1
    for k, columns in enumerate(([0], [1], [2, 3])):
        made = sum(np.outer(mirrored[:, c], mirrored[:, c]) for c in columns)
        assert np.abs(made - rows[k]).max() < 1e-8, k
    sigma = 0.5 * 0.082 * degrees
    steps = np.arange(-int(np.ceil(3 * sigma)), int(np.ceil(3 * sigma)) + 1)
    g = np.exp(-(steps**2) / (2 * sigma**2))
    half = tables["EDGES"]
    for k, (weights, sign) in enumerate(((g, 1), (-steps * g, -1), ((steps**2 / sigma**2 - 1) * g, 1))):
        want = np.where(weights > 0, weights / weights[weights > 0].sum(), 0)
        if k:
            want = want + np.where(weights < 0, weights / -weights[weights < 0].sum(), 0)
        mirrored = np.concatenate([sign * half[:0:-1, k], half[:, k]])
        assert np.abs(mirrored - want).max() < 1e-8, k


def _tables() -> dict[str, np.ndarray]:
    import re

    from glhybrid.load.builtin import data_folder

    text = (data_folder("glsl") / "lib/flip.glsl").read_text()
    found = {}
    for name, body in re.findall(r"const vec\d (\w+)\[\d+\] = vec\d\[\d+\]\(\n(.*?)\n\);", text, re.DOTALL):
        rows = re.findall(r"vec\d\((.*?)\)", body)
        found[name] = np.array([[float(v) for v in row.split(",")] for row in rows])
    return found
