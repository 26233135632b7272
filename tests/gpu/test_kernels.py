"""Reflections in one program, in two and in three are the same reflections."""

from typing import Any

import numpy as np
import pytest

from glhybrid import Renderer, Settings, load
from glhybrid.bench import scale
from glhybrid.context import Context
from glhybrid.levels import choose_levels
from glhybrid.scene import Camera, Instance, Light, Material, Mesh, Scene, Sphere

AOVS = ("reflection", "reflection_hit", "reason")
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
    """Bit for bit where the compiler rounds equal sums alike; elsewhere a few ulp, but for texels at the edge of a shadow."""
    made = {"masked": lambda: spheres(3, masked=True), "plain": lambda: scale.subject(2000)}
    drawn = spheres(scene) if isinstance(scene, int) else made.get(scene, lambda: load(scene))()
    found = {}
    for kernels in ("fused", "split"):
        with Renderer(context=context) as renderer:
            settings = Settings(aa=1, kernels=kernels, levels=levels, shadows=shadows, parameters=SMALL)
            found[kernels] = renderer.render(drawn, size=SIZE, settings=settings, aovs=AOVS)
            programs = {p.split()[0] for p in found[kernels].receipt["plan"]["programs"]}
            assert ("reflect" in programs) == (kernels == "fused")
            features = renderer._stagings[-1].features
            together = kernels == "split" and scene == "plain" and levels == 1 and shadows == "ray"
            assert features.mirror_shadows == together
            bits = features.shadow_bits and not together
            assert {"reflect_ray", "reflect_shade"} <= programs or kernels == "fused"
            assert ("reflect_shadow" in programs) == (bits and kernels == "split")
    one, three = (found[k] for k in ("fused", "split"))
    assert (one["reflection_hit"] > 0).mean() > 0.01
    assert (one["reason"] != three["reason"]).mean() < 1e-3
    for name in ("radiance", "reflection"):
        if context.device.software:
            assert np.array_equal(one[name], three[name])
        off = np.abs(one[name] - three[name]).max(-1) > 1e-4 * (1 + one[name].max(-1))
        assert off.mean() < 1e-3


def test_a_gpu_flattens_what_is_repeated_a_few_times() -> None:
    scene = load("atrium")
    assert choose_levels(scene, "auto", software=True)[0] == 2
    levels, why = choose_levels(scene, "auto", software=False)
    assert levels == 1 and "times the triangles" in why
    assert choose_levels(load("plaza"), "auto", software=False)[0] == 2
