"""Which point a mirror shows, as the study tells it from distances and reasons, against pictures whose colours are places.

The colours are what is drawn; the study's scenes have none, so its points are worked out. Both must say the same.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import mirror_room
import numpy as np
import pytest
from scene_kit import Camera, Scene, metal, scene

import glhybrid as gh
from glhybrid.layout import CONSTANTS
from glhybrid.scene import Probe, Sphere
from glhybrid.study import reflected
from glhybrid.study.reflected_points import shown_points

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (200, 150)
PROBE = Probe((0.3, 1.7, -0.4), (-5, 0, -5), (5, 4, 5))
GUESS = CONSTANTS["REASON_THICKNESS"]
AOVS = ("reflection", "reflection_hit", "reason", "position", "instance_id")
SETTINGS: dict[str, dict[str, Any]] = {
    "ray-lerp": {}, "ssr-ray": {}, "probe": {}, "ssr": {"reflections.ssr.fade": 0.0},
    "ssr thick": {"reflections.ssr.fade": 0.0, "reflections.ssr.thickness": 0.2},
}  # fmt: skip


@pytest.fixture(scope="module")
def renderer(_shared_context: "Context") -> Iterator[gh.Renderer]:
    with gh.Renderer(context=_shared_context) as made:
        yield made


def settings(name: str) -> gh.Settings:
    return gh.Settings(reflections=name.split()[0], aa=1, exposure=0.0, parameters=SETTINGS[name])


@pytest.mark.parametrize("name", list(SETTINGS))
def test_the_point_told_is_the_point_drawn(context: "Context", renderer: gh.Renderer, name: str) -> None:
    room = mirror_room.room().replace(probes=(PROBE,))
    mirrors = reflected.find(renderer, room, room.cameras[0], SIZE)
    assert mirrors is not None
    frame = renderer.render(room, 0, SIZE, settings(name), AOVS)
    use = mirrors.counted & (frame["instance_id"] == mirror_room.FLOOR)
    told = shown_points(renderer, room, mirrors.rays, frame, settings(name))
    known = use & np.isfinite(told).all(-1)
    assert known.sum() > (0.6 if name.startswith("ssr ") or name == "ssr" else 0.99) * use.sum()
    colour, share = frame["reflection"].astype(np.float64), np.ones(known.shape)
    if name == "ssr thick":  # what is guessed fades into a black sky: a share of its colour
        told_colour = np.where(known[..., None], told / (2 * mirror_room.REACH) + 0.5, 0)
        share = (colour * told_colour).sum(-1) / np.maximum((told_colour**2).sum(-1), 1e-9)
        known &= share > 0.1
        colour /= np.where(known, share, 1)[..., None]
        assert known[frame["reason"] == GUESS].sum() > 200
    drawn = mirror_room.places(colour)
    apart = np.where(known, np.linalg.norm(np.where(known[..., None], told, 0) - drawn, axis=-1) * share, np.inf)
    # Colours are half floats, 2 cm; a probe's texels are 3 to 6 cm there, and blend over edges.
    assert np.mean(apart[known] < (0.15 if name == "probe" else 0.05)) > (0.93 if name == "probe" else 0.995)
    true = mirror_room.truth(SIZE)
    same = known & true.mirror & (apart < 0.15)
    off = np.abs(mirrors.rays.error_px(told) - mirror_room.error_px(drawn, true))[same]
    near = mirror_room.error_px(drawn, true)[same] < 20  # an angle is no distance on a picture far from its middle
    assert np.median(off[near]) < 0.5


def test_figures_of_the_room(context: "Context", renderer: gh.Renderer) -> None:
    room = mirror_room.room().replace(probes=(PROBE,))
    mirrors = reflected.find(renderer, room, room.cameras[0], SIZE)
    assert mirrors is not None
    found = {name: mirrors.ask(renderer, settings(name)) for name in ("ray-lerp", "ssr-ray", "ssr", "probe")}
    for name in ("ray-lerp", "ssr-ray"):
        shown = found[name]
        assert shown.right_object_percent > 99.8 and (shown.right_point_percent or 0) > 99.8
        assert shown.reflected_error_px_p95 is not None and shown.reflected_error_px_p95 < 0.01
    true = mirror_room.truth(SIZE)
    there = 100 * float(true.shown[true.mirror].mean())
    assert found["ssr"].right_point_percent == pytest.approx(there, abs=3), "what the picture shows, and no more"
    assert found["ssr"].reflected_error_px is not None and found["ssr"].reflected_error_px < 0.01
    probe = found["probe"]
    assert probe.right_point_percent is not None and 50 < probe.right_point_percent < probe.right_object_percent < 95
    assert probe.reflected_error_px_p95 is not None and probe.reflected_error_px_p95 < 0.5, "what it gets right is wall"
    # A box that is too large: walls are still seen, where the probe has them.
    off = mirrors.scene.replace(probes=(Probe(PROBE.position, (-7, -2, -7), (7, 6, 7)),))
    parallax = replace(mirrors, scene=off).ask(renderer, settings("probe"))
    assert parallax.reflected_error_px is not None and parallax.reflected_error_px > 3
    assert parallax.right_point_percent is not None and parallax.right_point_percent < 10


def test_curved_mirrors_and_parallel_rays(context: "Context", renderer: gh.Renderer) -> None:
    """Exact rays are at their own pixel whatever the mirror's shape, and however the camera projects."""
    for camera in (mirror_room.CAMERA, Camera("flat", mirror_room.CAMERA.world_from_view, fov_y=0.0, ymag=2.0)):
        made: Scene = scene([*ball()], camera)
        mirrors = reflected.find(renderer, made, camera, SIZE)
        assert mirrors is not None
        shown = mirrors.ask(renderer, gh.Settings(aa=1))
        assert shown.right_point_percent == 100
        assert shown.reflected_error_px_p95 is not None and shown.reflected_error_px_p95 < 0.02


def ball() -> list[Any]:
    parts: list[Any] = [(mirror_room.placed(mirror_room.box(*b)), metal()) for b in mirror_room.BOXES]
    return [*parts, (Sphere(0.6), metal(), (1, 1.5, -1))]
