"""Pictures of a first run ever, before any kernel is compiled: those of every later one."""

from typing import TYPE_CHECKING

import numpy as np
import pytest

from glhybrid import kernels
from glhybrid.bench import scenes
from glhybrid.bvh import blas, tlas
from glhybrid.kernels import MOTION, Kernels
from glhybrid.load.shapes import box
from glhybrid.renderer import Renderer
from glhybrid.scene import Animation, Camera, Channel, Environment, Instance, Light, Material, Mesh, Node, Scene
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (64, 36)
AOVS = ("radiance", "depth", "visibility", "reflection", "normal")


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Nothing is compiled until this is undone, and no process is started."""
    monkeypatch.setenv("GLHYBRID_COMPILE", "aside")
    monkeypatch.setenv("GLHYBRID_CACHE", "off")
    trees = Kernels("TREES", "a test", ("glhybrid.bvh.build",), 60.0)
    for module in (blas, tlas):
        monkeypatch.setattr(module, "TREES", trees)
    for name, value in {"loaded": False, "spent": 0.0, "_ready": False, "_look": 0.0, "_compiling_s": 60.0}.items():
        monkeypatch.setattr(MOTION, name, value)
    monkeypatch.setattr(MOTION, "load", lambda: pytest.fail("compiled"))
    for kernel in MOTION._kernels:
        monkeypatch.setattr(kernel, "_compiled", None)
    return monkeypatch


def test_a_quick_tree_gives_the_same_picture_and_is_said(context: "Context", cold: pytest.MonkeyPatch) -> None:
    scene, settings = scenes.make("spheres", 4000), Settings(aa=1, primary="trace")
    with Renderer(context=context) as renderer:
        first = renderer.render(scene, size=SIZE, settings=settings, aovs=AOVS)
    cold.undo()
    with Renderer(context=context) as renderer:
        later = renderer.render(scene, size=SIZE, settings=settings, aovs=AOVS)
    assert first.receipt["bvh"]["quick"] and not later.receipt["bvh"]["quick"]
    assert kernels.QUICK in first.receipt["plan"]["reasons"] and kernels.QUICK not in later.receipt["plan"]["reasons"]
    for name in AOVS:  # watertight rays: a tree changes how a hit is found, not which
        np.testing.assert_array_equal(first[name], later[name], err_msg=name)


def moving() -> Scene:
    """Boxes that turn, wander and swell under a sun, one of them inside out, below a node that moves too."""
    rng = np.random.default_rng(5)
    piece = box()
    nodes, channels, instances = [Node("all", -1)], [], []
    times = np.array([0, 0.4, 1], np.float32)
    channels.append(Channel(0, "translation", "LINEAR", times, rng.normal(0, 0.3, (3, 3)).astype(np.float32)))
    for i in range(1, 13):
        place = (*rng.uniform(-3, 3, 2).tolist(), 0.0)
        nodes.append(Node(f"n{i}", 0, translation=place, scale=(-1.0 if i == 5 else 1.0, 1.0, 0.5)))
        world = np.diag([-1.0 if i == 5 else 1.0, 1.0, 0.5, 1.0])
        world[:3, 3] = place
        instances.append(Instance(0, world, f"n{i}", node=i))
        turns = rng.normal(size=(3, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        channels.append(Channel(i, "rotation", "LINEAR", times, turns.astype(np.float32)))
        ways = np.array(place) + rng.normal(0, 1, (3, 3, 3))
        channels.append(Channel(i, "translation", "CUBICSPLINE", times, ways.astype(np.float32)))
    return Scene(
        "boxes", meshes=(Mesh("box", (piece,)),), materials=(Material(metallic=0.5, roughness=0.1),),
        nodes=tuple(nodes), instances=tuple(instances), animations=(Animation("move", tuple(channels)),),
        lights=(Light("directional", direction=(-0.4, -0.8, -0.4)),), cameras=(Camera.look_at((0, 0, 12), (0, 0, 0)),),
        environment=Environment(np.full((1, 1, 3), 0.3, np.float32)),
    )  # fmt: skip


@pytest.mark.parametrize("rebuild", [0.0, 1.0])
def test_frames_without_numba_are_those_with_it(context: "Context", cold: pytest.MonkeyPatch, rebuild: float) -> None:
    """Played without, sought without and sought with: equal to the bit."""
    scene, times = moving(), (0.0, 0.3, 0.31, 0.9)

    def sought() -> list[np.ndarray]:
        found = []
        for time in times:
            with Renderer(context=context) as renderer:
                settings = Settings(aa=1, time=time, rebuild=rebuild)
                found.append(renderer.render(scene, size=SIZE, settings=settings).rgb)
        return found

    with Renderer(context=context) as renderer:
        played = [
            renderer.render(scene, size=SIZE, settings=Settings(aa=1, time=time, rebuild=rebuild)).rgb for time in times
        ]
    without = sought()
    assert MOTION.spent > 0
    cold.undo()
    for one, two, three in zip(played, without, sought(), strict=True):
        assert np.array_equal(one, two) and np.array_equal(two, three)
    assert not np.array_equal(played[0], played[-1])
