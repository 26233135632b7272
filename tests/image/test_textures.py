"""Maps of materials, texel by texel, against float64 NumPy: normals, colours, every slot, vertex colours."""

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from analytic import DOWN, SIZE, direct, draw, on_floor
from bars import BARS
from compare import relative
from numpy_brdf import Brdf, unit
from scene_kit import camera_rays, constant_sky, floor, plastic, quad, scene, sun, texture
from texture_oracle import linear, sampled, transformed

from glhybrid.scene import Camera

if TYPE_CHECKING:
    from glhybrid.image import Frame
    from glhybrid.renderer import Renderer


def tilt(x: float, y: float) -> tuple[int, int, int]:
    """Texel of a tangent-space normal."""
    n = unit([x, y, 1.0])
    r, g, b = (int(c) for c in np.round((n * 0.5 + 0.5) * 255))
    return r, g, b


@pytest.mark.parametrize("scale", [1.0, 0.5, -1.0])
@pytest.mark.parametrize("pose", ["plain", "turned", "mirrored", "squashed"])
def test_normal_map(renderer: "Renderer", scale: float, pose: str) -> None:
    """A map of one tilt: the normal is T x + B y + N z with +X along u and +Y against v, whatever the instance's transform."""
    texel = tilt(0.3, 0.2)
    normal_map = texture(np.tile(np.array(texel, np.uint8), (2, 2, 1)))
    placement = {
        "plain": np.eye(4),
        "turned": np.array([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]]),
        "mirrored": np.diag([-1.0, 1, 1, 1]),
        "squashed": np.diag([0.5, 1, 2, 1.0]),
    }[pose]
    material = plastic((0.6, 0.6, 0.6), 0.6, textures={"normal": normal_map}, normal_scale=scale)
    world = scene([(floor(), material, placement)], DOWN, lights=[sun((0.4, -1, 0.3))])
    frame = draw(renderer, world, "position", "normal", "normal_geometric", "visibility", reflections="none")
    m = np.array(texel) / 255 * 2 - 1
    t = unit(placement[:3, :3] @ (1, 0, 0))
    n = np.array([0, 1.0, 0])
    b = unit(placement[:3, :3] @ (0, 0, -1))  # up in the texture: against v, which runs along +Z
    want = unit(m[0] * scale * t + m[1] * scale * b + m[2] * n)
    assert np.abs(frame["normal"] - want).max() < BARS["normal"].value, (frame["normal"][0, 0], want)
    assert np.abs(frame["normal_geometric"] - n).max() < BARS["normal"].value
    shaded = direct(
        frame,
        world,
        Brdf((0.6,) * 3, roughness=0.6),
        camera_rays(world, SIZE).origin,
        np.broadcast_to(want, (48, 64, 3)),
    )
    assert relative(frame["radiance"], shaded).max() < BARS["analytic light"].value


def test_normal_map_from_behind(renderer: "Renderer") -> None:
    """Seen from behind, the whole frame turns over: normals point towards the viewer, tilted to the same world side."""
    normal_map = texture(np.tile(np.array(tilt(0.3, 0.0), np.uint8), (2, 2, 1)))
    card = quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    material = plastic(textures={"normal": normal_map})
    for z in (3, -3):
        world = scene([(card, material)], Camera.look_at((0, 0, z), (0, 0, 0)), lights=[sun()])
        frame = draw(renderer, world, "normal")
        x, _, n_z = frame["normal"][24, 32]
        assert np.sign(n_z) == np.sign(z) and np.sign(x) == np.sign(z), frame["normal"][24, 32]


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
@pytest.mark.parametrize("nearest", [True, False])
def test_textures(renderer: "Renderer", wrap: str, nearest: bool) -> None:
    """A 5 x 3 texture, 2.5 times over a floor, sRGB, moved by KHR_texture_transform: against NumPy at every pixel."""
    rng = np.random.default_rng(6)
    texels = rng.integers(0, 256, (3, 5, 3)).astype(np.uint8)
    c, s = np.cos(0.4), np.sin(0.4)
    transform = np.array([[c * 2.5, s * 1.5, 0.3], [-s * 2.5, c * 1.5, -0.2]])
    look = texture(texels, wrap_u=wrap, wrap_v="repeat", nearest=nearest, uv_transform=transform)
    world = scene([(floor(2.0), plastic((0.9, 0.8, 0.7), 1.0, textures={"base_color": look}))], DOWN, lights=[sun()])
    frame = draw(renderer, world, "position", "albedo")
    p = frame["position"].astype(np.float64)
    uv = np.stack([p[..., 0] / 4 + 0.5, p[..., 2] / 4 + 0.5], -1)
    uv = transformed(look, uv.reshape(-1, 2)).reshape(uv.shape)
    want = sampled(look, linear(look.image.texels, srgb=True), uv.reshape(-1, 2)).reshape(*uv.shape[:2], 4)
    want = want[..., :3] * (0.9, 0.8, 0.7)
    error = np.abs(frame["albedo"] - want).max(-1)
    if nearest:  # a texel's border is a step: float32 may fall on the other side
        step = np.abs(uv * (5, 3) - np.round(uv * (5, 3))).min(-1) < 1e-4
        error = error[~step]
    assert error.max() < BARS["albedo"].value, error.max()


def test_minified_texture_is_its_mean(renderer: "Renderer") -> None:
    """A fine black and white checker, far away, is linear 0.5 (not sRGB 0.5), without moire."""
    checker = (np.indices((256, 256)).sum(0) % 2 * 255).astype(np.uint8)
    look = texture(checker, mipmap=True)
    world = scene([(floor(2.0), plastic((1, 1, 1), 1.0, textures={"base_color": look}))], DOWN, lights=[sun()])
    albedo = draw(renderer, world, "albedo", size=(24, 18))["albedo"]
    assert np.abs(albedo - 0.5).max() < 0.01


def test_every_slot(renderer: "Renderer") -> None:
    """Each texture slot reads its own channels, in its own encoding, and multiplies its factor."""
    rgba = np.array([[[200, 100, 50, 128]]], np.uint8)
    linear, decoded = rgba[0, 0] / 255, np.append(((rgba[0, 0, :3] / 255 + 0.055) / 1.055) ** 2.4, 128 / 255)

    size = (16, 12)

    def with_texture(slot: str, *aovs: str, **factors: Any) -> "Frame":
        material = plastic((0.8, 0.8, 0.8), 0.9, textures={slot: texture(rgba)}, **factors)
        world = scene([(floor(), material)], DOWN, lights=[sun((0.3, -1, 0.2))], environment=constant_sky(0.5))
        return draw(renderer, world, *aovs, reflections="none", size=size)

    assert np.allclose(with_texture("base_color", "albedo")["albedo"], 0.8 * decoded[:3], atol=2e-6)
    frame = with_texture("metallic_roughness", "roughness", "metallic", metallic=0.7)
    assert np.allclose(frame["roughness"], 0.9 * linear[1], atol=1e-6)
    assert np.allclose(frame["metallic"], 0.7 * linear[2], atol=1e-6)
    assert np.allclose(
        with_texture("emissive", "emissive", emissive=(2.0, 3.0, 4.0))["emissive"], decoded[:3] * (2, 3, 4), atol=1e-5
    )
    base = Brdf((0.8,) * 3, roughness=0.9)
    sky = 0.5 * 0.8
    for slot, factors, brdf, occlusion in (
        ("occlusion", {"occlusion_strength": 0.6}, base, 1 + 0.6 * (linear[0] - 1)),
        ("specular", {"specular": 0.9}, base.replace(specular=0.9 * linear[3]), 1.0),
        ("specular_color", {"specular_color": (0.5, 1.0, 1.0)}, base.replace(specular_color=decoded[:3] * (0.5, 1, 1)), 1.0),
        ("clearcoat", {"clearcoat": 0.8, "clearcoat_roughness": 0.3},
         base.replace(clearcoat=0.8 * linear[0], clearcoat_roughness=0.3), 1.0),
        ("clearcoat_roughness", {"clearcoat": 0.8, "clearcoat_roughness": 0.9},
         base.replace(clearcoat=0.8, clearcoat_roughness=0.9 * linear[1]), 1.0),
    ):  # fmt: skip
        frame = with_texture(slot, **factors)
        world = scene([(floor(), plastic())], DOWN, lights=[sun((0.3, -1, 0.2))])
        rays = camera_rays(world, size)
        points = on_floor(rays)
        v = -rays.direction
        under = 1 - brdf.coat_fresnel(v[..., 1])[..., None] if brdf.clearcoat else 1.0
        want = direct(points, world, brdf, rays.origin) + sky * occlusion * under
        assert relative(frame["radiance"], want).max() < BARS["analytic light"].value, slot


def test_vertex_colours(renderer: "Renderer") -> None:
    """COLOR_0 multiplies the base colour, interpolated in linear light; alpha too."""
    square = floor(2.0)
    colors = np.array([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1), (1, 1, 0.5, 1)], np.float32)
    world = scene([(dataclasses.replace(square, color=colors), plastic((0.5, 1.0, 0.8), 1.0))], DOWN, lights=[sun()])
    frame = draw(renderer, world, "albedo", "position")
    p = frame["position"].astype(np.float64)
    u, v = p[..., 0] / 4 + 0.5, 0.5 - p[..., 2] / 4  # corners: (0, 0), (1, 0), (1, 1), (0, 1)
    c = colors[:, :3].astype(np.float64)
    first = (1 - u)[..., None] * c[0] + (u - v)[..., None] * c[1] + v[..., None] * c[2]
    second = (1 - v)[..., None] * c[0] + u[..., None] * c[2] + (v - u)[..., None] * c[3]
    want = np.where((u >= v)[..., None], first, second) * (0.5, 1.0, 0.8)
    assert np.abs(frame["albedo"] - want).max() < BARS["albedo"].value
