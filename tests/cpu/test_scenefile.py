"""Scene files: every key, what is shared, what moves."""

from pathlib import Path

import numpy as np
import pytest
from scenefile_kit import STUDY, model, scene

import glhybrid as gh
from glhybrid.errors import LoadError
from glhybrid.load import load, shapes
from glhybrid.scene import Sphere, Triangles

MODELS = Path(__file__).resolve().parents[3] / "shared" / "models"


def test_an_empty_file_is_an_empty_scene(tmp_path: Path) -> None:
    empty = scene(tmp_path, "")
    assert empty.instances == () and empty.lights == () and empty.cameras == () and empty.environment is None
    assert empty.name == "hall" and len(empty.sha256) == 64 and empty.materials


def test_cameras(tmp_path: Path) -> None:
    made = scene(
        tmp_path,
        """
        [camera.main]
        eye = [0, 1, 4]
        target = [0, 1, 0]
        [camera.side]
        eye = [3, 0, 0]
        target = [0, 0, 0]
        up = [0, 0, 1]
        fov_y_deg = 60
        near = 0.5
        """,
    )
    main, side = made.cameras
    assert (main.name, side.name) == ("main", "side")
    assert main.fov_y == pytest.approx(np.radians(45)) and side.fov_y == pytest.approx(np.radians(60))
    assert main.near == 0.01 and side.near == 0.5
    assert np.allclose(main.world_from_view, [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 4], [0, 0, 0, 1]])
    assert np.allclose(side.world_from_view[:3, 1], [0, 0, 1]) and np.allclose(side.world_from_view[:3, 2], [1, 0, 0])


def test_lights(tmp_path: Path) -> None:
    made = scene(
        tmp_path,
        """
        [[light]]
        kind = "directional"
        direction = [0, -2, 0]
        color = [1, 0.5, 0.25]
        intensity = 3
        angular_diameter_deg = 0.5
        [[light]]
        kind = "point"
        position = [1, 2, 3]
        radius = 0.2
        range = 9
        [[light]]
        kind = "spot"
        name = "lamp"
        position = [0, 3, 0]
        direction = [1, 0, 0]
        inner_cone_deg = 10
        outer_cone_deg = 20
        [[light]]
        kind = "directional"
        """,
    )
    sun, point, spot, plain = made.lights
    assert sun.direction == (0, -1, 0) and sun.color == (1, 0.5, 0.25) and sun.intensity == 3
    assert sun.angular_diameter == pytest.approx(np.radians(0.5))
    assert point.position == (1, 2, 3) and point.radius == 0.2 and point.range == 9 and point.intensity == 1
    assert spot.name == "lamp" and spot.direction == (1, 0, 0)
    assert (spot.inner_cone, spot.outer_cone) == (pytest.approx(np.radians(10)), pytest.approx(np.radians(20)))
    assert plain.direction == (0, -1, 0) and plain.angular_diameter == 0


def test_materials(tmp_path: Path) -> None:
    from PIL import Image

    Image.fromarray(np.full((4, 4, 3), 77, np.uint8)).save(tmp_path / "a.png")
    made = scene(
        tmp_path,
        """
        [[material]]
        name = "plain"
        [[material]]
        name = "full"
        base_color = [0.1, 0.2, 0.3, 0.4]
        metallic = 0.5
        roughness = 0.25
        emissive = [1, 0.5, 0]
        emissive_strength = 4
        alpha_mode = "MASK"
        alpha_cutoff = 0.3
        double_sided = true
        unlit = true
        ior = 1.7
        clearcoat = 0.6
        transmission = 0.1
        [material.textures]
        base_color = "a.png"
        [material.textures.normal]
        file = "a.png"
        repeat = [2, 3]
        offset = [0.5, 0]
        rotate_deg = 90
        uv_set = 1
        wrap = "clamp"
        nearest = true
        [material.textures.metallic_roughness]
        pattern = "checker"
        cells = [2, 2]
        texels = [4, 4]
        low = [0, 0.1, 0, 1]
        high = [0, 0.9, 1, 1]
        [[material]]
        name = "three"
        base_color = [0.1, 0.2, 0.3]
        """,
    )
    plain, full, three = made.materials
    default = gh.Material()
    for field in (
        "base_color",
        "metallic",
        "roughness",
        "emissive",
        "alpha_mode",
        "alpha_cutoff",
        "double_sided",
        "ior",
    ):
        assert getattr(plain, field) == getattr(default, field), field
    assert full.base_color == (0.1, 0.2, 0.3, 0.4) and full.metallic == 0.5 and full.roughness == 0.25
    assert full.emissive == (4, 2, 0) and full.alpha_mode == "MASK" and full.alpha_cutoff == 0.3
    assert full.double_sided and full.unlit and full.ior == 1.7 and full.clearcoat == 0.6 and full.transmission == 0.1
    assert three.base_color == (0.1, 0.2, 0.3, 1.0)
    base, normal = full.textures["base_color"], full.textures["normal"]
    assert base.image is normal.image and (base.image.texels[..., :3] == 77).all() and base.uv_transform is None
    assert (normal.uv_set, normal.wrap_u, normal.wrap_v, normal.nearest) == (1, "clamp", "clamp", True)
    # KHR_texture_transform's own order: translation x rotation x scale, with its sign of the rotation
    assert normal.uv_transform is not None
    assert np.allclose(normal.uv_transform @ [1, 0, 1], [0.5, -2]) and np.allclose(
        normal.uv_transform @ [0, 1, 1], [3.5, 0]
    )
    rough = full.textures["metallic_roughness"].image.texels
    assert (
        rough.shape == (4, 4, 4)
        and rough[0, 0].tolist() == [0, 26, 0, 255]
        and rough[0, 2].tolist() == [0, 230, 255, 255]
    )


def test_environment_kinds(tmp_path: Path) -> None:
    grey = scene(tmp_path, "[environment]\nconstant = [1, 2, 3]\nintensity = 2\nrotation_deg = 90").environment
    assert grey is not None and grey.constant and grey.radiance.ravel().tolist() == [1, 2, 3]
    assert grey.intensity == 2 and grey.rotation == pytest.approx(np.pi / 2)
    sky = scene(tmp_path, "[environment]\nsky = {}")
    assert sky.environment is not None and sky.environment.radiance.shape == (256, 512, 3) and sky.lights == ()
    studio = scene(tmp_path, "[environment]\nstudio = { boxes = [ { azimuth_deg = 90, radiance = [7, 7, 7] } ] }")
    assert studio.environment is not None and studio.environment.radiance.max() == pytest.approx(7, rel=1e-3)
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes([128, 0, 0, 129] * 2))
    file = scene(tmp_path, '[environment]\nfile = "a.hdr"').environment
    assert file is not None and file.radiance.tolist() == [[[1, 0, 0], [1, 0, 0]]] and file.name == "a.hdr"


def test_sun_of_the_sky_follows_its_rotation_and_intensity(tmp_path: Path) -> None:
    text = "[environment]\nintensity = 2\nrotation_deg = {}\nsky = {{ sun_elevation_deg = 0.001, sun = true }}"
    plain, turned = (scene(tmp_path, text.format(r)).lights[0] for r in (0, 90))
    assert np.allclose(plain.direction, (0, 0, 1), atol=1e-4)  # from -Z
    assert np.allclose(turned.direction, (1, 0, 0), atol=1e-4)  # the map turned right-handed about +Y: now from -X
    half = scene(tmp_path, text.format(0).replace("intensity = 2", "intensity = 1")).lights[0]
    assert plain.intensity == pytest.approx(2 * half.intensity)


def test_transform_is_t_r_s_with_rz_ry_rx(tmp_path: Path) -> None:
    made = scene(
        tmp_path,
        '[[object]]\nshape = "box"\ntranslate = [1, 2, 3]\nrotate_deg = [90, 90, 0]\nscale = [2, 3, -4]\n'
        '[[object]]\nshape = "box"\nscale = 0.5',
    )
    first, second = (i.world_from_object for i in made.instances)
    # x: scaled to 2, unmoved by Rx, Ry takes it to -z. y: 3 -> Rx -> +z -> Ry -> +x. z: -4 -> Rx -> +y -> stays.
    assert np.allclose(first @ [1, 0, 0, 1], [1, 2, 1, 1])
    assert np.allclose(first @ [0, 1, 0, 1], [4, 2, 3, 1])
    assert np.allclose(first @ [0, 0, 1, 1], [1, 6, 3, 1])
    assert np.allclose(second, np.diag([0.5, 0.5, 0.5, 1]))


def test_count_and_step(tmp_path: Path) -> None:
    made = scene(
        tmp_path,
        '[[object]]\nshape = "box"\nname = "row"\ntranslate = [1, 0, 0]\nrotate_deg = [0, 90, 0]\n'
        "count = 3\nstep = [0, 0, 2]\n"
        '[[object]]\nshape = "box"\nscale = 3\ncount = [2, 1, 3]\nstep = [5, 0, 7]',
    )
    places = [tuple(i.world_from_object[:3, 3].tolist()) for i in made.instances]
    assert places[:3] == [(1, 0, 0), (1, 0, 2), (1, 0, 4)]  # world axes, whatever the rotation
    assert set(places[3:]) == {(x, 0, z) for x in (0, 5) for z in (0, 7, 14)} and len(places) == 9
    assert len(made.meshes) == 1 and {i.mesh for i in made.instances} == {0}
    assert made.triangle_count() == 9 * 12 and made.instances[0].name == "row"


def test_equal_shapes_share_a_mesh_whatever_their_material(tmp_path: Path) -> None:
    made = scene(
        tmp_path,
        '[[material]]\nname = "a"\n[[material]]\nname = "b"\n'
        '[[object]]\nshape = "torus"\nradius = 2\nmaterial = "a"\n'
        '[[object]]\nshape = "torus"\nradius = 2.0\nmaterial = "b"\n'
        '[[object]]\nshape = "torus"\n[[object]]\nshape = "sphere"\nradius = 3',
    )
    assert [i.mesh for i in made.instances] == [0, 0, 1, 2]
    assert [i.materials for i in made.instances] == [(0,), (1,), (2,), (2,)]
    assert made.materials[2].base_color == (1, 1, 1, 1) and made.materials[2].roughness == 1
    assert isinstance(made.meshes[2].primitives[0], Sphere) and made.meshes[2].primitives[0].radius == 3


def test_every_shape_loads_with_its_defaults(tmp_path: Path) -> None:
    made = scene(tmp_path, "".join(f'[[object]]\nshape = "{name}"\n' for name in shapes.SHAPES))
    assert len(made.meshes) == len(shapes.SHAPES) and made.warnings == ()


def test_files_are_read_once_and_bring_lights_and_cameras_along(tmp_path: Path) -> None:
    model(tmp_path / "m.gltf")
    made = scene(
        tmp_path,
        '[camera.main]\neye = [0, 0, 9]\ntarget = [0, 0, 0]\n[[material]]\nname = "new"\n'
        '[[object]]\nfile = "m.gltf"\nname = "a"\ntranslate = [10, 0, 0]\nrotate_deg = [0, 90, 0]\nscale = 2\n'
        '[[object]]\nfile = "m.gltf"\nmaterial = "new"\ncount = 2\nstep = [0, 0, 5]',
    )
    assert len(made.meshes) == 1 and [i.mesh for i in made.instances] == [0, 0, 0]
    assert made.instances[0].name == "a/part" and made.instances[1].name == "part"
    assert [i.materials for i in made.instances] == [None, (0,), (0,)]
    piece = made.meshes[0].primitives[0]
    assert made.materials[piece.material].name == "own" and made.materials[0].name == "new"
    assert np.allclose(made.instances[0].world_from_object[:3, 3], [12, 0, 0])  # (0, 0, 1) x 2, turned to +X
    assert np.allclose(made.instances[2].world_from_object[:3, 3], [0, 0, 6])
    assert len(made.lights) == 3 and np.allclose(made.lights[0].position, [10, 4, 0])
    assert np.allclose(made.lights[0].direction, [-1, 0, 0]) and made.lights[0].range == 7  # scale changes no range
    assert made.cameras[0].name == "main" and len(made.cameras) == 4
    pose = made.cameras[1].world_from_view
    assert np.allclose(pose[:3, 3], [20, 0, 0]) and np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3))
    assert np.allclose(pose[:3, 2], [1, 0, 0]) and made.cameras[1].fov_y == pytest.approx(0.5)
    assert made.nodes == () and all(i.node == -1 for i in made.instances), "nothing moves, so no nodes are kept"


def test_animated_files_keep_their_nodes_under_the_object(tmp_path: Path) -> None:
    model(tmp_path / "m.gltf", animated=True)
    made = scene(tmp_path, '[[object]]\nfile = "m.gltf"\nname = "a"\ncount = 2\nstep = [3, 0, 0]')
    roots = [i for i, node in enumerate(made.nodes) if node.parent == -1]
    assert len(roots) == 2 and made.nodes[roots[1]].matrix is not None
    assert np.allclose(made.nodes[roots[1]].matrix[:3, 3], [3, 0, 0])
    assert len(made.animations) == 1 and made.animations[0].name == "move" and len(made.animations[0].channels) == 2
    for instance, channel, root in zip(made.instances, made.animations[0].channels, roots, strict=True):
        assert channel.node == instance.node and made.nodes[instance.node].parent == root
        assert made.nodes[instance.node].name == "part"
    assert all(np.all(c.values == made.animations[0].channels[0].values) for c in made.animations[0].channels)


def test_animated_skinned_model() -> None:
    file = MODELS / "CesiumMan" / "CesiumMan.glb"
    if not file.exists():
        pytest.skip("the shared models are not here")
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        made = scene(Path(folder), f"[[object]]\nfile = '{file}'\ncount = 2\nstep = [1, 0, 0]", allow_outside=True)
    assert len(made.skins) == 2 and made.instances[0].skin == 0 and made.instances[1].skin == 1
    first, second = (set(s.joints) for s in made.skins)
    assert not first & second and all(0 <= j < len(made.nodes) for j in first | second)
    assert all(-1 <= n.parent < len(made.nodes) for n in made.nodes)


def test_normal_maps_get_tangents_and_missing_uvs_are_said(tmp_path: Path) -> None:
    model(tmp_path / "m.gltf")
    made = scene(
        tmp_path,
        '[[material]]\nname = "bumpy"\ntextures = { normal = { pattern = "noise" } }\n'
        '[[object]]\nfile = "m.gltf"\nmaterial = "bumpy"',
    )
    piece = made.meshes[0].primitives[0]
    assert isinstance(piece, Triangles) and piece.tangent is not None
    assert len(made.warnings) == 1 and "no UVs" in made.warnings[0]
    with pytest.raises(LoadError, match=r"no UVs.*strict"):
        load(tmp_path / "hall.toml", strict=True)


def test_sha256_covers_every_file(tmp_path: Path) -> None:
    from PIL import Image

    text = (
        '[[material]]\nname = "a"\ntextures = { base_color = "a.png" }\n[environment]\nfile = "a.hdr"\n'
        '[[object]]\nfile = "m.gltf"\n'
    )
    hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n"
    Image.new("RGB", (2, 2), (9, 9, 9)).save(tmp_path / "a.png")
    (tmp_path / "a.hdr").write_bytes(hdr + bytes([1, 1, 2, 128]))
    model(tmp_path / "m.gltf")
    seen = {scene(tmp_path, text).sha256, scene(tmp_path, text).sha256}
    assert len(seen) == 1
    seen.add(scene(tmp_path, text + "# more").sha256)
    Image.new("RGB", (2, 2), (8, 9, 9)).save(tmp_path / "a.png")
    seen.add(scene(tmp_path, text).sha256)
    (tmp_path / "a.hdr").write_bytes(hdr + bytes([2, 1, 2, 128]))
    seen.add(scene(tmp_path, text).sha256)
    model(tmp_path / "m.gltf", animated=True)
    seen.add(scene(tmp_path, text).sha256)
    assert len(seen) == 5


def test_study_table(tmp_path: Path) -> None:
    study = scene(tmp_path, STUDY).study
    assert study is not None and (study.title, study.size, study.measure) == ("acne", (64, 48), "wrong shadow")
    assert study.settings == {"reflections": "none"} and study.options == {}
    fails, holds = study.expectations
    assert fails.fails and (fails.low, fails.high, fails.because) == (30, 50, "half")
    assert fails.settings == {"shadows": "map", "shadows.map.slope_bias": 0}
    assert not holds.fails and holds.settings == {"shadows": "ray"}
    assert scene(tmp_path, "").study is None


def test_an_orthographic_camera(tmp_path: Path) -> None:
    text = "[camera.plan]\neye = [0, 5, 0]\ntarget = [0, 0, 0]\nup = [0, 0, -1]\nheight = 3\n"
    (camera,) = scene(tmp_path, text).cameras
    assert camera.fov_y == 0 and camera.ymag == 1.5
    with pytest.raises(LoadError, match="either height or fov_y_deg"):
        scene(tmp_path, text + "fov_y_deg = 40")
