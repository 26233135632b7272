"""Any number of lights: past 32, where hits carry no bit for each, as below; direct and in a mirror, against float64."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, say, scene_of
from shadow_scenes import exact_visibility

import glhybrid as gh
from glhybrid.load.shapes import box
from glhybrid.scene import F64, Camera, Instance, Light, Material, Scene

if TYPE_CHECKING:
    from glhybrid.context import Context

MATT = Material(double_sided=True, specular=0.0)
MIRROR = Material(double_sided=True, metallic=1.0, roughness=0.0)


def posts(count: int) -> tuple[Scene, Camera]:
    """Nine posts on a floor before a mirror, under suns and lamps by turns."""
    rng = np.random.default_rng(count)
    lights = []
    for k in range(count):
        color: Any = tuple(rng.uniform(0.2, 1, 3))
        if k % 3 == 0:
            down = rng.normal(size=3) * (0.6, 0.4, 0.6) - (0, 1, 0)
            direction: Any = tuple(down / np.linalg.norm(down))
            lights.append(Light("directional", color, 3 / count, direction=direction))
        else:
            position: Any = tuple(rng.uniform((-3, 2, -2), (3, 4, 4)))
            lights.append(Light("point", color, 30 / count, position=position))
    scene = scene_of(
        box(size=(12, 0.2, 12)), box(size=(0.4, 1.2, 0.4)), box(size=(8, 3, 0.1)), materials=(MATT, MIRROR)
    )
    places = [(0, (0, -0.1, 0)), (2, (0, 1.6, -3.2))] + [(1, (x, 0.6, z)) for x in (-2, 0, 2) for z in (-2, 0, 2)]
    instances = tuple(Instance(m, moved(np.array(p)), materials=(int(m == 2),)) for m, p in places)
    return scene.replace(instances=instances, lights=tuple(lights)), Camera.look_at(
        (1.0, 3, 5), (0, 0.6, -2), fov_y=0.8
    )


def lit(scene: Scene, points: F64, normal: F64) -> F64:
    """(N, 3) radiance of a white Lambert surface at points (N, 3), with shadows."""
    total = np.zeros(points.shape)
    for light in scene.lights:
        toward, away, fall = (
            np.broadcast_to(-np.array(light.direction), points.shape),
            np.full(len(points), np.inf),
            1.0,
        )
        if light.kind == "point":
            toward = np.array(light.position) - points
            away = np.linalg.norm(toward, axis=1)
            toward, fall = toward / away[:, None], 1 / away[:, None] ** 2
        facing = np.maximum((normal * toward).sum(1), 0)
        visible = exact_visibility(scene, points + 1e-5 * normal, toward, away)
        total += (facing * visible)[:, None] * fall * np.array(light.color) * light.intensity / np.pi
    return total


@pytest.mark.parametrize("count", [1, 32, 33, 64, 200])
def test_every_light_counts_once(renderer: gh.Renderer, context: "Context", count: int) -> None:
    scene, camera = posts(count)
    settings = gh.Settings(aa=1, exposure=0.0)
    names = ("position", "normal_geometric", "instance_id", "reflection", "reflection_hit")
    frame = renderer.render(scene, camera, (120, 90), settings, names)
    matt = (frame["instance_id"] != gh.image.NO_ID) & (frame["instance_id"] != 1)
    points, normal = (frame[n].astype(np.float64) for n in ("position", "normal_geometric"))
    want = lit(scene, points[matt], normal[matt])
    off = np.abs(frame["radiance"][matt] - want).max(1) / want.mean()
    say(f"{count} lights: direct off by {np.quantile(off, 0.99):.2e}, more than 1e-5 {(off > 1e-5).mean():.2e}")
    assert matt.sum() > 3000 and want.mean() > 0.05 and (off > 1e-5).mean() < 2e-3  # pixels on a shadow's border
    # What the mirror shows of the floor, found from the length of the mirror ray.
    view = points - camera.world_from_view[:3, 3]
    view /= np.maximum(np.linalg.norm(view, axis=-1, keepdims=True), 1e-9)
    mirrored = view - 2 * (view * normal).sum(-1, keepdims=True) * normal
    with np.errstate(invalid="ignore"):
        met = points + frame["reflection_hit"][..., None] * mirrored
    floor = (frame["instance_id"] == 1) & np.isfinite(met).all(-1) & (np.abs(met[..., 1]) < 1e-4)
    met[..., 1] = 0
    want = lit(scene, met[floor], np.broadcast_to((0.0, 1.0, 0.0), met[floor].shape))
    off = np.abs(frame["reflection"][floor] - want).max(1) / want.mean()
    say(f"{count} lights: mirrored off by {np.quantile(off, 0.99):.2e}, more than 1e-4 {(off > 1e-4).mean():.2e}")
    assert floor.sum() > 500 and want.mean() > 0.05 and (off > 1e-4).mean() < 5e-3
    assert not any("lights" in w for w in frame.receipt["scene"]["warnings"])
    bits = any("SHADOW_BITS" in p for p in frame.receipt["plan"]["programs"] if p.startswith("reflect"))
    assert bits or count > 32


def test_more_than_a_software_device_can_trace_is_said(renderer: gh.Renderer, context: "Context") -> None:
    scene, camera = posts(501)
    for reflections, warned in (("ray-lerp", context.device.software), ("env", False)):
        settings = gh.Settings(aa=1, exposure=0.0, reflections=reflections)
        frame = renderer.render(scene, camera, (8, 6), settings)
        assert any("501 lights" in w for w in frame.receipt["scene"]["warnings"]) == warned
