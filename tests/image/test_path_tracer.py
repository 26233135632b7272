"""The path-traced reference against Mitsuba 3 by Z-tests, and against scenes whose radiance is known without one."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from compare import Noisy, edges, keep, reference_batches, z_test
from scene_kit import box, camera_rays, constant_sky, floor, matte, metal, plastic, quad, scene, soup, sun, texture

from glhybrid.load.shapes import ellipsoid
from glhybrid.scene import Camera, Environment, Light, Material, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from mitsuba_client import Oracle

    from glhybrid.renderer import Renderer

SIZE = (64, 48)


@functools.cache
def rough_sky() -> Environment:
    """Texels that differ by 100, one that holds a third of the light, turned by an odd angle."""
    texels = np.random.default_rng(3).uniform(0.05, 1, (8, 16, 3)).astype(np.float32) ** 2 * 3
    texels[2, 5] = 40
    return Environment(texels, intensity=0.6, rotation=0.7)


def room(*more: Any, **extra: Any) -> Scene:
    """Rough and sharp metal, plastic, and a mix of both on a matte floor. Flat, but for the analytic balls."""
    c, s = np.cos(0.6), np.sin(0.6)
    turn = np.array([[c, 0, s, -0.9], [0, 1, 0, 0.5], [-s, 0, c, 0.2], [0, 0, 0, 1]])
    wall = quad([(-2, 0, -1.6), (2, 0, -1.8), (2, 2.2, -1.9), (-2, 2.2, -1.7)])
    parts = [
        (floor(3), matte((0.8, 0.7, 0.6))), (box((-0.5,) * 3, (0.5,) * 3), plastic((0.6, 0.2, 0.1), 0.3), turn),
        (Sphere(0.45), metal((0.9, 0.6, 0.3), 0.25), (0.9, 0.45, 0.4)), (Sphere(0.3), metal(0.9, 0.0), (0.1, 0.3, 1.2)),
        (wall, plastic((0.3, 0.5, 0.7), 0.6, metallic=0.5)), *more,
    ]  # fmt: skip
    return scene(parts, **extra)


def lamp(y: float = 3.2, **extra: Any) -> tuple:
    """A square that shines down (and, double-sided, up)."""
    shape = quad([(-0.6, y, -0.3), (0.6, y, -0.3), (0.6, y, 0.9), (-0.6, y, 0.9)])
    return shape, matte(0.5, emissive=(6.0, 5.0, 4.0), **extra)


def cornell(models: Path) -> Scene:
    """The file's geometry and lamp, seen from the open side."""
    import glhybrid

    world = glhybrid.load(models / "CornellBox" / "CornellBox.glb")
    camera = Camera.look_at((-278, 273, 800), (-278, 273, 0), fov_y=np.radians(39))
    return world.replace(lights=(), environment=None, cameras=(camera,))


def light_of(name: str) -> Callable[[], Scene]:
    suns = [sun(), Light("point", (1.0, 0.5, 0.2), 3.0, position=(0.5, 2.0, 1.0))]
    return {
        "constant sky": lambda: room(environment=constant_sky((0.7, 0.8, 1.0))),
        "sky map": lambda: room(environment=rough_sky()),
        "sun and point lamp": lambda: room(lights=suns),
        "square lamp": lambda: room(lamp()),
        "square lamp and sky": lambda: room(lamp(double_sided=False), environment=rough_sky()),
        "lamp of 120 triangles": lambda: room((facets(0.2, 12), matte(0.5, emissive=(6.0, 5.0, 4.0)), (0.3, 1.5, 0.3))),
    }[name]


def facets(radius: float, segments: int) -> Any:
    """A ball of flat triangles: Mitsuba takes the angle of a lamp's light from smooth normals, which glTF does not."""
    ball = ellipsoid(radii=(radius,) * 3, segments=segments)
    return soup(ball.position[ball.index])


def judge(
    renderer: "Renderer",
    oracle: "Oracle",
    world: Scene,
    bounces: int,
    scale: float,
    folder: Path,
    traced: Scene | None = None,
) -> None:
    """Z-test of the reference on `world` against Mitsuba on `traced` (the same thing in the oracle's means)."""
    settings = Settings(reflections="reference", samples=8, bounces=bounces, aa=1, seed=1)
    got = reference_batches(renderer, world, SIZE, settings, batches=int(64 * scale))
    want = Noisy(*oracle.render(traced or world, camera_rays(world, SIZE), bounces + 2, spp=int(512 * scale)))
    result = z_test(got, want)
    print(result)
    assert want.mean.mean() > 0.01
    ok = (
        result.passed >= BARS["z passed"].value
        and result.tiles < BARS["z of a tile"].value
        and result.whole < BARS["z of the picture"].value
        and BARS["z spread, low"].value < result.spread < BARS["z spread, high"].value
    )
    assert ok, (result, keep(folder, got=got.mean, want=want.mean, variance=got.variance + want.variance))


@pytest.mark.parametrize(
    ("light", "bounces"),
    [
        ("constant sky", 3), ("sky map", 0), ("sky map", 3), ("sun and point lamp", 3), ("square lamp", 0),
        ("square lamp and sky", 3), ("lamp of 120 triangles", 2),
    ],
)  # fmt: skip
def test_against_mitsuba(
    renderer: "Renderer", oracle: "Oracle", light: str, bounces: int, scale: float, tmp_path: Path
) -> None:
    judge(renderer, oracle, light_of(light)(), bounces, scale, tmp_path)


def test_the_test_sees_small_errors(renderer: "Renderer", oracle: "Oracle", scale: float, tmp_path: Path) -> None:
    """Control: a floor 2 % too dark, a metal of roughness 0.32 for 0.25, a sky turned by a tenth of a texel must all fail."""
    world = light_of("sky map")()
    sky = rough_sky()
    turned = Environment(sky.radiance, sky.intensity, sky.rotation + 0.1 * 2 * np.pi / 16)
    swaps = {0: matte((0.784, 0.686, 0.588)), 2: metal((0.9, 0.6, 0.3), 0.32)}
    wrong = [
        world.replace(materials=tuple(m if i != k else new for i, m in enumerate(world.materials)))
        for k, new in swaps.items()
    ]
    for other in (*wrong, world.replace(environment=turned)):
        with pytest.raises(AssertionError, match="Agreement"):
            judge(renderer, oracle, world, 0, scale, tmp_path, traced=other)


def test_cornell_box(renderer: "Renderer", oracle: "Oracle", models: Path, scale: float, tmp_path: Path) -> None:
    """A real file: a lamp through KHR_materials_emissive_strength, five units of scale hundreds, eight bounces."""
    judge(renderer, oracle, cornell(models), 8, scale, tmp_path)


def checker(half: float, y: float, holes: bool) -> Any:
    """8 x 8 squares over a horizontal square, all of them, or only those that a checkerboard keeps, as triangles."""
    step = 2 * half / 8
    corners = []
    for i in range(8):
        for j in range(8):
            if not holes or (i + j) % 2 == 0:
                x, z = -half + i * step, -half + j * step
                a, b, c, d = (x, y, z + step), (x + step, y, z + step), (x + step, y, z), (x, y, z)
                corners += [(a, b, c), (a, c, d)]
    return soup(corners)


@pytest.mark.parametrize("shines", [False, True])
def test_cut_outs(renderer: "Renderer", oracle: "Oracle", shines: bool, scale: float, tmp_path: Path) -> None:
    """A checkerboard cut out by alpha is the checkerboard cut out of the mesh: seen, in shadows, in mirrors, and as a lamp."""
    alpha = np.indices((8, 8)).sum(0) % 2 == 0
    texels = np.dstack([np.full((8, 8, 3), 255), np.where(alpha, 255, 0)])
    look: Any = {"emissive": (4.0, 3.0, 2.0)} if shines else {}
    cut = matte(0.7, alpha_mode="MASK", textures={"base_color": texture(texels, nearest=True)}, **look)
    light: Any = {} if shines else {"environment": constant_sky((0.5, 0.7, 1.0)), "lights": [sun()]}
    y = 1.8
    square = quad([(-1, y, 1), (1, y, 1), (1, y, -1), (-1, y, -1)], [(0, 1), (1, 1), (1, 0), (0, 0)])
    world = room((square, cut), **light)
    same = room((checker(1.0, y, holes=True), matte(0.7, **look)), **light)
    judge(renderer, oracle, world, 1, scale, tmp_path, traced=same)


def test_closed_white_room(renderer: "Renderer") -> None:
    """Walls that shine with 0.5 and reflect half of it: every path sums to 0.5 + 0.25 + ... = 1. pbrt's bar is 0.025."""
    camera = Camera.look_at((0.2, 0.1, 0.9), (0, 0, 0))
    inside = scene([(box((-1, -1, -1), (1, 1, 1), inside=True), matte(0.5, emissive=(0.5,) * 3))], camera)
    settings = Settings(reflections="reference", samples=64, bounces=40, aa=1)
    picture = renderer.render(inside, size=SIZE, settings=settings)["radiance"].astype(np.float64)
    assert abs(picture.mean() - 1) < BARS["closed room"].value, picture.mean()


def test_closed_mirror_room(renderer: "Renderer") -> None:
    """White mirrors that shine with 0.2, seen over 0 to 3 bounces: 0.2 for each surface met, without noise or leak."""
    camera = Camera.look_at((0.2, 0.1, 0.9), (0, 0, 0))
    inside = scene([(box((-1, -1, -1), (1, 1, 1), inside=True), metal(1.0, 0.0, emissive=(0.2,) * 3))], camera)
    for bounces in range(4):
        settings = Settings(reflections="reference", samples=4, bounces=bounces, aa=1)
        picture = renderer.render(inside, size=SIZE, settings=settings)["radiance"]
        assert np.abs(picture - 0.2 * (bounces + 2)).max() < 1e-6, bounces


def test_white_sky_shows_no_object(renderer: "Renderer") -> None:
    """White Lambert and a white mirror in a sky of 1 without end: radiance 1 everywhere. A leak, or a lost path, would show."""
    parts = [
        (floor(2), matte(1.0)), (box((-0.5, 0, -0.5), (0.5, 1, 0.5)), matte(1.0)),
        (Sphere(0.4), metal(1.0, 0.0), (1.1, 0.4, 0.3)), (Sphere(0.3), matte(1.0), (-1.1, 0.3, 0.5)),
    ]  # fmt: skip
    world = scene(parts, environment=constant_sky(1.0))
    settings = Settings(reflections="reference", samples=64, bounces=64, aa=1)
    picture = renderer.render(world, size=SIZE, settings=settings)["radiance"].astype(np.float64)
    assert abs(picture.mean() - 1) < BARS["white sky"].value, picture.mean()
    # Every pixel within its noise: 64 samples of a spread that never passes 1.
    assert np.abs(picture - 1).max() < 0.5


@pytest.mark.parametrize("light", ["sun and point lamp", "sun alone"])
def test_no_bounces_is_the_direct_light_of_the_hybrid(renderer: "Renderer", light: str) -> None:
    """`--bounces 0` with lamps and no sky: the same function, within noise where lamps are picked at random, else equal."""
    lights = {"lights": [sun()]} if light == "sun alone" else {"lights": light_of(light)().lights}
    world = room(**lights)
    mirror = world.materials[3]
    world = world.replace(materials=tuple(plastic() if m is mirror else m for m in world.materials))
    hybrid = renderer.render(world, size=SIZE, settings=Settings(aa=1, reflections="none"))["radiance"].astype(
        np.float64
    )
    settings = Settings(reflections="reference", samples=1 if light == "sun alone" else 4, bounces=0, aa=1)
    if light == "sun alone":
        frame = renderer.render(world, size=SIZE, settings=settings, aovs=("instance_id", "normal"))
        same = ~edges(frame["instance_id"], frame["normal"])  # where the raster's 1/256 px does not decide
        assert same.mean() > 0.8 and np.abs(frame["radiance"] - hybrid)[same].max() <= 1e-5 * hybrid.max()
        return
    got = reference_batches(renderer, world, SIZE, settings, batches=64)
    result = z_test(got, Noisy(hybrid, np.zeros_like(hybrid)))
    assert result.passed >= BARS["z passed"].value and result.tiles < BARS["z of a tile"].value, result


def test_seeds_and_samples(renderer: "Renderer") -> None:
    """One seed, one picture; other seeds other noise; n samples of a seed continue the first ones."""
    world = room(environment=rough_sky())

    def picture(**settings: int) -> np.ndarray:
        chosen = Settings(reflections="reference", bounces=2, aa=1, **settings)  # type: ignore[arg-type]
        return renderer.render(world, size=SIZE, settings=chosen)["radiance"].astype(np.float64)

    first = picture(samples=4)
    assert np.array_equal(first, picture(samples=4))
    other = picture(samples=4, seed=9)
    noise = np.abs(first - other).mean()
    assert noise > 0.01
    exact = picture(samples=600, seed=2)
    few, many = (np.sqrt(((picture(samples=n) - exact) ** 2).mean()) for n in (4, 64))
    assert 2.5 < few / many < 5.5, (few, many)  # error falls as 1 / sqrt(n): 4, less the noise of 600


def test_material_without_lamps_is_dark(renderer: "Renderer") -> None:
    world = room()
    settings = Settings(reflections="reference", samples=4, aa=1)
    assert not renderer.render(world, size=SIZE, settings=settings)["radiance"].any()


def test_unlit_shines_and_ends_the_path(renderer: "Renderer") -> None:
    """An unlit surface has the radiance of its base colour, in mirrors too, and is lit by nothing."""
    unlit = Material("unlit", (0.25, 0.5, 0.75, 1.0), unlit=True)
    world = scene([(floor(), metal(1.0, 0.0)), (box((-0.5, 0.2, -0.5), (0.5, 1.2, 0.5)), unlit)], lights=[sun()])
    frame = renderer.render(
        world, size=SIZE, settings=Settings(reflections="reference", samples=1, aa=1), aovs=("instance_id",)
    )
    inner = ~edges(frame["instance_id"])
    own = frame["radiance"][inner & (frame["instance_id"] == 1)]
    assert np.array_equal(np.unique(own, axis=0), [[0.25, 0.5, 0.75]])
    mirrored = frame["radiance"][inner & (frame["instance_id"] == 0)]
    seen = mirrored[mirrored.any(-1)]
    assert len(seen) > 50 and np.allclose(seen, [0.25, 0.5, 0.75], rtol=1e-6)
