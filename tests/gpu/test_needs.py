"""What a scene does not need is not there: no program, image, buffer or dispatch of it. Counted, not believed."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, scene_of

import glhybrid as gh
from glhybrid import geometry, plan
from glhybrid.image import AOVS
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Camera, Environment, Image, Light, Material, Scene, Sphere, Texture

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (64, 48)
SUN = (Light("directional", direction=(-0.4, -0.8, -0.4)),)
SKY = Environment(np.full((1, 1, 3), 0.3, np.float32))
CAMERA = Camera.look_at((2, 2, 4), (0, 0, 0))
TEXTURE = Texture(Image(np.random.default_rng(0).integers(0, 255, (16, 16, 4)).astype(np.uint8)))


@pytest.fixture
def renderer(context: "Context") -> Iterator[gh.Renderer]:
    """A fresh one for each test: its programs and images are those of the test."""
    with gh.Renderer(context=context) as made:
        yield made


def scene(material: Material | None = None, lights: tuple[Light, ...] = SUN, sky: Environment | None = SKY) -> Scene:
    """Two different bodies in one material: matt, two-sided, without textures unless told."""
    plain = material or Material(double_sided=True)
    return scene_of(
        box(), torus(segments=16, sides=8), poses=[np.eye(4), moved((1, 0, 0))], materials=(plain,)
    ).replace(lights=lights, environment=sky)


class Ran:
    """A rendered frame and what it took."""

    def __init__(self, renderer: gh.Renderer, scene: Scene, **settings: Any) -> None:
        chosen = gh.Settings(aa=1, exposure=0.0, **settings)
        self.frame = renderer.render(scene, CAMERA, SIZE, chosen)
        staged = renderer.stage(scene, chosen, SIZE)
        self.plan = self.frame.receipt["plan"]
        self.programs: list[str] = self.plan["programs"]
        self.dispatched = {p["name"] for p in self.frame.receipt["passes"]}
        self.images = set(staged.targets._images)
        self.resources = set(staged.upload.resources)
        self.read = {name for p in renderer.shaders._programs.values() for name in p.resources}
        self.features = staged.features

    def names(self, word: str) -> bool:
        """Whether any linked program is specialised for, or reads, something called so."""
        return any(word.upper() in p.upper() for p in self.programs) or any(
            word.lower() in r.lower() for r in self.read
        )

    def skipped(self, words: str) -> bool:
        return any(s.startswith(words) for s in self.plan["skipped"])


def test_the_plain_scene_runs_three_passes(renderer: gh.Renderer) -> None:
    ran = Ran(renderer, scene())
    rays = {"gbuffer", "shadow"} if renderer.context.device.software else {"rays"}  # a GPU joins the two
    assert ran.dispatched == {*rays, "composite", "display"} == set(ran.plan["passes"])
    assert len(ran.programs) <= 6, ran.programs
    for word in (
        "alpha",
        "blend",
        "texture",
        "tangent",
        "attributes",
        "sphere",
        "clearcoat",
        "specular=",
        "normal_map",
    ):
        assert not ran.names(word), (word, ran.programs, ran.read)
    for name in ("texture_pages", "Textures", "TextureLevels", "tangents", "attributes"):
        assert name not in ran.resources


def test_no_mirror_no_reflection(renderer: gh.Renderer) -> None:
    ran = Ran(renderer, scene())
    assert "reflect" not in ran.dispatched and not any(p.startswith("reflect") for p in ran.programs)
    assert "reflection" not in ran.images and ran.skipped("reflect pass")
    bytes_without = ran.plan["image_bytes"]
    mirror = Ran(renderer, scene(Material(double_sided=True, roughness=0.1)), kernels="fused")
    assert "reflect" in mirror.dispatched and any(p.startswith("reflect") for p in mirror.programs)
    assert mirror.plan["image_bytes"] - bytes_without == 16 * SIZE[0] * SIZE[1]
    off = Ran(renderer, scene(Material(double_sided=True, roughness=0.1)), reflections="none")
    assert "reflect" not in off.dispatched and "reflection" not in off.images


def test_no_cut_out_no_alpha(renderer: gh.Renderer) -> None:
    textured = Material(double_sided=True, textures={"base_color": TEXTURE})
    ran = Ran(renderer, scene(textured))
    assert not ran.names("alpha") and ran.skipped("alpha tests")
    cut = Ran(renderer, scene(replace(textured, alpha_mode="MASK")))
    assert cut.names("alpha_test")
    # A raster program for what is whole stays free of it, beside the one for what is cut.
    mixed = scene_of(box(), torus(), materials=(replace(textured, alpha_mode="MASK"), Material(double_sided=True)))
    mixed = mixed.replace(instances=(mixed.instances[0], replace(mixed.instances[1], materials=(1,))), lights=SUN)
    both = Ran(renderer, mixed, primary="raster")
    gbuffers = [p for p in both.programs if p.startswith("gbuffer")]
    assert any("ALPHA_TEST" in p for p in gbuffers) and any("ALPHA_TEST" not in p for p in gbuffers)


def test_no_texture_no_page(renderer: gh.Renderer) -> None:
    ran = Ran(renderer, scene())
    assert "texture_pages" not in ran.resources and "texture_pages" not in ran.read and ran.skipped("textures")
    textured = Ran(renderer, scene(Material(double_sided=True, textures={"base_color": TEXTURE})))
    assert "texture_pages" in textured.resources and "texture_pages" in textured.read
    assert textured.plan["image_bytes"] > ran.plan["image_bytes"]
    assert "tangents" not in textured.resources  # only normal maps need them
    assert "tangents" in Ran(renderer, scene(Material(double_sided=True, textures={"normal": TEXTURE}))).resources


def test_no_light_no_visibility(renderer: gh.Renderer) -> None:
    ran = Ran(renderer, scene(lights=()))
    assert "shadow" not in ran.dispatched and not any(p.startswith("shadow") for p in ran.programs)
    assert not {"visibility", "visibility_tint"} & ran.images and ran.skipped("shadow pass")
    one, two = Ran(renderer, scene()), Ran(renderer, scene(lights=SUN * 2))
    assert one.plan["image_bytes"] - ran.plan["image_bytes"] == SIZE[0] * SIZE[1]
    assert two.plan["image_bytes"] - one.plan["image_bytes"] == SIZE[0] * SIZE[1]
    off = Ran(renderer, scene(), shadows="none")
    assert "shadow" not in off.dispatched and "visibility" not in off.images
    unlit = Ran(renderer, scene(Material(double_sided=True, unlit=True)))
    assert "shadow" not in unlit.dispatched


def test_no_environment_no_map(renderer: gh.Renderer) -> None:
    ran = Ran(renderer, scene(sky=None))
    assert not any("environment" in name for name in ran.read) and ran.skipped("environment")
    constant = Ran(renderer, scene())
    assert "environment_constant" in constant.read and "environment_map" not in constant.read
    varied = Environment(np.random.default_rng(0).uniform(0, 1, (8, 16, 3)).astype(np.float32))
    mapped = Ran(renderer, scene(sky=varied))
    assert "environment_map" in mapped.read and mapped.plan["image_bytes"] > constant.plan["image_bytes"]


def test_the_reference_convolves_no_sky(renderer: gh.Renderer) -> None:
    varied = Environment(np.random.default_rng(0).uniform(0, 1, (8, 16, 3)).astype(np.float32))
    ran = Ran(renderer, scene(sky=varied), reflections="reference", samples=1)
    assert "environment_map" in ran.read and not any(p.startswith("sky") for p in ran.programs)
    assert not {"environment_rough", "environment_diffuse", "dfg"} & set(ran.resources)


def test_the_reference_of_nothing_is_the_sky(renderer: gh.Renderer) -> None:
    varied = Environment(np.random.default_rng(0).uniform(0, 1, (8, 16, 3)).astype(np.float32))
    pictures = [
        Ran(renderer, scene_of().replace(environment=varied), reflections=name, samples=1).frame["radiance"]
        for name in ("reference", "ray-lerp")
    ]
    assert np.array_equal(*pictures) and pictures[0].std() > 0.1


def test_one_level_where_nothing_repeats(renderer: gh.Renderer) -> None:
    flat = Ran(renderer, scene())
    assert flat.plan["levels"] == 1 and not flat.names("two_level")
    repeated = scene()
    again = repeated.replace(
        instances=tuple(
            replace(i, world_from_object=moved((0, 2 * k, 0))) for k in range(8) for i in repeated.instances
        )
    )
    ran = Ran(renderer, again)
    assert ran.plan["levels"] == 2 and ran.names("two_level")
    assert ran.frame.receipt["bvh"]["bytes"] < 1.2 * flat.frame.receipt["bvh"]["bytes"]  # stored once


def test_triangles_only_no_spheres(renderer: gh.Renderer) -> None:
    assert not Ran(renderer, scene()).names("sphere")
    ball = scene_of(Sphere(1.0), materials=(Material(double_sided=True),)).replace(lights=SUN, environment=SKY)
    assert Ran(renderer, ball).names("sphere")


def test_a_second_frame_compiles_and_allocates_nothing(renderer: gh.Renderer) -> None:
    material = Material(double_sided=True, roughness=0.2, textures={"base_color": TEXTURE})
    made, chosen = scene(material), gh.Settings(aa=1, exposure=0.0)
    first = renderer.render(made, CAMERA, SIZE, chosen).receipt["plan"]
    programs = dict(renderer.shaders._programs)
    second = renderer.render(made, Camera.look_at((3, 1, 4), (0, 0, 0)), SIZE, chosen).receipt["plan"]
    assert renderer.shaders._programs == programs
    assert {k: v for k, v in first.items() if "bytes" in k} == {k: v for k, v in second.items() if "bytes" in k}


def test_features_that_differ_in_nothing_a_pass_reads_share_its_program(renderer: gh.Renderer) -> None:
    """A program's key is what its text names: shading features must not multiply the raster's programs."""
    Ran(renderer, scene(), primary="raster")
    before = [p for p in renderer.shaders.names if p.startswith("gbuffer")]
    Ran(renderer, scene(Material(double_sided=True, roughness=0.1, clearcoat=1.0)), primary="raster")
    Ran(renderer, scene(sky=None), primary="raster")
    assert [p for p in renderer.shaders.names if p.startswith("gbuffer")] == before


def glossy(**parameters: Any) -> dict[str, Any]:
    named = {k if "." in k else f"reflections.ray-glossy.{k}": v for k, v in parameters.items()}
    return {"reflections": "ray-glossy", "parameters": named}


def test_no_lamp_in_the_sky_no_ray_to_it(renderer: gh.Renderer) -> None:
    """A table of where the sky is bright, and a second ray, only where lobes would find too rarely what shines."""
    rough, mirror = Material(double_sided=True, roughness=0.4), Material(double_sided=True, roughness=0.0)
    even = np.random.default_rng(0).uniform(0, 1, (16, 32, 3)).astype(np.float32)
    spot = even.copy()
    spot[3, 5] = 500
    with gh.Renderer(context=renderer.context) as fresh:
        none = Ran(fresh, scene(rough, sky=Environment(even)), **glossy())
        assert none.skipped("rays to lamps of the sky") and none.features.glossy
        for ran in (
            none, Ran(fresh, scene(rough, sky=Environment(spot)), **glossy(sky_rays=False)),
            Ran(fresh, scene(mirror, sky=Environment(spot)), **glossy()), Ran(fresh, scene(rough), **glossy()),
            Ran(fresh, scene(rough, sky=Environment(spot))),
        ):  # fmt: skip
            assert not ran.names("sky_samples") and not ran.names("environment_cdf")
            assert "environment_cdf" not in ran.resources
    lamp = Ran(renderer, scene(rough, sky=Environment(spot)), **glossy())
    assert lamp.names("sky_samples") and "environment_cdf" in lamp.resources
    assert not lamp.skipped("rays to lamps of the sky")


def test_no_shining_mesh_no_ray_to_it(renderer: gh.Renderer) -> None:
    """A table of what shines, and a ray to it, only where something much brighter than the sky does."""
    rough = Material(double_sided=True, roughness=0.4)
    with gh.Renderer(context=renderer.context) as fresh:
        for ran in (
            Ran(fresh, scene(rough), **glossy()), Ran(fresh, scene(replace(rough, emissive=(0.1, 0.1, 0.1))), **glossy()),
            Ran(fresh, scene(replace(rough, emissive=(500.0, 0, 0))), **glossy(lamp_rays=False)),
        ):  # fmt: skip
            assert not ran.names("emitters") and not ran.features.emitters
    assert Ran(renderer, scene(rough), **glossy()).skipped("rays to meshes that shine")
    assert Ran(renderer, scene(replace(rough, emissive=(500.0, 0, 0))), **glossy()).names("emitters")


def test_no_noise_no_filter(renderer: gh.Renderer) -> None:
    """A filter runs, and has images, only where a technique is noisy: not for hard shadows, mirrors, or when it is off."""
    rough, mirror = Material(double_sided=True, roughness=0.4), Material(double_sided=True, roughness=0.0)
    wide = (replace(SUN[0], angular_diameter=0.1),)

    def filtered(ran: Ran) -> bool:
        parts = {
            "denoise" in ran.dispatched, "denoise" in ran.plan["passes"], any(p.startswith("denoise") for p in ran.programs),
            any("history" in i or "denoise" in i or "guide" in i for i in ran.images),
        }  # fmt: skip
        assert len(parts) == 1, (ran.dispatched, ran.images)
        return parts.pop()

    with gh.Renderer(context=renderer.context) as fresh:
        assert not filtered(Ran(fresh, scene(lights=SUN), shadows="ray-soft"))
        assert not filtered(Ran(fresh, scene(mirror), **glossy()))
        assert not filtered(Ran(fresh, scene(rough), **glossy(denoise=False)))
        assert not filtered(Ran(fresh, scene(rough), **glossy(cutoff=0.3)))
        assert not filtered(
            Ran(fresh, scene(lights=wide), shadows="ray-soft", parameters={"shadows.ray-soft.denoise": False})
        )
        assert not filtered(Ran(fresh, scene(), ao="ray", parameters={"ao.ray.denoise": False}))
        assert not filtered(Ran(fresh, scene(), ao="ssao")) and not filtered(Ran(fresh, scene(sky=None), ao="ray"))
    open_sky = Ran(renderer, scene(), ao="ray")
    assert filtered(open_sky) and not any("reflection" in i or "visibility_" in i for i in open_sky.images)
    soft = Ran(renderer, scene(lights=wide), shadows="ray-soft")
    assert filtered(soft) and not any("reflection" in i or "occlusion" in i for i in soft.images)
    both = Ran(renderer, scene(rough, lights=wide), shadows="ray-soft", **glossy())
    assert filtered(both) and {"reflection_history_odd", "visibility_history_odd"} <= both.images
    assert not any("coat" in i for i in both.images) and "denoise_moved" not in both.images
    coated = Ran(renderer, scene(replace(rough, clearcoat=1.0)), **glossy())
    assert {"reflection_coat", "reflection_coat_history_odd"} <= coated.images
    # Rays are kept one by one only where there are few, for filters alone.
    assert "reflection_rays" in both.images and {"reflection_rays", "reflection_coat_rays"} <= coated.images
    with gh.Renderer(context=renderer.context) as fresh:
        for ran in (Ran(fresh, scene(rough), **glossy(samples=5)), Ran(fresh, scene(rough), **glossy(denoise=False))):
            assert not any("rays" in i for i in ran.images) and not ran.names("reuse")


UNTRACED = [
    {"shadows": shadows, "reflections": reflections, "ao": ao}
    for shadows, reflections, ao in (
        ("none", "none", "none"), ("map", "env", "none"), ("pcf", "none", "ssao"), ("pcss", "ssr", "ssao"),
        ("csm", "probe", "none"), ("none", "ssr", "none"), ("none", "probe", "ssao"),
    )
]  # fmt: skip
TRACED: list[dict[str, Any]] = [
    {"shadows": "ray"}, {"shadows": "ray-soft"}, {"shadows": "baked"}, {"reflections": "ray-lerp"},
    {"reflections": "ssr-ray"}, {"reflections": "ray-glossy"}, {"reflections": "reference", "samples": 1},
    {"ao": "ray"}, {"primary": "trace"},
]  # fmt: skip
PLAIN = {"shadows": "none", "reflections": "none", "primary": "raster"}
EVERY_AOV = tuple(AOVS)


def bright(**more: Any) -> Scene:
    """Something for every technique: a mirror, a lamp with a size, a sky that varies."""
    sky = Environment(np.random.default_rng(0).uniform(0, 1, (8, 16, 3)).astype(np.float32))
    return scene(Material(double_sided=True, roughness=0.2, **more), (replace(SUN[0], angular_diameter=0.1),), sky)


@pytest.mark.parametrize("asked", UNTRACED, ids=lambda a: "-".join(a.values()))
def test_no_ray_no_tree(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch, asked: dict[str, Any]) -> None:
    """No tree is built or uploaded, and no program reads one: all AOVs included.

    Without lib/buffers.glsl's array, which names every buffer, a program that reads a tree fails to bind it.
    """
    made = plan.make
    monkeypatch.setattr(
        plan,
        "make",
        lambda *a, **k: (p := made(*a, **k)) and replace(p, features=p.features.replace(buffer_array=False)),
    )
    monkeypatch.setattr(geometry, "load_or_build", lambda *_, **__: pytest.fail("a tree was built"))
    settings = gh.Settings(aa=1, exposure=0.0, primary="raster", **asked)
    frame = renderer.render(bright(), CAMERA, SIZE, settings, EVERY_AOV)
    told = frame.receipt
    assert told["bvh"] == {"levels": 1, "nodes": 0, "depth": 0, "sah_cost": 0.0, "build_ms": 0.0, "bytes": 0}
    assert "trees: nothing sends rays" in told["plan"]["skipped"]
    staged = renderer.stage(bright(), settings, SIZE, EVERY_AOV)
    assert not {"nodes", "slots"} & set(staged.upload.resources)
    assert not frame["bvh_steps"].any() and (frame["instance_id"] < 2).any()


@pytest.mark.parametrize("asked", TRACED, ids=lambda a: next(iter(a.values())))
def test_a_tree_once_something_traces(renderer: gh.Renderer, asked: dict[str, Any]) -> None:
    """Built then, for an upload that is shared: the picture is that of a renderer that had it from the start."""
    made, settings = bright(), gh.Settings(aa=1, exposure=0.0, **{**PLAIN, **asked})  # type: ignore[arg-type]
    before = renderer.render(made, CAMERA, SIZE, gh.Settings(aa=1, exposure=0.0, **PLAIN))  # type: ignore[arg-type]
    upload = renderer._stagings[-1].upload
    after = renderer.render(made, CAMERA, SIZE, settings, ("visibility", "reflection"))
    assert renderer._stagings[-1].upload is upload
    assert before.receipt["bvh"]["bytes"] == 0 < after.receipt["bvh"]["bytes"]
    assert (
        after.receipt["plan"]["buffer_bytes"] - before.receipt["plan"]["buffer_bytes"] >= after.receipt["bvh"]["bytes"]
    )
    with gh.Renderer(context=renderer.context) as fresh:
        want = fresh.render(made, CAMERA, SIZE, settings, ("visibility", "reflection"))
    for name in ("radiance", "visibility", "reflection"):
        assert np.array_equal(after[name], want[name]), name
    again = renderer.render(made, CAMERA, SIZE, gh.Settings(aa=1, exposure=0.0, **PLAIN))  # type: ignore[arg-type]
    assert np.array_equal(again["radiance"], before["radiance"])


def test_layers_need_a_tree(renderer: gh.Renderer) -> None:
    glass = scene(Material(double_sided=True, alpha_mode="BLEND", base_color=(1, 1, 1, 0.5)))
    assert Ran(renderer, glass, **PLAIN).frame.receipt["bvh"]["bytes"] > 0
    assert Ran(renderer, scene_of(), **PLAIN).skipped("trees: nothing is drawn")
