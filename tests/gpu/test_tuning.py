"""What a device is measured for: what is kept, what is mistrusted, what the plan makes of it; every variant traces alike."""

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from rays import Rays, Tracer, piece, scene_of

import glhybrid as gh
from glhybrid import content_cache, tuning
from glhybrid.bench import scenes
from glhybrid.bvh import blas, presplit
from glhybrid.shaders import Shaders
from glhybrid.tuning import ALL_STEPS, Tuning

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.context import Context

    F64 = NDArray[np.float64]

MADE = Tuning(8.0, 100.0, 120.0, ALL_STEPS, {str(ALL_STEPS): 300.0, "3": 350.0}, 0.8)


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A cache of its own, in which tuning is on."""
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    monkeypatch.delenv("GLHYBRID_TUNING", raising=False)
    return tmp_path


def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Measurements that were asked for; each gives MADE."""
    calls: list[int] = []
    monkeypatch.setattr(tuning, "measure", lambda *_: calls.append(1) or MADE)
    return calls


def test_measured_rates_are_numbers_and_come_back(context: "Context", kept: Path) -> None:
    first = tuning.tuned(context)
    assert first.source == "measured" and str(first.inner_steps) in first.variants
    rates = (first.raster_ns_pixel, first.trace_ns_pixel, *first.variants.values())
    assert all(0 < rate < 1e6 for rate in rates) and 0 <= first.raster_ns_triangle < 1e6
    assert set(map(int, first.variants)) <= set(tuning.candidates(context.device.software))
    again = tuning.tuned(context)
    assert again == dataclasses.replace(first, source="kept")


def test_measured_once_for_a_device(context: "Context", kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = counted(monkeypatch)
    for _ in range(3):
        assert tuning.tuned(context).inner_steps == MADE.inner_steps
    assert len(calls) == 1
    monkeypatch.setattr(context, "device", dataclasses.replace(context.device, version="4.5 of another driver"))
    tuning.tuned(context)
    assert len(calls) == 2


def damaged() -> dict[str, Any]:
    """What a file could hold that adds up but was never measured."""
    good = dataclasses.asdict(MADE)
    changes: dict[str, dict[str, Any]] = {
        "negative": {"trace_ns_pixel": -1.0}, "nan": {"raster_ns_pixel": float("nan")}, "text": {"took_s": "soon"},
        "unknown steps": {"inner_steps": 7}, "no variants": {"variants": {}}, "another field": {"gpu": 1},
        "a list": {"variants": [1]},
    }  # fmt: skip
    return {name: json.dumps(good | change).encode() for name, change in changes.items()} | {
        "not JSON": b"{",
        "empty": b"",
    }


@pytest.mark.parametrize("what", [*damaged(), "a flipped bit"])
def test_what_is_damaged_is_measured_again(
    context: "Context", kept: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    calls = counted(monkeypatch)
    shaders = Shaders(context)
    name = tuning.cache_key(context, shaders)
    shaders.release()
    if what == "a flipped bit":
        tuning.tuned(context)
        file = kept / "tuning" / f"{name}.tuning"
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 4
        file.write_bytes(data)
        calls.clear()
    else:
        content_cache.write("tuning", name, damaged()[what])
    assert tuning.tuned(context) == MADE and len(calls) == 1
    assert tuning.tuned(context).source == "kept" and len(calls) == 1


def test_off_measures_nothing(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    calls = counted(monkeypatch)
    for name in ("GLHYBRID_TUNING", "GLHYBRID_CACHE"):
        with monkeypatch.context() as patch:
            patch.delenv("GLHYBRID_TUNING", raising=False)
            patch.setenv(name, "off")
            assert tuning.tuned(context) == tuning.rule(context.device.software)
    assert not calls


def test_the_rates_choose_by_pixels_and_triangles() -> None:
    """Raster pays for triangles, rays for pixels."""
    assert MADE.primary(1280 * 720, 10_000)[0] == "raster" and MADE.primary(1280 * 720, 10_000_000)[0] == "trace"
    assert MADE.primary(3840 * 2160, 1_000_000)[0] == "raster" and MADE.primary(64 * 64, 1_000_000)[0] == "trace"
    assert tuning.rule(True).primary(1, 10**9)[0] == "raster" and tuning.rule(False).primary(1, 10**9)[0] == "trace"


def test_the_plan_follows_the_rates_unless_told(context: "Context") -> None:
    scene = scenes.make("spheres", 10_000)
    with gh.Renderer(context=context) as renderer:
        for rates in (dataclasses.replace(MADE, raster_ns_triangle=1e6), dataclasses.replace(MADE, trace_ns_pixel=1e6)):
            renderer.tuning = rates
            wanted = rates.primary(64 * 48, scene.triangle_count())[0]
            for asked in ("auto", "raster", "trace"):
                settings = gh.Settings(aa=1, primary=asked, seed=int(rates.raster_ns_triangle))
                plan = renderer.render(scene, size=(64, 48), settings=settings).receipt["plan"]
                assert plan["primary"] == (wanted if asked == "auto" else asked)
                assert any(why.startswith("primary") for why in plan["reasons"]) == (asked == "auto")


STEPS = (1, 2, 3, 4, ALL_STEPS)


@pytest.mark.parametrize(("levels", "pieces"), [(1, False), (2, False), (1, True)])
def test_no_variant_leaks_and_all_find_the_same(
    context: "Context", monkeypatch: pytest.MonkeyPatch, levels: int, pieces: bool
) -> None:
    """Every number of inner steps, with branches and without: through vertices and edges of closed bodies.

    pieces: trees whose triangles are split wherever they can be (bvh/presplit.py).
    """
    rng = np.random.default_rng(2)
    bodies = [ray.uv_sphere(20), ray.jagged(24, rng)]
    if pieces:
        for name, value in (("WORTH", 0.1), ("SHARE", 2.0), ("KEPT", np.inf)):
            monkeypatch.setattr(presplit, name, value)
        monkeypatch.setattr(blas, "SMALL", 0)
        monkeypatch.setenv("GLHYBRID_CACHE", "off")  # no other test may find these trees
        bodies += [ray.drum(60)]
    for position, index in bodies:
        vertex = position.astype(np.float32).astype(np.float64)
        with Tracer(context, scene_of(piece(position, index)), levels, origin=(0, 0, 0)) as tracer:
            n = ray.count(50_000)
            row, at = index[rng.integers(0, len(index), n)], np.arange(n)
            corner = rng.integers(0, 3, n)
            along = rng.random((n, 1)) * (rng.random((n, 1)) < 0.5)  # half at vertices, half at edges
            target = vertex[row[at, corner]]
            target = target + along * (vertex[row[at, (corner + 1) % 3]] - target)
            origin = rng.integers(-8, 9, (n, 3)) / 64
            sent = Rays.make(origin, ray.unit(target - origin))
            slots = sum(len(m.blas.slots) for m in tracer.geometry.meshes)
            assert (slots > 1.2 * len(index)) == pieces
            first = tracer.trace(sent)
            assert first.hit.all() and first.blocked.all()
            for change in [{"bvh_inner_steps": k} for k in STEPS] + [{"branchless": k} for k in (0, 1)]:
                found = tracer.trace(sent, **change)
                assert found.hit.all() and found.blocked.all(), change
                if context.device.software:
                    assert np.array_equal(found.t, first.t) and np.array_equal(found.triangle, first.triangle), change
                # Other compilers contract sums as they please: t is as good as its triangle is steep to the ray, and an
                # edge has a triangle on either side.
                one, other = index[first.triangle], index[found.triangle]
                steep = np.minimum(steepness(vertex[one], sent), steepness(vertex[other], sent))
                error = np.abs(found.t - first.t) / first.t * steep
                assert error.max() < 1e-6, (change, error.max(), steep[error.argmax()])
                assert (one[:, :, None] == other[:, None, :]).any((1, 2)).all(), change


def steepness(corners: "F64", sent: Rays) -> "F64":
    """(R,) cosines between rays and the normals of triangles (R, 3, 3)."""
    normal = ray.unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    return np.abs((normal * sent.direction).sum(1))
