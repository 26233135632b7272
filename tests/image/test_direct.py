"""Lamps, lobes and emission, as the hybrid draws them, against float64 NumPy."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest
from analytic import ASKANCE, DOWN, LAMPS, SIZE, direct, draw, material_of
from bars import BARS
from compare import edges, relative
from numpy_brdf import Brdf, dot, unit
from scene_kit import box, camera_rays, floor, matte, metal, plastic, scene, sun

from glhybrid.scene import Camera, Sphere

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer


@pytest.mark.parametrize("names", [(n,) for n in LAMPS] + [tuple(LAMPS)])
def test_lamps(renderer: "Renderer", names: tuple[str, ...]) -> None:
    """Every kind of lamp, and all six at once, on a rough dielectric."""
    brdf = Brdf((0.8, 0.5, 0.3), roughness=0.5)
    world = scene([(floor(), plastic(brdf.base_color, 0.5))], DOWN, lights=[LAMPS[n] for n in names])
    frame = draw(renderer, world, "position", "normal", "visibility", reflections="none")
    rays = camera_rays(world, SIZE)
    lit = frame["visibility"].max(-1) > 0
    assert lit.mean() > 0.05
    want = direct(frame, world, brdf, rays.origin)
    # A light that no longer arrives may still be "visible" at its rim; both are then 0.
    bar = BARS["analytic light" if renderer.context.device.software else "analytic light, GPU"]
    assert relative(frame["radiance"], want).max() < bar.value
    if names == ("spot",):
        assert not frame["visibility"][..., 0].all(), "the cone must end within the picture"


MATERIALS = {
    "specular 0.3": Brdf((0.5, 0.3, 0.7), roughness=0.3, specular=0.3),
    "specular colour": Brdf((0.5, 0.3, 0.7), roughness=0.3, specular_color=(1.0, 0.2, 0.1)),
    "specular colour over 1": Brdf((0.5, 0.3, 0.7), roughness=0.3, ior=1.8, specular_color=(20.0, 1.0, 0.5), specular=0.8),
    "ior 2.4": Brdf((0.5, 0.3, 0.7), roughness=0.4, ior=2.4),
    "ior 1": Brdf((0.5, 0.3, 0.7), roughness=0.4, ior=1.0),
    "coat": Brdf((0.7, 0.1, 0.1), metallic=0.5, roughness=0.7, clearcoat=0.9, clearcoat_roughness=0.2),
    "mirror coat": Brdf((0.7, 0.1, 0.1), roughness=0.7, clearcoat=1.0, clearcoat_roughness=0.0),
    "all": Brdf((0.7, 0.4, 0.1), metallic=0.3, roughness=0.5, ior=1.3, specular=0.9, specular_color=(0.2, 1, 1), clearcoat=0.4,
                clearcoat_roughness=0.6),
}  # fmt: skip


@pytest.mark.parametrize("name", MATERIALS)
def test_extensions(renderer: "Renderer", name: str) -> None:
    """KHR_materials_specular, ior and clearcoat on a ball in the sun and a lamp."""
    brdf = MATERIALS[name]
    world = scene(
        [(Sphere(1.0), material_of(brdf), (0, 0.5, 0))], ASKANCE, lights=[sun((-0.5, -0.6, -1)), LAMPS["point"]]
    )
    frame = draw(renderer, world, "position", "normal", "visibility", "instance_id", reflections="none")
    want = direct(
        frame,
        world,
        brdf.replace(clearcoat_roughness=brdf.clearcoat_roughness or 1e-9),
        camera_rays(world, SIZE).origin,
    )
    if (
        brdf.clearcoat_roughness == 0 and brdf.clearcoat > 0
    ):  # an exact mirror shows no lamp: only what it takes is left
        frame_v = unit(camera_rays(world, SIZE).origin - frame["position"])
        bare = direct(frame, world, brdf.replace(clearcoat=0.0), camera_rays(world, SIZE).origin)
        want = bare * (1 - brdf.coat_fresnel(dot(frame["normal"], frame_v)))[..., None]
    hit = frame["instance_id"] == 0
    error = relative(np.where(hit[..., None], frame["radiance"], 0), np.where(hit[..., None], want, 0))
    assert hit.mean() > 0.2 and error.max() < BARS["analytic light"].value, error.max()


def test_emission(renderer: "Renderer") -> None:
    """Emission adds to light, is seen in mirrors, and lies under a clearcoat."""
    plain = matte(0.0, emissive=(2.0, 1.0, 0.5))
    world = scene([(floor(), plain)], DOWN)
    assert np.allclose(draw(renderer, world)["radiance"], (2.0, 1.0, 0.5), rtol=1e-6)
    coated = scene([(floor(), dataclasses.replace(plain, clearcoat=1.0, clearcoat_roughness=1.0))], DOWN)
    frame = draw(renderer, coated, "position", reflections="none")
    cos = unit(np.array([0, 3, 0.001]) - frame["position"])[..., 1]
    want = np.array([2.0, 1.0, 0.5]) * (1 - Brdf(clearcoat=1.0).coat_fresnel(cos))[..., None]
    assert relative(frame["radiance"], want).max() < 1e-5
    mirror = scene(
        [(floor(), metal(1.0, 0.0)), (box((-99, 2, -99), (99, 3, 99)), plain)], Camera.look_at((0, 1, 2), (0, 0, 0))
    )
    frame = draw(renderer, mirror, "instance_id")
    near = (frame["instance_id"] == 0) & ~edges(frame["instance_id"])
    assert np.allclose(frame["radiance"][near], (2.0, 1.0, 0.5), rtol=1e-6)
