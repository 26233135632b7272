"""What the hybrid draws, feature by feature, against float64 NumPy: lamps, layers, maps, lobes, and Kim's lerp."""

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from compare import edges, relative
from numpy_brdf import Brdf, dot, specular_albedo, toward_viewer, unit
from scene_kit import box, camera_rays, constant_sky, floor, matte, metal, plastic, quad, scene, sun, texture
from texture_oracle import linear, sampled, transformed

from glhybrid.scene import Camera, Light, Material, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.image import Frame
    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]

SIZE = (64, 48)
DOWN = Camera.look_at((0, 3, 0.001), (0, 0, 0), (0, 0, -1), fov_y=np.radians(50))
ASKANCE = Camera.look_at((0.5, 1.2, 3.0), (0, 0.2, 0), fov_y=np.radians(45))


def draw(renderer: "Renderer", world: Scene, *aovs: str, size: tuple[int, int] = SIZE, **settings: Any) -> "Frame":
    return renderer.render(world, size=size, settings=Settings(**({"aa": 1} | settings)), aovs=aovs)


def lamp_at(light: Light, position: "F64") -> "tuple[F64, F64]":
    """Irradiance facing the light (..., 3) and the unit direction to it, by KHR_lights_punctual."""
    color = np.asarray(light.color) * light.intensity
    axis = unit(light.direction)
    if light.kind == "directional":
        return np.broadcast_to(color, position.shape), np.broadcast_to(-axis, position.shape)
    to = np.asarray(light.position) - position
    d = np.linalg.norm(to, axis=-1)
    to /= d[..., None]
    falloff = 1 / d**2
    if light.range > 0:
        falloff *= np.clip(1 - (d / light.range) ** 4, 0, 1)
    if light.kind == "spot":
        inner, outer = np.cos(light.inner_cone), np.cos(light.outer_cone)
        scale = 1 / max(0.001, inner - outer)
        falloff *= np.clip(dot(-to, axis) * scale - outer * scale, 0, 1) ** 2
    return color * falloff[..., None], to


def on_floor(rays: Any) -> "dict[str, F64]":
    """What `direct` reads of a frame, for an unshadowed floor at y = 0: no AOV needed."""
    p = rays.origin - rays.direction * (rays.origin[..., 1:2] / rays.direction[..., 1:2])
    up = np.zeros_like(p)
    up[..., 1] = 1
    return {"position": p, "normal": up, "visibility": np.ones((*p.shape[:2], 8))}


def direct(frame: Any, world: Scene, brdf: Brdf, origin: "F64", normal: "F64 | None" = None, **given: Any) -> "F64":
    """Direct light of all lamps on the frame's surface points, shadows from its `visibility`."""
    p = frame["position"].astype(np.float64)
    n = frame["normal"].astype(np.float64) if normal is None else normal
    v = unit(origin - p)
    total = np.zeros_like(p)
    for i, light in enumerate(world.lights):
        irradiance, to = lamp_at(light, p)
        total += brdf.times_cosine(n, v, to, **given) * irradiance * frame["visibility"][..., i : i + 1]
    return total


LAMPS = {
    "point": Light("point", (1.0, 0.7, 0.4), 5.0, position=(0.3, 1.1, 0.2)),
    "point with range": Light("point", (1.0, 1.0, 1.0), 5.0, position=(0.3, 1.1, 0.2), range=1.8),
    "spot": Light("spot", (0.5, 1.0, 1.0), 9.0, position=(-0.4, 1.5, 0.3), direction=(0.196116, -0.980581, 0.0),
                  inner_cone=0.2, outer_cone=0.6),
    "hard spot": Light("spot", (1.0, 1.0, 1.0), 9.0, position=(0.0, 1.5, 0.0), inner_cone=0.4, outer_cone=0.4),
    "spot with range": Light("spot", (1.0, 1.0, 1.0), 9.0, position=(0.0, 1.5, 0.0), inner_cone=0.0, outer_cone=0.7,
                             range=1.9),
    "sun": sun((0.3, -1, 0.2), 4.0, (1.0, 0.9, 0.8)),
}  # fmt: skip


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


def material_of(brdf: Brdf, **more: Any) -> Material:
    names = ("metallic", "roughness", "ior", "specular", "clearcoat", "clearcoat_roughness", "transmission")
    fields = {name: float(getattr(brdf, name)) for name in names}
    r, g, b = (float(c) for c in np.broadcast_to(brdf.base_color, 3))
    color = tuple(float(c) for c in np.broadcast_to(brdf.specular_color, 3))
    return Material("given", (r, g, b, 1.0), specular_color=color, **(fields | more))  # type: ignore[arg-type]


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


def unlit(color: Any, alpha: float = 1.0, **more: Any) -> Material:
    r, g, b = color
    mode = {"alpha_mode": "BLEND"} if alpha < 1 else {}
    return Material("unlit", (r, g, b, alpha), unlit=True, double_sided=True, **(mode | more))


def card(z: float, half: float = 1.0) -> Any:
    return quad([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)])


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
@pytest.mark.parametrize("through", ["camera", "mirror", "reference"])
def test_layers_are_in_order(renderer: "Renderer", order: tuple[int, ...], through: str) -> None:
    """Three blended cards before a wall: the nearest first, in whatever order the file has them."""
    colors = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    alphas = (0.5, 0.25, 0.6)
    layers = [(card(z), unlit(colors[i], alphas[i])) for i, z in enumerate((1.0, 0.5, 0.0))]
    parts = [*(layers[i] for i in order), (card(-1.0, 9), unlit((1.0, 1.0, 1.0)))]
    camera = Camera.look_at((0, 0, 4), (0, 0, 0), fov_y=0.2)
    if through == "mirror":
        parts.append((card(6.0, 9), metal(1.0, 0.0)))
        camera = Camera.look_at((0, 0, 4), (0, 0, 6), fov_y=0.05)
    settings = {"reflections": "reference", "samples": 4096} if through == "reference" else {}
    got = draw(renderer, scene(parts, camera), size=(8, 8), **settings)["radiance"].astype(np.float64)
    want, left = np.zeros(3), 1.0
    for color, alpha in zip(colors, alphas, strict=True):
        want, left = want + left * alpha * np.array(color), left * (1 - alpha)
    want += left
    if through == "reference":  # coverage is drawn at random: 64 pixels of 4096 paths
        assert np.abs(got.mean((0, 1)) - want).max() < 0.005
    else:
        assert np.allclose(got, want, atol=1e-5), (got[4, 4], want)


PANES: dict[str, Any] = {
    "a third there": (matte((1.0, 0.5, 0.2), alpha=0.4, alpha_mode="BLEND"), 0.6),
    "opaque": (matte((1.0, 0.5, 0.2)), 0.0),
    "cut out": (matte((1.0, 0.5, 0.2), alpha=0.4, alpha_mode="MASK"), 1.0),
    "stained": (matte((1.0, 0.5, 0.2), transmission=0.8), np.array([0.8, 0.4, 0.16])),
    "glass": (plastic((1.0, 0.9, 0.8), 0.0, transmission=1.0), np.array([1.0, 0.9, 0.8]) * 0.96),
    "metal": (metal((1.0, 0.9, 0.8), 0.3, transmission=1.0), 0.0),
    "coated glass": (plastic((1.0, 0.9, 0.8), 0.0, transmission=1.0, clearcoat=0.5), np.array([1.0, 0.9, 0.8]) * 0.96 * 0.98),
    "half glass": (plastic((1.0, 0.9, 0.8), 0.0, transmission=1.0, alpha=0.5, alpha_mode="BLEND"),
                   0.5 + 0.5 * 0.96 * np.array([1.0, 0.9, 0.8])),
}  # fmt: skip


@pytest.mark.parametrize("name", PANES)
@pytest.mark.parametrize("reflections", ["none", "reference"])
def test_shadows_of_panes(renderer: "Renderer", name: str, reflections: str) -> None:
    """What a pane lets through of the sun, once and twice: coverage, tint, Fresnel; the same in hybrid and reference."""
    pane, tint = PANES[name]
    for count in (1, 2):
        panes = [(floor(0.8, 1.0 + 0.1 * k), pane) for k in range(count)]
        # The camera looks in under the panes.
        camera = Camera.look_at((0, 0.5, 3), (0, 0, 0), fov_y=0.3)
        world = scene([(floor(), matte(0.8)), *panes], camera, lights=[sun((0, -1, 0), np.pi)])
        frame = draw(renderer, world, "position", reflections=reflections, samples=1, bounces=0, size=(32, 24))
        p = frame["position"]
        bottom = p.any(-1) & (np.abs(p[..., 1]) < 0.01)
        under = (np.abs(p[..., 0]) < 0.78) & (np.abs(p[..., 2]) < 0.78) & bottom
        away = ((np.abs(p[..., 0]) > 0.82) | (np.abs(p[..., 2]) > 0.82)) & bottom
        assert under.sum() > 50 and away.sum() > 50
        want = 0.8 * np.broadcast_to(tint, 3) ** count
        assert np.allclose(frame["radiance"][under], want, atol=1e-3), (count, frame["radiance"][under][0], want)
        assert np.allclose(frame["radiance"][away], 0.8, atol=1e-5)


@pytest.mark.parametrize("mu", [1.0, 0.5, 0.2])
def test_glass_neither_takes_nor_gives(renderer: "Renderer", mu: float) -> None:
    """A white pane in a sky of 1, smooth and thin: what it reflects and what it lets through add up to 1 at any angle."""
    glass = plastic((1.0, 1.0, 1.0), 0.0, transmission=1.0, ior=1.8)
    toward = np.array([0, mu, np.sqrt(1 - mu**2)])
    pose = Camera.look_at(tuple(5 * toward), (0, 0, 0), (0, 0, -1)).world_from_view
    world = scene([(floor(9.0), glass)], Camera("ortho", pose, fov_y=0, ymag=0.5), environment=constant_sky(1.0))
    assert np.abs(draw(renderer, world, size=(8, 8))["radiance"] - 1).max() < 1e-5
    exact = draw(renderer, world, size=(16, 16), reflections="reference", samples=256)["radiance"]
    assert np.abs(exact - 1).max() < 1e-5, "each path ends in the same sky, whichever way it went"


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
