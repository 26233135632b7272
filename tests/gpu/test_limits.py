"""What a driver's limits do not hold is refused by name, never drawn wrong. The limits are lowered here."""

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rays import moved, scene_of

import glhybrid as gh
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
    "triangles": ("texture_buffer_texels", 500, scene(segments=64), "(slots|nodes|vertices) needs.*500"),
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
