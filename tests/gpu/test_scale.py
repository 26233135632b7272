"""`glhybrid bench --scale`: what it varies, fits, draws and refuses. Times are never asserted."""

import dataclasses
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from glhybrid import cli
from glhybrid.bench import frames, scale
from glhybrid.scene import Triangles

if TYPE_CHECKING:
    from glhybrid.context import Context

SMALL = {"triangles": (4_000, 8_000, 16_000), "pixels": (160 * 90, 320 * 180), "lights": (1, 3), "instances": (1, 20)}


def test_the_exponent_is_that_of_a_power_law() -> None:
    x = np.array([1.0, 10, 100, 1000])
    for power in (-1.0, 0.0, 0.5, 1.3):
        assert scale.exponent(x, 7 * x**power) == pytest.approx(power, abs=1e-9)


def test_one_thing_changes_at_a_time(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "HOST_FRAMES", 3)  # times are only looked for
    result = scale.run(context=context, quick=True, size=(48, 32), values=SMALL)
    assert [curve.over for curve in result.curves] == list(SMALL) and not any(c.ended for c in result.curves)
    for curve in result.curves:
        values = [p.value for p in curve.points]
        assert values == list(SMALL[curve.over])
        assert all(p.frame_ms > 0 and p.wall_ms > 0 and p.host_us > 0 and p.buffer_bytes > 0 for p in curve.points)
        assert all(
            set(p.passes) & {"gbuffer", "rays"} and set(p.passes) >= {"reflect", "composite"} for p in curve.points
        )
        assert set(curve.exponents) >= ({"frame", "composite", "host"} if len(values) > 2 else set())
        same = {(p.size, p.lights, p.instances if curve.over != "instances" else 0) for p in curve.points}
        assert len(same) == (1 if curve.over in ("triangles", "instances") else len(values))
    by_triangles, by_pixels, by_lights, by_instances = result.curves
    assert [p.triangles for p in by_triangles.points] == pytest.approx(SMALL["triangles"], rel=0.2)
    assert [p.size[0] * p.size[1] for p in by_pixels.points] == list(SMALL["pixels"])
    assert [p.lights for p in by_lights.points] == [1, 3]
    assert [p.instances for p in by_instances.points] == [2, 21]  # and the floor
    json.dumps(result.to_dict())
    drawn = ET.fromstring(scale.chart(result))
    paths = [e for e in drawn.iter() if e.tag.endswith("path") and e.get("class") == "curve"]
    assert len(paths) >= 4 * 5
    scale.show(result)


def test_instances_share_one_small_mesh() -> None:
    scene = scale.crowd(1000)
    assert len(scene.instances) == 1001 and len(scene.meshes) == 2
    ball = scene.meshes[1].primitives[0]
    assert isinstance(ball, Triangles) and 0.5 * scale.BALL < len(ball.index) < 2 * scale.BALL
    low, high = scene.bounds()
    assert np.allclose(scale.crowd(16).bounds()[:, [0, 2]], [low[[0, 2]], high[[0, 2]]], rtol=0.1)


def test_what_a_device_refuses_ends_the_curve(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    limits = dataclasses.replace(context.limits, storage_block_bytes=4000)
    monkeypatch.setattr(context, "limits", limits)
    (curve,) = scale.run(["instances"], context=context, size=(16, 16), values={"instances": (1, 5, 1000, 2000)}).curves
    assert [p.value for p in curve.points] == [1, 5]
    assert curve.ended.startswith("1,000 instances: ") and "4000" in curve.ended
    assert not context.raw.errors()


def test_memory_is_looked_at_before(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "_available_bytes", lambda: 2_500 * scale.BYTES_A_TRIANGLE)
    (curve,) = scale.run(["triangles"], context=context, size=(16, 16), values={"triangles": (2_000, 4_000)}).curves
    assert [p.value for p in curve.points] == [2_000] and "GiB are needed" in curve.ended


def test_usage(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["bench", "--svg", "chart.svg"]) == 2
    assert "--scale" in capsys.readouterr().err
    assert cli.main(["bench", "--scale", "--svg", str(tmp_path / "chart.png")]) == 2
    assert ".svg" in capsys.readouterr().err
    assert cli.main(["bench", "--scale", "triangle"]) == 2
    assert "triangles" in capsys.readouterr().err
