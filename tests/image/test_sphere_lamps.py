"""Analytic spheres that shine, in the path tracer: against the closed form, and against the same body of triangles."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from compare import reference_batches, z_test
from scene_kit import constant_sky, floor, matte, metal, plastic, scene, texture

from glhybrid.load.shapes import ellipsoid
from glhybrid.scene import Camera, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer

SIZE = (64, 48)
LAMP = (6.0, 5.0, 4.0)


def settings(samples: int, bounces: int = 0) -> Settings:
    return Settings(reflections="reference", samples=samples, bounces=bounces, aa=1, seed=1)


@pytest.mark.parametrize("radius", [0.02, 0.4])
def test_a_sphere_over_a_floor(renderer: "Renderer", radius: float) -> None:
    """Radiance of a Lambert floor: albedo L r^2 h / D^3, whatever the radius; almost no noise, since all that the cone is
    drawn for is that cosine. Without next-event estimation the small lamp would be met by one path in 2,500."""
    height, albedo = 1.5, 0.6
    camera = Camera.look_at((0, 4, 0.01), (0, 0, 0), fov_y=0.5)
    world = scene([(floor(6), matte(albedo)), (Sphere(radius), matte(0.5, emissive=LAMP), (1.6, height, 0))], camera)
    frame = renderer.render(world, size=SIZE, settings=settings(64), aovs=("position", "instance_id"))
    on = frame["instance_id"] == 0
    distance = np.linalg.norm(frame["position"] - (1.6, height, 0), axis=-1)
    want = albedo * np.array(LAMP) * (radius**2 * height / distance**3)[..., None]
    ratio = (frame["radiance"] / want)[on]
    print(f"radius {radius}: mean {ratio.mean():.5f}, spread {ratio.std():.4f}")
    assert on.sum() > 2500 and abs(ratio.mean() - 1) < 0.002  # 64 samples of 3,000 pixels
    small = 0.003 if renderer.context.device.software else 0.005  # noise: 0.0033 on an H100, whose sines differ
    assert ratio.std() < (0.03 if radius > 0.1 else small)


def lit_by(lamp: Any, pose: Any, **extra: Any) -> Scene:
    parts = [
        (floor(3), matte((0.8, 0.7, 0.6))), (Sphere(0.4), metal((0.9, 0.6, 0.3), 0.25), (0.9, 0.4, 0.4)),
        (Sphere(0.3), plastic((0.3, 0.5, 0.7), 0.5), (-0.7, 0.3, 0.6)), (lamp, matte(0.5, emissive=LAMP), pose),
    ]  # fmt: skip
    return scene(parts, **extra)


@pytest.mark.parametrize("name", ["small", "near and stretched", "with a sky"])
def test_the_same_as_of_many_triangles(renderer: "Renderer", scale: float, name: str) -> None:
    """Tessellated so finely that it lacks 4e-4 of the sphere's width: a Z-test of the two pictures, highlights and all."""
    pose = np.eye(4)
    pose[:3, 3] = (0.2, 1.5, 0.2)
    if name == "near and stretched":
        c, s = np.cos(0.7), np.sin(0.7)
        pose[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.diag([2.5, 0.6, -1.2])
        pose[1, 3] = 1.1
    radius = 0.1 if name == "small" else 0.3
    extra: Any = {"environment": constant_sky((0.2, 0.3, 0.4))} if name == "with a sky" else {}
    ball = ellipsoid(radii=(radius,) * 3, segments=160)
    world, same = lit_by(Sphere(radius), pose, **extra), lit_by(ball, pose, **extra)
    batches = int(20 * scale)
    got, want = (reference_batches(renderer, w, SIZE, settings(8, bounces=1), batches=batches) for w in (world, same))
    result = z_test(got, want)
    print(result)
    assert got.mean.mean() > 0.005 and result.passed >= BARS["z passed"].value
    assert result.tiles < BARS["z of a tile"].value and result.whole < BARS["z of the picture"].value


def test_it_takes_less_noise_than_chance_hits(renderer: "Renderer") -> None:
    """Of the same picture, a lamp 0.1 m wide: the spread between batches is that of the lamp of triangles, or less."""
    pose = np.eye(4)
    pose[:3, 3] = (0.2, 1.5, 0.2)
    ball = ellipsoid(radii=(0.1,) * 3, segments=64)
    noise = [
        reference_batches(renderer, lit_by(lamp, pose), SIZE, settings(4), batches=8).variance.mean()
        for lamp in (Sphere(0.1), ball)
    ]
    print(f"variance: sphere {noise[0]:.3g}, triangles {noise[1]:.3g}")
    assert noise[0] < noise[1]


def test_from_within_and_through_holes(renderer: "Renderer") -> None:
    """A room that is a shining sphere: L, L (1 + albedo) ... The far side of a shell of holes shines through the near one."""
    inside = scene([(Sphere(2.0), matte(0.5, emissive=(0.5,) * 3))], Camera.look_at((0.3, 0.2, 0.5), (0, 0, -1)))
    for bounces, want in ((0, 0.75), (40, 1.0)):
        picture = renderer.render(inside, size=SIZE, settings=settings(32, bounces))["radiance"].astype(np.float64)
        assert abs(picture.mean() - want) < 0.01, (bounces, picture.mean())
    alpha = np.where(np.indices((8, 16)).sum(0) % 2 == 0, 255, 0)
    texels = np.dstack([np.full((8, 16, 3), 255), alpha])
    holes = matte(0.5, emissive=LAMP, alpha_mode="MASK", textures={"base_color": texture(texels, nearest=True)})
    world = scene([(floor(3), matte(0.8)), (Sphere(0.5), holes, (0, 1.2, 0))])
    whole = scene([(floor(3), matte(0.8)), (Sphere(0.5), matte(0.5, emissive=LAMP), (0, 1.2, 0))])
    got, solid = (renderer.render(w, size=SIZE, settings=settings(48), aovs=("instance_id",)) for w in (world, whole))
    on = (got["instance_id"] == 0) & (solid["instance_id"] == 0)
    # Half of the near side and, through the other half, half of the far one: three quarters, about.
    share = got["radiance"][on].mean() / solid["radiance"][on].mean()
    print(f"share of light from a shell of holes: {share:.3f}")
    assert 0.68 < share < 0.82
