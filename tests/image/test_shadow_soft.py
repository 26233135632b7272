"""`ray-soft`: penumbras against the analytic disc, the reference, and `ray` where lights have no size."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from compare import reference_batches
from scene_kit import box, floor, matte, metal, quad, scene, sun, texture

from glhybrid.scene import Camera, Light, Scene, Sphere
from glhybrid.settings import Settings
from glhybrid.study.metrics import disc_visibility, penumbra_width

if TYPE_CHECKING:
    from glhybrid.image import Frame
    from glhybrid.renderer import Renderer

SIZE = (96, 64)
DOWN = replace(Camera.look_at((0, 6, 0), (0, 0, 0), (0, 0, -1)), fov_y=0.0, ymag=1.0)


def draw(renderer: "Renderer", world: Scene, samples: int = 16, *aovs: str, **settings: Any) -> "Frame":
    parameters = {"shadows.ray-soft.samples": samples, "shadows.ray-soft.denoise": False} | settings.pop(
        "parameters", {}
    )
    chosen = Settings(**({"aa": 1, "shadows": "ray-soft", "parameters": parameters} | settings))
    return renderer.render(world, size=SIZE, settings=chosen, aovs=("visibility", *aovs))


def edge(light: Light, height: float = 2.0) -> Scene:
    """A half plane over x < 0, straight above a floor that is seen from above it."""
    sheet = quad([(-50, height, 50), (0, height, 50), (0, height, -50), (-50, height, -50)])
    camera = replace(
        DOWN, world_from_view=DOWN.world_from_view + np.array([[0] * 4, [0, 0, 0, height - 6.5], [0] * 4, [0] * 4])
    )
    return scene([(floor(60.0), matte(1.0)), (sheet, matte(1.0))], camera, lights=[light])


def lamps(size: float) -> list[Light]:
    lit = sun((-0.6, -1.0, -0.4))
    lamp = Light("point", (1.0, 0.7, 0.4), 5.0, position=(1.5, 2.0, -1.0), radius=0.4 * size)
    spot = Light("spot", (0.5, 1.0, 1.0), 9.0, position=(-0.4, 2.5, 0.3), direction=(0.0, -1.0, 0.0), inner_cone=0.4,
                 outer_cone=0.8, radius=0.2 * size)  # fmt: skip
    return [replace(lit, angular_diameter=0.2 * size), lamp, spot]


def posts(lights: list[Light], **material: Any) -> Scene:
    parts = [(floor(4.0), matte(0.8)), (box((-0.1, 0, -0.1), (0.1, 1.2, 0.1)), matte(0.5, **material)),
             (Sphere(0.3), matte(0.6), (0.7, 0.5, 0.4))]  # fmt: skip
    return scene(parts, Camera.look_at((2.0, 2.2, 3.0), (0, 0.3, 0), fov_y=np.radians(45)), lights=lights)


def test_without_size_it_is_ray(renderer: "Renderer") -> None:
    """Bit for bit, and by the same program: nothing of a penumbra is compiled."""
    world = posts(lamps(0.0))
    soft, hard = draw(renderer, world), draw(renderer, world, shadows="ray")
    assert np.array_equal(soft["visibility"], hard["visibility"]) and np.array_equal(soft["radiance"], hard["radiance"])
    assert "shadow_soft" not in {p["name"] for p in soft.receipt["passes"]}
    assert any(s.startswith("penumbras: no light has a size") for s in soft.receipt["plan"]["skipped"])


def test_a_light_without_size_stays_hard_beside_soft_ones(renderer: "Renderer") -> None:
    lights = lamps(1.0)
    lights[1] = replace(lights[1], radius=0.0)
    world = posts(lights)
    soft, hard = draw(renderer, world)["visibility"], draw(renderer, world, shadows="ray")["visibility"]
    assert np.array_equal(soft[..., 1], hard[..., 1])
    for i in (0, 2):
        partly = (soft[..., i] > 0.01) & (soft[..., i] < 0.99)
        assert 0.005 < partly.mean() < 0.4
        # A penumbra lies on both sides of the hard border; away from it nothing changes.
        assert (np.abs(soft[..., i] - hard[..., i]) > 0.99).mean() < 0.002


@pytest.mark.parametrize("kind", ["directional", "point", "spot"])
def test_penumbra_of_a_straight_edge(renderer: "Renderer", kind: str) -> None:
    """Against the share of a disc that a straight line leaves, and its width."""
    height, half = 2.0, 0.2
    lights = {
        "directional": replace(sun((0, -1, 0)), angular_diameter=2 * np.arctan(half)),
        "point": Light("point", intensity=5.0, position=(0.0, 102.0, 0.0), radius=100 * half),
        "spot": Light("spot", intensity=5.0, position=(0.0, 102.0, 0.0), direction=(0.0, -1.0, 0.0), radius=100 * half),
    }
    frame = draw(renderer, edge(lights[kind], height), 256, "position")
    seen = frame["visibility"][..., 0].astype(np.float64)
    x = frame["position"][..., 0].astype(np.float64)
    sine = np.sin(np.arctan(half)) if kind == "directional" else half * 100 / 102
    # The edge covers a disc of directions' sines from x / |(x, height)| on.
    want = disc_visibility(x / np.hypot(x, height) / sine)
    assert np.abs(seen - want).mean() < 0.01 and np.abs(seen - want).max() < 0.08
    row = SIZE[1] // 2
    width, exact = (penumbra_width(x[row], v[row]) for v in (seen, want))
    assert width == pytest.approx(exact, rel=0.05)


def test_error_falls_with_samples(renderer: "Renderer") -> None:
    """At least as 1 / sqrt(N): in the penumbra, over seeds, against many samples."""
    world = posts(lamps(1.0))
    fine = draw(renderer, world, 256, seed=99)["visibility"]
    partly = (fine > 0.02) & (fine < 0.98)
    assert partly.mean() > 0.01
    rms = [
        np.sqrt(
            np.mean([((draw(renderer, world, n, seed=s)["visibility"] - fine)[partly] ** 2).mean() for s in range(3)])
        )
        for n in (1, 4, 16)
    ]
    assert 0.3 < rms[0] < 0.5  # one ray answers 0 or 1
    assert rms[1] < 0.55 * rms[0] and rms[2] < 0.5 * rms[1], rms


def test_mean_is_the_reference(renderer: "Renderer") -> None:
    """Matt surfaces under a sun, a lamp and a spot with a size: ray-soft has no bias that the reference could see."""
    world = posts(lamps(1.0))
    settings = Settings(reflections="reference", samples=8, bounces=0, aa=1, seed=1)
    want = reference_batches(renderer, world, SIZE, settings, batches=32)  # fewer tell a pixel's variance too badly
    got = draw(renderer, world, 128, reflections="none")["radiance"].astype(np.float64)
    error = got - want.mean
    spread = np.sqrt(want.variance + (0.004 * want.mean) ** 2 + 1e-8)  # 128 rays leave a noise of their own
    assert np.mean(np.abs(error) < 4 * spread) > 0.995
    assert abs(got.mean() / want.mean.mean() - 1) < 0.003


def test_holes_and_tints(renderer: "Renderer") -> None:
    """A sheet with half of its texels cut out, far wider than the penumbra, and a blended one of alpha one half, let half of it through."""
    holes = np.full((256, 256, 4), 255, np.uint8)
    holes[(np.indices((256, 256)).sum(0) % 2) == 0, 3] = 0
    sheet = matte(1.0, alpha_mode="MASK", textures={"base_color": texture(holes, nearest=True)})
    tint = matte(1.0, alpha_mode="BLEND", alpha=0.5)
    light = replace(sun((0, -1, 0)), angular_diameter=0.6)
    for material, low, high in ((sheet, 0.4, 0.6), (tint, 0.499, 0.501)):
        world = edge(light)
        world = world.replace(materials=(world.materials[0], material))
        seen = draw(renderer, world, 64)["visibility"][..., 0]
        dark = seen[:, : SIZE[0] // 4]
        assert low < dark.mean() < high and np.ptp(dark) < 0.45, (material.name, dark.mean())
        assert seen[:, -4:].min() > 0.9


def test_mirrors_show_penumbras(renderer: "Renderer") -> None:
    """What a mirror shows is lit through the same discs: against the reference with one bounce."""
    wall = quad([(-2, 0, -0.5), (2, 0, -0.5), (2, 2, -0.5), (-2, 2, -0.5)])
    world = posts(lamps(1.0))
    plain = scene([(wall, metal(1.0, 0.0))])
    mirror = replace(plain.instances[0], mesh=len(world.meshes), materials=(len(world.materials),))
    world = world.replace(
        meshes=(*world.meshes, plain.meshes[0]), materials=(*world.materials, plain.materials[0]),
        instances=(*world.instances, mirror),
    )  # fmt: skip
    settings = Settings(reflections="reference", samples=16, bounces=1, aa=1, seed=1)
    want = reference_batches(renderer, world, SIZE, settings, batches=16)
    hit_samples = {"shadows.ray-soft.hit_samples": 64}
    frame = draw(renderer, world, 4, "instance_id", parameters=hit_samples)
    on = frame["instance_id"] == len(world.instances) - 1
    got, mean = frame["radiance"].astype(np.float64)[on], want.mean[on]
    assert on.mean() > 0.1 and abs(got.mean() / mean.mean() - 1) < 0.01
    spread = np.sqrt(want.variance[on] + (0.02 * mean) ** 2 + 1e-6)
    assert np.mean(np.abs(got - mean) < 4 * spread) > 0.99


def test_seeds(renderer: "Renderer") -> None:
    """The same seed gives the same bits, another one other noise of the same mean."""
    world = posts(lamps(1.0))
    first, again, other = (draw(renderer, world, 4, seed=s)["visibility"] for s in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert first.mean() == pytest.approx(other.mean(), rel=0.003)
