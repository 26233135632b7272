"""Thousands of rigid instances in motion: hits against Embree, what is uploaded against NumPy, and what is not touched."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import oracles
import pytest
import rays as ray
from rays import Rays
from test_motion import MovingTracer, channel

from glhybrid import gpu_scene, keys, layout, motion
from glhybrid.renderer import Renderer
from glhybrid.scene import Animation, Camera, Instance, Light, Material, Mesh, Node, Scene
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from glhybrid.context import Context

COUNT = 1200


def swarm(still: int = 0) -> Scene:
    """Two kinds of bodies that wander and turn, some mirrored; `still` of them, at the front of the list, stand."""
    rng = np.random.default_rng(3)
    meshes = []
    for n in (5, 7):
        exact, index = ray.uv_sphere(n, 1.0)
        position: Any = exact.astype(np.float32)
        meshes.append(Mesh(f"ball {n}", (ray.piece(position, index),)))
    place = rng.uniform(-30, 30, (COUNT, 3)) + np.array([200, 0, 0])
    nodes, channels, instances = [], [], []
    for i in range(COUNT):
        side = (-1.0 if i % 5 == 0 else 1.0, 1.0, 0.7)
        nodes.append(Node(f"n{i}", -1, translation=tuple(place[i]), scale=side))
        world = np.diag([*side, 1.0])
        world[:3, 3] = place[i]
        instances.append(Instance(i % 2, world, f"n{i}", node=i))
        if i >= still:
            way = place[i] + rng.normal(0, 15, (3, 3))
            turns = rng.normal(size=(3, 4))
            channels.append(channel(i, "translation", way, (0, 1, 2)))
            channels.append(channel(i, "rotation", turns / np.linalg.norm(turns, axis=1, keepdims=True), (0, 1, 2)))
    return Scene("swarm", meshes=tuple(meshes), materials=(Material(double_sided=True),), nodes=tuple(nodes),
                 instances=tuple(instances), animations=(Animation("wander", tuple(channels)),),
                 lights=(Light("directional", direction=(-0.4, -0.8, -0.4)),),
                 cameras=(Camera.look_at((200, 0, 90), (200, 0, 0)),))  # fmt: skip


@pytest.mark.parametrize(("rebuild", "built"), [(0.0, 0), (1.0, 3), (1.5, 3)])
def test_hits_stay_exact_while_all_move(context: "Context", rebuild: float, built: int) -> None:
    """With a top-level tree that is refitted for ever, built anew each frame, or when it is half as bad again."""
    pytest.importorskip("embreex")
    rng = np.random.default_rng(8)
    with MovingTracer(context, swarm(), rebuild=rebuild) as tracer:
        for time in (0.1, 0.9, 1.7):
            tracer.show(time)
            corners, rows, _ = tracer.triangles()
            embree = oracles.Embree(corners)
            low, high = corners.min((0, 1)), corners.max((0, 1))
            n = ray.count(10_000)
            aimed = corners[rng.integers(0, len(corners), n)].mean(1)
            origin = aimed + 80 * ray.sphere_directions(rng, n)
            sets = [ray.camera_rays(low, high, n, rng), ray.random_rays(low, high, n, rng)]
            for these in (*sets, Rays.make(origin, ray.unit(aimed - origin))):
                verdict = oracles.compare(tracer, these, tracer.trace(these), embree, corners, rows)
                assert verdict.wrong == 0 and verdict.hits > n // 20, verdict
        assert tracer.upload.trees is not None and tracer.upload.trees.tops_built == built


def test_compiled_rows_are_those_of_numpy(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for many in (1, 10**9):
        for module in (keys, motion, gpu_scene):
            monkeypatch.setattr(module, "MANY", many)
        with MovingTracer(context, swarm()) as tracer:
            for time in (0.3, 1.1):
                tracer.show(time)
            found.append((tracer.upload._instances.copy(), tracer.upload._boxes.copy(), tracer.upload.flipped))
    (rows, boxes, flipped), (want, want_boxes, want_flipped) = found
    for name in rows.dtype.names or ():
        np.testing.assert_allclose(rows[name], want[name], rtol=1e-5, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(boxes, want_boxes, atol=1e-9)
    np.testing.assert_array_equal(flipped, want_flipped)
    assert 0 < flipped.sum() < COUNT


def test_only_what_moves_is_uploaded(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    """A third at the end of the list moves: no vertex, no tree of a mesh, and no row of the others is written."""
    size, still = layout.dtype("Instance").itemsize, 800
    written: list[tuple[str, int, int]] = []

    class Watched:
        def __init__(self, name: str, buffer: Any) -> None:
            self.name, self.buffer = name, buffer

        def write(self, data: Any, offset: int = 0) -> None:
            written.append((self.name, offset, memoryview(data).nbytes))
            self.buffer.write(data, offset=offset)

        def __getattr__(self, name: str) -> Any:
            return getattr(self.buffer, name)

    scene = swarm(still)
    with Renderer(context=context) as renderer:
        for time in (0.2, 0.3):
            renderer.render(scene, size=(32, 24), settings=Settings(aa=1, time=time))
        assert renderer._staged is not None
        upload = renderer._staged.upload
        resources, nodes = upload.resources, upload.resources["nodes"]
        for name in ("Instances", "Lights"):
            monkeypatch.setitem(resources, name, Watched(name, resources[name]))
        monkeypatch.setattr(nodes, "buffer", Watched("nodes", nodes.buffer))
        renderer._staged.mover.show(0.4)  # type: ignore[union-attr]
        upload.rebase(upload._origin)
        assert upload.trees is not None and upload.trees.top is not None
        tree = ("nodes", 32 * upload.top_root, upload.trees.top.nbytes)
        assert [w for w in written if w[0] != "Lights"] == [tree, ("Instances", still * size, (COUNT - still) * size)]
        monkeypatch.undo()


def test_play_and_seek_with_refitted_and_built_trees(context: "Context") -> None:
    """However the top-level tree came about, the picture is the same."""
    scene = swarm()
    scene = scene.replace(materials=tuple(replace(m, roughness=0.0) for m in scene.materials))
    pictures = []
    for times, rebuild in (((0.0, 0.5, 1.0, 1.5), 0.0), ((1.5,), 0.0), ((0.0, 1.5), 1.0), ((2.0, 0.1, 1.5), 1.2)):
        with Renderer(context=context) as renderer:
            for time in times:
                settings = Settings(aa=1, time=time, rebuild=rebuild)
                frame = renderer.render(scene, size=(64, 48), settings=settings, aovs=("instance_id", "visibility"))
            pictures.append(frame)
    assert len(np.unique(pictures[0]["instance_id"])) > 100 and pictures[0]["visibility"].min() == 0
    for other in pictures[1:]:
        np.testing.assert_array_equal(other["radiance"], pictures[0]["radiance"])
