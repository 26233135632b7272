"""Mirror rays for a part of the pixels, held against a ray for each."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, scene_of

import glhybrid as gh
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Camera, Environment, Image, Light, Material, Scene, Sphere, Texture
from glhybrid.shaders import Program

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (67, 45)  # odd: cells at the border have one neighbour
GRIDS = ("half", "checkerboard")
NAMES = ("reflection", "reflection_hit", "reason", "radiance")
LOOKS = {
    "perspective": Camera.look_at((3, 2.5, 5), (0, 0, 0)),
    "orthographic": replace(Camera.look_at((3, 2.5, 5), (0, 0, 0)), fov_y=0.0, ymag=2.5),
}


@pytest.fixture(scope="module")
def renderer(_shared_context: "Context") -> Iterator[gh.Renderer]:
    _shared_context.make_current()
    with gh.Renderer(context=_shared_context) as made:
        yield made


def scene(two_level: bool = False) -> Scene:
    """A mirror floor with a roughness map, a metal ring, a glossy ball and a matt box under a sky with detail."""
    rng = np.random.default_rng(4)
    checker = Texture(
        Image((np.kron(rng.integers(0, 2, (8, 8)), np.ones((4, 4)))[..., None] * [0, 200, 0, 255]).astype(np.uint8))
    )
    materials = (
        Material(roughness=1.0, textures={"metallic_roughness": checker}, double_sided=True),
        Material(metallic=1.0, roughness=0.1, base_color=(0.9, 0.7, 0.4, 1), double_sided=True),
        Material(roughness=0.3, base_color=(0.3, 0.5, 0.8, 1)),
        Material(base_color=(0.8, 0.2, 0.2, 1)),
    )  # fmt: skip
    shapes = (box(size=(9, 0.2, 9)), torus(segments=40, sides=20), Sphere(0.7), box(size=(0.8, 1.6, 0.8)))
    poses = [moved((0, -1, 0)), moved((-1, 0.2, 0)), moved((1.4, -0.2, 0.5)), moved((0.2, -0.1, -1.5))]
    made = scene_of(*shapes, poses=poses, materials=materials)
    instances = tuple(replace(i, materials=(k,)) for k, i in enumerate(made.instances))
    if two_level:
        instances += tuple(replace(i, world_from_object=moved((0, 2.2, -3))) for i in instances[1:])
    sky = Environment(rng.uniform(0.1, 1.0, (8, 16, 3)).astype(np.float32))
    return made.replace(
        instances=instances,
        environment=sky,
        lights=(Light("directional", direction=(-0.4, -0.8, -0.4), intensity=3.0),),
    )


def render(
    renderer: gh.Renderer,
    made: Scene,
    resolution: str = "full",
    contrast: float = 0.1,
    size: Any = SIZE,
    look: str = "perspective",
    **more: Any,
) -> gh.Frame:
    parameters = {"reflections.ray-lerp.resolution": resolution, "reflections.ray-lerp.contrast": contrast}
    settings = gh.Settings(aa=1, exposure=0.0, parameters=parameters, **more)
    return renderer.render(made, LOOKS[look], size, settings, NAMES)


def rays_sent(renderer: gh.Renderer, resolution: str, size: tuple[int, int]) -> int:
    """Pixels of the grid and of the list, surface or not."""
    listed = int(np.frombuffer(renderer._staged.passes.reflect._count.read(), np.uint32)[3])  # type: ignore[union-attr]
    return listed + size[0] * size[1] // {"half": 4, "checkerboard": 2}[resolution]


def of_the_grid(resolution: str, size: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: pixels that always send their own ray. Rows count from the bottom."""
    width, height = size
    x, y = np.arange(width)[None, :], np.arange(height)[::-1, None]
    return ((x | y) & 1) == 0 if resolution == "half" else ((x + y) & 1) == 0


def same(renderer: gh.Renderer, got: Any, want: Any) -> bool:
    """To the last bit; where the ray for each pixel goes in parts, as on GPUs, but for the rounding of what they hand on."""
    if renderer.context.device.software:
        return np.array_equal(got, want)
    return bool((~np.isclose(got, want, 1e-4, 1e-4)).mean() <= 1e-3)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize(
    ("look", "kind", "primary"),
    [
        ("perspective", {}, "raster"),
        ("orthographic", {"two_level": True}, "trace"),
    ],
)
def test_without_tolerance_it_is_a_ray_for_each(
    renderer: gh.Renderer, grid: str, look: str, kind: dict[str, bool], primary: str
) -> None:
    """contrast = 0 shares nothing: every ray is traced, by the grid or from the list, and the same."""
    made = scene(**kind)
    want = render(renderer, made, look=look, primary=primary)
    got = render(renderer, made, grid, 0.0, look=look, primary=primary)
    for name in NAMES:
        assert same(renderer, got[name], want[name]), name


@pytest.mark.parametrize(("grid", "most_rays", "most_error"), [("half", 0.5, 0.0005), ("checkerboard", 0.7, 0.0005)])
def test_fewer_rays_and_what_they_cost(renderer: gh.Renderer, grid: str, most_rays: float, most_error: float) -> None:
    """The error of the picture against a ray for each, of all its radiance; measured 0.00005 and 0.00003 on
    llvmpipe.

    The bar is ten times that: what is lost is features thinner than two pixels, and rounding may move their outlines.
    """
    made, size = scene(), (240, 160)
    want = render(renderer, made, size=size)
    got = render(renderer, made, grid, size=size)
    sent = rays_sent(renderer, grid, size)
    mirrors = int((want["reflection_hit"] > 0).sum())
    error = np.abs(got["radiance"] - want["radiance"])
    share = error.sum() / want["radiance"].sum()
    off = (error.max(-1) > 0.1 * want["radiance"].max(-1)).mean()
    print(f"{grid}: {sent} rays for {mirrors} pixels, error {share:.5f}, {off:.5f} of pixels by more than contrast")
    exact = of_the_grid(grid, size)
    own, each = got["reflection"][exact], want["reflection"][exact]
    assert same(renderer, own, each), "a pixel with a ray of its own differs"
    assert sent < most_rays * size[0] * size[1] and share < most_error
    assert off < 0.002
    assert error.any(), "nothing was shared: this test would not see a fault"
    assert (got["reason"] == want["reason"]).mean() > 0.98


def test_more_contrast_fewer_rays(renderer: gh.Renderer) -> None:
    made, sent = scene(), []
    for contrast in (0.0, 0.02, 0.1, 0.5, 1.0):
        render(renderer, made, "half", contrast)
        sent.append(rays_sent(renderer, "half", SIZE))
    assert sent == sorted(sent, reverse=True) and sent[0] > 1.3 * sent[-1]


def test_what_hardly_shows_is_shared(renderer: gh.Renderer) -> None:
    """The same sky with detail in a floor: a mirror needs rays where it differs, matt plaster shows next to nothing of it."""
    made, sent = scene(), []
    for metallic, roughness in ((1.0, 0.0), (0.0, 0.3), (0.0, 0.8)):
        floor = Material(metallic=metallic, roughness=roughness, double_sided=True)
        only = made.replace(materials=(floor, *made.materials[1:]), instances=made.instances[:1])
        render(renderer, only, "half")
        sent.append(rays_sent(renderer, "half", SIZE))
    print(sent)
    assert sent == sorted(sent, reverse=True) and sent[0] > 1.2 * sent[-1]


def test_another_material_needs_its_own_ray(renderer: gh.Renderer) -> None:
    """Tilted mirrors a pixel wide in a plaster wall: what plaster shares does not do for them."""
    names = ("reflection_hit", "reflection", "material_id", "radiance")
    wall = box(size=(40, 40, 0.2))
    wire = box(size=(40, 0.14, 0.01))
    tilt = np.eye(4)
    tilt[1:3, 1:3] = [[0.9, -0.43589], [0.43589, 0.9]]
    poses = [moved((0, 0, -0.1)), *(moved((0, -3.2 + 0.31 * k, 0.0)) @ tilt for k in range(20))]
    materials = (Material(roughness=0.9), Material(metallic=1.0, roughness=0.0))
    made = scene_of(wall, *[wire] * 20, poses=poses, materials=materials)
    made = made.replace(
        instances=tuple(replace(i, materials=(min(k, 1),)) for k, i in enumerate(made.instances)),
        environment=scene().environment,
    )
    look = replace(Camera.look_at((0, 0, 5), (0, 0, 0)), fov_y=0.0, ymag=2.5)
    found = {}
    for grid in ("full", "half"):
        parameters = {"reflections.ray-lerp.resolution": grid, "reflections.ray-lerp.contrast": 1.0}
        settings = gh.Settings(aa=1, exposure=0.0, parameters=parameters)
        found[grid] = renderer.render(made, look, SIZE, settings, names)
    mirrors = found["full"]["material_id"] == 1
    assert 0.2 < mirrors.mean() < 0.7
    for name in ("radiance", "reflection"):
        assert np.allclose(found["half"][name][mirrors], found["full"][name][mirrors], 1e-3, 1e-3), name


def test_full_resolution_has_none_of_it(context: "Context") -> None:
    with gh.Renderer(context=context) as fresh:
        plain = render(fresh, scene()).receipt["plan"]
        images = set(fresh._staged.targets._images)  # type: ignore[union-attr]
        assert not any("GRID" in name or "resolve" in name for name in (*plain["programs"], *images))
        assert "reflection_guide" not in images
        less = render(fresh, scene(), "half").receipt["plan"]
        cells = (SIZE[0] + 1) // 2 * ((SIZE[1] + 1) // 2)
        assert less["image_bytes"] - plain["image_bytes"] == 16 * cells
        more = set(less["programs"]) - set(plain["programs"])
        assert more and all("GRID" in name for name in more)


def test_another_size_after_the_first(renderer: gh.Renderer) -> None:
    """The list grows with the picture."""
    made = scene()
    for size in (SIZE, (90, 70), (33, 20)):
        sparse, each = render(renderer, made, "half", 0.0, size), render(renderer, made, size=size)
        assert same(renderer, sparse["radiance"], each["radiance"])


@pytest.mark.parametrize("grid", GRIDS)
def test_rays_of_the_list_go_beside_the_shadow_rays(
    context: "Context", grid: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In parts: what few rays leave idle is there for what the frame has to do anyway, and nobody reads them before."""
    ran: list[tuple[str, bool]] = []
    for way in ("dispatch", "dispatch_indirect"):
        run = getattr(Program, way)

        def noted(self: Program, *given: Any, run: Any = run, wait: bool = True, **more: Any) -> None:
            ran.append((self.name.split(" ")[0] + "+" * ("PIXEL_LIST" in self.name), wait))
            run(self, *given, wait=wait, **more)

        monkeypatch.setattr(Program, way, noted)
    with gh.Renderer(context=context) as fresh:
        parameters = {"reflections.ray-lerp.resolution": grid}
        settings = gh.Settings(aa=1, exposure=0.0, primary="trace", kernels="split", parameters=parameters)
        fresh.render(scene(), LOOKS["perspective"], SIZE, settings)
    names, waits = [name for name, _ in ran], dict(ran)
    begin = names.index("gbuffer")
    assert names[begin : names.index("composite") + 1] == [
        "gbuffer", "reflect_ray", "reflect_shadow", "reflect_guide", "reflect_shade", "reflect_resolve",
        "reflect_ray+", "shadow", "reflect_shadow+", "reflect_shade+", "composite",
    ]  # fmt: skip
    assert [name for name in names[begin:] if not waits[name]] == ["reflect_shadow", "reflect_ray+", "shadow"]
