"""`glhybrid bench --motion`: what it plays and counts, and that pictures that differ are found out. No time is asserted."""

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from glhybrid import cli
from glhybrid.bench import motion, movers
from glhybrid.errors import SettingError
from glhybrid.renderer import Renderer
from glhybrid.scene import Triangles

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (32, 24)


@pytest.mark.parametrize("triangles", [2000, 100_000])
def test_the_ring_has_the_triangles_asked_for_and_is_skinned_smoothly(triangles: int) -> None:
    scene = movers.ring(triangles)
    assert scene.triangle_count() == pytest.approx(triangles, rel=0.05)
    piece = scene.meshes[0].primitives[0]
    assert isinstance(piece, Triangles) and piece.weights is not None
    np.testing.assert_allclose(piece.weights.sum(1), 1, atol=1e-6)


def test_an_old_tree_costs_more_and_shows_the_same(context: "Context") -> None:
    scene, fresh = movers.ring(3000), []  # type: ignore[var-annotated]
    with Renderer(context=context) as renderer:
        policies = ((1.0, "cpu"), (1.05, "auto"), (0.0, "auto"), (1.0, "gpu"))
        played = [motion.play(renderer, "ring", scene, SIZE, r, 12, fresh, builder) for r, builder in policies]
    every, often, never, compute = played
    assert compute.builds == 12 and compute.sah_ratio_mean < 1.1
    assert compute.steps_per_ray_mean < 1.1 * every.steps_per_ray_mean
    assert (every.builds, never.builds) == (12, 0) and 0 < often.builds < 12
    assert every.age == [0] * 12 and never.age == list(range(1, 13)) and 0 in often.age and 1 in often.age
    assert every.sah_ratio == pytest.approx([1.0] * 12) and never.sah_ratio_mean > 1.2
    assert never.steps_per_ray_mean > 1.05 * every.steps_per_ray_mean
    assert all(p.error == 0 for p in played)


def test_a_picture_that_differs_is_a_failure(context: "Context") -> None:
    scene, fresh = movers.ring(2000), []  # type: ignore[var-annotated]
    with Renderer(context=context) as renderer:
        played = motion.play(renderer, "ring", scene, SIZE, 1.0, 2, fresh)
        fresh[1][1].flags.writeable = True
        fresh[1][1][3, 4] += 0.25
        other = motion.play(renderer, "ring", scene, SIZE, 0.0, 2, fresh)
    report = motion.MotionReport({}, [played, other])
    assert report.failures == ["ring, rebuild = 0: a picture differs by 0.25 from that with trees built for it"]


def test_a_whole_report(
    context: "Context", monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the command runs it, but smaller: JSON with every table, and the tables themselves."""
    ring, swarm, play = movers.ring, movers.swarm, motion.play
    monkeypatch.setattr(movers, "ring", lambda n: ring(min(n, 1000)))
    monkeypatch.setattr(movers, "swarm", lambda n: swarm(min(n // 10, 1200)))
    monkeypatch.setattr(motion, "play", lambda r, n, s, z, b, _, f, w: play(r, n, s, z, b, 3, f, w))
    run = motion.run
    monkeypatch.setattr(motion, "run", lambda *a, **k: run(*a, **(k | {"context": context})))
    assert cli.main(["bench", "--motion", "--quick", "--size", "32x24", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [row["rebuild"] for row in said["refit"]] == [1, 1, 1.5, 2, 0] and said["machine"]["failures"] == []
    assert [len(row["steps_per_ray"]) for row in said["refit"]] == [3] * 5
    assert [(row["instances"], row["rebuild"]) for row in said["instances"]] == [
        (100, 1),
        (100, 0),
        (1000, 1),
        (1000, 0),
    ]
    assert all(min(row[k] for k in ("pose_ms", "tlas_ms", "frame_ms", "host_us")) > 0 for row in said["instances"])
    assert [row["way"] for row in said["readback"]] == ["drawn", "ring 1", "ring 2", "ring 3", "frames", "single"]
    assert all(row["per_second"] > 0 for row in said["readback"])
    report = run(quick=True, size=SIZE, context=context)
    assert all(d.build_ms > 0 and d.dispatches[0] == 1 < d.dispatches[1] for d in report.deformed)
    motion.show(replace(report, refit=report.refit[:3]))
    out: Any = capsys.readouterr().out
    assert "every frame, gpu" in out and "past 1.5" in out and "refitted" in out and "ring 3" in out


def test_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SettingError, match="no clip of it changes a shape"):
        motion.run([("swarm", movers.swarm(8))])
    assert cli.main(["bench", "--motion", "--peers"]) == 2
    assert "give one" in capsys.readouterr().err


def test_bars() -> None:
    assert motion.bars([0, 1, 2], 0, 2) == "▁▅█" and motion.bars([3, 3], 3, 3) == "▁▁"
    assert len(motion.bars(list(range(100)), 0, 99)) == 48
