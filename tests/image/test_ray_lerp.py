"""Kim's lerp of a mirror ray and the blurred sky, term by term, against float64 NumPy."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from analytic import SIZE, draw, lamp_at, material_of
from bars import BARS
from compare import edges
from numpy_brdf import Brdf, dot, specular_albedo, unit
from scene_kit import camera_rays, constant_sky, floor, matte, quad, scene, sun

from glhybrid.scene import Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]


@pytest.mark.parametrize("kind", ["metal", "dielectric", "coat"])
@pytest.mark.parametrize("roughness", [0.0, 0.3, 0.8, 1.0])
@pytest.mark.parametrize("reflections", ["ray-lerp", "env"])
def test_ray_lerp(renderer: "Renderer", kind: str, roughness: float, reflections: str) -> None:
    """Design, section 4: direct x visibility + emission + albedo x irradiance + (F0 scale + F90 bias) x lerp(traced, sky, r)."""
    sky = np.array([0.3, 0.5, 0.8])
    brdf = {
        "metal": Brdf((0.9, 0.6, 0.3), metallic=1.0, roughness=roughness),
        "dielectric": Brdf((0.5, 0.6, 0.2), roughness=roughness),
        "coat": Brdf((0.5, 0.6, 0.2), roughness=0.9, clearcoat=0.8, clearcoat_roughness=roughness),
    }[kind]
    if kind == "coat" and roughness >= 0.9:
        brdf = brdf.replace(clearcoat_roughness=0.95)  # the rougher of the two: then the base leads
    glow = np.array([0.1, 0.0, 0.05])
    wall_color = np.array([0.8, 0.3, 0.2])
    light = sun((0.2, -1.0, -0.5), 3.0)
    wall = quad([(-0.6, 0, -1), (0.6, 0, -1), (0.6, 0.6, -1), (-0.6, 0.6, -1)])
    world = scene(
        [(floor(), material_of(brdf, emissive=tuple(glow.tolist()), double_sided=True)), (wall, matte(wall_color))],
        Camera.look_at((0, 1.0, 2.5), (0, 0.2, -0.5), fov_y=0.6), lights=[light], environment=constant_sky(sky),
    )  # fmt: skip
    frame = draw(renderer, world, "position", "visibility", "instance_id", reflections=reflections)
    seen = (frame["instance_id"] == 0) & ~edges(frame["instance_id"], frame["visibility"])
    p = frame["position"].astype(np.float64)[seen]
    v = unit(camera_rays(world, SIZE).origin[seen] - p)
    n = np.array([0, 1.0, 0])
    mirror = 2 * dot(n, v)[:, None] * n - v
    # The wall's plane is z = -1; it is lit by sun and sky and has no specular lobe.
    t = (-1 - p[:, 2]) / mirror[:, 2]
    at = p + t[:, None] * mirror
    met = (t > 0) & (np.abs(at[:, 0]) < 0.6) & (at[:, 1] < 0.6)
    border = np.minimum(np.abs(np.abs(at[:, 0]) - 0.6), np.abs(at[:, 1] - 0.6)) < 1e-3
    wall_light = wall_color * (np.clip(-np.asarray(light.direction)[2], 0, None) * 3.0 / np.pi + sky)
    traced = np.where(met[:, None], wall_light, sky)
    if reflections == "env":
        traced = np.broadcast_to(sky, traced.shape)
    cos = v[:, 1]
    grid = np.linspace(cos.min() - 1e-3, min(cos.max() + 1e-3, 1), 24)

    def table(r: float) -> "F64":
        rows = np.array([specular_albedo(float(c), max(r * r, 4e-4)) for c in grid])
        return np.stack([np.interp(cos, grid, rows[:, k]) for k in (0, 1)], -1)[:, :, None]

    base = np.asarray(brdf.base_color)
    irradiance, to = lamp_at(light, p)
    lit = frame["visibility"][seen]
    total = brdf.times_cosine(n, v, to) * irradiance * lit
    if brdf.roughness == 0:  # an exact mirror shows no lamp, and nothing but Fresnel
        f_dielectric, f_metal = brdf.fresnel(cos)
        diffuse = (1 - brdf.fresnel(dot(v, unit(v + to)))[0].max(-1))[:, None] * (1 - brdf.metallic) * base / np.pi
        total = diffuse * to[:, 1:2] * irradiance * lit
        specular = f_dielectric + (f_metal - f_dielectric) * brdf.metallic
        shown = traced
    else:
        ab = table(brdf.roughness)
        f0 = brdf.f0 + (base - brdf.f0) * brdf.metallic
        f90 = brdf.specular + (1 - brdf.specular) * brdf.metallic
        specular = f0 * ab[:, 0] + f90 * ab[:, 1]
        shown = traced + (sky - traced) * brdf.roughness
    ambient = base * (1 - brdf.metallic) * sky + specular * shown
    emission: Any = glow
    if brdf.clearcoat:
        f = brdf.coat_fresnel(cos)[:, None]
        ambient = ambient * (1 - f) + f * (traced + (sky - traced) * brdf.clearcoat_roughness)
        emission = glow * (1 - f)
        if brdf.clearcoat_roughness < 0.02:  # no highlight from lamps in an exact mirror: only what the coat takes
            total = brdf.replace(clearcoat=0.0).times_cosine(n, v, to) * irradiance * lit * (1 - f)
    want = total + emission + ambient
    error = np.abs(frame["radiance"][seen] - want).max(-1) / want.mean()
    share = (error[~border] < BARS["ray-lerp"].value).mean()
    print(kind, roughness, reflections, f"largest {error[~border].max():.1e}, walls met {met.mean():.2f}")
    assert met.mean() > 0.1 and (~met).mean() > 0.1 and share == 1, (share, error[~border].max())
