"""Reflections in one program and in parts, and all rays of a pixel in one, make the same pictures."""

from typing import Any

import numpy as np
import pytest

from glhybrid import Renderer, Settings, load
from glhybrid.bench import scale
from glhybrid.context import Context
from glhybrid.levels import choose_levels
from glhybrid.plan import make, resized
from glhybrid.scene import Camera, Instance, Light, Material, Mesh, Scene, Sphere
from glhybrid.tuning import rule

AOVS = ("reflection", "reflection_hit", "reason", "visibility")
SIZE = (96, 54)
SMALL = {"shadows.pcf.resolution": 256}


def spheres(lights: int, masked: bool = False) -> Scene:
    """Mirrors that see each other under lamps in a ring. masked: the floor is one that may have holes."""
    ring = [i * 2 * np.pi / max(lights, 1) for i in range(lights)]
    return Scene(
        name="spheres",
        meshes=(
            Mesh(name="ball", primitives=(Sphere(radius=1.0, material=0),)),
            Mesh(name="floor", primitives=(Sphere(radius=30.0, material=1),)),
        ),
        instances=(
            Instance(mesh=0, world_from_object=_at(-1.2, 0, 0)),
            Instance(mesh=0, world_from_object=_at(1.2, 0, 0)),
            Instance(mesh=1, world_from_object=_at(0, -31, 0)),
        ),
        materials=(
            Material(roughness=0.1, metallic=1.0),
            Material(roughness=0.4, alpha_mode="MASK" if masked else "OPAQUE"),
        ),
        lights=tuple(Light(kind="point", position=(4 * np.cos(a), 3.0, 4 * np.sin(a)), intensity=9.0) for a in ring),
        cameras=(Camera.look_at((0, 1.5, 5), (0, 0, 0)),),
    )


def _at(x: float, y: float, z: float) -> Any:
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


@pytest.mark.parametrize("scene", ["cornell", "showroom", 0, 3, "masked", 40, "plain"], ids=str)
@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("shadows", ["ray", "pcf"])
def test_programs_of_parts_are_one(context: Context, scene: Any, levels: Any, shadows: str) -> None:
    """But for the rounding of a direction that is handed on, 1e-7 (6e-5 in a highlight), and texels at the edge of a shadow."""
    made = {"masked": lambda: spheres(3, masked=True), "plain": lambda: scale.subject(2000)}
    drawn = spheres(scene) if isinstance(scene, int) else made.get(scene, lambda: load(scene))()
    found = {}
    for kernels in ("fused", "split", "joined"):
        with Renderer(context=context) as renderer:
            settings = Settings(
                aa=1, kernels=kernels, levels=levels, shadows=shadows, primary="trace", parameters=SMALL
            )
            found[kernels] = renderer.render(drawn, size=SIZE, settings=settings, aovs=AOVS)
            programs = {p.split()[0] for p in found[kernels].receipt["plan"]["programs"]}
            features = renderer._stagings[-1].features
            small = scene == "plain" and levels == 1 and shadows == "ray"
            assert features.mirror_shadows == (small and kernels != "fused")
            assert features.mirror_hits == (kernels == "joined")
            assert ("reflect" in programs) == (kernels == "fused") != ("reflect_ray" in programs)
            assert ("reflect_shadow" in programs) == (features.shadow_bits and not small and kernels != "fused")
            together = kernels == "joined" and shadows == "ray" and features.visibility and scene != 40
            assert ("rays" in programs) == together
    one = found["fused"]
    assert (one["reflection_hit"] > 0).mean() > 0.01
    for kernels in ("split", "joined"):
        other = found[kernels]
        assert (one["reason"] != other["reason"]).mean() < 1e-3
        assert (one["visibility"] != other["visibility"]).sum() <= 1e-3 * one["visibility"].size
        for name in ("radiance", "reflection"):
            off = np.abs(one[name] - other[name]).max(-1) > 1e-4 * (1 + one[name].max(-1))
            assert off.mean() < 1e-3


def test_camera_and_shadow_rays_together_or_not_as_the_size_asks(context: Context) -> None:
    """Which of raster and rays is faster may change with the size, and with it what the passes are."""
    rays, raster = rule(software=False), rule(software=True)
    scene, settings = scale.subject(2000), Settings(kernels="joined", aa=1, exposure=0.0)
    made = make(scene, settings, tuning=rays)
    assert made.passes == ("rays", "reflect", "composite", "display")
    other = resized(made, raster, 2000, (64, 64))
    assert other.passes == ("gbuffer", "shadow", "reflect", "composite", "display")
    assert resized(other, rays, 2000, (640, 640)).passes == made.passes
    with Renderer(context=context) as renderer:
        renderer.__dict__["tuning"] = rays
        for k, tuning in enumerate((rays, raster, rays)):
            renderer.stage(scene, settings, SIZE)._tuning = tuning
            frame = renderer.render(scene, size=(64, 40 + k), settings=settings)
            want = made if tuning is rays else other
            assert (
                {p["name"] for p in frame.receipt["passes"]} == set(want.passes) == set(frame.receipt["plan"]["passes"])
            )


def test_a_gpu_joins_what_was_faster_there() -> None:
    """Textures, alpha tests and instances make programs large: less goes together."""

    def features(scene: Scene, **more: Any) -> Any:
        return make(scene, Settings(**more), software=False)

    plain, textured = features(scale.subject(2000)), features(load("atrium"))
    assert plain.joined and plain.features.mirror_hits and plain.features.encodes
    assert textured.joined and not textured.features.mirror_hits and textured.split
    assert not features(load("plaza")).joined and not features(load("showroom")).joined
    assert not features(load("atrium"), shadows="pcf").joined and not features(load("atrium"), terminator=True).joined
    split = features(scale.subject(2000), kernels="split")
    assert not (split.joined or split.features.mirror_hits or split.features.encodes)
    fused = make(scale.subject(2000), Settings(), software=True)
    assert not (fused.joined or fused.split or fused.features.mirror_hits or fused.features.encodes)


@pytest.mark.parametrize("aa", [1, 3])
def test_what_a_frame_encodes_is_what_display_shows(context: Context, aa: int) -> None:
    scene, shown = scale.subject(2000), {}
    for kernels in ("split", "joined"):
        with Renderer(context=context) as renderer:
            for look in ({"exposure": 0.0}, {"exposure": 1.5}, {"exposure": "auto"}, {"exposure": 1.5, "tone": "agx"}):
                frame = renderer.render(scene, size=SIZE, settings=Settings(aa=aa, kernels=kernels, **look))
                shown.setdefault(str(look), []).append(frame.rgb)
            staged = renderer._stagings[-1]
            radiance = staged.targets.get("radiance")
            # A picture that no frame made, in the same image; and another way to show the same radiance.
            radiance.write(np.full((*SIZE[::-1], 4), 0.18, np.float32).tobytes())
            shown.setdefault("written", []).append(staged.display.run(staged.targets, radiance).read())
            staged.constants.under(scene, Settings(aa=aa, kernels=kernels, exposure=-2.0))
            staged.set()
            shown.setdefault("again", []).append(staged.display.image(staged.targets, radiance).read())
    for name, (one, other) in shown.items():
        assert np.array_equal(one, other), name
    assert len({bytes(np.asarray(pictures[0])) for pictures in shown.values()}) == len(shown)


def test_a_gpu_flattens_what_is_repeated_a_few_times() -> None:
    scene = load("atrium")
    assert choose_levels(scene, "auto", software=True)[0] == 2
    levels, why = choose_levels(scene, "auto", software=False)
    assert levels == 1 and "times the triangles" in why
    assert choose_levels(load("plaza"), "auto", software=False)[0] == 2
