"""The resting pose: morph targets at default weights, skins on their joints."""

from pathlib import Path

import numpy as np
import pytest
from gltf_builder import QUAD, QUAD_INDEX, Builder, load, piece

from glhybrid.deform import at_rest as rest_pose
from glhybrid.load import read_model
from glhybrid.pose import trs_matrices, world_matrices
from glhybrid.scene import Node

MODELS = Path(__file__).resolve().parents[3] / "shared" / "models"


def test_nothing_to_pose_is_the_same_scene(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    scene = load(b, tmp_path)
    assert rest_pose(scene) is scene


def test_morph_weights_of_mesh_and_node(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad(targets=[{"POSITION": b.accessor(QUAD)}, {"NORMAL": b.accessor(np.float32([[0, 1, 0]] * 4))}])
    b.scene(quad)
    b.json["meshes"][0]["weights"] = [2, 0]
    for weights in ([0, 1], [2, 0], [0, 0]):
        b.json["scenes"][0]["nodes"].append(b.add("nodes", mesh=0, weights=weights))
    scene = rest_pose(load(b, tmp_path))
    assert [i.mesh for i in scene.instances] == [1, 2, 1, 0]  # equal poses share a mesh; without weights, the old one
    np.testing.assert_array_equal(piece(scene, 1).position, QUAD * 3)
    np.testing.assert_allclose(piece(scene, 2).normal, [[0, 0.5**0.5, 0.5**0.5]] * 4, atol=1e-6)
    np.testing.assert_array_equal(piece(scene, 2).position, QUAD)
    np.testing.assert_array_equal(piece(scene, 0).position, QUAD)
    assert not piece(scene, 1).morph_targets


def test_flat_shading_stays_flat_when_morphed(tmp_path: Path) -> None:
    b = Builder()
    lift = np.float32([[0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 0]])
    b.scene({"attributes": {"POSITION": b.accessor(QUAD)}, "indices": b.accessor(QUAD_INDEX),
             "targets": [{"POSITION": b.accessor(lift)}]}, weights=[1])  # fmt: skip
    made = piece(rest_pose(load(b, tmp_path)))
    np.testing.assert_allclose(made.normal, [[-(0.5**0.5), 0, 0.5**0.5]] * 6, atol=1e-6)


def test_skin_places_vertices_by_their_joints(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad()
    # Lower corners on joint 0, upper ones half on each; a joint without weight names one that is not there.
    quad["attributes"]["JOINTS_0"] = b.accessor(np.uint8([[0, 9, 9, 9], [0, 9, 9, 9], [0, 1, 9, 9], [0, 1, 9, 9]]))
    quad["attributes"]["WEIGHTS_0"] = b.accessor(np.float32([[1, 0, 0, 0]] * 2 + [[0.5, 0.5, 0, 0]] * 2))
    b.scene(quad, skin=0, translation=[100, 0, 0])
    quarter = [0, 0.5**0.5, 0, 0.5**0.5]  # +X to -Z, +Z to +X
    b.json["scenes"][0]["nodes"].append(b.add("nodes", rotation=quarter, children=[2]))
    b.add("nodes", translation=[0, 4, 0])
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[1, :3, 3] = [0, -1, 0]  # joint 1 was bound at y = 1
    b.add("skins", joints=[1, 2], inverseBindMatrices=b.accessor(bind.transpose(0, 2, 1).reshape(2, 16)))
    scene = rest_pose(load(b, tmp_path))
    made = piece(scene)
    np.testing.assert_allclose(made.position, [[0, 0, 0], [0, 0, -1], [0, 2.5, -1], [0, 2.5, 0]], atol=1e-6)
    np.testing.assert_allclose(made.normal, [[1, 0, 0]] * 4, atol=1e-6)
    assert made.joints is None and scene.instances[0].skin == -1
    np.testing.assert_array_equal(scene.instances[0].world_from_object, np.eye(4))


def test_world_matrices_whatever_the_order_of_nodes() -> None:
    nodes = (
        Node("leaf", 2, translation=(1, 0, 0)),
        Node("root", -1, scale=(2, 2, 2)),
        Node("arm", 1, translation=(0, 1, 0)),
    )
    np.testing.assert_array_equal(world_matrices(nodes)[0][:3, 3], [2, 2, 0])
    assert world_matrices(()).shape == (0, 4, 4)


def test_trs_against_the_textbook() -> None:
    rng = np.random.default_rng(0)
    axis, angle = rng.normal(size=(20, 3)), rng.uniform(-3, 3, 20)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    quaternion = np.concatenate([axis * np.sin(angle / 2)[:, None], np.cos(angle / 2)[:, None]], axis=1)
    scale, move, p = rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    s = p * scale  # Rodrigues
    turned = s * np.cos(angle)[:, None] + np.cross(axis, s) * np.sin(angle)[:, None]
    turned += axis * (axis * s).sum(1, keepdims=True) * (1 - np.cos(angle))[:, None]
    matrix = trs_matrices(move, quaternion, scale)
    got = np.einsum("nij,nj->ni", matrix, np.concatenate([p, np.ones((20, 1))], axis=1))[:, :3]
    np.testing.assert_allclose(got, turned + move, atol=1e-12)


@pytest.mark.skipif(not MODELS.is_dir(), reason=f"the test models are not at {MODELS}")
def test_models_stand_up() -> None:
    """Mesh vertices of these lie on their backs or in other units; on their joints they stand, in metres."""
    for name, low, high in (("CesiumMan", 1.4, 1.6), ("RiggedFigure", 1.2, 1.9), ("Fox", 70, 90)):
        box = rest_pose(read_model(MODELS / name / f"{name}.glb")).bounds()
        height = box[1, 1] - box[0, 1]
        assert low < height < high and abs(box[0, 1]) < 0.1 * height  # feet on the ground
    simple = rest_pose(read_model(MODELS / "SimpleMorph/SimpleMorph.gltf"))
    np.testing.assert_allclose(simple.bounds()[1], [1, 1.5, 0], atol=1e-6)  # two targets, half of each
