"""Thousands of rigid instances in motion: hits against Embree, what is uploaded against NumPy, and what is not touched."""

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import oracles
import pytest
import rays as ray
from rays import Rays
from test_motion import MovingTracer, channel

from glhybrid import deform, geometry, gpu_scene, gpu_trees, layout
from glhybrid.bvh.top import MovingTop
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
    """Of what was moved step by step, against a still scene of that time that NumPy places."""
    scene = swarm(still=300)
    with MovingTracer(context, scene) as tracer:
        for time in (0.3, 0.31, 1.1):
            tracer.show(time)
        rows, boxes, flipped = tracer.upload._instances.copy(), tracer.upload._boxes.copy(), tracer.upload.flipped
        uploaded = np.frombuffer(tracer.upload.resources["Instances"].read(), rows.dtype)
        origin, features = tracer.origin, tracer.features
    np.testing.assert_array_equal(uploaded, rows)
    monkeypatch.setattr(gpu_scene, "MANY", 10**9)
    still = deform.at_time(scene, 1.1, None)
    oracle = gpu_scene.GpuScene(context, still, geometry.build(still, 2), features)
    oracle.rebase(origin)
    assert not oracle._compiled
    for name in rows.dtype.names or ():
        np.testing.assert_allclose(rows[name], oracle._instances[name], rtol=1e-5, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(boxes, oracle._boxes, atol=1e-9)
    np.testing.assert_array_equal(flipped, oracle.flipped)
    assert 0 < flipped.sum() < COUNT
    oracle.release()


def test_one_of_many_costs_what_one_costs(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    """Where few move, what is written is their rows and the nodes above them; and when they stop, nothing."""
    scene = swarm(still=COUNT - 1)
    with MovingTracer(context, scene, rebuild=0.0) as tracer:
        tracer.show(0.1)
        upload, written = tracer.upload, Counter[str]()
        assert upload.trees is not None
        for name, buffer in (("Instances", upload.resources["Instances"]), ("nodes", upload.resources["nodes"].buffer)):

            def write(data: Any, offset: int = 0, name: str = name, buffer: Any = buffer) -> None:
                written[name] += memoryview(data).nbytes
                type(buffer).write(buffer, data, offset=offset)

            monkeypatch.setattr(buffer, "write", write)
        tracer.mover.show(0.2)
        upload.rebase(tracer.origin)
        deepest = upload.trees.top.depth if upload.trees.top is not None else 0
        assert written["Instances"] == layout.dtype("Instance").itemsize
        assert 0 < written["nodes"] <= 32 * gpu_trees.NEAR_NODES * deepest < 32 * COUNT
        written.clear()
        for time in (9.0, 10.0, 11.0):  # behind the end of the clip
            tracer.mover.show(time)
            upload.rebase(tracer.origin)
            if time > 9:
                assert not written
            written.clear()
        monkeypatch.undo()
        rows = np.frombuffer(upload.resources["nodes"].buffer.read(), np.uint32).reshape(-1, 8)[upload.top_root :]
        boxes = upload._boxes
        fresh = MovingTop(upload.trees._moving.built, upload.top_root)
        fresh._on, fresh.grid = upload.trees._moving._on, upload.trees._moving.grid
        fresh.refit(boxes)
        np.testing.assert_array_equal(rows, fresh.rows)


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
