"""What a driver's limits do not hold is refused by name, never drawn wrong. The limits are lowered here."""

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rays import moved, scene_of

import glhybrid as gh
from glhybrid import geometry, levels
from glhybrid.errors import GeometryError, GlhybridError, SettingError
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Camera, Image, Light, Material, Scene, Texture

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (32, 24)
CAMERA = Camera.look_at((4, 5, 9), (2, 0, 2))


@pytest.fixture
def renderer(context: "Context") -> Iterator[gh.Renderer]:
    with gh.Renderer(context=context) as made:
        yield made


def scene(instances: int = 1, materials: int = 1, lights: int = 1, textured: bool = False, segments: int = 12) -> Scene:
    image = Image(np.random.default_rng(0).integers(0, 255, (100, 100, 4)).astype(np.uint8))
    kinds = tuple(
        Material(base_color=(k / materials, 0.5, 0.5, 1), textures={"base_color": Texture(image)} if textured else {})
        for k in range(materials)
    )
    made = scene_of(torus(segments=segments, sides=8), box(), materials=kinds)
    first = made.instances[0]
    drawn = tuple(
        type(first)(0, moved((k % 5, 0, k // 5)), f"{k}", (k % materials,)) for k in range(max(instances, materials))
    )
    lamps = tuple(Light("point", position=(k, 5.0, 0), intensity=20.0) for k in range(lights))
    return made.replace(instances=drawn, lights=lamps)


CASES = {
    # what is too small: the limit, its value, the scene that needs more, what the message names
    "instances": ("storage_block_bytes", 160 * 40, scene(instances=60), "Instances needs.*hold 6400.*fewer instances"),
    "materials": ("storage_block_bytes", 2048, scene(materials=40), "Materials.*2048"),
    "lights": ("storage_block_bytes", 1024, scene(lights=40), "Lights.*1024.*fewer lights"),
    "triangles": ("texture_buffer_texels", 500, scene(segments=64), "tree over 1024 triangles needs 3072 texels.*500"),
    "layers": ("texture_layers", 6, scene(lights=7), "visibility: 7 layers.*6"),
    "pages": ("texture_size", 64, scene(textured=True), "pages of .* texels a side.*64"),
    "pixels": ("texture_size", 31, scene(), "size 32x24.*31x31"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_lowered_limit_is_named_and_nothing_is_drawn(
    renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    field, value, made, message = CASES[case]
    settings = gh.Settings(aa=1, exposure=0.0)
    want = renderer.render(made, CAMERA, SIZE, settings)
    assert np.ptp(want["radiance"]) > 0
    limits = renderer.context.limits
    with monkeypatch.context() as patch, gh.Renderer(context=renderer.context) as low:
        patch.setattr(renderer.context, "limits", dataclasses.replace(limits, **{field: value}))
        with pytest.raises((GeometryError, SettingError), match=message):
            low.render(made, CAMERA, SIZE, settings)
        assert not renderer.context.raw.errors()
    with gh.Renderer(context=renderer.context) as again:
        assert np.array_equal(again.render(made, CAMERA, SIZE, settings)["radiance"], want["radiance"])


def test_a_tree_that_has_no_room_is_not_built(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Minutes and gigabytes at 45 million triangles; where copies are what is too much, the message says so."""
    copies = scene(instances=5)
    want = renderer.render(copies, CAMERA, SIZE, gh.Settings(aa=1, exposure=0.0, levels=2))
    limits = dataclasses.replace(renderer.context.limits, texture_buffer_texels=1000)
    with monkeypatch.context() as patch, gh.Renderer(context=renderer.context) as low:
        patch.setattr(renderer.context, "limits", limits)
        got = low.render(copies, CAMERA, SIZE, gh.Settings(aa=1, exposure=0.0, levels=2))
        assert np.array_equal(got["radiance"], want["radiance"])
        patch.setattr(geometry, "build", lambda *_, **__: pytest.fail("built all the same"))
        with pytest.raises(GeometryError, match=r"960 triangles needs 2880 texels.*1000.*levels = 2"):
            low.render(copies, CAMERA, SIZE, gh.Settings(aa=1, levels=1))
        with pytest.raises(GeometryError, match=r"1024 triangles needs 3072 texels.*decimate its meshes$"):
            low.render(scene(segments=64), CAMERA, SIZE, gh.Settings(aa=1, levels=1))


def test_what_is_only_rasterised_is_checked_too(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = gh.Settings(aa=1, shadows="none", reflections="none", primary="raster")
    limits = dataclasses.replace(renderer.context.limits, texture_buffer_texels=100)
    with monkeypatch.context() as patch, gh.Renderer(context=renderer.context) as low:
        patch.setattr(renderer.context, "limits", limits)
        with pytest.raises(GeometryError, match=r"(vertices|triangles) needs \d+ texels.*100.*decimate its meshes$"):
            low.render(scene(), CAMERA, SIZE, settings)


def test_what_one_level_cannot_hold_gets_two(monkeypatch: pytest.MonkeyPatch) -> None:
    copies = scene(instances=5)
    assert levels.choose_levels(copies, "auto", software=False)[0] == 1
    monkeypatch.setattr(levels, "FLATTEN_MOST", 900)
    assert levels.choose_levels(copies, "auto", software=False) == (
        2, "960 triangles, 192 without repeats: more than one level's buffers hold",
    )  # fmt: skip
    assert levels.choose_levels(scene(segments=64), "auto", software=False)[0] == 1  # nothing to gain


def test_a_table_that_is_read_by_texels_is_checked(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    if not renderer.context.device.software:
        pytest.skip("only Mesa's software renderer reads tables by texels")
    limits = dataclasses.replace(renderer.context.limits, texture_buffer_texels=1000)
    with monkeypatch.context() as patch, gh.Renderer(context=renderer.context) as low:
        patch.setattr(renderer.context, "limits", limits)
        with pytest.raises(GeometryError, match=r"Instances needs \d+ texels.*1000.*fewer instances"):
            low.render(scene(instances=150), CAMERA, SIZE, gh.Settings(aa=1))


def test_any_block_that_is_bound_is_checked(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those that a pass brings along: the list of pixels of a sparse reflection, the emitters of the reference."""
    mirrors = scene()
    mirrors = mirrors.replace(materials=(Material(roughness=0.0),))
    limits = renderer.context.limits
    parameters = {"reflections.ray-lerp.resolution": "half"}
    with monkeypatch.context() as patch, gh.Renderer(context=renderer.context) as low:
        patch.setattr(renderer.context, "limits", dataclasses.replace(limits, storage_block_bytes=2000))
        with pytest.raises(GlhybridError, match=r"PixelList holds 3072 bytes.*2000"):
            low.render(mirrors, CAMERA, SIZE, gh.Settings(aa=1, parameters=parameters))
