"""Surfaces and textures against NumPy in float64: points, normals, frames, factors, wrapping, filtering, levels."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from rays import Rays, Tracer, moved, scene_of
from texture_oracle import linear, sampled, transformed

from glhybrid import textures
from glhybrid.load.shapes import torus
from glhybrid.scene import F64, Image, Instance, Material, Mesh, Scene, Sphere, Texture, Triangles

if TYPE_CHECKING:
    from glhybrid.context import Context

FINEST = -1e9
FIELDS: dict[str, tuple[int, Any]] = {
    "position": (0, slice(0, 3)), "offset": (0, 3), "n_geo": (1, slice(0, 3)), "alpha": (1, 3), "n": (2, slice(0, 3)),
    "roughness": (2, 3), "n_coat": (3, slice(0, 3)), "metallic": (3, 3), "base_color": (4, slice(0, 3)),
    "occlusion": (4, 3), "emissive": (5, slice(0, 3)), "unlit": (5, 3), "bary": (6, slice(0, 2)), "met": (6, 3),
    "clearcoat": (7, 0), "clearcoat_roughness": (7, 1), "transmission": (7, 2), "t": (7, 3),
}  # fmt: skip


# --- the oracle ----------------------------------------------------------------------------------------------------


def chain(light: F64) -> list[F64]:
    """Mip levels by a 2x2 mean, each from the one above; sides must be powers of two."""
    levels = [light]
    while max(levels[-1].shape[:2]) > 1:
        c = levels[-1]
        if c.shape[0] > 1:
            c = (c[::2] + c[1::2]) / 2
        if c.shape[1] > 1:
            c = (c[:, ::2] + c[:, 1::2]) / 2
        levels.append(c)
    return levels


def bumps(rng: np.random.Generator, height: int, width: int) -> Image:
    """A map of normals that all point out."""
    texels = rng.integers((64, 64, 190, 0), (192, 192, 256, 256), (height, width, 4))
    return Image(texels.astype(np.uint8))


def picture(rng: np.random.Generator, height: int, width: int) -> Image:
    return Image(rng.integers(0, 256, (height, width, 4)).astype(np.uint8))


# --- textures ------------------------------------------------------------------------------------------------------


def look_up(tracer: Tracer, texture: Texture, slot: str, samples: Any) -> F64:
    """(R, 4) of the GPU's sampler at rows of u, v, log2_area, 0."""
    pages = textures.pack(tracer.geometry.materials)
    srgb = slot in textures.SRGB_SLOTS
    gl, samples = tracer.context.gl, np.ascontiguousarray(samples, np.float32)
    source, target = gl.buffer(samples), gl.buffer(reserve=samples.nbytes)
    uniforms = {"sample_total": len(samples), "texture_row": pages.row_of[id(texture), srgb], "is_srgb": int(srgb)}
    program = tracer.program("sample")
    program.dispatch({**tracer.resources, "Samples": source, "Colors": target, **uniforms}, (len(samples), 1), (64, 1))
    result = np.frombuffer(target.read(), np.float32).reshape(-1, 4).astype(np.float64)
    source.release()
    target.release()
    return result


def textured(*slots: dict[str, Texture]) -> Scene:
    """A triangle for each set of textures."""
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float64)
    pieces = [ray.soup(corners, material=i) for i in range(len(slots))]
    return scene_of(*pieces, materials=[Material(textures=s) for s in slots])


def test_wrapping_filtering_and_transforms(context: "Context") -> None:
    """Every pair of wrap modes, nearest and linear, sRGB and linear slots, odd sizes, far past both ends."""
    rng = np.random.default_rng(2)
    transforms = [None, np.array([[2.5, 0.3, -1.7], [-0.4, 1.5, 0.25]]), np.array([[-1.0, 0, 1], [0, -3.0, 0.5]])]
    made: list[tuple[str, Texture]] = []
    for k, (u, v) in enumerate((u, v) for u in ("repeat", "clamp", "mirror") for v in ("repeat", "clamp", "mirror")):
        for nearest in (False, True):
            size = [(8, 8), (5, 3), (1, 7), (64, 2), (1, 1)][(k + nearest) % 5]
            slot = ("base_color", "metallic_roughness")[(k + nearest) % 2]
            image, move = picture(rng, *size), transforms[k % 3]
            made.append((slot, Texture(image, 0, move, u, v, nearest, mipmap=False)))  # type: ignore[arg-type]
    uv = np.concatenate([rng.uniform(-4, 5, (3000, 2)), rng.uniform(-900, 900, (500, 2)), rng.integers(-3, 4, (50, 2))])
    with Tracer(context, textured(*({slot: texture} for slot, texture in made)), 1) as tracer:
        for slot, texture in made:
            where = transformed(texture, uv.astype(np.float32).astype(np.float64))
            height, width = texture.image.texels.shape[:2]
            # Where a texel's border is nearer than float32's coordinates tell, nearest may take either side.
            border = np.abs(where * (width, height) - np.round(where * (width, height))).min(1)
            sure = (border > 1e-5 * np.abs(where).max(1) * max(width, height) + 1e-4) | (not texture.nearest)
            assert sure.mean() > 0.3
            want = sampled(texture, linear(texture.image.texels, slot == "base_color"), where)
            rows = np.column_stack([uv, np.full(len(uv), FINEST), np.zeros(len(uv))])
            error = np.abs(look_up(tracer, texture, slot, rows) - want).max(1)
            slack = 2e-6 + 4e-7 * np.abs(where).max(1) * max(width, height)  # a coordinate's ulp, in texels
            what = (slot, texture.wrap_u, texture.wrap_v, texture.nearest, (width, height))
            assert (error <= slack)[sure].all(), (what, uv[sure][np.argmax((error - slack)[sure])], error[sure].max())


@pytest.mark.parametrize("slot", ["base_color", "metallic_roughness"])
@pytest.mark.parametrize("size", [(64, 64), (16, 128), (32, 1)])
def test_levels_are_blended_by_the_footprint(context: "Context", slot: str, size: tuple[int, int]) -> None:
    """Trilinear: level = log2 of texels across the footprint, levels averaged as light, each rounded to 8 bits."""
    rng = np.random.default_rng(5)
    texture = Texture(picture(rng, *size))
    levels = chain(linear(texture.image.texels, slot == "base_color"))
    uv = rng.uniform(-2, 3, (3000, 2))
    lod = rng.uniform(-1, len(levels) + 1, 3000)
    rows = np.column_stack([uv, 2 * lod - np.log2(size[0] * size[1]), np.zeros(len(uv))])
    with Tracer(context, textured({slot: texture}), 1) as tracer:
        got = look_up(tracer, texture, slot, rows)
        held = np.clip(lod, 0, len(levels) - 1)
        low = np.minimum(held.astype(int), len(levels) - 1)
        high = np.minimum(low + 1, len(levels) - 1)
        each = np.stack([sampled(texture, level, uv) for level in levels])
        rows_of = np.arange(len(uv))
        between = (held - low)[:, None]
        want = each[low, rows_of] * (1 - between) + each[high, rows_of] * between
        # A level is kept in 8 bits: half a step of sRGB is up to 0.0045 of light, of a linear slot 0.002; times levels.
        assert np.abs(got - want).max() < (0.007 if slot == "base_color" else 0.004)
        fine = held == 0
        assert fine.sum() > 100 and np.abs(got - want)[fine].max() < 1e-4


# --- surfaces ------------------------------------------------------------------------------------------------------


def surfaces(tracer: Tracer, rays: Rays, footprint: Any = 0.0) -> dict[str, F64]:
    """What the GPU says of the nearest hits, by FIELDS, float64; triangle is the row of Geometry.triangles."""
    gl, n = tracer.context.gl, len(rays)
    rows = np.empty((n, 8), np.float32)
    rows[:, :3], rows[:, 3], rows[:, 4:7], rows[:, 7] = rays.origin, footprint, rays.direction, rays.t_max
    source, target = gl.buffer(rows), gl.buffer(reserve=n * 128)
    program = tracer.program("surface")
    program.dispatch({**tracer.resources, "Rays": source, "Surfaces": target, "ray_count": n}, (n, 1), (64, 1))
    data = np.frombuffer(target.read(), np.float32).reshape(n, 8, 4)
    source.release()
    target.release()
    result = {name: data[:, row, part].astype(np.float64) for name, (row, part) in FIELDS.items()}
    result["triangle"] = data[:, 6, 2].copy().view(np.uint32)
    return result


def body(rng: np.random.Generator, material: int = 0) -> Triangles:
    """A smooth torus with texture coordinates, a second set, colours and tangents."""
    made = torus(segments=24, sides=12)
    n = len(made.position)
    uv1, color = rng.uniform(-2, 2, (n, 2)).astype(np.float32), rng.uniform(0, 1, (n, 4)).astype(np.float32)
    assert made.uv0 is not None and made.tangent is not None
    return Triangles(
        made.position, made.index, made.normal, material, made.tangent, made.uv0 * np.float32(3), uv1, color
    )


def oracle(scene: Scene, tracer: Tracer, got: dict[str, F64], rays: Rays) -> dict[str, F64]:
    """The same by the formulas of glTF, from the scene's own arrays: only the triangle met, and where, is taken."""
    assert tracer.geometry.levels == 2 or len(scene.instances) == 1
    instance = scene.instances[0]
    p = scene.meshes[instance.mesh].primitives[0]
    assert isinstance(p, Triangles) and p.uv0 is not None and p.uv1 is not None
    assert p.color is not None and p.tangent is not None
    tangent = p.tangent
    m, pose = scene.materials[p.material], instance.world_from_object
    index = p.index[tracer.geometry.source_triangle[got["triangle"].astype(int)]]
    flipped = np.linalg.det(pose[:3, :3]) < 0
    if flipped and tracer.geometry.levels == 1:
        index = index[:, ::-1]  # one level turns mirrored triangles over
    w = np.column_stack([1 - got["bary"].sum(1), got["bary"]])
    mix = lambda a: np.einsum("rk,rkc->rc", w, np.asarray(a, np.float64)[index])  # noqa: E731
    position = mix(p.position) @ pose[:3, :3].T + pose[:3, 3] - tracer.origin
    corners = p.position.astype(np.float64)[index] @ pose[:3, :3].T
    n_geo = ray.unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    if flipped and tracer.geometry.levels == 2:
        n_geo = -n_geo  # glTF: the winding of a mirrored instance is turned over
    side = np.where((n_geo * rays.direction).sum(1, keepdims=True) > 0, -1.0, 1.0)
    n_front = ray.unit(mix(p.normal) @ np.linalg.inv(pose[:3, :3]))
    uv = {0: mix(p.uv0), 1: mix(p.uv1)}

    def texel(slot: str) -> F64:
        texture = m.textures[slot]
        light = linear(texture.image.texels, slot in textures.SRGB_SLOTS)
        return sampled(texture, light, transformed(texture, uv[texture.uv_set]))

    def mapped(slot: str, scale: float) -> F64:
        t = ray.unit(mix(tangent[:, :3]) @ pose[:3, :3].T)
        sign = np.sign(mix(tangent)[:, 3:]) * (-1 if flipped else 1)
        b = np.cross(n_front, t) * sign
        c = texel(slot)[:, :3] * 2 - 1
        return facing(ray.unit(c[:, :1] * scale * t + c[:, 1:2] * scale * b + c[:, 2:] * n_front) * side)

    def facing(n: F64) -> F64:  # turned, where it faces away, to where N.V is 0.001 or 0.9 of the facet's
        v = -ray.unit(rays.direction)
        least = np.clip(0.9 * (n_geo * side * v).sum(1), 1e-6, 1e-3)
        below = np.maximum(0, least - (n * v).sum(1))
        return np.asarray(ray.unit(n + below[:, None] * v))

    color = np.array(m.base_color) * texel("base_color") * mix(p.color.astype(np.float16))
    return {
        "position": position,
        "n_geo": n_geo * side,
        "n": mapped("normal", m.normal_scale),
        "n_coat": mapped("clearcoat_normal", m.clearcoat_normal_scale),
        "base_color": color[:, :3],
        "roughness": m.roughness * texel("metallic_roughness")[:, 1],
        "metallic": m.metallic * texel("metallic_roughness")[:, 2],
        "occlusion": 1 + m.occlusion_strength * (texel("occlusion")[:, 0] - 1),
        "clearcoat": m.clearcoat * texel("clearcoat")[:, 0],
        "clearcoat_roughness": m.clearcoat_roughness * texel("clearcoat_roughness")[:, 1],
    }


POSES = {
    "plain": np.eye(3),
    "turned": ray.rotation(np.random.default_rng(3)) * 2.5,
    "stretched": ray.rotation(np.random.default_rng(4)) @ np.diag([0.3, 1.0, 2.0]),
    "mirrored": ray.rotation(np.random.default_rng(5)) @ np.diag([-0.7, 1.0, 1.6]),
}


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("pose", POSES)
def test_every_attribute_of_a_hit(context: "Context", pose: str, levels: int) -> None:
    rng = np.random.default_rng(1)
    slots = (
        "base_color",
        "metallic_roughness",
        "normal",
        "occlusion",
        "clearcoat",
        "clearcoat_roughness",
        "clearcoat_normal",
    )
    maps = {s: Texture(picture(rng, 8, 16), uv_set=k % 2, mipmap=False) for k, s in enumerate(slots)}
    maps["clearcoat_normal"] = Texture(bumps(rng, 8, 16), uv_set=1, mipmap=False)
    maps["normal"] = Texture(bumps(rng, 8, 8), uv_transform=np.array([[0, 2.0, 0.1], [-1.5, 0, 0.3]]), mipmap=False)
    material = Material(
        base_color=(0.9, 0.8, 0.7, 0.6), metallic=0.7, roughness=0.8, normal_scale=0.6, occlusion_strength=0.7,
        clearcoat=0.8, clearcoat_roughness=0.5, clearcoat_normal_scale=1.3, double_sided=True, textures=maps,
    )  # fmt: skip
    scene = scene_of(body(rng), poses=[moved((300, -20, 50), POSES[pose])], materials=(material,))
    with Tracer(context, scene, levels) as tracer:
        corners = tracer.triangles()[0]
        rays = ray.camera_rays(corners.min((0, 1)), corners.max((0, 1)), 6000, rng)
        inside = corners[rng.integers(0, len(corners), 800)].mean(1)
        rays = ray.join([rays, Rays.make(inside * 0.7, ray.sphere_directions(rng, 800))])  # backs as well
        got = surfaces(tracer, rays)
        met = got["met"] == 1
        assert met.sum() > 600
        rays, got = rays[met], {k: v[met] for k, v in got.items()}
        want = oracle(scene, tracer, got, rays)
        graze = np.abs((want["n_geo"] * ray.unit(rays.direction)).sum(1)) < 1e-3
        for name, values in want.items():
            error = np.abs(got[name] - values).reshape(len(values), -1).max(1)[~graze]
            assert error.max() < 2e-4, (name, error.max(), np.argmax(error))
            assert np.median(error) < 5e-6, (name, np.median(error))
        assert ((got["n"] * ray.unit(rays.direction)).sum(1) < 1e-6).all()
        assert np.allclose(np.linalg.norm(got["n"], axis=1), 1, atol=1e-5) and (got["alpha"] == 1).all()
        # The point is on its triangle's plane to within the offset that clears it, which is small.
        lift = np.abs(((got["position"] - want["position"]) * want["n_geo"]).sum(1))
        assert (lift <= got["offset"]).all() and got["offset"].max() < 4e-6 * np.abs(corners).max()


def test_a_spawn_offset_at_the_origin_is_a_millionth(context: "Context") -> None:
    rng = np.random.default_rng(7)
    for size in (1e-3, 1.0, 1e3):
        position, index = ray.uv_sphere(30, size)
        with Tracer(context, scene_of(ray.soup(position[index])), 1, origin=(0, 0, 0)) as tracer:
            got = surfaces(tracer, ray.random_rays(np.full(3, -0.3 * size), np.full(3, 0.3 * size), 2000, rng))
            assert (got["met"] == 1).all() and got["offset"].max() <= 1e-6 * 2 * size


def test_spheres_have_exact_points_and_coordinates(context: "Context") -> None:
    rng = np.random.default_rng(9)
    linear_part = ray.rotation(rng) @ np.diag([0.5, 1.0, 2.0])
    scene = scene_of(Sphere(1.5), poses=[moved((10, 20, 30), linear_part)])
    with Tracer(context, scene, 2) as tracer:
        rays = Rays.make(rng.uniform(-3, 3, (3000, 3)), ray.sphere_directions(rng, 3000))
        got = surfaces(tracer, rays)
        met = got["met"] == 1
        assert met.sum() > 300
        local = (got["position"][met] + tracer.origin - (10, 20, 30)) @ np.linalg.inv(linear_part).T
        assert np.abs(np.linalg.norm(local, axis=1) - 1.5).max() < 3e-6
        n = ray.unit(local @ np.linalg.inv(linear_part))
        n *= np.where((n * rays.direction[met]).sum(1, keepdims=True) > 0, -1, 1)
        assert np.abs(n - got["n"][met]).max() < 1e-5 and np.abs(n - got["n_geo"][met]).max() < 1e-5


@pytest.mark.parametrize("levels", [1, 2])
def test_the_level_of_a_hit_is_that_of_its_ray_cone(context: "Context", levels: int) -> None:
    """A square of 64 texels over 2 m by 1 m, seen at an angle: area of the footprint over the area of a texel."""
    rng = np.random.default_rng(11)
    texture = Texture(picture(rng, 64, 64))
    corner = np.array([[-1, -0.5, 0], [1, -0.5, 0], [1, 0.5, 0], [-1, 0.5, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    square = Triangles(corner, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), normal, uv0=uv)
    scale = 3.0
    mesh = Mesh("square", (square,))
    material = Material(double_sided=True, textures={"base_color": texture})
    scene = Scene("square", (mesh,), (Instance(0, moved((5, 0, 0), np.eye(3) * scale)),), (material,))
    levels_of = chain(linear(texture.image.texels, True))
    with Tracer(context, scene, levels, origin=(5, 0, 0)) as tracer:
        target = scale * rng.uniform(-0.4, 0.4, (3000, 3)) * (2, 1, 0)
        view = ray.unit(np.column_stack([rng.uniform(-1, 1, (3000, 2)), rng.uniform(0.4, 1, 3000)]))
        footprint = 10 ** rng.uniform(-3, 1.5, 3000)
        got = surfaces(tracer, Rays.make(target + 4 * view, -view), footprint)
        assert (got["met"] == 1).all()
        texel_area = scale**2 * 2 / 64**2
        lod = np.clip(0.5 * np.log2(footprint**2 / view[:, 2] / texel_area), 0, 6)
        at = target[:, :2] / (2 * scale, -scale) + 0.5
        each = np.stack([sampled(texture, level, at) for level in levels_of])
        low = np.minimum(lod.astype(int), 5)
        k = np.arange(3000)
        want = each[low, k] * (1 - (lod - low))[:, None] + each[low + 1, k] * (lod - low)[:, None]
        assert (lod == 0).sum() > 300 and (lod == 6).sum() > 100
        assert np.abs(got["base_color"] - want[:, :3]).max() < 0.01
