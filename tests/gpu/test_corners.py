"""Pixel centres exactly in the corners of walls: lit, shadowed and occluded as the open side of the corner is.

A square room seen along its axis has its edges on the picture's diagonals, and blocks stand where the front of each meets
the floor or a wall under the centres of a row or column. Without a step back along the ray that found a point (stand_back
in lib/geometry.glsl) 30 to 250 of 16,384 pixels are black in every case here; 0 is the bar.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from rays import moved, piece, scene_of

import glhybrid as gh
from glhybrid import geometry, reference
from glhybrid.load.shapes import box
from glhybrid.scene import F64, Camera, Environment, Light, Material, Scene

if TYPE_CHECKING:
    from glhybrid.context import Context

SIDE = 128  # pixels
FOV = 1.2
CASES: dict[str, dict[str, Any]] = {
    "axes": {},
    "turned": {"turn": 1},
    "far": {"turn": 1, "place": 1e4},
    "small": {"turn": 2, "size": 1e-3},
    "large": {"turn": 2, "size": 1e3},
    "mirrored": {"turn": 3, "mirrored": True},
    "two-sided, seen from behind": {"turn": 3, "behind": True},
    "corridor": {"turn": 2, "length": 60.0},
}


def room(
    size: float = 1.0,
    place: float = 0.0,
    turn: int = 0,
    mirrored: bool = False,
    behind: bool = False,
    length: float = 6.0,
) -> tuple[Scene, Camera]:
    """behind: the walls' fronts look out, and all is two-sided."""
    shell, eye = box(size=(4, 4, length)), length / 2 - 0.1
    pieces, poses = [piece(shell.position, shell.index if behind else shell.index[:, ::-1])], [np.eye(4)]
    for row, x, width, height in ((6.5, -1.2, 0.7, 0.4), (14.5, 0.2, 0.8, 0.9), (30.5, 1.3, 0.5, 1.5)):
        front = eye - 2 / (np.tan(FOV / 2) * (1 - 2 * row / SIDE))
        on_floor, on_wall = box(size=(width, height, 0.5)), box(size=(height, width, 0.5))
        pieces += [piece(on_floor.position, on_floor.index), piece(on_wall.position, on_wall.index)]
        poses += [moved((x, height / 2 - 2, front - 0.25)), moved((2 - height / 2, x + 0.4, front - 0.55))]
    linear = size * (ray.rotation(np.random.default_rng(turn)) if turn else np.eye(3))
    whole = moved(place * np.array([0.6, -0.3, 0.7]), linear @ np.diag([-1.0 if mirrored else 1.0, 1, 1]))
    scene = scene_of(*pieces, poses=[whole @ p for p in poses], materials=(Material(double_sided=behind),))

    def at(p: Any) -> tuple[float, ...]:
        return tuple((whole[:3, :3] @ p + whole[:3, 3]).tolist())

    lamp = Light("point", position=at((0.3, 1.7, eye - 2)), intensity=10 * size * size)  # type: ignore[arg-type]
    up = tuple(ray.unit(linear[:, 1]).tolist())
    camera = Camera.look_at(at((0, 0, eye)), at((0, 0, -length / 2)), up=up, fov_y=FOV, near=1e-3 * size)  # type: ignore[arg-type]
    return scene.replace(lights=(lamp,), environment=Environment(np.zeros((1, 1, 3), np.float32))), camera


def pixel_rays(camera: Camera) -> F64:
    """(SIDE * SIDE, 3) unit directions through pixel centres, row 0 at the top."""
    across = ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1) * np.tan(FOV / 2)
    x, y = np.meshgrid(across, -across)
    return ray.unit(np.stack([x, y, -np.ones_like(x)], -1)).reshape(-1, 3) @ camera.world_from_view[:3, :3].T


def seen(scene: Scene, camera: Camera) -> tuple[Any, Any, F64]:
    """What is surely lit and surely not: points a thousandth to a millionth before the surface agree. And to the lamp."""
    eye = camera.world_from_view[:3, 3]
    corners = ray.world_triangles(geometry.build(scene, 2, tangents=False, attributes=False), eye)[0]
    directions = pixel_rays(camera)
    t = reference.closest_hit(corners, np.zeros(3), directions).t[:, None]
    to_lamp = np.asarray(scene.lights[0].position) - eye - directions * t
    blocked = [
        reference.any_hit(corners, directions * t * (1 - back), to_lamp + directions * t * back, 0.0, 1.0)
        for back in (1e-6, 1e-5, 1e-4, 1e-3)
    ]
    return ~np.any(blocked, 0), np.all(blocked, 0), to_lamp / np.linalg.norm(to_lamp, axis=1, keepdims=True)


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("case", CASES)
def test_corners_are_lit_from_their_open_side(
    renderer: gh.Renderer, context: "Context", case: str, levels: Any
) -> None:
    scene, camera = room(**CASES[case])
    lit, dark, to_lamp = seen(scene, camera)
    for primary in ("raster", "trace"):
        settings = gh.Settings(aa=1, exposure=0.0, levels=levels, primary=primary)
        frame = renderer.render(scene, camera, (SIDE, SIDE), settings, ("visibility", "normal_geometric"))
        facing = (frame["normal_geometric"].reshape(-1, 3) * to_lamp).sum(-1) > 1e-3
        arrives = frame["visibility"].reshape(-1)
        assert (lit & facing).sum() > 15000 and (dark & facing).sum() > 300
        assert (arrives[lit & facing] == 1).all(), (primary, int((arrives[lit & facing] == 0).sum()))
        assert (arrives[dark & facing] == 0).all(), (primary, int((arrives[dark & facing] == 1).sum()))


def test_the_reference_lights_corners(renderer: gh.Renderer, context: "Context") -> None:
    """Its direct light at the first surface."""
    scene, camera = room(turn=1)
    lit, _, to_lamp = seen(scene, camera)
    settings = gh.Settings(aa=1, exposure=0.0, reflections="reference", samples=1, bounces=0)
    frame = renderer.render(scene, camera, (SIDE, SIDE), settings, ("radiance", "normal_geometric"))
    facing = (frame["normal_geometric"].reshape(-1, 3) * to_lamp).sum(-1) > 1e-3
    assert (frame["radiance"].reshape(-1, 3)[lit & facing].min(-1) > 0).all()


def test_corners_are_half_open(renderer: gh.Renderer, context: "Context") -> None:
    """Of the sky over a wall another hides half where they meet at right angles; a corner under its plane has none left."""
    for case in ("axes", "turned"):
        scene, camera = room(**CASES[case])
        sky = Environment(np.ones((1, 1, 3), np.float32))
        settings = gh.Settings(aa=1, exposure=0.0, ao="ray", samples=64, parameters={"ao.ray.radius": 0.5})
        frame = renderer.render(scene.replace(environment=sky), camera, (SIDE, SIDE), settings, ("occlusion",))
        corners = np.diagonal(frame["occlusion"][..., 0] if frame["occlusion"].ndim == 3 else frame["occlusion"])[8:28]
        assert abs(corners.mean() - 0.5) < 0.05 and corners.min() > 0.3


@pytest.mark.parametrize("levels", [1, 2])
def test_a_lamp_on_a_surface_is_in_its_shadow_everywhere(
    renderer: gh.Renderer, context: "Context", levels: Any
) -> None:
    """Whichever way rounding goes: a shadow ray that ended exactly at the lamp would meet the surface here and not there."""
    floor, lid = box(size=(6, 0.2, 6)), box(size=(6, 0.3, 6))
    height = 1.7 + 0.1  # of the lid's underside, no round number
    scene = scene_of(
        floor, lid, poses=[moved((0, -0.1, 0)), moved((0, height + 0.15, 0))], materials=(Material(double_sided=True),)
    )
    lamp = Light("point", intensity=10.0, position=(0.31, height, -0.17))
    camera = Camera.look_at((2.5, 1.0, 2.5), (0, 0, 0))
    settings = gh.Settings(aa=1, exposure=0.0, levels=levels)
    frame = renderer.render(scene.replace(lights=(lamp,)), camera, (SIDE, SIDE), settings, ("visibility", "position"))
    on_floor = (np.abs(frame["position"][..., 1]) < 1e-3) & np.isfinite(frame["position"]).all(-1)
    assert on_floor.sum() > 2000
    assert frame["visibility"][on_floor].mean() < 0.01
