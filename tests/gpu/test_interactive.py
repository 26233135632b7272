"""What an interactive client asks of the renderer: cheap changes of size, light and technique, and shaders that reload."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glhybrid import Renderer, Scene, Settings, ShaderError, load, techniques
from glhybrid.context import Context

SIZE = (64, 40)


@pytest.fixture
def renderer(context: Context) -> Iterator[Renderer]:
    with Renderer(context=context, interactive=True) as made:
        yield made


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load("cornell")


def relit(scene: Scene) -> Scene:
    """The same with its lights moved and its sky, if any, turned."""
    lights = tuple(
        replace(p, position=tuple(np.add(p.position, 0.1)), direction=(0.6, -0.8, 0.0), intensity=0.5 * p.intensity)
        for p in scene.lights
    )
    sky = scene.environment and replace(scene.environment, rotation=1.0, intensity=0.7)
    return scene.replace(lights=lights, environment=sky)


@pytest.mark.parametrize("settings", [Settings(aa=1), Settings(aa=1, shadows="pcf"), Settings(reflections="reference", samples=2)], ids=["ray", "pcf", "reference"])  # fmt: skip
@pytest.mark.parametrize("name", ["cornell", "sky"])
def test_other_lights_cost_no_staging_and_look_as_if_staged(
    renderer: Renderer, context: Context, settings: Settings, name: str
) -> None:
    scene = load("cornell") if name == "cornell" else _under_a_sky()
    renderer.render(scene, size=SIZE, settings=settings)
    staged = renderer._staged
    got = renderer.render(relit(scene), size=SIZE, settings=settings)
    assert renderer._staged is staged
    with Renderer(context=context) as fresh:
        want = fresh.render(relit(scene), size=SIZE, settings=settings)
        before = fresh.render(scene, size=SIZE, settings=settings)
    assert np.array_equal(got["radiance"], want["radiance"])
    assert not np.array_equal(before["radiance"], want["radiance"])
    again = renderer.render(scene, size=SIZE, settings=settings)
    assert np.array_equal(again["radiance"], before["radiance"])


def _under_a_sky() -> Scene:
    from glhybrid.scene import Camera, Environment, Instance, Light, Material, Mesh, Sphere

    ramp = np.linspace(0.1, 1.0, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
    return Scene(
        name="ball", meshes=(Mesh("ball", (Sphere(1.0),)),), instances=(Instance(0, np.eye(4)),),
        materials=(Material(roughness=0.3, metallic=1.0),), lights=(Light("directional"),),
        cameras=(Camera.look_at((0, 1, 4), (0, 0, 0)),), environment=Environment(ramp),
    )  # fmt: skip


def test_stagings_side_by_side_do_not_disturb_each_other(renderer: Renderer, context: Context, scene: Scene) -> None:
    """Three settings in turns, sample by sample, give the pictures that each gives alone, on one upload."""
    from glhybrid.timing import Timing

    every = [
        Settings(aa=3),
        Settings(aa=3, shadows="pcss", reflections="env"),
        Settings(reflections="reference", samples=3),
    ]
    timing = Timing(context.gl.finish)
    running = []
    for settings in every:
        staged = renderer.stage(scene, settings, SIZE)
        staged.aim(settings, None)
        running.append((settings, staged.refine(timing)))
    assert len({id(renderer.stage(scene, s, SIZE).upload) for s in every}) == 1
    pictures = {}
    for _ in range(3):  # on a GPU one step is several samples of the reference
        for settings, samples in running:
            renderer.stage(scene, settings, SIZE)
            step = next(samples, None)
            if step is None:
                continue
            _, _, image = step
            pictures[settings.shadows, settings.reflections] = np.frombuffer(image.read(), np.float32)
    for settings in every:
        with Renderer(context=context) as alone:
            want = alone.render(scene, size=SIZE, settings=settings)["radiance"]
        got = pictures[settings.shadows, settings.reflections].reshape(SIZE[1], SIZE[0], 4)[::-1, :, :3]
        assert np.array_equal(got, want), settings


def test_another_size_changes_images_alone(renderer: Renderer, context: Context, scene: Scene) -> None:
    renderer.render(scene, size=SIZE, settings=Settings(aa=1))
    staged = renderer._staged
    assert staged is not None
    small = renderer.render(scene, size=(32, 20), settings=Settings(aa=1))
    large = renderer.render(scene, size=SIZE, settings=Settings(aa=1))
    assert renderer._staged is staged
    for frame in (small, large):
        with Renderer(context=context) as fresh:
            assert np.array_equal(
                fresh.render(scene, size=frame.size, settings=Settings(aa=1))["radiance"], frame["radiance"]
            )


def test_exposure_tone_and_counts_change_numbers_alone(renderer: Renderer, context: Context, scene: Scene) -> None:
    renderer.render(scene, size=SIZE, settings=Settings(aa=1))
    staged = renderer._staged
    other = Settings(aa=2, exposure=1.5, tone="aces", seed=3, bounces=1)
    got = renderer.render(scene, size=SIZE, settings=other)
    assert renderer._staged is staged and got.receipt["settings"]["tone"] == "aces"
    with Renderer(context=context) as fresh:
        assert np.array_equal(fresh.render(scene, size=SIZE, settings=other).rgb, got.rgb)


def test_most_stagings_are_freed(renderer: Renderer, scene: Scene) -> None:
    for shadows in ("none", "map", "pcf", "pcss", "ray"):
        renderer.render(scene, size=SIZE, settings=Settings(aa=1, shadows=shadows))
    assert len(renderer._stagings) == 4


def test_a_written_shader_is_used_and_a_broken_one_is_not(
    context: Context, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import shutil

    from glhybrid import shaders
    from glhybrid.load.builtin import data_folder

    folder = tmp_path / "glsl"
    shutil.copytree(data_folder("glsl"), folder)
    monkeypatch.setattr(shaders, "data_folder", lambda kind: folder)
    file = folder / "lib" / "light.glsl"
    text = file.read_text()
    with Renderer(context=context, interactive=True) as renderer:
        before = renderer.render(scene, size=SIZE, settings=Settings(aa=1))["radiance"]
        assert renderer.reload_shaders() == 0
        file.write_text(text.replace("LightSample light_at(", "LightSample light_at(nonsense "))
        with pytest.raises(ShaderError, match=r"glsl/lib/light\.glsl:\d+"):
            renderer.reload_shaders()
        assert renderer.reload_shaders() == 0  # a file that has not changed again is not tried again
        assert np.array_equal(renderer.render(scene, size=SIZE, settings=Settings(aa=1))["radiance"], before)
        dimmer = text.replace("light.color / distance2", "0.5 * light.color / distance2")
        assert dimmer != text
        file.write_text(dimmer)
        assert renderer.reload_shaders() > 0
        after = renderer.render(scene, size=SIZE, settings=Settings(aa=1))["radiance"]
        assert after.mean() < 0.8 * before.mean()
        file.write_text(text)
        assert renderer.reload_shaders() > 0
        assert np.array_equal(renderer.render(scene, size=SIZE, settings=Settings(aa=1))["radiance"], before)


TECHNIQUES = [
    *({"shadows": name} for name in techniques.SHADOWS),
    *({"reflections": name} for name in techniques.REFLECTIONS),
    {"ao": "ssao"},
]


@pytest.mark.parametrize("chosen", TECHNIQUES, ids=lambda c: next(iter(c.values())))
def test_every_technique_survives_other_sizes_and_lights(
    context: Context, scene: Scene, chosen: dict[str, str]
) -> None:
    """Another size, other lights and back, with another staging used in between: each the picture of a fresh start."""
    quick = {"shadows.baked.budget": 4096, "shadows.baked.samples": 1, "reflections.probe.resolution": 16}
    settings = Settings(aa=1, samples=2, parameters=quick, **chosen)
    other = Settings(aa=1, shadows="none", reflections="env")
    steps = [(scene, SIZE), (scene, (37, 53)), (relit(scene), SIZE), (scene, SIZE)]
    with Renderer(context=context, interactive=True) as renderer:
        got = []
        for shown, size in steps:
            got.append(renderer.render(shown, size=size, settings=settings)["radiance"])
            renderer.render(shown, size=size, settings=other)
    with Renderer(context=context) as fresh:
        for (shown, size), picture in zip(steps[:3], got, strict=False):
            assert np.array_equal(picture, fresh.render(shown, size=size, settings=settings)["radiance"]), size
    assert np.array_equal(got[0], got[3])
