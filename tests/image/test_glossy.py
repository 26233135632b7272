"""`ray-glossy` without its filter: unbiased against the reference, `ray-lerp` where surfaces are mirrors, reproducible."""

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from bars import BARS
from compare import keep, reference_batches, relative, z_test
from glossy_scenes import batches, draw, metal_floor, painted, things
from scene_kit import box, constant_sky, floor, matte, metal, plastic, scene, sun

from glhybrid.scene import Camera, Environment, Light, Material, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from pathlib import Path

    from glhybrid.renderer import Renderer

SIZE = (80, 60)
RAW = {"denoise": False}


def coated() -> Material:
    return replace(metal((0.9, 0.5, 0.2), 0.5), clearcoat=0.8, clearcoat_roughness=0.15)


@pytest.mark.parametrize("name", ["0.1", "0.25", "0.6", "1", "coat"])
def test_unbiased(renderer: "Renderer", name: str, scale: float, tmp_path: "Path") -> None:
    """Z-test against the reference, which samples the whole BSDF and the sky besides."""
    world = things(coated()) if name == "coat" else metal_floor(min(float(name), 0.999))
    count = int(24 * scale)  # 12 leave too few a pixel: of those that rarely meet the post some never do
    rays = 100 if name == "0.1" else 16  # 16 either way: enough that a rarely met post is met in most batches
    got = batches(renderer, world, count, size=SIZE, samples=rays, parameters=RAW)
    settings = Settings(reflections="reference", samples=8, bounces=0, aa=1, seed=5)
    want = reference_batches(renderer, world, SIZE, settings, batches=4 * count)
    result = z_test(got, want, floor=1e-3)
    print(result)
    ok = (
        result.passed >= BARS["z passed"].value
        and result.tiles < BARS["z of a tile"].value
        and result.whole < BARS["z of the picture"].value
    )
    assert ok, (result, keep(tmp_path, got=got.mean, want=want.mean, variance=got.variance + want.variance))


def lamp_sky() -> Environment:
    """A dim sky with one lamp of 4 x 2 degrees, 4,000 times as bright, and a sun of one texel."""
    radiance = np.full((90, 180, 3), (0.3, 0.35, 0.4), np.float32)
    radiance[20:22, 100:102] *= 4000
    radiance[30, 75] *= 20000
    return Environment(radiance)


@pytest.mark.parametrize("name", ["0.1", "0.4", "coat"])
def test_lamps_in_the_sky(renderer: "Renderer", name: str, scale: float) -> None:
    """Z-test against the reference, as above; and no ray finds what the mean does not know of."""
    world = things(coated() if name == "coat" else metal((0.95, 0.93, 0.9), float(name)), environment=lamp_sky())
    count = int(48 * scale)  # fewer tell the variance of a lamp's pixels too badly
    got = batches(renderer, world, count, size=SIZE, samples=2, parameters=RAW)
    settings = Settings(reflections="reference", samples=8, bounces=0, aa=1, seed=5)
    want = reference_batches(renderer, world, SIZE, settings, batches=2 * count)
    result = z_test(got, want, floor=1e-3)
    assert result.passed >= BARS["z passed"].value and result.whole < BARS["z of the picture"].value, result
    most = []
    for sky_rays in (True, False):
        frames = [
            draw(renderer, world, 1, size=SIZE, seed=k, parameters=RAW | {"sky_rays": sky_rays}) for k in range(4)
        ]
        bound = want.mean.mean(-1) + 0.02 * want.mean.mean()
        most.append(max(float((f["radiance"].mean(-1) / bound).max()) for f in frames))
    assert most[0] < 50 and most[1] > 200, most  # two lamps drawn in turn, and texels next to them, leave 10 to 30


@pytest.mark.parametrize(("name", "levels"), [("0.15", 1), ("0.4", 2), ("coat", 1)])
def test_small_lamps_that_are_meshes(renderer: "Renderer", name: str, levels: int, scale: float) -> None:
    """A ball and a box, mirrored and scaled: Z-test against the reference; no ray finds what the mean does not know of."""
    lamp = Material("lamp", (0, 0, 0, 1), emissive=(3000.0, 2700.0, 2400.0))
    material = coated() if name == "coat" else metal((0.95, 0.93, 0.9), float(name))
    parts = [
        (floor(4.0), material), (box((-0.5, 0, -0.5), (0.5, 1.3, 0.5)), painted(0.35, 0.08, 0.05), (-0.9, 0, -0.3)),
        (Sphere(0.03), lamp, (0.4, 0.9, 0.2)), (box((-0.04, -0.01, -0.02), (0.04, 0.0, 0.02)), lamp, (0.9, 1.2, -0.6)),
    ]  # fmt: skip
    camera = Camera.look_at((0.4, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44))
    world = scene(parts, camera, environment=constant_sky((0.3, 0.35, 0.4)))
    count = int(12 * scale)
    got = batches(renderer, world, count, size=SIZE, samples=24, levels=levels, parameters=RAW)
    settings = Settings(reflections="reference", samples=16, bounces=0, aa=1, seed=5, levels=levels)
    want = reference_batches(renderer, world, SIZE, settings, batches=2 * count)
    on = draw(renderer, world, 1, "instance_id", size=SIZE)["instance_id"] == 0
    spread = np.sqrt(got.variance + want.variance + (1e-3 * want.mean.mean()) ** 2)
    share = (np.abs((got.mean - want.mean) / spread)[on] < 5).mean()
    assert share > 0.997, share
    error = np.sqrt((got.variance + want.variance)[on].sum())
    whole = (got.mean - want.mean)[on].sum() / error  # channels go together: three times the variance at most
    assert abs(whole) < 3**0.5 * BARS["z of the picture"].value and error < 0.02 * want.mean[on].sum(), (whole, error)
    most = []
    for lamp_rays in (True, False):
        frames = [
            draw(renderer, world, 1, size=SIZE, seed=k, parameters=RAW | {"lamp_rays": lamp_rays}) for k in range(4)
        ]
        bound = want.mean.mean(-1) + 0.02 * want.mean.mean()
        most.append(max(float((f["radiance"].mean(-1) / bound)[on].max()) for f in frames))
    assert most[0] < 50 and most[1] > 100, most


def lit(roughness: float) -> Scene:
    """Matt things in a lamp and a sun over a metal floor; nothing else shines."""
    parts = [
        (floor(4.0), metal((0.95, 0.93, 0.9), roughness)), (box((-1.4, 0, -0.8), (-0.4, 1.3, 0.2)), matte((0.8, 0.3, 0.2))),
        (Sphere(0.5), matte((0.3, 0.5, 0.9)), (1.0, 0.5, -0.1)),
    ]  # fmt: skip
    lights = [sun((-0.5, -1.0, -0.8)), Light("point", (1.0, 0.8, 0.5), 2.0, position=(0.2, 1.2, 1.2))]
    camera = Camera.look_at((0.4, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44))
    return scene(parts, camera, lights=lights)


def test_hits_are_lit_with_their_own_shadows(renderer: "Renderer", scale: float) -> None:
    """Against the reference with one bounce, on the floor: what it reflects gets light from lamps alone."""
    world = lit(0.3)
    count = int(12 * scale)
    got = batches(renderer, world, count, size=SIZE, samples=4, parameters=RAW)
    settings = Settings(reflections="reference", samples=16, bounces=1, aa=1, seed=3)
    want = reference_batches(renderer, world, SIZE, settings, batches=2 * count)
    on = draw(renderer, world, 1, "instance_id", size=SIZE)["instance_id"] == 0
    spread = np.sqrt(got.variance + want.variance + (1e-4 * want.mean.mean()) ** 2)
    z = ((got.mean - want.mean) / spread)[on]
    assert on.mean() > 0.4 and want.mean[on].mean() > 0.05
    assert (np.abs(z) < 5).mean() > 0.997
    assert abs(got.mean[on].sum() / want.mean[on].sum() - 1) < 0.005


@pytest.mark.parametrize("roughness", [0.25, 0.75])
def test_error_falls_with_samples(renderer: "Renderer", roughness: float) -> None:
    """Faster than 1 / sqrt(N): 64 times the rays leave less than a twelfth of the error, not an eighth."""
    world = metal_floor(roughness)
    fine = draw(renderer, world, 512, size=SIZE, seed=77, parameters=RAW)["radiance"]
    rms = []
    for samples in (1, 4, 16, 64):
        error = draw(renderer, world, samples, size=SIZE, parameters=RAW)["radiance"] - fine
        rms.append(float(np.sqrt((error.astype(np.float64) ** 2).mean())))
    assert {0.25: 0.10, 0.75: 0.2}[roughness] < rms[0] < {0.25: 0.20, 0.75: 0.4}[roughness], rms
    assert all(b < 0.6 * a for a, b in pairwise(rms)) and rms[-1] < rms[0] / 12, rms


def test_mirrors_are_ray_lerp(renderer: "Renderer") -> None:
    """One ray, the same hit, the same light: also where the shading normal bends it under the surface."""
    parts = [
        (floor(4.0), metal(0.9, 0.0)), (Sphere(0.5), metal((0.9, 0.6, 0.3), 0.0), (-0.8, 0.5, 0.0)),
        (box((0.2, 0, 0.2), (0.7, 0.9, 0.6)), matte((0.8, 0.3, 0.2))),
    ]  # fmt: skip
    world = scene(parts, lights=[sun()], environment=metal_floor(0.0).environment)
    names = ("reflection", "reflection_hit", "reason")
    glossy = draw(renderer, world, 16, *names)
    lerp = renderer.render(world, size=(160, 120), settings=Settings(aa=1), aovs=names)
    on = lerp["reflection_hit"] != 0
    assert on.mean() > 0.3
    for name in names:
        assert np.allclose(glossy[name][on], lerp[name][on], rtol=1e-6), name
    assert relative(glossy["radiance"][on], lerp["radiance"][on]).max() < 1e-5


def test_rays_follow_the_roughness(renderer: "Renderer") -> None:
    """A mirror takes one ray, a surface past the cutoff and one without a specular lobe none."""
    parts = [
        (floor(4.0), plastic((0.5, 0.5, 0.5), 0.8)), (Sphere(0.5), metal(0.9, 0.3), (-0.8, 0.5, 0.0)),
        (Sphere(0.5), replace(matte(0.8), roughness=0.3), (0.8, 0.5, 0.0)),
    ]  # fmt: skip
    world = scene(parts, environment=metal_floor(0.0).environment)
    frame = draw(renderer, world, 4, "reflection_hit", "reason", "instance_id", parameters={"cutoff": 0.5})
    sent = frame["reflection_hit"] != 0
    ids = frame["instance_id"]
    assert not sent[ids == 0].any() and (frame["reason"][ids == 0] == 1).all()
    assert sent[ids == 1].mean() > 0.98 and not sent[ids == 2].any()
    # Where no ray is sent it is `env`.
    plain = renderer.render(world, size=(160, 120), settings=Settings(aa=1, reflections="env"))
    bar = 1e-5 if renderer.context.device.software else 3e-5  # two programs round apart; measured 1.1e-5 on an H100
    assert relative(frame["radiance"][ids == 0], plain["radiance"][ids == 0]).max() < bar


def test_seeds(renderer: "Renderer") -> None:
    """The same seed gives the same bits; another gives other noise. Jittered frames go on in the sequence."""
    world = metal_floor(0.4)
    first, again, other = (draw(renderer, world, size=SIZE, seed=s, parameters=RAW)["radiance"] for s in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert first.mean() == pytest.approx(other.mean(), rel=0.01)


def test_a_sized_lamp_lights_what_is_reflected_softly(renderer: "Renderer") -> None:
    """ray-soft's rays from hits: against the reference, which samples the same discs, away from the lamps' highlights
    (of a lamp's middle in the hybrid)."""
    world = lit(0.2)
    world = world.replace(lights=(replace(world.lights[0], angular_diameter=0.2), replace(world.lights[1], radius=0.3)))
    got = batches(renderer, world, 16, size=SIZE, samples=4, shadows="ray-soft", parameters=RAW)
    settings = Settings(reflections="reference", samples=16, bounces=1, aa=1, seed=3)
    want = reference_batches(renderer, world, SIZE, settings, batches=32)
    direct = draw(renderer, world, 1, "instance_id", size=SIZE, reflections="none")
    on = (direct["instance_id"] == 0) & (direct["radiance"].max(-1) < 0.02)
    assert on.mean() > 0.2 and want.mean[on].mean() > 0.02
    assert abs(got.mean[on].sum() / want.mean[on].sum() - 1) < 0.01


@pytest.mark.parametrize("denoise", [False, True])
def test_programs_apart_make_the_same_picture(renderer: "Renderer", denoise: bool) -> None:
    """As a GPU runs it, a ray at a time in several programs: only sums are rounded in another order."""
    world = lit(0.3)
    world = world.replace(environment=metal_floor(0.0).environment)
    fused, split = (
        draw(renderer, world, 3, size=SIZE, kernels=kernels, parameters={"denoise": denoise})["radiance"]
        for kernels in ("fused", "split")
    )
    # A GPU's compiler contracts sums in each program as it pleases; a filter may then take another neighbour for the same.
    rounding = 1e-5 if renderer.context.device.software else 1e-4
    assert np.abs(split - fused).max() < (1e-2 if denoise else rounding) * fused.mean()
    assert np.abs(split - fused).mean() < 1e-5 * fused.mean()
