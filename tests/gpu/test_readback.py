"""Pictures through the ring are those of single renders, bit for bit, and a steady frame makes and waits for nothing."""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import glhybrid as gh
from glhybrid import outputs
from glhybrid.errors import DeviceError, SettingError
from glhybrid.image import AOVS
from glhybrid.load import load
from glhybrid.readback import Ring, at_once
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera
from glhybrid.settings import Settings
from glhybrid.stream import Shot

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (61, 37)  # rows of no round number of bytes


@pytest.mark.parametrize("in_flight", [1, 3])
def test_frames_are_those_of_single_renders(context: "Context", models: Path, in_flight: int) -> None:
    scene = load(models / "CesiumMan/CesiumMan.glb")
    names = tuple(n for n in AOVS if n not in ("motion", "bvh_steps"))
    chosen = Settings(aa=2, shadows="ray")
    around = [Camera.look_at((2 * np.sin(a), 1.2, 2 * np.cos(a)), (0, 0.7, 0)) for a in range(5)]
    shots = [Shot(0.3 * k, camera) for k, camera in enumerate(around)]
    with Renderer(context=context) as renderer:
        got = list(renderer.frames(scene, iter(shots), SIZE, chosen, names, in_flight))
        bare = list(renderer.arrays(scene, shots, SIZE, chosen, in_flight))
        for shot, frame, rgba in zip(shots, got, bare, strict=True):
            one = renderer.render(scene, shot.camera, SIZE, chosen.replace(time=shot.time), names)
            np.testing.assert_array_equal(frame.rgb, one.rgb)
            np.testing.assert_array_equal(rgba[..., :3], one.rgb)
            assert rgba.shape == (37, 61, 4) and (rgba[..., 3] == 255).all()
            for name in names:
                np.testing.assert_array_equal(frame[name], one[name], err_msg=name)
                assert frame[name].flags.c_contiguous and frame[name].flags.writeable and frame[name].base is None
            assert frame.receipt.keys() == one.receipt.keys()
            for key in ("time", "exposure_ev"):
                assert frame.receipt["settings"][key] == one.receipt["settings"][key]
    assert {p["name"] for p in got[-1].receipt["passes"]} >= {"skin", "refit", "tlas", "shadow", "display"}


def test_nothing_overtakes_frames_on_their_way(context: "Context", models: Path) -> None:
    """Several pictures of a moving scene under way at once, again and again: on an H100 nine of ten runs had a picture
    with the instances of a later one before Context.write had buffers wait."""
    scene = load(models / "CesiumMan/CesiumMan.glb")
    shots = [Shot(0.3 * k, Camera.look_at((2 * np.sin(k), 1.2, 2 * np.cos(k)), (0, 0.7, 0))) for k in range(5)]
    chosen = Settings(aa=2, shadows="ray", rebuild=0)
    with Renderer(context=context) as renderer:
        want = [renderer.render(scene, s.camera, SIZE, chosen.replace(time=s.time)).rgb for s in shots]
        for again in range(3 if context.device.renderer.startswith("llvmpipe") else 60):
            got = renderer.arrays(scene, shots, SIZE, chosen, in_flight=1 + again % 3)
            for picture, single in zip(got, want, strict=True):
                np.testing.assert_array_equal(picture[..., :3], single)


def test_only_what_is_asked_for_is_read(context: "Context", models: Path) -> None:
    scene = load(models / "BoxAnimated/BoxAnimated.glb")
    with Renderer(context=context) as renderer:
        frames = renderer.frames(scene, [Shot(), Shot()], SIZE, Settings(aa=1), ("depth",))
        first = next(frames)
        assert set(first.arrays) == {"depth"}
        with pytest.raises(SettingError, match='no "radiance"'):
            first["radiance"]
        # Something else in between, and giving up half-way, harm nothing.
        renderer.render(scene, size=(16, 16), settings=Settings(aa=1, time=0.5))
        second = next(frames)
        np.testing.assert_array_equal(first["depth"], second["depth"])
        frames.close()  # type: ignore[attr-defined]
        with pytest.raises(SettingError, match="in_flight 0"):
            list(renderer.frames(scene, [Shot()], SIZE, in_flight=0))
        assert list(renderer.frames(scene, [], SIZE)) == []


@pytest.mark.parametrize("in_flight", [1, 2])
def test_drawing_something_else_in_between(context: "Context", models: Path, in_flight: int) -> None:
    """Same size, same scene, same settings: the same images are drawn over between any two pictures."""
    scene = load(models / "BoxAnimated/BoxAnimated.glb")
    chosen, names = Settings(aa=1), ("depth", "radiance")
    shots = [Shot(0.5 * k) for k in range(6)]
    with Renderer(context=context) as renderer:
        plain = list(renderer.frames(scene, shots, SIZE, chosen, names))
        for frame, want in zip(renderer.frames(scene, shots, SIZE, chosen, names, in_flight), plain, strict=True):
            renderer.render(scene, size=SIZE, settings=chosen.replace(time=3.3), aovs=names)
            np.testing.assert_array_equal(frame.rgb, want.rgb)
            for name in names:
                np.testing.assert_array_equal(frame[name], want[name])
    assert any((a.rgb != b.rgb).any() for a, b in pairwise(plain))


def test_a_renderer_that_is_closed_first(context: "Context", models: Path) -> None:
    """Frees what was on its way; whoever asks for more is told."""
    scene = load(models / "BoxAnimated/BoxAnimated.glb")
    with Renderer(context=context) as renderer:
        frames = renderer.arrays(scene, [Shot(0.1 * k) for k in range(9)], SIZE, Settings(aa=1))
        next(frames)
        assert len(renderer.rings) == 1
    assert not renderer.rings
    with pytest.raises(DeviceError, match="closed before the last picture"):
        next(frames)


def test_times_outside_the_clip_are_said(context: "Context", models: Path) -> None:
    scene = load(models / "BoxAnimated/BoxAnimated.glb")
    with Renderer(context=context) as renderer:
        said = [f.receipt["scene"]["warnings"] for f in renderer.frames(scene, [Shot(0.5), Shot(99), Shot(1)], (8, 8))]
    assert [any("outside" in w for w in warnings) for warnings in said] == [False, True, False]


def test_a_ring_holds_what_was_there_when_it_was_sent(context: "Context") -> None:
    """Images and buffers of several sizes, drawn over at once after each send."""
    gl = context.gl
    images = [gl.texture((7, 5), 4, dtype="f1"), gl.texture((3, 2), 1, dtype="u4"), gl.texture((5, 3), 4, dtype="f2")]
    buffer, rng = gl.buffer(reserve=12), np.random.default_rng(0)
    stack = gl.texture_array((4, 3, 2), 1, dtype="f1")
    ring, want = Ring(context, 3), []
    for k in range(7):
        if ring.full:
            check(ring.take(), want.pop(0))
        a = rng.integers(0, 255, (5, 7, 4), np.uint8)
        b = rng.integers(0, 1 << 30, (2, 3, 1), np.uint32)
        c = rng.uniform(-1, 1, (3, 5, 4)).astype(np.float16)
        d = rng.integers(0, 255, (2, 3, 4), np.uint8)
        for image, data in zip((*images, stack), (a, b, c, d), strict=True):
            image.write(np.ascontiguousarray(data))
        buffer.write(np.array([k, 2, 3], np.uint32))
        send: list[Any] = [outputs.rgba(images[0]), outputs.texels(images[1], 0, 1), outputs.texels(images[2], 1, 2)]
        ring.send([*send, number(buffer), outputs.constant(b), outputs.layers(stack)])
        layers = np.moveaxis(d[:, ::-1], 0, -1).astype(np.float32) / 255
        want.append([a[::-1], b[::-1, :, 0], c[::-1, :, 1:3].astype(np.float32), np.uint32(k), b, layers])
    assert len(ring) == 3 and ring.bytes >= 3 * 140
    while len(ring):
        check(ring.take(), want.pop(0))
    assert at_once(number(buffer)) == 6
    for owner in (ring, *images, stack, buffer):
        owner.release()


def number(buffer: Any) -> Any:
    data = yield buffer
    return np.frombuffer(data, np.uint32)[0]


def check(got: list[Any], want: list[Any]) -> None:
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "rebuild"), [("CesiumMan", 0), ("AnimatedMorphCube", 0), ("BoxAnimated", 0), ("CesiumMan", 1)]
)
def test_a_steady_animation_makes_nothing(
    context: "Context", models: Path, monkeypatch: pytest.MonkeyPatch, name: str, rebuild: float
) -> None:
    """After the first frames: no program compiled, no GL object made or freed, and nobody waits for the GPU."""
    scene = load(models / f"{name}/{name}.glb")
    made: dict[str, int] = {}
    calls = ("buffer", "texture", "texture_array", "framebuffer", "vertex_array", "program", "compute_shader", "finish")
    with Renderer(context=context) as renderer:
        shots = (Shot(0.05 * k) for k in range(100))
        # The processor would read back what it builds trees over.
        frames = renderer.frames(scene, shots, (32, 24), Settings(aa=1, rebuild=rebuild, builder="gpu"))
        for _ in range(6):
            next(frames)
        real = context.gl

        class Counting:
            def __getattr__(self, key: str) -> Any:
                if key in calls:
                    made[key] = made.get(key, 0) + 1
                return getattr(real, key)

        monkeypatch.setattr(context, "gl", Counting())
        programs = dict(renderer.shaders._programs)
        raw = [context.raw.glFinish, context.raw.glGenTextures]
        for call, key in zip(raw, ("glFinish", "glGenTextures"), strict=True):
            monkeypatch.setattr(context.raw, key, lambda *a, call=call, key=key: (made.__setitem__(key, 1), call(*a)))
        assert renderer._staged is not None and renderer._staged.mover is not None
        monkeypatch.setattr(renderer._staged.mover, "_finish", lambda: made.__setitem__("finish", 1))
        for _ in range(20):
            next(frames)
        assert not made and renderer.shaders._programs == programs
        frames.close()  # type: ignore[attr-defined]
        renderer.render(scene, size=(16, 16), settings=Settings(aa=1, time=0.0))
        assert {"finish", "texture"} <= made.keys()  # so it is counted
        monkeypatch.undo()


def test_shots_are_part_of_the_package() -> None:
    assert gh.Shot is Shot
