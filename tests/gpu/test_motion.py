"""Skinned and morphed vertices against glhybrid/deform.py, trees that follow them against Embree and float64, frames by
play against frames by seek, and motion vectors against positions projected in float64."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import oracles
import pytest
import rays as ray
from rays import Rays, Tracer

from glhybrid import geometry, layout, needs
from glhybrid.deform import at_time, posed
from glhybrid.gpu_scene import GpuScene
from glhybrid.layout import CONSTANTS
from glhybrid.load import default_camera, load
from glhybrid.motion import Motion
from glhybrid.mover import Mover
from glhybrid.pose import clip_span, evaluate, world_matrices
from glhybrid.renderer import Renderer
from glhybrid.scene import (
    Animation,
    Camera,
    Channel,
    Instance,
    Light,
    Material,
    Mesh,
    MorphTarget,
    Node,
    Scene,
    Skin,
    Triangles,
)
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.stream import Shot
from glhybrid.view import choose_camera, make_view

if TYPE_CHECKING:
    from glhybrid.context import Context

FILES = {
    "CesiumMan": "CesiumMan/CesiumMan.glb", "Fox": "Fox/Fox.glb", "RiggedFigure": "RiggedFigure/RiggedFigure.glb",
    "AnimatedMorphCube": "AnimatedMorphCube/AnimatedMorphCube.glb", "SimpleSkin": "SimpleSkin/SimpleSkin.gltf",
    "SimpleMorph": "SimpleMorph/SimpleMorph.gltf",
}  # fmt: skip


def channel(node: int, path: Any, values: Any, times: Any = (0, 1)) -> Channel:
    return Channel(node, path, "LINEAR", np.array(times, np.float32), np.array(values, np.float32))


def deformer_scene(n: int = 40, joints: int = 8, flat: bool = False) -> Scene:
    """A closed body of 4 n (n - 1) triangles: two targets, 8 joints a vertex, its node moved too."""
    rng = np.random.default_rng(n)
    exact, index = ray.uv_sphere(n)
    position: Any = exact.astype(np.float32)
    if flat:
        position, index = position[index.ravel()], np.arange(index.size, dtype=np.uint32).reshape(-1, 3)
    unit = position / np.linalg.norm(position, axis=1, keepdims=True)
    waves = np.float32(0.3) * unit * np.sin(6 * unit[:, :1] + 4 * unit[:, 1:2]).astype(np.float32)
    targets = (
        MorphTarget(waves, None if flat else 0.2 * unit[:, ::-1]),
        MorphTarget(np.ascontiguousarray(0.2 * unit[:, ::-1])),
    )
    weights = rng.uniform(0, 1, (len(position), joints)).astype(np.float32)
    weights[::7, 2:] = 0
    piece = Triangles(position, index, unit, joints=np.tile(np.arange(joints, dtype=np.uint16), (len(position), 1)),
                      weights=weights, morph_targets=targets)  # fmt: skip
    nodes = [Node("root", -1, translation=(300.0, 0, -20))]
    nodes += [Node(f"joint {j}", 0, translation=(0.3 * j, 0, 0)) for j in range(joints)]
    bind = np.tile(np.eye(4), (joints, 1, 1))
    bind[:, :3, 3] = [[-0.3 * j, 0, 0] for j in range(joints)]
    turns = [
        channel(1 + j, "rotation", [[0, 0, 0, 1], [np.sin(0.2 * j), 0, 0, np.cos(0.2 * j)]]) for j in range(joints)
    ]
    clip = Animation("twist", (
        *turns, channel(0, "translation", [[300, 0, -20], [301, 0, -20]]), channel(0, "weights", [[0, 0], [1, -1]]),
    ))  # fmt: skip
    return Scene("deformer", meshes=(Mesh("body", (piece,), (0.0, 0.0)),), materials=(Material(double_sided=True),),
                 instances=(Instance(0, np.eye(4), "body", node=0, skin=0),), nodes=tuple(nodes),
                 skins=(Skin(tuple(range(1, joints + 1)), bind),), animations=(clip,))  # fmt: skip


class MovingTracer(Tracer):
    """A tracer whose scene is brought to a time of a clip; `geometry` is kept true to what the GPU holds."""

    def __init__(
        self, context: "Context", scene: Scene, clip: int = 0, rebuild: float = 0.0, builder: str = "cpu"
    ) -> None:
        self.context, self.scene = context, scene
        self._owns_shaders, self.shaders = True, Shaders(context, extra=(ray.HERE,))
        self.motion = Motion(scene, scene.animations[clip])
        found = needs.find(self.motion.start, Settings()).features
        self.geometry = geometry.build(
            self.motion.start, 2, tangents=found.tangents, attributes=found.extra_attributes,
            deforming=self.motion.deforming,
        )  # fmt: skip
        steps = 1 << 20 if context.device.software else 3
        found = found.replace(two_level=True, bvh_inner_steps=steps)
        self.upload = GpuScene(context, self.motion.start, self.geometry, found, self.motion, rebuild, builder)
        self.features = found.replace(bvh_stack=self.upload.stack_entries)
        self.mover = Mover(context, self.shaders, self.upload, self.motion, found, rebuild)
        self.origin = np.round(self.motion.bounds.mean(0))
        self._frame = context.gl.buffer(reserve=layout.dtype("FrameConstants").itemsize)
        self.resources: dict[str, Any] = {}

    def show(self, time: float) -> None:
        self.mover.show(time)
        self.upload.rebase(self.origin)
        constants = np.zeros(1, layout.dtype("FrameConstants"))
        constants["top_root"] = self.upload.top_root
        constants["top_grid_min"], constants["top_grid_step"] = self.upload.top_grid(self.origin)
        self._frame.write(constants)
        self.resources = {**self.upload.resources, "Frame": self._frame}
        assert self.upload.stack_needed() <= self.features.bvh_stack
        object.__setattr__(self.geometry, "vertices", self.vertices())
        object.__setattr__(self.geometry, "world_from_object", self.upload.world_from_object)

    def vertices(self) -> Any:
        data = self.upload.resources["vertices"].buffer.read(self.geometry.vertices.nbytes)
        return np.frombuffer(data, np.float32).reshape(-1, 8)

    def close(self) -> None:
        self.mover.release()
        super().close()


def scene_named(models: Path, name: str) -> Scene:
    if name in FILES:
        return load(models / FILES[name])
    return deformer_scene(flat=name == "flat deformer")


@pytest.mark.parametrize("name", [*FILES, "deformer", "flat deformer"])
def test_vertices_are_those_of_the_oracle(context: "Context", models: Path, name: str) -> None:
    scene = scene_named(models, name)
    clip = scene.animations[-1]
    with MovingTracer(context, scene, clip=len(scene.animations) - 1) as tracer:
        start, end = clip_span(clip)
        for time in (start, 0.37 * start + 0.63 * end, end):
            tracer.show(time)
            got = tracer.vertices()
            still = posed(scene, evaluate(scene, time, clip), tracer.motion.deformers)
            for row, mesh in enumerate(tracer.geometry.meshes):
                number = int(tracer.geometry.instance_id[np.flatnonzero(tracer.geometry.instance_mesh == row)[0]])
                first = mesh.first_vertex
                for piece in still.meshes[still.instances[number].mesh].primitives:
                    assert isinstance(piece, Triangles)
                    ours = got[first : first + len(piece.position)]
                    first += len(piece.position)
                    size = float(np.abs(piece.position).max())
                    np.testing.assert_allclose(ours[:, :3], piece.position, atol=2e-6 * size)
                    np.testing.assert_allclose(ours[:, 4:7], piece.normal, atol=2e-4 if "flat" in name else 1e-5)
                    bounds = [s.bounds for s in tracer.motion.at(time).shapes]
                    assert any((piece.position >= b[0]).all() and (piece.position <= b[1]).all() for b in bounds)


@pytest.mark.parametrize("rebuild", [0.0, 1.0, 1.01])
@pytest.mark.parametrize("name", ["CesiumMan", "Fox", "RiggedFigure", "AnimatedMorphCube", "SimpleMorph", "deformer"])
def test_hits_stay_exact_mid_clip(context: "Context", models: Path, name: str, rebuild: float) -> None:
    """The trees were built at rest: refitted, built anew every frame, or when a little worse, no hit may be lost."""
    pytest.importorskip("embreex")
    scene = scene_named(models, name)  # Embree sees both sides
    scene = scene.replace(materials=tuple(replace(m, double_sided=True) for m in scene.materials))
    rng = np.random.default_rng(5)
    with MovingTracer(context, scene, rebuild=rebuild) as tracer:
        start, end = clip_span(scene.animations[0])
        total = 0
        for share in (0.2, 0.5, 0.83):
            tracer.show(start + share * (end - start))
            corners, rows, _ = tracer.triangles()
            embree = oracles.Embree(corners)
            low, high = corners.min((0, 1)), corners.max((0, 1))
            reach = high - low
            n = ray.count(20_000)
            sets = [ray.camera_rays(low, high, n, rng), ray.random_rays(low - reach, high + reach, n, rng)]
            aimed = corners[rng.integers(0, len(corners), n)].mean(1)
            origin = aimed + np.linalg.norm(reach) * ray.sphere_directions(rng, n)
            sets.append(Rays.make(origin, ray.unit(aimed - origin)))
            for these in sets:
                verdict = oracles.compare(tracer, these, tracer.trace(these), embree, corners, rows)
                total += verdict.hits
                assert verdict.wrong == 0, verdict
        assert total > 1000
        refit = tracer.mover.refit
        assert refit is not None
        assert refit.rebuilt == {0.0: 0, 1.0: 3 * len(tracer.motion.deformers)}.get(rebuild, refit.rebuilt)


@pytest.mark.parametrize("rebuild", [0.0, 1.05])
def test_hits_stay_exact_on_a_hundred_thousand_triangles(context: "Context", rebuild: float) -> None:
    """A body that eight joints a vertex and two targets bend out of shape, its tree refitted, or built anew on the way."""
    pytest.importorskip("embreex")
    rng = np.random.default_rng(6)
    with MovingTracer(context, deformer_scene(160), rebuild=rebuild) as tracer:
        assert len(tracer.geometry.triangles) > 100_000
        for time in (0.35, 0.8):
            for step in (-0.2, -0.1, 0.0):  # a look at the cost comes two frames after it was asked for
                tracer.show(time + step)
            corners, rows, _ = tracer.triangles()
            embree = oracles.Embree(corners)
            low, high = corners.min((0, 1)), corners.max((0, 1))
            n = ray.count(10_000)
            aimed = corners[rng.integers(0, len(corners), n)].mean(1)
            origin = aimed + np.linalg.norm(high - low) * ray.sphere_directions(rng, n)
            for these in (ray.camera_rays(low, high, n, rng), Rays.make(origin, ray.unit(aimed - origin))):
                verdict = oracles.compare(tracer, these, tracer.trace(these), embree, corners, rows)
                assert verdict.wrong == 0 and verdict.hits > n // 10, verdict
        refit = tracer.mover.refit
        assert refit is not None and (refit.rebuilt > 0) == (rebuild > 0)


def test_sah_cost_on_the_gpu_is_that_of_the_builder(context: "Context") -> None:
    scene = deformer_scene()
    with MovingTracer(context, scene, rebuild=1.0) as tracer:
        tracer.show(0.6)
        refit = tracer.mover.refit
        assert refit is not None
        built = refit.sah_cost(0)
        assert built == pytest.approx(refit._built_cost[0], rel=1e-3)
    with MovingTracer(context, scene) as tracer:
        tracer.show(0.6)
        refit = tracer.mover.refit
        assert (
            refit is not None and refit.sah_cost(0) > 0.95 * built
        )  # a refitted tree is no better than one built for it


def test_a_frame_is_the_same_by_play_and_by_seek(context: "Context", models: Path) -> None:
    scene = load(models / FILES["Fox"])
    still = Settings(aa=1, clip="Run")
    times = (0.1, 0.45, 0.8)

    def frame(renderer: Renderer, time: float) -> Any:
        return renderer.render(scene, size=(96, 64), settings=still.replace(time=time))

    with Renderer(context=context) as renderer:
        played = [frame(renderer, t) for t in times]
        upload = renderer._staged.upload if renderer._staged else None
        again = frame(renderer, times[0])
        assert renderer._staged is not None and renderer._staged.upload is upload  # one upload serves all
    np.testing.assert_array_equal(again["radiance"], played[0]["radiance"])
    with Renderer(context=context) as renderer:
        sought = frame(renderer, times[2])
        np.testing.assert_array_equal(sought["radiance"], played[2]["radiance"])
        assert {"skin", "refit", "tlas"} <= {p["name"] for p in sought.receipt["passes"]}
        # The path of still scenes: other trees, one level, vertices from the CPU.
        reference = renderer.render(at_time(scene, times[2], "Run"), size=(96, 64), settings=Settings(aa=1))
    off = np.abs(sought["radiance"] - reference["radiance"]).max(-1) > 1e-3 * (1 + reference["radiance"].max(-1))
    assert off.mean() < 2e-3  # rounding at silhouettes


CLIPS = {"CesiumMan": 1, "Fox": 3, "RiggedFigure": 1, "AnimatedMorphCube": 1, "SimpleSkin": 1, "SimpleMorph": 1,
         "BoxAnimated": 1, "InterpolationTest": 9}  # fmt: skip


@pytest.mark.parametrize("name", CLIPS)
def test_every_clip_of_a_file_plays_as_it_is_sought(context: "Context", models: Path, name: str) -> None:
    """All AOVs, bit for bit: frame by frame with trees refitted and built anew on the way, backwards, and at once."""
    files = (models / name / f"{name}.glb", models / name / f"{name}.gltf")
    scene = load(next(f for f in files if f.exists()))
    assert len(scene.animations) == CLIPS[name]
    names = ("position", "normal", "instance_id", "triangle_id", "visibility")
    for clip in scene.animations[:2]:
        start, end = clip_span(clip)
        times = [start + share * (end - start) for share in (0.1, 0.4, 0.7, 0.9)]
        chosen = Settings(aa=1, clip=str(scene.animations.index(clip)), rebuild=1.05)
        with Renderer(context=context) as renderer:
            played = list(renderer.frames(scene, [Shot(t) for t in times], (40, 30), chosen, names))
            back = list(renderer.frames(scene, [Shot(t) for t in times[::-1]], (40, 30), chosen, names))[::-1]
        with Renderer(context=context) as renderer:
            sought = renderer.render(
                scene, size=(40, 30), settings=chosen.replace(time=times[2], rebuild=0), aovs=names
            )
        for frame in (back[2], sought):
            np.testing.assert_array_equal(frame.rgb, played[2].rgb)
            for aov in names:
                np.testing.assert_array_equal(frame[aov], played[2][aov], err_msg=aov)
        assert any((a.rgb != b.rgb).any() for a, b in pairwise(played))


def test_trees_that_come_late_move_too(context: "Context", models: Path) -> None:
    """Depth maps need none; rays have them built, where vertices are by then, and refitted from there on."""
    scene, names = load(models / FILES["CesiumMan"]), ("visibility", "instance_id")
    maps, rays = (Settings(aa=1, shadows=name, reflections="none", primary="raster") for name in ("map", "ray"))
    with Renderer(context=context) as renderer:
        before = renderer.render(scene, size=(64, 48), settings=maps.replace(time=0.3), aovs=names)
        passes = {p["name"] for p in before.receipt["passes"]}
        assert "skin" in passes and "refit" not in passes and before.receipt["bvh"]["nodes"] == 0
        assert renderer._staged is not None
        upload = renderer._staged.upload
        late = [renderer.render(scene, size=(64, 48), settings=rays.replace(time=t), aovs=names) for t in (0.5, 0.9)]
        assert renderer._staged.upload is upload and "refit" in {p["name"] for p in late[1].receipt["passes"]}
        renderer.render(scene, size=(64, 48), settings=maps.replace(time=0.1))
    for frame, time in zip(late, (0.5, 0.9), strict=True):
        with Renderer(context=context) as renderer:
            want = renderer.render(scene, size=(64, 48), settings=rays.replace(time=time), aovs=names)
        for name in ("radiance", *names):
            np.testing.assert_array_equal(frame[name], want[name], err_msg=name)


def test_what_stands_still_costs_nothing(context: "Context", models: Path) -> None:
    scene = load(models / FILES["CesiumMan"])
    with Renderer(context=context) as renderer:
        frame = renderer.render(scene, size=(32, 32), settings=Settings(aa=1), aovs=("motion",))
        names = [p.split()[0] for p in frame.receipt["plan"]["programs"]]
        assert not {"skin", "refit"} & set(names)
        assert renderer._staged is not None and renderer._staged.mover is None
        assert not renderer._staged.upload.resources.keys() & {"PreviousInstances", "previous_vertices"}
        assert any(s.startswith("skin and refit: nothing moves") for s in frame.receipt["plan"]["skipped"])
    box = load(models / "BoxAnimated/BoxAnimated.glb")
    with Renderer(context=context) as renderer:
        frame = renderer.render(box, size=(32, 32), settings=Settings(aa=1, time=1.0))
        assert not {"skin", "refit"} & {p.split()[0] for p in frame.receipt["plan"]["programs"]}
        assert any(s.startswith("skin and refit: nothing changes shape") for s in frame.receipt["plan"]["skipped"])


@pytest.mark.parametrize("name", ["CesiumMan", "AnimatedMorphCube", "BoxAnimated", "deformer"])
def test_motion_vectors_are_where_points_were(context: "Context", models: Path, name: str) -> None:
    """Every pixel's point, by its triangle and barycentrics, projected at both times in float64."""
    scene = load(models / "BoxAnimated/BoxAnimated.glb") if name == "BoxAnimated" else scene_named(models, name)
    size, end = (80, 60), clip_span(scene.animations[0])[1]
    before, now = 0.47 * end, 0.5 * end
    scene = scene.replace(cameras=(default_camera(at_time(scene, now)),))
    with Renderer(context=context) as renderer:
        for time in (before, now):
            frame = renderer.render(
                scene,
                size=size,
                settings=Settings(aa=1, time=time),
                aovs=("motion", "position", "triangle_id", "instance_id"),
            )
        assert renderer._staged is not None
        bounds = renderer._staged.bounds
        still = renderer.render(scene, size=size, settings=Settings(aa=1, time=now), aovs=("motion",))
    assert not still["motion"].any()  # the frame before was the same one
    there, here = (at_time(scene, t) for t in (before, now))
    view = make_view(choose_camera(here, None), size, here, context.limits.clip_control, bounds)

    def pixel(p: Any) -> Any:
        clip = np.concatenate([p - view.origin, np.ones((len(p), 1))], 1) @ view.clip_from_world.T
        return np.stack([clip[:, 0], -clip[:, 1]], 1) / clip[:, 3:] * np.array(size) / 2

    hit = frame["instance_id"] != CONSTANTS["ID_NONE"]
    assert hit.mean() > 0.05
    corners = [_world_corners(s, frame["instance_id"][hit], frame["triangle_id"][hit]) for s in (there, here)]
    point = frame["position"][hit].astype(np.float64)
    bary = _barycentrics(corners[1], point)
    was = np.einsum("pk,pkc->pc", bary, corners[0])
    want = pixel(was) - pixel(np.einsum("pk,pkc->pc", bary, corners[1]))
    assert np.linalg.norm(want, axis=1).max() > 0.3
    np.testing.assert_allclose(frame["motion"][hit], want, atol=2e-2)
    assert np.median(np.abs(frame["motion"][hit] - want)) < 1e-3
    assert not frame["motion"][~hit].any()


def _world_corners(scene: Scene, instance: Any, triangle: Any) -> Any:
    """(P, 3, 3) float64."""
    out = np.zeros((len(instance), 3, 3))
    for number in np.unique(instance):
        placed = scene.instances[number]
        pieces = [p for p in scene.meshes[placed.mesh].primitives if isinstance(p, Triangles)]
        all_corners = np.concatenate([p.position[p.index].astype(np.float64) for p in pieces])
        rows = instance == number
        local = all_corners[triangle[rows]]
        out[rows] = local @ placed.world_from_object[:3, :3].T + placed.world_from_object[:3, 3]
    return out


def _barycentrics(corners: Any, point: Any) -> Any:
    e1, e2, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    a, b, c = (e1 * e1).sum(1), (e1 * e2).sum(1), (e2 * e2).sum(1)
    d, e = (p * e1).sum(1), (p * e2).sum(1)
    v, w = (c * d - b * e) / (a * c - b * b), (a * e - b * d) / (a * c - b * b)
    return np.stack([1 - v - w, v, w], 1)


@pytest.mark.parametrize("name", ["BoxAnimated/BoxAnimated.glb", FILES["CesiumMan"]])
def test_a_first_picture_has_not_moved(context: "Context", models: Path, name: str) -> None:
    # A clip is staged at rest: what lies between that and the first time asked for is no motion of the picture.
    scene = load(models / name)
    with Renderer(context=context) as renderer:
        single = renderer.render(scene, size=(64, 48), settings=Settings(time=0.5), aovs=("motion",))
        assert not single["motion"].any()
        assert renderer.render(scene, size=(64, 48), settings=Settings(time=0.55), aovs=("motion",))["motion"].any()
    with Renderer(context=context) as renderer:
        shots = [Shot(time=0.5), Shot(time=0.55), Shot(time=0.55)]
        moved = [f["motion"].any() for f in renderer.frames(scene, shots, (64, 48), aovs=("motion",))]
        assert moved == [False, True, False]


@pytest.mark.parametrize("name", ["BoxAnimated/BoxAnimated.glb", FILES["CesiumMan"]])
def test_pictures_side_by_side_have_moved_alike(context: "Context", models: Path, name: str) -> None:
    # Both techniques of a split view share what moves; the second one's frame before is not the first one's of now.
    scene, sides = load(models / name), [Settings(shadows=name, aa=1) for name in ("none", "map")]
    with Renderer(context=context, interactive=True) as renderer:
        for time in (0.5, 0.55, 0.55, 0.6):
            a, b = (
                renderer.render(scene, size=(64, 48), settings=side.replace(time=time), aovs=("motion",))["motion"]
                for side in sides
            )
            np.testing.assert_array_equal(a, b)
        assert a.any()


def test_things_that_turn_inside_out_vanish_and_come_back(context: "Context") -> None:
    """A single-sided quad whose node is mirrored, flattened and scaled to nothing on the way: raster and rays agree."""
    quad = ray.piece([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    scales = [[1, 1, 1], [-1, 1, 1], [-1, 0, 1], [0, 0, 0], [1, 1, 1]]
    clip = Animation("turn", (channel(0, "scale", scales, range(5)),))
    scene = Scene(
        "quad", meshes=(Mesh("quad", (quad,)),), instances=(Instance(0, np.eye(4), "quad", node=0),),
        materials=(Material(),), nodes=(Node("n", -1),), animations=(clip,),
        cameras=(Camera.look_at((0, 0, 4), (0, 0, 0)),),
    )  # fmt: skip
    seen: dict[int, float] = {}
    for primary in ("raster", "trace"):
        with Renderer(context=context) as renderer:
            for time in (0, 1, 2, 3, 4, 1):
                settings = Settings(aa=1, time=time, primary=primary)
                ids = renderer.render(scene, size=(32, 32), settings=settings, aovs=("instance_id",))["instance_id"]
                share = float((ids == 0).mean())
                assert share == seen.setdefault(time, share)
    # glTF: a negative determinant turns the winding over, so the mirrored quad is still seen.
    assert seen[0] == seen[1] == seen[4] > 0.2 and seen[2] <= 0.05 and seen[3] == 0


def test_moving_lights_and_cameras(context: "Context") -> None:
    """A lamp that a clip carries to the other side of a wall, and a camera that turns away."""
    floor = ray.piece([[-4, 0, -4], [-4, 0, 4], [4, 0, 4], [4, 0, -4]], [[0, 1, 2], [0, 2, 3]])
    wall = ray.piece([[0, 0, -4], [0, 9, -4], [0, 9, 4], [0, 0, 4]], [[0, 1, 2], [0, 2, 3]])
    nodes = (Node("lamp", -1, translation=(-2, 1, 0)), Node("eye", -1, translation=(0, 20, 0)))
    half = 0.5**0.5
    down, away = [-half, 0, 0, half], [half, 0, 0, half]
    clip = Animation("a", (
        channel(0, "translation", [[-2, 1, 0], [2, 1, 0]]), channel(1, "rotation", [down, down, away], (0, 1, 2)),
    ))  # fmt: skip
    scene = ray.scene_of(
        floor, wall, materials=(Material(double_sided=True),), nodes=nodes, animations=(clip,),
        lights=(Light("point", position=(-2, 1, 0), intensity=100.0, node=0),),
        cameras=(Camera("eye", world_matrices(nodes)[1], node=1),),
    )  # fmt: skip
    with Renderer(context=context) as renderer:
        bright = []
        for time in (0.0, 1.0, 2.0):
            frame = renderer.render(scene, size=(40, 40), settings=Settings(aa=1, time=time))
            bright.append(frame["radiance"].sum(-1))
    left, right = (bright[0][10:30, s].mean() for s in (slice(10, 19), slice(21, 30)))
    assert left > 0 and right == 0
    np.testing.assert_allclose(bright[1][10:30, 21:30], bright[0][10:30, 18:9:-1], rtol=1e-3, atol=1e-5)
    assert not bright[2].any()
