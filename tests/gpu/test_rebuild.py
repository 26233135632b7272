"""Trees that the GPU builds over moved vertices: proved by Blas.validate, hits against trees of the CPU bit for bit, the
sort against NumPy, and costs against the builder's."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from rays import Rays
from test_motion import MovingTracer, channel, deformer_scene, scene_named
from tree_oracle import sah_cost

from glhybrid import bvh, layout
from glhybrid.bench import movers
from glhybrid.bvh import Blas
from glhybrid.bvh.fragments import LEAF
from glhybrid.errors import GeometryError
from glhybrid.load import load
from glhybrid.motion import Motion
from glhybrid.passes import rebuild as building
from glhybrid.passes.refit_ways import parents_of
from glhybrid.renderer import Renderer
from glhybrid.scene import Animation, Camera, Instance, Light, Material, Mesh, MorphTarget, Node, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from glhybrid.context import Context


def morphing(*soups: Any) -> Scene:
    """Triangles (T, 3, 3) of some meshes, which a target moves by a hundredth of their size."""
    meshes, instances, nodes, channels = [], [], [], []
    rng = np.random.default_rng(7)
    for k, corners in enumerate(soups):
        body = ray.soup(corners)
        points = body.position
        size = np.float32(max(np.abs(points).max(), 1e-30))
        target = MorphTarget((rng.normal(size=points.shape) * 0.01).astype(np.float32) * size)
        meshes.append(Mesh(f"soup {k}", (replace(body, morph_targets=(target,)),), (0.0,)))
        nodes.append(Node(f"node {k}", -1))
        instances.append(Instance(k, np.eye(4), f"soup {k}", node=k))
        channels.append(channel(k, "weights", [[0], [1]]))
    return Scene("soups", meshes=tuple(meshes), materials=(Material(double_sided=True),), instances=tuple(instances),
                 nodes=tuple(nodes), animations=(Animation("shake", tuple(channels)),))  # fmt: skip


def rows_of(tracer: MovingTracer, name: str, words: int) -> Any:
    return np.frombuffer(tracer.upload.resources[name].buffer.read(), np.uint32).reshape(-1, words)


def built_tree(tracer: MovingTracer, mesh: int) -> Blas:
    """What stands on the GPU, its nodes numbered from the root down as the CPU's are."""
    refit, trees = tracer.mover.refit, tracer.upload.trees
    assert refit is not None and trees is not None
    row = refit._trees[refit.meshes.index(mesh)]
    nodes, slots = rows_of(tracer, "nodes", 8), rows_of(tracer, "slots", 12)
    order, level, depth = [], np.array([row["node_first"]]), 0
    while len(level):
        order, depth = [*order, *level.tolist()], depth + 1
        refs = nodes[level][:, 3::4]
        level = refs[refs < LEAF].astype(np.int64)
    first, count = trees.slot_first(mesh), len(trees.items[mesh])
    number = {old: new for new, old in enumerate(order)}
    own = nodes[order].copy()
    refs = own[:, 3::4]
    refs[:] = [[number[r] if r < LEAF else r - (first << 4) for r in pair] for pair in refs.tolist()]
    own_slots = slots[first : first + count]
    corners = own_slots.view(np.float32).reshape(-1, 3, 4)[..., :3]
    bounds = np.stack([corners.min((0, 1)), corners.max((0, 1))]).astype(np.float64)
    cost = refit.sah_cost(mesh)
    assert cost == pytest.approx(sah_cost(own, row["grid_step"].astype(np.float64)), rel=1e-5)
    return Blas(own, own_slots, row["grid_min"], row["grid_step"], bounds, depth, cost, 0.0)


def prove(tracer: MovingTracer) -> list[Blas]:
    """Every tree whole and tight, over all triangles where they are now; a refit finds nothing to change."""
    refit, trees = tracer.mover.refit, tracer.upload.trees
    assert refit is not None and trees is not None
    vertices, found = tracer.vertices()[:, :3], []
    for mesh in refit.meshes:
        blas = built_tree(tracer, mesh)
        blas.validate()
        assert blas.depth <= trees._depth[mesh]
        items = trees.items[mesh]
        order = np.argsort(blas.slots[:, 3])
        assert (blas.slots[order][:, [3, 7]] == items[np.argsort(items[:, 0])]).all() and (blas.slots[:, 11] == 0).all()
        corners = vertices[tracer.geometry.triangles[blas.slots[:, 3], :3]]
        assert (corners.view(np.uint32) == blas.slots.reshape(-1, 3, 4)[..., :3]).all()
        found.append(blas)
    before = rows_of(tracer, "nodes", 8)
    for _ in range(2):
        refit.refit()
        assert (rows_of(tracer, "nodes", 8) == before).all()
    return found


def shapes() -> dict[str, Any]:
    rng = np.random.default_rng(11)
    soup = rng.random((3000, 1, 3)) + rng.normal(size=(3000, 3, 3)) * 0.05
    halves = 2.0 ** -np.arange(40.0)
    chain = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]]) * halves[:, None, None] * 0.25 + halves[:, None, None]
    thin = rng.random((2500, 1, 3)) * [100, 1, 0.01] + rng.normal(size=(2500, 3, 3)) * 0.01
    quad = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], np.float64)
    return {
        "one": soup[:1], "two": quad, "five": soup[:5], "a group": soup[:1024], "a group and one": soup[:1025],
        "soup": soup, "huge": soup * 5e11, "tiny": soup * 1e-12, "far": soup * 0.01 + 1000,
        "equal": np.repeat(soup[:1], 2100, axis=0), "points": np.repeat(soup[:2000, :1], 3, axis=1),
        "flat": soup * [1, 1, 0], "thin": thin, "chain": np.tile(chain, (40, 1, 1)), "line": soup * [1, 0, 0],
    }  # fmt: skip


@pytest.mark.parametrize("name", list(shapes()))
def test_trees_are_whole(context: "Context", name: str) -> None:
    with MovingTracer(context, morphing(shapes()[name]), rebuild=1, builder="gpu") as tracer:
        for time in (0.7, 0.0):
            tracer.show(time)
            prove(tracer)
        refit = tracer.mover.refit
        assert refit is not None and refit.rebuilt == 2


def test_many_trees_are_built_at_once(context: "Context") -> None:
    """Of one triangle and of thousands; each keeps to its own rows, and dispatches do not grow with their number."""
    parts = [part for name, part in shapes().items() if name not in ("huge", "tiny")]
    dispatches = []
    for soups in (parts, parts[-1:] * 3):
        with MovingTracer(context, morphing(*soups), rebuild=1, builder="gpu") as tracer:
            tracer.show(0.4)
            assert len(prove(tracer)) == len(soups)
            refit = tracer.mover.refit
            assert refit is not None and refit._builder is not None
            dispatches.append(refit._builder.dispatches)
    assert dispatches == [1 + 3 * 4 + 2, 1 + 3 * 3 + 2]  # keys, digits, levels


@pytest.mark.parametrize("groups", [256, 3, 1])
def test_keys_are_sorted(context: "Context", monkeypatch: pytest.MonkeyPatch, groups: int) -> None:
    """Stable, and the Morton codes are those of the boxes' centres in NumPy; also where a group sorts many rounds."""
    monkeypatch.setattr(building, "SORT_GROUPS", groups)
    parts = shapes()
    with MovingTracer(
        context, morphing(parts["soup"], parts["thin"], parts["equal"]), rebuild=1, builder="gpu"
    ) as tracer:
        tracer.show(0.3)
        refit = tracer.mover.refit
        assert refit is not None and refit._builder is not None and refit._builder.key_bits == 22
        pairs = np.frombuffer(refit._builder._sorted.read(), np.uint32).reshape(-1, 2)
        items = np.frombuffer(refit._builder._steps[0][1]["BuildItems"].read(), layout.dtype("BuildItem"))
        want = np.zeros(len(items), np.uint32)
        vertices = tracer.vertices()[:, :3]
        for number, row in enumerate(refit._trees):
            ours = np.flatnonzero(items["tree"] == number)
            corners = vertices[tracer.geometry.triangles[items["triangle"][ours], :3]]
            step, low, pad = row["grid_step"], row["grid_min"], row["pad"]
            a = np.floor((corners.min(1) - pad - low) / step - np.float32(0.1)).clip(0, 65535).astype(np.uint32)
            b = np.ceil((corners.max(1) + pad - low) / step + np.float32(0.1)).clip(0, 65535).astype(np.uint32)
            centre, bit, key = a + b, np.full(3, 17), np.full(len(ours), number, np.uint32)
            for k in range(22):
                axis = int(row["axes"][k // 16]) >> 2 * (k % 16) & 3
                bit[axis] -= 1
                key = key << np.uint32(1) | centre[:, axis] >> np.uint32(bit[axis]) & np.uint32(1)
            want[ours] = key
        assert (np.sort(pairs[:, 1]) == np.arange(len(want))).all()
        keys = np.zeros(len(want), np.uint32)
        keys[pairs[:, 1]] = pairs[:, 0]
        # A compiler that fuses sums rounds a few centres to the next cell.
        assert (keys != want).mean() <= (0.0 if context.device.software else 0.02)
        assert (pairs[:, 0] == np.sort(keys)).all()
        assert (pairs[:, 1] == np.argsort(keys, kind="stable")).all()


@pytest.mark.parametrize("name", ["CesiumMan", "Fox", "RiggedFigure", "SimpleMorph", "ring"])
def test_rays_cost_little_more(context: "Context", models: Path, name: str) -> None:
    scene = movers.ring(20_000) if name == "ring" else scene_named(models, name)
    with MovingTracer(context, scene, rebuild=1, builder="gpu") as tracer:
        tracer.show(0.8)
        for blas in prove(tracer):
            corners = blas.slots.view(np.float32).reshape(-1, 3, 4)[..., :3]
            assert blas.sah_cost <= 1.12 * bvh.build_blas(corners).sah_cost


@pytest.mark.parametrize("name", ["soup", "equal", "chain", "ring"])
def test_hits_are_those_of_any_other_tree(context: "Context", name: str) -> None:
    """Bit for bit: refitted, built by the processor, and by the GPU, first in a frame and after a refit."""
    scene = movers.ring(3000) if name == "ring" else morphing(shapes()[name], np.add(shapes()["soup"][:50], 0.2))
    scene = scene.replace(materials=tuple(replace(m, double_sided=True) for m in scene.materials))
    found = []
    for rebuild, builder in ((0.0, "cpu"), (1.0, "cpu"), (1.0, "gpu"), (1e-6, "gpu")):
        rng = np.random.default_rng(3)
        with MovingTracer(context, scene, rebuild=rebuild, builder=builder) as tracer:
            for time in (0.1, 0.2, 0.3, 0.4, 0.5):  # a look at the cost comes two frames after it was asked for
                tracer.show(time)
            refit = tracer.mover.refit
            assert refit is not None and (refit.rebuilt > 0) == (rebuild > 0)
            corners, _, _ = tracer.triangles()
            low, high = corners.min((0, 1)), corners.max((0, 1))
            n = ray.count(4000)
            aimed = corners[rng.integers(0, len(corners), n)].mean(1)
            origin = aimed + np.linalg.norm(high - low) * ray.sphere_directions(rng, n)
            sets = (ray.camera_rays(low, high, n, rng), Rays.make(origin, ray.unit(aimed - origin)))
            found.append([tracer.trace(these) for these in sets])
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            assert one.hit.any()
            for key, value in vars(one).items():
                assert np.array_equal(value, getattr(two, key), equal_nan=True), key


def test_pictures_are_the_same_whoever_builds(context: "Context", models: Path) -> None:
    scene = load(models / "CesiumMan/CesiumMan.glb")
    seen = []
    with Renderer(context=context) as renderer:
        for builder in ("cpu", "gpu"):
            settings = Settings(aa=1, rebuild=1, builder=builder)
            frames = [
                renderer.render(scene, size=(48, 36), settings=settings.replace(time=t), aovs=("depth", "triangle_id"))
                for t in (0.2, 0.9, 0.5)
            ]
            names = {p.split()[0] for p in frames[0].receipt["plan"]["programs"]}
            assert ("rebuild_merge" in names) == (builder == "gpu")
            assert ("refit_climb" in names) == (builder == "gpu" or not context.device.software)
            where = "in compute" if builder == "gpu" else "on the processor"
            assert any(f"built anew {where} every frame" in r for r in frames[0].receipt["plan"]["reasons"])
            seen.append(frames)
    for one, two in zip(*seen, strict=True):
        for name in ("radiance", "depth", "triangle_id"):
            assert np.array_equal(one[name], two[name], equal_nan=True)


def test_materials_stay_with_their_triangles(context: "Context") -> None:
    """Of one mesh: tinted, single-sided and plain pieces, whose slots say which must be asked at a hit."""
    soup, target = shapes()["soup"], MorphTarget(np.full((900, 3), 0.2, np.float32))
    pieces = tuple(replace(ray.soup(soup[k::10], k), morph_targets=(target,)) for k in range(3))
    materials = (
        Material("tint", (0.9, 0.2, 0.2, 0.5), alpha_mode="BLEND"), Material("one side", (0.2, 0.9, 0.2, 1.0)),
        Material("plain", double_sided=True, metallic=1.0, roughness=0.1),
    )  # fmt: skip
    scene = morphing(soup[:1]).replace(
        meshes=(Mesh("body", pieces, (0.0,)),), materials=materials, cameras=(Camera.look_at((2, 1.5, 2), (0.5, 0.5, 0.5)),),
        lights=(Light("directional", intensity=3.0, direction=(-0.48, -0.8, -0.36)),),
    )  # fmt: skip
    with Renderer(context=context) as renderer:
        seen = [
            renderer.render(scene, size=(64, 48), settings=Settings(aa=1, rebuild=1, builder=builder, time=0.6))
            for builder in ("cpu", "gpu")
        ]
    assert seen[0]["radiance"].std() > 0.01 and np.array_equal(seen[0]["radiance"], seen[1]["radiance"])


def test_what_is_never_built_anew_costs_nothing(context: "Context") -> None:
    """Without builds there are neither programs nor buffers of them, and no room for their trees."""
    bytes_of = {}
    for rebuild in (0.0, 1.5):
        with MovingTracer(context, deformer_scene(), rebuild=rebuild, builder="gpu") as tracer:
            tracer.show(0.5)
            refit, trees = tracer.mover.refit, tracer.upload.trees
            assert refit is not None and trees is not None
            assert (refit._builder is not None) == trees.on_gpu == (rebuild > 0)
            assert any("rebuild" in name for name in tracer.shaders.names) == (rebuild > 0)
            bytes_of[rebuild] = refit.bytes
    assert bytes_of[0.0] < bytes_of[1.5] / 3


def test_a_hundred_frames(context: "Context") -> None:
    """The root and its ways are as at first: no count is left over, nothing grows."""
    with MovingTracer(context, deformer_scene(12), rebuild=1, builder="gpu") as tracer:
        refit = None
        for k in range(100):
            tracer.show(k / 100)
            refit = refit or tracer.mover.refit
            assert refit is not None
            if k % 3 == 0:
                refit.refit()
        assert refit is tracer.mover.refit and refit.rebuilt == 100
        assert not np.frombuffer(refit._way._arrived.read(), np.uint32).any()
        prove(tracer)


def test_spheres_do_not_bend(context: "Context") -> None:
    scene = morphing(shapes()["five"])
    body = replace(scene.meshes[0], primitives=(*scene.meshes[0].primitives, Sphere(0.5)))
    with pytest.raises(GeometryError, match='clip "shake" deforms mesh "soup 0", which holds an analytic sphere'):
        Motion(scene.replace(meshes=(body,)), scene.animations[0])


def test_parents() -> None:
    blas = bvh.build_blas(np.random.default_rng(2).random((200, 3, 3)).astype(np.float32))
    refs, parents = blas.nodes[:, 3::4], parents_of(blas.nodes, 10)
    assert parents[0] == layout.CONSTANTS["REFIT_ROOT"]
    for node in range(1, len(blas.nodes)):
        parent, side = divmod(int(parents[node]) - 20, 2)
        assert refs[parent, side] == node
