"""The sky on the GPU: orientation, lookups, and its convolutions against quadrature in float64."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from bars import BARS
from compare import relative
from mitsuba_client import sky_radiance
from scene_kit import camera_rays, constant_sky, floor, matte, plastic, scene

from glhybrid import content_cache, layout
from glhybrid.load.environment import read_environment
from glhybrid.scene import Camera, Environment, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]

AXES = {"-Z": (0, 0, -1), "+X": (1, 0, 0), "+Z": (0, 0, 1), "-X": (-1, 0, 0), "+Y": (0, 1, 0), "-Y": (0, -1, 0)}


def seen(
    renderer: "Renderer", sky: Environment, toward: tuple[float, float, float], fov: float = 0.2, size: int = 9
) -> "F64":
    """The sky alone, looking along `toward`: (size, size, 3)."""
    up = (0.0, 1.0, 0.0) if abs(toward[1]) < 0.9 else (0.0, 0.0, -1.0)
    camera = Camera.look_at((0, 0, 0), toward, up, fov_y=fov)
    # Something must be drawn: a speck that no pixel's ray meets.
    world = scene([(floor(0.01, -1000.0, center=(300.0, 400.0)), matte())], camera=camera, environment=sky)
    return renderer.render(world, size=(size, size), settings=Settings(aa=1))["radiance"].astype(np.float64)


def compass() -> Environment:
    """12 x 6 texels, a colour for each of the four sides, white above, grey below."""
    texels = np.zeros((6, 12, 3), np.float32)
    sides = {"+Z": (1, 1, 0), "-X": (0, 0, 1), "-Z": (1, 0, 0), "+X": (0, 1, 0)}
    for k, color in enumerate(sides.values()):  # columns from the left edge, +Z, over -X and the centre, -Z, to +X
        texels[2:4, [(3 * k + i - 1) % 12 for i in range(3)]] = color
    texels[:2], texels[4:] = 1, 0.25
    return Environment(texels)


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_orientation(renderer: "Renderer", quarter: int) -> None:
    """The centre column looks along -Z and +X is to its right; rotation turns the sky right-handed about +Y."""
    import dataclasses

    sky = dataclasses.replace(compass(), rotation=quarter * np.pi / 2)
    order = ["-Z", "-X", "+Z", "+X"]  # a turn about +Y takes each into the next
    colors = {"-Z": (1, 0, 0), "-X": (0, 0, 1), "+Z": (1, 1, 0), "+X": (0, 1, 0)}
    for k, axis in enumerate(order):
        got = seen(renderer, sky, AXES[order[(k + quarter) % 4]])
        assert np.allclose(got, colors[axis], atol=1e-6), (axis, quarter, got[4, 4])
    assert np.allclose(seen(renderer, sky, AXES["+Y"]), 1) and np.allclose(seen(renderer, sky, AXES["-Y"]), 0.25)


def test_right_is_right(renderer: "Renderer") -> None:
    """Looking along -Z, what lies towards +X is on the right of the picture and +Y on top."""
    wide = seen(renderer, compass(), (0, 0, -1), fov=np.radians(100), size=33)
    assert (
        wide[16, 32, 1] > wide[16, 32, 2] and wide[16, 0, 2] > wide[16, 0, 1] and np.allclose(wide[16, 16], (1, 0, 0))
    )
    assert wide[0, 16].min() > 0.9 and wide[32, 16].max() < 0.5


@pytest.mark.parametrize("shape", [(1, 2), (3, 7), (64, 128), (150, 301)])
def test_lookup(renderer: "Renderer", shape: tuple[int, int]) -> None:
    """Bilinear, texel centres at 0.5, columns wrap, rows clamp; any size; rotated and scaled; at the poles and the seam."""
    rng = np.random.default_rng(shape[1])
    sky = Environment(rng.uniform(0, 1, (*shape, 3)).astype(np.float32) ** 4 * 50, intensity=1.7, rotation=2.1)
    for toward in ((0.3, 0.2, -1), (0.1, 1, 0.1), (-0.2, -1, 0.05), (0.05, 0.1, 1)):
        camera = Camera.look_at((0, 0, 0), toward, fov_y=1.6)
        world = scene([(floor(0.01, -1000.0), matte())], camera=camera, environment=sky)
        got = renderer.render(world, size=(64, 48), settings=Settings(aa=1))["radiance"]
        d = camera_rays(world, (64, 48)).direction
        want = sky_radiance(sky, d)
        # Around the poles a step of direction is a longer way round.
        error = np.abs(got - want).max(-1) / want.mean() * np.minimum(1, 10 * np.hypot(d[..., 0], d[..., 2]))
        assert error.max() < BARS["sky lookup"].value * (1 + shape[1] / 128), (toward, error.max())


@pytest.mark.usefixtures("no_cache")
def test_a_sun_brighter_than_half_floats(renderer: "Renderer") -> None:
    """The camera sees 10^6 as 10^6; what it sheds is that of 10^6 over its solid angle, not of 65504."""
    texels = np.zeros((64, 128, 3), np.float32)
    texels[20, 64] = 1e6
    sky = Environment(texels)
    theta = (20.5 / 64) * np.pi
    toward = np.array([np.sin(theta) * np.sin(np.pi / 128), np.cos(theta), -np.sin(theta) * np.cos(np.pi / 128)])
    assert seen(renderer, sky, tuple(toward), fov=0.001, size=3).max() > 0.999e6
    world = scene([(floor(), matte(1.0))], environment=sky)
    picture = renderer.render(world, size=(16, 12), settings=Settings(aa=1, reflections="none"), aovs=("instance_id",))
    solid = (np.cos(20 / 64 * np.pi) - np.cos(21 / 64 * np.pi)) * 2 * np.pi / 128
    want = 1e6 * solid * np.cos(theta) / np.pi
    got = picture["radiance"][picture["instance_id"] == 0]
    # Bilinear lookup spreads the texel over its neighbours, and so moves some of its light.
    assert np.allclose(got, want, rtol=0.02), (got.mean(), want)


def octahedron(size: int) -> "F64":
    """(size, size, 3) directions of an octahedral map's texel centres (Cigolle et al. 2014)."""
    y, x = np.mgrid[0:size, 0:size]
    p = (np.stack([x, y], -1) + 0.5) / size * 2 - 1
    z = 1 - np.abs(p).sum(-1)
    folded = (1 - np.abs(p[..., ::-1])) * np.where(p >= 0, 1, -1)
    d = np.dstack([np.where(z[..., None] < 0, folded, p), z])
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def sphere_grid(sky: Environment, rows: int) -> "tuple[F64, F64, F64]":
    """Directions (N, 3), radiance (N, 3) and solid angles (N,) of a fine equirect grid."""
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    phi = (np.arange(2 * rows) + 0.5) / (2 * rows) * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    d = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], -1).reshape(-1, 3)
    edge = np.cos(np.arange(rows + 1) / rows * np.pi)
    solid = np.repeat((edge[:-1] - edge[1:]) * np.pi / rows, 2 * rows)
    return d, sky_radiance(sky, d), solid


def maps_of(renderer: "Renderer", sky: Environment) -> "tuple[list[F64], F64]":
    """The prefiltered maps by level and the irradiance map over pi, without their borders."""
    world = scene([(floor(), plastic())], environment=sky)
    staged = renderer.stage(world, Settings(aa=1), (8, 8))

    def read(name: str) -> "F64":
        t = staged.sky.resources[name]
        return np.frombuffer(t.read(), np.float16).reshape(t.height, t.width, 4)[..., :3].astype(np.float64)

    atlas, levels, column = read("environment_rough"), [], 0
    for size in layout.PREFILTER_SIZES:
        levels.append(atlas[1 : size + 1, column + 1 : column + size + 1])
        column += size + 2
    return levels, read("environment_diffuse")[1:-1, 1:-1]


def skies(models: Path) -> dict[str, Environment]:
    blocks = np.random.default_rng(8).uniform(0, 1, (8, 16, 3)).astype(np.float32) ** 6 * 20
    return {
        "hall": Environment(read_environment(models / "environments" / "royal_esplanade_256.hdr")[0]),
        "studio": Environment(read_environment(models / "environments" / "studio_small_03_1k.hdr")[0]),
        "blocks": Environment(blocks),
    }


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """Convolutions are made here and now."""
    monkeypatch.setattr(content_cache, "read", lambda *_: None)
    monkeypatch.setattr(content_cache, "write", lambda *_: None)


@pytest.mark.usefixtures("no_cache")
@pytest.mark.parametrize("name", ["hall", "studio", "blocks"])
def test_convolutions(renderer: "Renderer", models: Path, name: str) -> None:
    """Irradiance over pi, and the GGX lobes of n = v = r weighted by N.L (Karis 2013), at texels drawn at random."""
    sky = skies(models)[name]
    levels, irradiance = maps_of(renderer, sky)
    grids = {rows: sphere_grid(sky, rows) for rows in (256, 512)}
    rng = np.random.default_rng(2)

    def check(image: "F64", weights: object, count: int) -> "F64":
        size = len(image)
        d, radiance, solid = grids[
            512 if name == "studio" or size >= 64 else 256
        ]  # narrow lobes and small lamps ask for a fine grid
        errors = []
        for y, x in rng.integers(0, size, (count, 2)):
            c = d @ octahedron(size)[y, x]
            w = weights(c) * solid  # type: ignore[operator]
            want = (radiance * w[:, None]).sum(0) / w.sum()
            errors.append(np.abs(image[y, x] - want).max() / want.mean())
        return np.array(errors)

    errors = {"irradiance": check(irradiance, lambda c: np.clip(c, 0, None), 8)}
    for i, image in enumerate(levels):
        a2 = ((i + 1) / len(levels)) ** 4

        def lobe(c: "F64", a2: float = a2) -> "F64":
            nh2 = (1 + c) / 2  # half vector: half the angle
            return np.clip(c, 0, None) * a2 / (nh2 * (a2 - 1) + 1) ** 2

        errors[f"level {i}"] = check(image, lobe, 4)
    for key, e in errors.items():
        print(f"{name} {key}: median {np.median(e):.4f}, largest {e.max():.4f}")
    assert np.median(errors["irradiance"]) < BARS["irradiance, median"].value
    assert errors["irradiance"].max() < BARS["irradiance, largest"].value
    lobes = np.concatenate([v for k, v in errors.items() if k != "irradiance"])
    assert np.median(lobes) < BARS["prefilter, median"].value and lobes.max() < BARS["prefilter, largest"].value


def test_convolutions_are_seamless(renderer: "Renderer", models: Path) -> None:
    """Rough reflections of the sky on a sphere have no seam where octahedral maps fold: steps stay as small as their light's."""
    sky = skies(models)["hall"]
    world = scene(
        [(floor(0.01, -1000.0), matte()), (Sphere(0.9), plastic(0.0, 0.6, specular_color=(1, 1, 1), ior=8.0))],
        camera=Camera.look_at((0, 4, 0.01), (0, 0, 0), fov_y=0.5), environment=sky,
    )  # fmt: skip
    frame = renderer.render(world, size=(128, 128), settings=Settings(aa=1, reflections="env"), aovs=("instance_id",))
    picture = frame["radiance"].astype(np.float64).mean(-1)
    inside = frame["instance_id"] == 1
    for _ in range(6):
        inside[1:-1, 1:-1] &= inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
    step = np.abs(np.diff(picture, axis=1))[inside[:, 1:]]
    bend = np.abs(np.diff(picture, 2, axis=1))[inside[:, 1:-1]]
    assert inside.mean() > 0.2 and bend.max() < 3 * np.quantile(step, 0.99), (bend.max(), np.quantile(step, 0.99))


@pytest.mark.usefixtures("no_cache")
def test_constant_is_constant(renderer: "Renderer") -> None:
    """A constant sky and a map of one colour are the same light, whatever the material and its roughness."""
    for roughness in (0.1, 0.6):
        material = plastic((0.5, 0.6, 0.7), roughness)
        pictures = []
        for sky in (
            constant_sky((0.5, 1.0, 2.0)),
            Environment(np.tile(np.array([0.5, 1.0, 2.0], np.float32), (16, 32, 1))),
        ):
            world = scene([(floor(), material), (Sphere(0.9), material, (0, 0.9, 0))], environment=sky)
            pictures.append(renderer.render(world, size=(48, 36), settings=Settings(aa=1))["radiance"])
        assert relative(pictures[1], pictures[0]).max() < BARS["half float"].value
