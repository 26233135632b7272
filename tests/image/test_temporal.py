"""Nothing that a technique draws may change unless the scene does: pans of 32 frames and animations, and the figures
that say so, which must see what is put into them."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scene_kit import box, constant_sky, floor, matte, metal, plastic, scene, sun

from glhybrid.load import load
from glhybrid.scene import Animation, Camera, Channel, Light, Node, Scene, Sphere
from glhybrid.settings import Settings
from glhybrid.study import temporal
from glhybrid.study.temporal import change_rate, flicker, flip_rate, over_animation, over_pan

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer

SIZE = (64, 48)
HARD = Settings(aa=1, shadows="ray", reflections="ray-lerp")


def stage(moves: bool = True) -> Scene:
    """A mirror floor, posts, a ball and a lamp; a box that walks across, and one that turns."""
    parts: list[Any] = [
        (floor(6.0), matte(0.7)), (floor(1.2, 0.01, (0.8, 0.5)), metal(1.0, 0.0)),
        (box((-0.15, 0, -0.15), (0.15, 0.6, 0.15)), plastic(), (-1.0, 0.0, -0.4)),
        (box((-0.3, 0, -0.04), (0.3, 0.5, 0.04)), plastic(), (0.6, 0.02, -0.5)),
        (Sphere(0.3), plastic(), (-0.4, 0.31, 0.7)),
    ]  # fmt: skip
    rng = np.random.default_rng(4)
    for _ in range(8):
        x, z = rng.uniform(-2.2, 2.2, 2)
        parts.append((box((-0.05, 0, -0.05), (0.05, 0.7, 0.05)), plastic(), (x, 0.0, z)))
    made = scene(parts, lights=[sun((-0.8, -0.6, -0.45)), Light("point", (1, 1, 1), 3.0, position=(0.4, 1.4, 1.0))],
                 environment=constant_sky(0.4))  # fmt: skip
    if not moves:
        return made
    still = made.instances
    nodes = tuple(Node(f"n{k}", -1, translation=tuple(still[k].world_from_object[:3, 3])) for k in (2, 3))
    walk = np.array([(-1.0, 0, -0.4), (1.0, 0, -0.2)], np.float32)
    turn = np.array([(0, 0, 0, 1), (0, 1, 0, 0)], np.float32)
    times = np.array([0, 2], np.float32)
    clip = Animation("walk", (
        Channel(0, "translation", "LINEAR", times, walk), Channel(1, "rotation", "LINEAR", times, turn),
    ))  # fmt: skip
    instances = tuple(replace(p, node=k - 2) if k in (2, 3) else p for k, p in enumerate(still))
    return made.replace(instances=instances, nodes=nodes, animations=(clip,))


def above(flat: bool) -> Camera:
    made = Camera.look_at((2.0, 2.2, 3.0), (0, 0.2, 0.0))
    return replace(made, fov_y=0.0, ymag=1.5) if flat else made


def test_hard_shadows_and_mirrors_do_not_change_in_a_pan(renderer: "Renderer") -> None:
    """32 frames. Mirror images are compared to a thousandth: their rays start from points rebuilt in float32 anew."""
    found = over_pan(renderer, stage(False), above(True), SIZE, HARD, steps=32)
    assert found.points > 50_000
    assert found.flips == found.own_flips == found.changes == found.own_changes == 0, found


def test_the_pan_sees_a_technique_that_changes(renderer: "Renderer") -> None:
    """Screen-space reflections lose what the pan moves out of the picture."""
    found = over_pan(renderer, stage(False), above(True), SIZE, HARD.replace(reflections="ssr"), steps=6)
    assert found.changes == found.own_changes > 0.5 and found.flips == 0, found


def test_only_what_moves_changes_an_animation(renderer: "Renderer") -> None:
    """Shadows and mirror images of the walkers change, and are explained; no other one does."""
    found = over_animation(renderer, stage(), above(False), SIZE, HARD, np.linspace(0, 2, 21).tolist())
    assert found.points > 30_000 and found.flips > 0.1 and found.changes > 0.1
    assert found.own_flips == 0 and found.own_changes == 0, found
    assert 0 < found.flicker < 0.05


def test_a_figure_that_walks_changes_only_what_it_passes(renderer: "Renderer", models: Path) -> None:
    """Skinned: its triangles' boxes hold it, wherever its joints are."""
    man = load(models / "CesiumMan/CesiumMan.glb")
    ground = stage(False)
    parts = tuple(
        replace(p, mesh=p.mesh + len(man.meshes), materials=tuple(m + len(man.materials) for m in p.materials))
        if p.materials
        else p
        for p in ground.instances
    )
    first = len(man.meshes)
    meshes = tuple(replace(m, primitives=tuple(replace(q, material=q.material + len(man.materials)) for q in m.primitives))
                   for m in ground.meshes)  # fmt: skip
    if not all(p.materials for p in ground.instances):
        parts = tuple(replace(p, mesh=p.mesh + first) if not p.materials else q
                      for p, q in zip(ground.instances, parts, strict=True))  # fmt: skip
    both = man.replace(
        meshes=man.meshes + meshes, materials=man.materials + ground.materials, instances=man.instances + parts,
        lights=ground.lights, environment=ground.environment, cameras=(above(False),),
    )  # fmt: skip
    found = over_animation(renderer, both, 0, SIZE, HARD, np.linspace(0, 0.6, 9).tolist())
    assert found.points > 8_000 and found.own_flips == 0 and found.own_changes == 0, found
    assert found.flips > 0


def test_what_flips_by_itself_in_an_animation_is_counted(renderer: "Renderer", monkeypatch: Any) -> None:
    """The same frames, with a speck of shadow that comes and goes far from anything that moves."""
    from glhybrid.renderer import Renderer as Made

    frames = Made.frames

    def specks(*args: Any, **more: Any) -> Any:
        for k, frame in enumerate(frames(*args, **more)):
            corner = frame["position"][..., 2] < -2.5
            frame["visibility"][corner] = k % 2
            yield frame

    monkeypatch.setattr(Made, "frames", specks)
    found = over_animation(renderer, stage(), above(False), SIZE, HARD, [0.0, 0.1, 0.2])
    assert found.own_flips > 0.1 and found.own_changes == 0


def image(value: float, shape: tuple[int, int] = (20, 30), move: tuple[float, float] = (0, 0)) -> dict[str, Any]:
    height, width = shape
    return {
        "radiance": np.full((height, width, 3), value, np.float32), "visibility": np.ones((height, width, 1), np.float32),
        "reflection": np.full((height, width, 3), value, np.float32),
        "motion": np.tile(np.array(move, np.float32), (height, width, 1)),
        "instance_id": np.zeros(shape, np.uint32), "triangle_id": np.zeros(shape, np.uint32),
    }  # fmt: skip


def test_rates_by_hand() -> None:
    a, b, c = image(1.0), image(1.0), image(1.0)
    b["visibility"][:5] = 0
    c["visibility"][:5, :6] = 0
    assert flip_rate([a, b]) == 25 and flip_rate([b, c]) == 20 and flip_rate([a, b, c]) == 22.5
    only = np.zeros((20, 30), bool)
    only[:5] = True
    assert flip_rate([a, b], [only]) == 100
    b["triangle_id"][:] = 1  # other points: none is fixed
    assert flip_rate([a, b]) == 0
    d = image(1.0)
    d["reflection"][:, :3] *= 1.01
    assert change_rate([a, d]) == 10
    assert flicker([a, image(1.5)]) == (pytest.approx(1 / 3), pytest.approx(1 / 3))


def test_points_are_followed_by_their_motion() -> None:
    """A picture that slides by 3 and 1 pixels, or by half a one, does not flicker; one that stands beside its motion does."""
    rng = np.random.default_rng(0)
    wave = np.sin(np.arange(60) / 5)[None, :, None] + np.arange(40)[:, None, None] / 20 + 3
    noise = rng.uniform(0, 1, (40, 60, 1))
    for texture, move, most in ((noise, (3, 1), 1e-12), (wave, (0.5, 0.0), 2e-3)):
        a, b = image(0, (40, 60)), image(0, (40, 60), move)
        a["radiance"] = np.tile(texture, 3).astype(np.float32)
        y, x = np.mgrid[:40, :60]
        if move == (3, 1):
            b["radiance"] = np.roll(a["radiance"], (-1, -3), (0, 1))
            a["visibility"] = (noise > 0.5).astype(np.float32)
            b["visibility"] = np.roll(a["visibility"], (-1, -3), (0, 1))
            assert flip_rate([a, b]) == 0 and temporal.matches(a, b).fixed.sum() == 39 * 57
        else:
            slid = np.sin((x + 0.5) / 5) + y / 20 + 3
            b["radiance"] = np.repeat(slid[..., None], 3, -1).astype(np.float32)
            assert not temporal.matches(a, b).fixed.any()
        assert flicker([a, b])[0] < most
        assert flicker([a, b | {"motion": np.zeros((40, 60, 2), np.float32)}])[0] > 5 * most + 1e-3
