"""Where a clip puts things, against numbers worked out by hand and against the models."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glhybrid import pose as posing
from glhybrid.deform import at_rest, at_time, deformers, posed, skinned
from glhybrid.errors import GeometryError, SettingError
from glhybrid.keys import sample, slerp
from glhybrid.load import read_model
from glhybrid.pose import Pose, evaluate, find_clip, joint_matrices, moving_nodes, notes, place
from glhybrid.scene import (
    F64,
    Animation,
    Camera,
    Channel,
    Instance,
    Light,
    Mesh,
    MorphTarget,
    Node,
    Scene,
    Skin,
    Triangles,
)

QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
QUAD_INDEX = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
ANIMATED = ("CesiumMan", "Fox", "RiggedFigure", "SimpleSkin", "SimpleMorph", "AnimatedMorphCube", "InterpolationTest",
            "BoxAnimated")  # fmt: skip


def channel(path: Any, values: Any, times: Any = (0, 1), kind: Any = "LINEAR", node: int = 0) -> Channel:
    return Channel(node, path, kind, np.array(times, np.float32), np.array(values, np.float32))


def f32(values: Any) -> Any:
    return np.array(values, np.float32)


def u16(values: Any) -> Any:
    return np.array(values, np.uint16)


def about(axis: Any, degrees: float) -> F64:
    half = np.radians(degrees) / 2
    return np.array([*(np.sin(half) * np.asarray(axis, float)), np.cos(half)])


def quad(**more: Any) -> Triangles:
    return Triangles(QUAD, QUAD_INDEX, np.tile(f32([0, 0, 1]), (4, 1)), **more)


def scene_of(piece: Triangles, nodes: tuple[Node, ...], *channels: Channel, **more: Any) -> Scene:
    return Scene("test", meshes=(Mesh("quad", (piece,), (0.0,) * len(piece.morph_targets)),), nodes=nodes,
                 animations=(Animation("walk", channels),), **more)  # fmt: skip


def corners(scene: Scene, instance: int = 0) -> F64:
    """World positions of an instance's first piece."""
    placed = scene.instances[instance]
    piece = scene.meshes[placed.mesh].primitives[0]
    assert isinstance(piece, Triangles)
    return piece.position @ placed.world_from_object[:3, :3].T + placed.world_from_object[:3, 3]


def model(models: Path, name: str) -> Scene:
    return read_model(next(p for p in (models / name / f"{name}.glb", models / name / f"{name}.gltf") if p.exists()))


def test_step_holds_and_linear_goes_straight() -> None:
    keys = [[0, 0, 0], [2, 0, 4]]
    step, line = channel("translation", keys, (1, 3), "STEP"), channel("translation", keys, (1, 3))
    for time, stepped, straight in ((0, 0, 0), (1, 0, 0), (2, 0, 1), (2.5, 0, 1.5), (3, 2, 2), (9, 2, 2)):
        assert sample(step, time).tolist() == [stepped, 0, 2 * stepped]
        assert sample(line, time).tolist() == [straight, 0, 2 * straight]


def test_two_keys_at_one_time_jump() -> None:
    c = channel("scale", [[1] * 3, [2] * 3, [5] * 3, [6] * 3], (0, 1, 1, 2))
    assert sample(c, 1)[0] == 5 and sample(c, np.nextafter(1.0, 0))[0] == pytest.approx(2) and sample(c, 1.5)[0] == 5.5


def test_cubic_spline_by_hand() -> None:
    """From 1 to 3 in 2 s, leaving with slope 4, arriving with slope -1: glTF 2.0, appendix C.5."""
    keys = [[[9.0], [1.0], [4.0]], [[-1.0], [3.0], [9.0]]]
    c = channel("weights", keys, (0, 2), "CUBICSPLINE")
    assert sample(c, -1) == 1 and sample(c, 0) == 1 and sample(c, 2) == 3 and sample(c, 5) == 3
    # Hermite at u = 1/2: 1/2, 1/8, 1/2, -1/8.
    assert sample(c, 1)[0] == pytest.approx(0.5 * 1 + 0.125 * 2 * 4 + 0.5 * 3 - 0.125 * 2 * -1, abs=1e-12)
    h = 1e-5
    assert (sample(c, h) - sample(c, 0))[0] / h == pytest.approx(4, abs=1e-3)
    assert (sample(c, 2) - sample(c, 2 - h))[0] / h == pytest.approx(-1, abs=1e-3)


def test_rotations_take_the_shorter_way_at_an_even_speed() -> None:
    a, b = about([0, 1, 0], 20), about([0, 1, 0], 80)
    for sign in (1, -1):
        c = channel("rotation", [a, sign * b])
        for u in (0, 0.1, 0.5, 0.9, 1):
            got = sample(c, u)
            assert abs(got @ about([0, 1, 0], 20 + 60 * u)) == pytest.approx(1, abs=1e-7)  # keys are float32
            assert np.linalg.norm(got) == pytest.approx(1, abs=1e-15)
    cubic = channel("rotation", [[0 * a, a, b - a], [b - a, b, 0 * b]], kind="CUBICSPLINE")
    assert np.linalg.norm(sample(cubic, 0.3)) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(slerp(a, a, 0.3), a, atol=1e-16)
    close = about([0, 1, 0], 20 + 1e-5)  # acos of the product would see no angle here
    np.testing.assert_allclose(slerp(a, close, 0.5), about([0, 1, 0], 20 + 5e-6), atol=1e-15)


def test_children_lights_and_cameras_go_with_their_nodes() -> None:
    nodes = (
        Node("arm", -1, translation=(0, 0, 5)),
        Node("hand", 0, translation=(1, 0, 0), scale=(2, 2, 2)),
        Node("still", -1),
    )
    spin = channel("rotation", [about([0, 1, 0], 0), about([0, 1, 0], 90)])
    rest = posing.world_matrices(nodes)
    lift = posing.translation_matrix(np.array([0, 1, 0]))
    scene = scene_of(
        quad(), nodes, spin,
        instances=(Instance(0, rest[1], node=1), Instance(0, rest[1] @ lift, node=1),
                   Instance(0, rest[2], node=2)),
        lights=(Light("spot", position=(1, 0, 5), direction=(0, 0, -1), node=1), Light("point", position=(7, 7, 7))),
        cameras=(Camera("eye", rest[1], node=1), Camera("free", np.eye(4))),
    )  # fmt: skip
    moved = place(scene, evaluate(scene, 1, scene.animations[0]))
    # A quarter turn about +Y takes +X to -Z: the hand goes from (1, 0, 5) to (0, 0, 4).
    np.testing.assert_allclose(moved.instances[0].world_from_object[:3, 3], [0, 0, 4], atol=1e-6)
    np.testing.assert_allclose(
        moved.instances[1].world_from_object[:3, 3], [0, 2, 4], atol=1e-6
    )  # instanced: scaled by 2
    assert moved.instances[2] is scene.instances[2]
    np.testing.assert_allclose(moved.lights[0].position, [0, 0, 4], atol=1e-6)
    np.testing.assert_allclose(moved.lights[0].direction, [-1, 0, 0], atol=1e-6)
    assert moved.lights[1] is scene.lights[1] and moved.cameras[1] is scene.cameras[1]
    view = moved.cameras[0].world_from_view
    np.testing.assert_allclose(-view[:3, 2], [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(
        view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-12
    )  # the node's scale is not a camera's
    assert moving_nodes(scene, scene.animations[0]) == {0, 1} and not deformers(scene, scene.animations[0])


def test_an_object_scaled_to_nothing_can_still_be_inverted() -> None:
    shrink = channel("scale", [[1, 1, 1], [0, 0, 0]])
    flat = channel("scale", [[1, 1, 1], [3, 0, 1]])
    for c, size in ((shrink, 0), (flat, 3)):
        scene = scene_of(quad(), (Node("n", -1),), c, instances=(Instance(0, np.eye(4), node=0),))
        matrix = posed(scene, evaluate(scene, 1, scene.animations[0])).instances[0].world_from_object
        assert np.isfinite(np.linalg.inv(matrix)).all() and abs(matrix[0, 0] - size) < 1e-6


@pytest.mark.parametrize("count", [4, 8])
def test_skins_of_four_and_eight_joints(count: int) -> None:
    """Every vertex follows all joints; joint j moves by (j, 0, 0) and is bound at height j."""
    rng = np.random.default_rng(count)
    weights = rng.uniform(0.1, 1, (4, count))
    weights /= weights.sum(1, keepdims=True)
    piece = quad(joints=np.tile(np.arange(count, dtype=np.uint16), (4, 1)), weights=np.float32(weights),
                 tangent=np.tile(f32([1, 0, 0, -1]), (4, 1)))  # fmt: skip
    nodes = (Node("root", -1, translation=(0, 10, 0)), *(Node(f"{j}", 0, translation=(j, j, 0)) for j in range(count)))
    bind = np.stack([posing.translation_matrix(np.array([0, -j, 0])) for j in range(count)])
    skin = Skin(tuple(range(1, count + 1)), bind)
    lift = channel("translation", [[0, 10, 0], [0, 30, 0]])
    scene = scene_of(piece, nodes, lift, skins=(skin,), instances=(Instance(0, np.eye(4), skin=0),))
    for time in (0, 0.5, 1):
        made = at_time(scene, time)
        want = QUAD + (weights @ np.arange(count))[:, None] * [1, 0, 0] + np.array([0, 10 + 20 * time, 0])
        np.testing.assert_allclose(corners(made), want, atol=1e-6)
    still = made.meshes[0].primitives[0]
    assert isinstance(still, Triangles) and still.tangent is not None
    assert still.joints is None and still.tangent[:, 3].tolist() == [-1] * 4
    assert deformers(scene, scene.animations[0])[0].instances == (0,)


def test_weights_are_made_to_add_up_and_a_vertex_without_any_stays() -> None:
    piece = quad(
        joints=np.zeros((4, 4), np.uint16),
        weights=f32([[2, 0, 0, 0], [0.25, 0.25, 0, 0], [0] * 4, [1, 0, 0, 0]]),
    )
    nodes = (Node("joint", -1, translation=(0, 0, 3)),)
    scene = scene_of(piece, nodes, skins=(Skin((0,), np.eye(4)[None]),), instances=(Instance(0, np.eye(4), skin=0),))
    want = QUAD + np.array([[0, 0, 3], [0, 0, 3], [0, 0, 0], [0, 0, 3]])
    np.testing.assert_allclose(corners(at_rest(scene)), want, atol=1e-6)


def test_normals_of_a_bent_and_squashed_joint() -> None:
    """Normals go by the inverse transpose: of a plane at 45 degrees squashed to half in X, (2, 0, 1) / sqrt 5."""
    piece = Triangles(QUAD, QUAD_INDEX, np.tile(f32([0.5**0.5, 0, 0.5**0.5]), (4, 1)),
                      joints=np.zeros((4, 4), np.uint16), weights=np.tile(f32([1, 0, 0, 0]), (4, 1)))  # fmt: skip
    matrix = np.diag([0.5, 1, 1, 1])[None]
    made = skinned(piece, np.concatenate([matrix, np.eye(4)[None]]))
    np.testing.assert_allclose(made.normal, [np.array([2, 0, 1]) / 5**0.5] * 4, atol=1e-6)


def test_a_figure_far_from_zero_keeps_its_fingers() -> None:
    """1e6 m away float32 knows 6 cm; vertices relative to the first joint know 1e-7 of the figure."""
    far = np.array([1e6, 0, 1e6])
    piece = quad(joints=np.tile(u16([0, 1, 0, 0]), (4, 1)), weights=np.tile(f32([0.5, 0.5, 0, 0]), (4, 1)))
    nodes = (Node("a", -1, translation=tuple(far)), Node("b", 0, translation=(0.01, 0, 0)))
    scene = scene_of(piece, nodes, skins=(Skin((0, 1), np.tile(np.eye(4), (2, 1, 1))),),
                     instances=(Instance(0, np.eye(4), skin=0),))  # fmt: skip
    np.testing.assert_allclose(corners(at_rest(scene)) - far, QUAD + np.array([0.005, 0, 0]), atol=1e-8)


def test_morphs_sum_and_weights_come_from_clip_node_mesh_in_that_order() -> None:
    targets = (MorphTarget(position=QUAD), MorphTarget(normal=np.tile(f32([0, 1, 0]), (4, 1))))
    keys = channel("weights", [[0, 0], [2, 1]])
    scene = Scene("test", meshes=(Mesh("m", (quad(morph_targets=targets),), (1.0, 0.0)),),
                  nodes=(Node("n", -1, morph_weights=(3.0, 0.0)), Node("plain", -1)),
                  animations=(Animation("a", (keys,)),),
                  instances=(Instance(0, np.eye(4), node=0), Instance(0, np.eye(4), node=1)))  # fmt: skip
    np.testing.assert_allclose(corners(at_rest(scene)), QUAD * 4)
    np.testing.assert_allclose(corners(at_rest(scene), 1), QUAD * 2)
    half = at_time(scene, 0.5)
    np.testing.assert_allclose(corners(half), QUAD * 2)
    np.testing.assert_allclose(corners(half, 1), QUAD * 2)
    piece = half.meshes[half.instances[0].mesh].primitives[0]
    assert isinstance(piece, Triangles)
    np.testing.assert_allclose(piece.normal, [np.array([0, 0.5, 1]) / 1.25**0.5] * 4, atol=1e-6)
    assert [d.node for d in deformers(scene, scene.animations[0])] == [0]


def test_what_is_asked_for_and_is_not_there() -> None:
    nodes = (Node("n", -1),)
    scene = scene_of(
        quad(), nodes, channel("translation", [[0] * 3, [1] * 3]), instances=(Instance(0, np.eye(4), node=0),)
    )
    with pytest.raises(SettingError, match='unknown clip "wlak"; did you mean "walk"'):
        find_clip(scene, "wlak")
    assert find_clip(scene) is find_clip(scene, "walk") is find_clip(scene, "0")
    assert find_clip(Scene("empty")) is None
    lost = scene_of(quad(), nodes, channel("translation", [[0] * 3] * 2, node=4))
    with pytest.raises(GeometryError, match="moves node 4, the scene has 1"):
        evaluate(lost, 0, lost.animations[0])
    broken = scene_of(quad(), nodes, skins=(Skin((3,), np.eye(4)[None]),), instances=(Instance(0, np.eye(4), skin=0),))
    with pytest.raises(GeometryError, match="joint node 3, the scene has 1"):
        at_rest(broken)
    assert "outside" in notes(scene, 3, None)[0] and not notes(scene, 1, None) and not notes(scene, None, None)
    assert "no animation" in notes(Scene("empty"), 1, None)[0]


def test_a_clip_of_no_length_holds_its_pose_and_one_without_channels_rests() -> None:
    nodes = (Node("n", -1, translation=(5, 0, 0)),)
    instance = Instance(0, posing.world_matrices(nodes)[0], node=0)
    for channels, x in (((channel("translation", [[7, 0, 0]], [2.0]),), 7), ((), 5)):
        scene = scene_of(quad(), nodes, *channels, instances=(instance,))
        for time in (-1.0, 0.0, 2.0, 3.0):
            assert at_time(scene, time).instances[0].world_from_object[0, 3] == x


def test_posing_leaves_what_does_not_move() -> None:
    scene = scene_of(
        quad(), (Node("n", -1),), channel("translation", [[0] * 3, [1] * 3]), instances=(Instance(0, np.eye(4)),)
    )
    assert at_rest(scene) is scene
    assert at_time(scene, 0.5).meshes is scene.meshes


@pytest.mark.parametrize("name", ANIMATED)
def test_models_play(models: Path, name: str) -> None:
    """Finite at any time, a whole figure, keys met exactly, and something moves in every clip."""
    scene = model(models, name)
    size = np.linalg.norm(np.diff(at_rest(scene).bounds(), axis=0))
    for clip in scene.animations:
        start, end = posing.clip_span(clip)
        boxes, shapes = [], set()
        for time in (start - 1, start, (2 * start + end) / 3, (start + end) / 2, end, end + 1):
            pose = evaluate(scene, time, clip)
            made = posed(scene, pose)
            boxes.append(made.bounds())
            shapes.add(b"".join(corners(made, i).tobytes() for i in range(len(made.instances))))
            assert np.isfinite(boxes[-1]).all() and np.linalg.norm(np.diff(boxes[-1], axis=0)) < 4 * size
        np.testing.assert_array_equal(boxes[0], boxes[1])
        np.testing.assert_array_equal(boxes[-1], boxes[-2])
        assert len(shapes) > 1
        for c in clip.channels:
            for k in (0, len(c.times) // 2, len(c.times) - 1):
                key = c.values[k, 1] if c.interpolation == "CUBICSPLINE" else c.values[k]
                np.testing.assert_allclose(sample(c, float(c.times[k])), key, atol=2e-6)


def test_known_poses_of_models(models: Path) -> None:
    """Numbers of the files' own descriptions."""
    skin = model(models, "SimpleSkin")  # the upper half bends: by 90 degrees at 1 s, about joint 1
    assert isinstance(skin.meshes[0].primitives[0], Triangles)
    upright = corners(at_time(skin, 0.0))
    np.testing.assert_allclose(upright, skin.meshes[0].primitives[0].position, atol=1e-6)
    bent = corners(at_time(skin, 1.0))
    np.testing.assert_allclose(bent[:2], upright[:2], atol=1e-6)
    top = (upright[-2:] - np.array([0.0, 1.0, 0.0])) @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(bent[-2:], top + np.array([0.0, 1.0, 0.0]), atol=1e-5)
    box = model(models, "BoxAnimated")
    worlds = [evaluate(box, t, box.animations[0]).world for t in (0.0, 1.25, 2.5)]
    assert np.abs(worlds[1] - worlds[0]).max() > 0.1


def test_walking_figures_stand_on_the_ground_at_any_time(models: Path) -> None:
    for name, low, high in (("CesiumMan", 1.3, 1.7), ("Fox", 60, 100)):
        scene = model(models, name)
        for clip in scene.animations:
            end = posing.clip_span(clip)[1]
            for time in np.linspace(0, end, 4):
                box = posed(scene, evaluate(scene, float(time), clip)).bounds()
                assert low < box[1, 1] - box[0, 1] < high and abs(box[0, 1]) < 0.15 * high


def test_skinning_is_exact_against_a_loop(models: Path) -> None:
    """Fox mid-clip, vertex by vertex in float64."""
    scene = model(models, "Fox")
    clip = find_clip(scene, "Run")
    pose = evaluate(scene, 0.3, clip)
    piece = scene.meshes[0].primitives[0]
    assert isinstance(piece, Triangles) and piece.joints is not None and piece.weights is not None
    world = pose.world[list(scene.skins[0].joints)] @ scene.skins[0].inverse_bind
    got = corners(posed(scene, Pose(pose.world, {})))
    for v in range(0, len(piece.position), 97):
        p = np.array([*piece.position[v].astype(float), 1])
        want = sum(w * (world[j] @ p) for j, w in zip(piece.joints[v], piece.weights[v].astype(float), strict=True))
        np.testing.assert_allclose(got[v], np.asarray(want)[:3] / piece.weights[v].sum(), atol=2e-5)
    assert len(joint_matrices(scene, pose, 0)) == len(scene.skins[0].joints) + 1
