"""`glhybrid bench`: what it sends and counts, and that a tracer that misses is found out. Times are never asserted."""

import json
import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from glhybrid import bench, cli, reference
from glhybrid.bench import clock, peers, scenes
from glhybrid.bench.rays import CLASSES, UNBOUNDED, Tracer, Variant, variants
from glhybrid.errors import SettingError
from glhybrid.load.builtin import data_folder
from glhybrid.scene import Camera, Instance, Material, Mesh, Scene, Sphere
from glhybrid.shaders import Program, Shaders

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (80, 52)  # 10 x 6.5 tiles
Scan = Callable[[], Any]


@pytest.fixture
def tracer(context: "Context") -> Iterator[Tracer]:
    shaders = Shaders(context)
    scene = scenes.make("spheres", 10_000)
    with Tracer(context, shaders, scene, scene.cameras[0], SIZE) as opened:
        yield opened
    shaders.release()


@pytest.mark.parametrize("name", scenes.SITES)
@pytest.mark.parametrize("triangles", [10_000, 100_000])
def test_scenes_have_the_triangles_asked_for(name: str, triangles: int) -> None:
    scene = scenes.make(name, triangles)
    assert scene.triangle_count() == pytest.approx(triangles, rel=0.03)
    for mesh in scene.meshes:
        piece = mesh.primitives[0]
        corner = piece.position[piece.index].astype(np.float64)
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (np.linalg.norm(normal, axis=1) > 0).all(), "a triangle without area"
        facing = (normal * piece.normal[piece.index].mean(1)).sum(1)
        assert (facing > 0).all(), "wound the wrong way"


def test_cells_are_even() -> None:
    """Evenly tessellated: no triangle is much larger than the middle one."""
    scene = scenes.make("hall", 100_000)
    corners = np.concatenate([m.primitives[0].position[m.primitives[0].index] for m in scene.meshes])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area.max() < 1.5 * np.median(area)


def test_scene_names_and_sizes_are_checked() -> None:
    with pytest.raises(SettingError, match='did you mean "spheres"'):
        scenes.make("sphere", 10_000)
    with pytest.raises(SettingError, match="2000 to"):
        scenes.make("hall", 3)


def test_rays_are_live_and_in_tiles(tracer: Tracer) -> None:
    width, height = SIZE
    rays, view = tracer.rays, tracer.view
    assert len(rays["camera"]) == width * height
    # Where each camera ray meets the image: whole 8x8 tiles in a row, each in Morton order.
    d = rays["camera"].direction.astype(np.float64)
    d /= (d @ view.forward)[:, None]
    px = [((d @ axis) / (axis @ axis) + 1) / 2 * n - 0.5 for axis, n in ((view.right, width), (view.up, height))]
    px = np.rint(np.stack(px, 1)).astype(int)
    assert np.array_equal(px[:8], [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (3, 0), (2, 1), (3, 1)])
    full = px[: 64 * (width // 8) * (height // 8)].reshape(-1, 64, 2)
    assert (np.ptp(full, axis=1) == 7).all() and len({tuple(p) for p in px.tolist()}) == width * height
    # The others leave hits, upwards of the surface: as many as there are hits, shadow rays only where the sun shines.
    camera = tracer.launch("camera", tracer.own)
    camera[0]()
    hits = int(np.isfinite(camera[1]()).sum())
    assert 0 < len(rays["shadow"]) < len(rays["mirror"]) == len(rays["diffuse"]) == hits < width * height
    assert (rays["mirror"].t_max == np.inf).all()
    assert np.unique(rays["shadow"].direction.round(5), axis=0).shape == (1, 3)


def test_every_variant_finds_the_same_and_what_embree_finds(tracer: Tracer) -> None:
    tried = variants(tracer.scene, software=True)
    assert tried[0] == tracer.own or not tracer.context.device.software
    assert {v.inner_steps for v in tried} >= {1, 2, 3, 4, UNBOUNDED} and {v.levels for v in tried} == {1, 2}
    corners = tracer.triangles()
    assert corners is not None and len(corners) == tracer.scene.triangle_count()
    truth = reference.closest_hit  # float64
    for name in CLASSES:
        rays, answers = tracer.rays[name], []
        for variant in tried:
            run, read = tracer.launch(name, variant)
            run()
            answers.append(read())
        if not peers.Embree.missing:
            run, read = peers.Embree(corners).launch(name, rays)
            run()
            answers.append(read())
        for other in answers[1:]:
            assert len(bench.differing(name, answers[0], other, 60.0)) <= 1
        some = slice(0, None, 50)
        found = truth(corners.astype(np.float64), rays.origin[some], rays.direction[some], 0.0, rays.t_max[some])
        hit = np.isfinite(found.t)
        assert np.array_equal(hit, answers[0][some] if name == "shadow" else np.isfinite(answers[0][some]))


def test_steps_are_those_of_the_tree(tracer: Tracer) -> None:
    """Steps a ray on the GPU against the CPU's walk of the same tree, unbounded and in the shader's arithmetic."""
    tree = tracer.structure(1).geometry.meshes[0].blas
    shift = tracer.structure(1).geometry.world_from_object[0, :3, 3] - tracer.view.origin
    for name in ("camera", "diffuse"):
        rays = tracer.rays[name]
        walked = reference.traverse(
            tree, rays.origin - shift.astype(np.float32), rays.direction, precision=np.float32
        )  # fmt: skip
        counted = tracer.steps(name, Variant(1, UNBOUNDED))
        assert counted == pytest.approx(float((walked.nodes_visited + walked.triangles_tested).mean()), rel=0.01)
        assert tracer.steps(name, Variant(1, 1)) == pytest.approx(counted, rel=1e-6), (
            "the bound changes turns, not steps"
        )
    assert tracer.steps("shadow", Variant(1, UNBOUNDED)) < tracer.steps("diffuse", Variant(1, UNBOUNDED))


def test_one_dispatch_a_launch_and_few_bytes_a_ray(tracer: Tracer, monkeypatch: pytest.MonkeyPatch) -> None:
    launches = {name: tracer.launch(name, tracer.own)[0] for name in CLASSES}
    sizes: list[tuple[int, int, set[str]]] = []
    dispatch = Program.dispatch

    def counted(self: Program, resources: Any, size: tuple[int, int], group: tuple[int, int] = (8, 8)) -> None:
        sizes.append((size[0] * size[1], resources["Found"].size, set(self.resources)))
        dispatch(self, resources, size, group)

    monkeypatch.setattr(Program, "dispatch", counted)
    for name, run in launches.items():
        sizes.clear()
        run()
        (rays, found, resources), *rest = sizes
        count = len(tracer.rays[name])
        assert not rest and rays >= count and found == count * (4 if name == "shadow" else 8)
        assert resources >= {"nodes", "slots", "rays"}
        assert not resources & {"vertices", "triangles", "texture_pages"}, "a tracer reads no attribute"


def test_a_tracer_that_misses_is_a_failure(context: "Context", monkeypatch: pytest.MonkeyPatch) -> None:
    """A variant made to lose one ray in a thousand ends the bench with exit status 1, and is named."""
    launch = Tracer.launch

    def lossy(self: Tracer, name: str, variant: Variant) -> tuple[Scan, Scan]:
        run, read = launch(self, name, variant)
        if variant.inner_steps != 2 or name != "mirror":
            return run, read

        def lose() -> Any:
            found = read().copy()
            found[np.flatnonzero(np.isfinite(found))[::1000]] = np.inf
            return found

        return run, lose

    monkeypatch.setattr(Tracer, "launch", lossy)
    report = bench.run(["spheres:10k"], quick=True, size=SIZE, context=context)
    assert len(report.failures) == 1
    assert re.search(r"spheres, 10000 triangles, mirror rays: 1 level, inner 2, woop differs", report.failures[0])


def test_differing() -> None:
    a = np.array([1, 2, 3, np.inf, np.inf, 1e-9], np.float32)
    b = np.array([1, 2.001, np.inf, 3, np.inf, 2e-9], np.float32)
    assert bench.differing("camera", a, b, 1.0).tolist() == [1, 2, 3]
    assert bench.differing("shadow", np.array([True, False, True]), np.array([True, True, False]), 1.0).tolist() == [
        1,
        2,
    ]


def test_the_json_is_the_contract(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, context: "Context"
) -> None:
    run = bench.run
    monkeypatch.setattr(bench, "run", lambda *names, **more: run(*names, **more | {"context": context}))
    shown = ["hall:10k", "grey", "--quick", "--json", "--peers", "--size", "64x40"]
    monkeypatch.setattr(peers, "mitsuba_missing", lambda: "mitsuba is not installed (pip install mitsuba)")
    assert cli.main(["bench", *shown]) == 0
    result = json.loads(capsys.readouterr().out)
    assert list(result) == ["machine", "rows", "frames", "builds"]
    row_keys = ["scene", "triangles", "rays", "variant", "mrays_s", "ratio_embree_per_core"]
    assert all(list(row) == row_keys for row in result["rows"])
    assert [list(f) for f in result["frames"]] == [["scene", "size", "passes", "frame_ms", "host_us"]]
    assert all(list(b) == ["triangles", "mtris_s", "sah_cost", "ratio_sah_binned"] for b in result["builds"])
    machine = result["machine"]
    assert machine["device"]["renderer"] == context.device.renderer and machine["size"] == [64, 40]
    assert any("mitsuba is not installed" in note for note in machine["notes"]) and machine["failures"] == []
    hall = [row for row in result["rows"] if row["scene"] == "hall"]
    assert {row["rays"] for row in hall} == set(CLASSES)
    own = [row for row in hall if "woop" in row["variant"]]
    assert len(own) == 4 * len(variants(scenes.make("hall", 10_000), context.device.software))
    assert all(row["mrays_s"] > 0 for row in result["rows"])
    if not peers.Embree.missing:
        embree = [row for row in hall if row["variant"] == "embree"]
        assert [row["ratio_embree_per_core"] for row in embree] == [1.0] * 4
        assert all(row["ratio_embree_per_core"] > 0 for row in own)
        fast = [row for row in machine["measurements"] if row["variant"] == "embree_fast"]
        assert fast and all(row["ratio_embree_fast_per_core"] == 1.0 for row in fast)
    assert len(machine["measurements"]) == len(result["rows"])
    (frame,) = result["frames"]
    assert frame["scene"] == "grey" and {"gbuffer", "composite", "display"} <= {p["name"] for p in frame["passes"]}
    build = result["builds"][0]
    assert build["triangles"] == 9836 and 0.9 < build["ratio_sah_binned"] < 1.05


def test_spheres_and_instances_go_without_peers(context: "Context") -> None:
    """Analytic spheres have no triangles for a peer, and under a non-uniform scale only two levels."""
    squash = np.diag([1.0, 0.5, 1.0, 1.0])
    scene = Scene(
        "eggs",
        meshes=(Mesh("egg", (Sphere(1.0),)),),
        instances=(Instance(0, squash, "egg"),),
        materials=(Material(roughness=0.0),),
        cameras=(Camera.look_at((0, 0, 4), (0, 0, 0)),),
    )
    report = bench.run(
        ["eggs.toml"], quick=True, with_peers=True, size=(32, 32), load=lambda name: scene, context=context
    )
    assert not report.failures and {row.variant[:8] for row in report.rows} == {"2 levels"}
    assert any("no peers" in note for note in report.notes) and not report.builds
    assert len(report.frames) == 1


def test_timer_queries_that_lie_are_not_believed(context: "Context", tracer: Tracer) -> None:
    """The GPU's way of timing on any driver: every launch queued, and wall time where the timestamps are nonsense."""
    run, read = tracer.launch("camera", tracer.own)
    sample = clock.on_gpu(context, {"it": run}, repeats=5, warm_up_s=0.01)["it"]
    assert len(sample.wall) == 1 and sample.wall[0] > 0 and len(sample.gpu) in (0, 5)
    if sample.gpu:
        assert sample.median("gpu") > 0.5 * sample.wall[0]
    assert np.isfinite(read()).any()
    assert not context.raw.errors()


def test_usage_errors_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "hall:3k", "--size", "64x40"]) == 2
    assert 'unknown size "3k"' in capsys.readouterr().err
    assert cli.main(["bench", "--size", "4"]) == 2
    assert "WIDTHxHEIGHT" in capsys.readouterr().err
    assert cli.main(["bench", "hall:10k", "--size", "8000x8000"]) == 2
    assert "rays of a class" in capsys.readouterr().err


def test_shaders_are_where_the_package_looks() -> None:
    """glsl/bench travels with the wheel as glsl/ does."""
    assert {p.name for p in (data_folder("glsl") / "bench").glob("*")} >= {"any.comp", "closest.comp", "rays.comp"}
