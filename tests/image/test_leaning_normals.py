"""Shading normals that face away from the viewer: turned to the edge, by all who ask alike."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest
from analytic import ASKANCE, SIZE, draw, lamp_at
from numpy_brdf import Brdf, dot, toward_viewer, unit
from scene_kit import camera_rays, constant_sky, floor, metal, plastic, scene, sun

from glhybrid.scene import Camera, Light

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]

ORTHO = Camera("ortho", ASKANCE.world_from_view, fov_y=0, ymag=1.5)


def leaning(x: "F64") -> "F64":
    """Normals along a floor of 8 m, the further back the larger x is. Linear over both triangles: known at every point."""
    near, far = unit([0.0, 1.0, 1.5]), unit([0.0, 0.05, -1.0])
    return np.asarray(unit(near * (4 - x) + far * (4 + x)))


@pytest.mark.parametrize("view", ["perspective", "orthographic", "traced", "mirrored"])
@pytest.mark.parametrize("coat", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_a_normal_that_faces_away_is_turned_to_the_edge(
    renderer: "Renderer", roughness: float, coat: float, view: str
) -> None:
    """Normals that lean ever further back, along a floor that faces the camera: the same turned ones for all who ask.

    They light by lamps, `reference` included, as the formula says; no dark is left under a sky; the rest are as given.
    """
    piece = floor(4.0)
    piece = dataclasses.replace(piece, normal=leaning(piece.position[:, :1]).astype(np.float32))
    material = plastic(roughness=roughness, clearcoat=coat, clearcoat_roughness=0.3)
    pose = np.diag([-1.0, 1.0, 1.0, 1.0]) if view == "mirrored" else np.eye(4)
    camera = ORTHO if view == "orthographic" else ASKANCE
    world = scene([(piece, material, pose)], camera=camera, lights=(sun((0.3, -1.0, 0.4)),))
    rays, how = camera_rays(world, SIZE), {"primary": "trace"} if view == "traced" else {}
    hybrid = draw(renderer, world, "normal", "position", "normal_geometric", **how)
    reference = draw(renderer, world, reflections="reference", samples=1, bounces=0)
    seen = np.isfinite(hybrid["position"]).all(-1) & (np.linalg.norm(hybrid["normal"], axis=-1) > 0)
    v = -rays.direction[seen]
    raw = leaning(hybrid["position"][seen].astype(np.float64)[:, :1] * pose[0, 0])
    n = toward_viewer(raw, v, hybrid["normal_geometric"][seen])
    away = dot(raw, v) < 0
    assert away.mean() > 0.1 and (dot(raw, v) > 0.1).mean() > 0.1
    error = np.abs(hybrid["normal"][seen] - n).max(-1)
    assert error.max() < 2e-6 and (dot(hybrid["normal"][seen], v) > 0).all(), error.max()

    irradiance, to = lamp_at(world.lights[0], hybrid["position"][seen].astype(np.float64))
    brdf = Brdf((0.6, 0.2, 0.1), 0.0, roughness, clearcoat=coat, clearcoat_roughness=0.3)
    want = brdf.times_cosine(n, v, to) * irradiance
    if roughness == 0:  # an exact mirror shows no lamp
        diffuse = (1 - brdf.fresnel(dot(v, unit(v + to)))[0]) * np.array(brdf.base_color) / np.pi
        lobe = brdf.replace(base_color=(0, 0, 0), specular=0.0).times_cosine(n, v, to)
        want = (
            diffuse * np.clip(dot(n, to), 0, None)[:, None] * (1 - brdf.coat_fresnel(dot(n, v)))[:, None] + lobe
        ) * irradiance
    assert (want[away].max(-1) > 0.01).mean() > 0.9
    for name, frame in {"hybrid": hybrid, "reference": reference}.items():
        error = np.abs(frame["radiance"][seen] - want).max(-1) / want.mean()
        print(f"{view} {roughness} {coat} {name}: largest {error.max():.1e}")
        assert error.max() < 1e-4, (name, error.max())

    under_sky = world.replace(lights=(), environment=constant_sky((1.0, 1.0, 1.0)))
    # An edge-on coat takes nearly all light, and `ray-glossy`, as `reference`, drops what it reflects under the floor.
    for reflections in ("ray-lerp", "env", "ray-glossy")[: 2 if coat else 3]:
        frame = draw(renderer, under_sky, reflections=reflections, **how)
        assert frame["radiance"][seen].max(-1).min() > 0.3, reflections


@pytest.mark.parametrize("reflections", ["ray-lerp", "ray-glossy", "reference"])
def test_a_normal_that_faces_away_is_turned_in_a_mirror(renderer: "Renderer", reflections: str) -> None:
    """A ceiling over a mirror, under one lamp: its normals are turned towards the ray from the mirror, by all alike."""
    ceiling = floor(4.0, y=2.0)
    normal = (leaning(ceiling.position[:, :1]) * (1, -1, 1)).astype(np.float32)
    ceiling = dataclasses.replace(ceiling, normal=normal, index=ceiling.index[:, ::-1])
    lamp = Light("point", (1.0, 0.9, 0.8), 20.0, position=(1.5, 0.6, -3.0))
    parts = [(floor(4.0), metal(1.0, 0.0)), (ceiling, plastic(roughness=0.5))]
    world = scene(parts, camera=ASKANCE, lights=(lamp,))
    frame = draw(renderer, world, "instance_id", reflections=reflections, samples=1, bounces=1)
    rays = camera_rays(world, SIZE)
    origin, direction = rays.origin * (1, -1, 1), rays.direction * (1, -1, 1)  # of the mirrored camera
    with np.errstate(divide="ignore"):
        p = origin + direction * ((2 - origin[..., 1:2]) / direction[..., 1:2])
    seen = (frame["instance_id"] == 0) & (direction[..., 1] > 0) & (np.abs(p[..., ::2]) < 3.9).all(-1)
    p, v = p[seen], -direction[seen]
    raw = leaning(p[:, :1]) * (1, -1, 1)
    assert seen.mean() > 0.1 and (dot(raw, v) < 0).mean() > 0.1 and (dot(raw, v) > 0).mean() > 0.1
    n = toward_viewer(raw, v, np.broadcast_to([0.0, -1.0, 0.0], v.shape))
    irradiance, to = lamp_at(lamp, p)
    want = Brdf((0.6, 0.2, 0.1), 0.0, 0.5).times_cosine(n, v, to) * irradiance
    assert (want[dot(raw, v) < 0].max(-1) > 1e-3).mean() > 0.9
    error = np.abs(frame["radiance"][seen] - want).max(-1) / want.mean()
    print(f"{reflections}: largest {error.max():.1e}")
    assert error.max() < 5e-4, error.max()  # float32: an N.V of 0.001 is known to 1e-4 of itself, and lobes steep there
