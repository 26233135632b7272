"""Other renderers see what this one sees: the sky the same way round, lights as bright, from the same place."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scene_kit import box, floor, metal, plastic, scene

from glhybrid.scene import F32, Camera, Environment, Light, Scene, Sphere
from glhybrid.settings import Settings
from glhybrid.study.peers import panel

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer
SIZE = (96, 64)
CAMERA = Camera.look_at((0.6, 0.9, 3.0), (0, 0, 0), fov_y=0.9, name="main")
SHOWS_SKY = ("mitsuba", "bpy", "filly")


@pytest.fixture(params=panel.NAMES)
def peer(request: pytest.FixtureRequest) -> str:
    if reason := panel.missing(request.param):
        pytest.skip(reason)
    return str(request.param)


def seen_by(peer: str, world: Scene, reference: F32) -> F32:
    site = panel.Site("world", world, CAMERA, SIZE, reference, "", 0.0, Path("."))
    found = panel._run(peer, site, 64)
    assert not isinstance(found, str), found
    return found[0]


def reference_of(renderer: "Renderer", world: Scene, bounces: int = 8) -> F32:
    path = Settings(reflections="reference", aa=1, samples=128, bounces=bounces)
    return np.asarray(renderer.render(world, CAMERA, SIZE, path)["radiance"])


def lopsided_sky() -> Environment:
    """Smooth, and unlike itself in every mirror and turn."""
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(128) + 0.5) / 128, indexing="ij")
    sky = np.stack([1 + np.sin(2 * np.pi * u), 1.2 + np.cos(2 * np.pi * u), 0.3 + 1.5 * (1 - v)], -1)
    return Environment(sky.astype(np.float32), rotation=0.7)


def test_the_sky_is_the_same_way_round(renderer: "Renderer", peer: str) -> None:
    """Behind everything within 2 %, of texels; the control, a sky turned by a tenth, is further off."""
    if peer not in SHOWS_SKY:
        pytest.skip(f"{peer} shows no sky, and says so")
    world = scene([(Sphere(0.6), metal())], environment=lopsided_sky())
    want = reference_of(renderer, world)
    got = seen_by(peer, world, want)
    sky = renderer.render(world, CAMERA, SIZE, Settings(aa=1), aovs=("depth",))["depth"] == np.inf
    assert 0.5 < sky.mean() < 0.95
    off = np.abs(got - want)[sky].mean() / want[sky].mean()
    turned = lopsided_sky()
    turned = Environment(turned.radiance, rotation=turned.rotation + 0.1)
    other = reference_of(renderer, world.replace(environment=turned))
    control = np.abs(other - want)[sky].mean() / want[sky].mean()
    assert off < 0.02 < control, (off, control)
    # The mirror shows what is behind the camera, and above: filly's ball is of triangles, its sky blurred.
    ball = ~sky
    assert np.abs(got - want)[ball].mean() / want[ball].mean() < (0.12 if peer == "filly" else 0.05)


LAMPS = {
    "sun": Light("directional", direction=(-0.5, -0.8, -0.3), intensity=3.0, color=(1.0, 0.8, 0.6)),
    "point lamp": Light("point", position=(1.0, 2.0, 1.0), intensity=6.0),
    "spot lamp": Light(
        "spot", position=(-1.0, 2.5, 1.0), direction=(0.4, -0.85, -0.35), intensity=9.0, inner_cone=0.2, outer_cone=0.6
    ),
}


@pytest.mark.parametrize("lamp", LAMPS)
def test_lights_are_as_bright(renderer: "Renderer", peer: str, lamp: str) -> None:
    """On a grey floor: the median where they are brightest within a tenth: diffuse lobes and spots' edges differ."""
    grey = plastic((0.5, 0.5, 0.5), roughness=0.5)
    world = scene([(floor(1.5), grey), (box((-0.2, 0, -0.6), (0.2, 0.5, -0.2)), grey)], lights=[LAMPS[lamp]])
    want = reference_of(renderer, world, bounces=0)
    got = seen_by(peer, world, want)
    level = want @ np.array([0.2126, 0.7152, 0.0722])
    lit = level > 0.8 * level.max()
    assert lit.mean() > 0.01
    ratio = np.median(got[lit] / want[lit], axis=0)
    assert np.abs(ratio - 1).max() < 0.1, ratio
