"""The glTF reader: nodes, instances, lights, cameras, and what moves, on the smallest asset that holds each."""

from pathlib import Path

import numpy as np
from gltf_builder import PNG, QUAD, QUAD_INDEX, Builder, load, piece


def test_hierarchy_of_trs_and_matrix(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    quarter = [0, 0, 0.5**0.5, 0.5**0.5]  # 90 degrees about +Z
    matrix = np.array([[2, 0, 0, 1], [0, 2, 0, 2], [0, 0, -2, 3], [0, 0, 0, 1]], float)
    b.json["nodes"] = [
        {"mesh": 0, "scale": [1, 2, 3], "name": "leaf"},
        {"children": [0], "rotation": quarter, "translation": [10, 0, 0]},
        {"children": [1], "matrix": matrix.T.ravel().tolist()},
    ]
    b.json["scenes"] = [{"nodes": [2]}]
    scene = load(b, tmp_path)
    rotated = np.array([[0, -1, 0, 10], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    want = matrix @ rotated @ np.diag([1, 2, 3, 1.0])
    np.testing.assert_allclose(scene.instances[0].world_from_object, want, atol=1e-6)
    assert np.linalg.det(scene.instances[0].world_from_object[:3, :3]) < 0  # mirrored, as the file says
    assert [n.parent for n in scene.nodes] == [1, 2, -1] and scene.instances[0].node == 0
    assert scene.nodes[2].matrix is not None and scene.instances[0].name == "leaf"


def test_one_mesh_under_many_nodes_stays_one(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    for x in (1, 2):
        b.json["scenes"][0]["nodes"].append(b.add("nodes", mesh=0, translation=[x, 0, 0]))
    scene = load(b, tmp_path)
    assert len(scene.meshes) == 1 and [i.mesh for i in scene.instances] == [0, 0, 0]
    assert [i.world_from_object[0, 3] for i in scene.instances] == [0, 1, 2] and scene.triangle_count() == 6


def test_meshes_that_differ_in_material_are_one_shape(tmp_path: Path) -> None:
    b = Builder()
    red, green, bumpy = (b.add("materials", name=n) for n in ("red", "green", "bumpy"))
    quad = b.quad()
    for material in (red, green, None, red, bumpy):
        b.scene({**quad, **({} if material is None else {"material": material})})
    b.json["materials"][bumpy]["normalTexture"] = {"index": b.add("textures", source=0)}
    b.add("images", bufferView=b.view(PNG), mimeType="image/png")
    scene = load(b, tmp_path)
    assert [i.mesh for i in scene.instances] == [0, 0, 0, 0, 1]  # a normal map brings tangents: another shape
    names = [scene.materials[(i.materials or (scene.meshes[i.mesh].primitives[0].material,))[0]].name
             for i in scene.instances]  # fmt: skip
    assert names == ["red", "green", "", "red", "bumpy"]
    assert piece(scene, 0).tangent is None and piece(scene, 1).tangent is not None


def test_gpu_instancing_with_normalised_rotations(tmp_path: Path) -> None:
    b = Builder()
    rotation = np.int16([[0, 0, 0, 32767], [0, 0, 23170, 23170]])
    attributes = {"TRANSLATION": b.accessor(np.float32([[1, 0, 0], [0, 2, 0]])),
                  "ROTATION": b.accessor(rotation, normalized=True),
                  "SCALE": b.accessor(np.float32([[1, 1, 1], [3, 1, 1]]))}  # fmt: skip
    b.scene(b.quad(), translation=[0, 0, 5], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    scene = load(b, tmp_path)
    assert len(scene.meshes) == 1 and len(scene.instances) == 2
    np.testing.assert_allclose(scene.instances[0].world_from_object[:3, 3], [1, 0, 5])
    want = np.array([[0, -1, 0, 0], [3, 0, 0, 2], [0, 0, 1, 5], [0, 0, 0, 1]])
    np.testing.assert_allclose(scene.instances[1].world_from_object, want, atol=1e-4)


def test_default_scene_only(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    b.json["scenes"] = [{"nodes": []}, {"nodes": [0], "name": "this"}, {"nodes": [0], "name": "other"}]
    b.json["scene"] = 1
    scene = load(b, tmp_path)
    assert scene.triangle_count() == 2
    assert scene.warnings == ('scene 0; scene "other": not loaded: it is not the default scene',)


def test_hidden_nodes_hide_what_is_below(tmp_path: Path) -> None:
    builder = Builder()
    mesh = builder.add("meshes", primitives=[builder.quad()])
    hidden, shown = ({"KHR_node_visibility": {"visible": on}} for on in (False, True))
    below = builder.add("nodes", mesh=mesh, name="below", extensions=shown)
    nodes = [
        builder.add("nodes", mesh=mesh, name="hidden", children=[below], extensions=hidden),
        builder.add("nodes", mesh=mesh, name="shown", extensions=shown), builder.add("nodes", mesh=mesh, name="plain"),
    ]  # fmt: skip
    builder.json |= {"scenes": [{"nodes": nodes}], "scene": 0, "extensionsUsed": ["KHR_node_visibility"]}
    scene = load(builder, tmp_path)
    assert [i.name for i in scene.instances] == ["shown", "plain"] and not scene.warnings


def test_lights(tmp_path: Path) -> None:
    b = Builder()
    spot = {"type": "spot", "color": [1, 0.5, 0.25], "intensity": 30, "range": 8,
            "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}}  # fmt: skip
    b.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 7}, spot]}}
    quarter = [0.5**0.5, 0, 0, 0.5**0.5]  # -Z turned about +X points to +Y
    b.scene(b.quad())
    for light in (0, 1):
        node = b.add("nodes", rotation=quarter, translation=[1, 2, 3], scale=[2, 2, 2], name=f"n{light}",
                     extensions={"KHR_lights_punctual": {"light": light}})  # fmt: skip
        b.json["scenes"][0]["nodes"].append(node)
    sun, lamp = load(b, tmp_path).lights
    assert (sun.kind, sun.intensity, sun.color, sun.range) == ("directional", 7.0, (1.0, 1.0, 1.0), 0.0)
    np.testing.assert_allclose(sun.direction, [0, 1, 0], atol=1e-7)
    assert (lamp.kind, lamp.color, lamp.intensity, lamp.range) == ("spot", (1.0, 0.5, 0.25), 30.0, 8.0)
    assert (lamp.inner_cone, lamp.outer_cone, lamp.position, lamp.name, lamp.node) == (0.25, 0.5, (1, 2, 3), "n1", 2)
    assert lamp.angular_diameter == lamp.radius == 0.0


def test_cameras_are_rigid(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad())
    b.add("cameras", type="perspective", name="eye", perspective={"yfov": 0.7, "znear": 0.1})
    b.add("cameras", type="orthographic", orthographic={"xmag": 3, "ymag": 2, "znear": 0, "zfar": 9})
    quarter = [0, 0.5**0.5, 0, 0.5**0.5]  # looks along -X
    for camera, scale in ((0, [3, 3, 3]), (1, [-1, 2, 5])):
        node = b.add("nodes", camera=camera, rotation=quarter, scale=scale, translation=[4, 5, 6], name="where")
        b.json["scenes"][0]["nodes"].append(node)
    eye, plan = load(b, tmp_path).cameras
    assert (eye.name, eye.fov_y, eye.near, eye.far, eye.node) == ("eye", 0.7, 0.1, 0.0, 1)
    assert (plan.name, plan.fov_y, plan.xmag, plan.ymag, plan.near, plan.far) == ("where", 0.0, 3.0, 2.0, 0.0, 9.0)
    for camera in (eye, plan):
        pose = camera.world_from_view
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) > 0
        np.testing.assert_allclose(pose @ [0, 0, -1, 0], [-1, 0, 0, 0], atol=1e-7)
        np.testing.assert_allclose(pose[:3, 3], [4, 5, 6])


# --- what moves


def test_skin_morph_and_animation(tmp_path: Path) -> None:
    b = Builder()
    quad = b.quad()
    quad["attributes"]["JOINTS_0"] = b.accessor(np.uint8([[0, 1, 0, 9]] * 4))
    quad["attributes"]["WEIGHTS_0"] = b.accessor(np.uint8([[255, 127, 128, 0]] * 4), normalized=True)
    quad["targets"] = [{"POSITION": b.accessor(QUAD * 2)}, {"NORMAL": b.accessor(QUAD)}]
    bind = np.tile(np.arange(16, dtype=np.float32), (2, 1))
    b.scene(quad, skin=0, weights=[0.5, 0.25], translation=[100, 0, 0])
    b.json["meshes"][0]["weights"] = [1, 0]
    b.json["scenes"][0]["nodes"] += [b.add("nodes", name="bone"), b.add("nodes")]
    b.add("skins", joints=[1, 2], inverseBindMatrices=b.accessor(bind))
    times = b.accessor(np.float32([0, 1]))
    turns = b.accessor(np.int8([[0, 0, 0, 127], [0, 127, 0, 0]]), normalized=True)
    spline = b.accessor(np.arange(18, dtype=np.float32).reshape(6, 3))
    weights = b.accessor(np.float32([1, 2, 3, 4]))
    b.add("animations", name="walk", samplers=[
        {"input": times, "output": turns, "interpolation": "STEP"},
        {"input": times, "output": spline, "interpolation": "CUBICSPLINE"},
        {"input": times, "output": weights},
    ], channels=[
        {"sampler": 0, "target": {"node": 1, "path": "rotation"}},
        {"sampler": 1, "target": {"node": 2, "path": "translation"}},
        {"sampler": 2, "target": {"node": 0, "path": "weights"}},
    ])  # fmt: skip
    scene = load(b, tmp_path)
    made, instance = piece(scene), scene.instances[0]
    np.testing.assert_array_equal(instance.world_from_object, np.eye(4))  # the node has no say over a skinned mesh
    assert instance.skin == 0 and scene.skins[0].joints == (1, 2)
    np.testing.assert_array_equal(
        scene.skins[0].inverse_bind[0], [*np.arange(16).reshape(4, 4).T[:3].tolist(), [0, 0, 0, 1]]
    )
    assert made.joints is not None and made.joints.dtype == np.uint16 and made.weights is not None
    np.testing.assert_allclose(made.weights.sum(1), 1, atol=1e-6)
    assert scene.meshes[0].morph_weights == (1.0, 0.0) and scene.nodes[0].morph_weights == (0.5, 0.25)
    np.testing.assert_array_equal(made.morph_targets[0].position, QUAD * 2)
    assert made.morph_targets[1].position is None and made.morph_targets[0].normal is None
    step, cubic, linear = scene.animations[0].channels
    assert (step.interpolation, cubic.interpolation, linear.interpolation) == ("STEP", "CUBICSPLINE", "LINEAR")
    np.testing.assert_array_equal(step.values, [[0, 0, 0, 1], [0, 1, 0, 0]])
    assert cubic.values.shape == (2, 3, 3) and linear.values.shape == (2, 2)
    np.testing.assert_array_equal(cubic.values[1, 1], [12, 13, 14])


def test_flat_shading_keeps_skin_and_morph_with_their_vertices(tmp_path: Path) -> None:
    b = Builder()
    attributes = {"POSITION": b.accessor(QUAD), "JOINTS_0": b.accessor(np.uint8([[k, 0, 0, 0] for k in range(4)])),
                  "WEIGHTS_0": b.accessor(np.float32([[1, 0, 0, 0]] * 4))}  # fmt: skip
    b.scene({"attributes": attributes, "indices": b.accessor(QUAD_INDEX), "targets": [{"POSITION": b.accessor(QUAD)}]})
    made = piece(load(b, tmp_path))
    assert made.joints is not None
    np.testing.assert_array_equal(made.position, QUAD[QUAD_INDEX])
    np.testing.assert_array_equal(made.joints[:, 0], QUAD_INDEX)
    np.testing.assert_array_equal(made.morph_targets[0].position, made.position)
