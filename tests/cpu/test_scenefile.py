"""Scene files: every key, what is shared, what moves, what is refused and how it reads; load() and its defaults."""

import base64
import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest

import glhybrid as gh
from glhybrid.errors import LoadError
from glhybrid.load import builtin, default_camera, defaults, load, patterns, shapes
from glhybrid.load.scenefile import load_scene_file
from glhybrid.scene import Instance, Mesh, Scene, Sphere, Triangles
from glhybrid.view import make_view

MODELS = Path(__file__).resolve().parents[3] / "shared" / "models"


def scene(folder: Path, text: str, **options: bool) -> Scene:
    path = folder / "hall.toml"
    path.write_text(text)
    return load_scene_file(path, **options)


def model(path: Path, animated: bool = False) -> Path:
    """A triangle under a node at (0, 0, 1), with a spot light, a camera and perhaps an animation, as one .gltf."""
    data = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + struct.pack("<8f", 0, 1, 0, 0, 0, 2, 0, 0)
    gltf: dict[str, object] = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "spot", "range": 7, "spot": {}}]}},
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteOffset": o, "byteLength": n} for o, n in ((0, 36), (36, 8), (44, 24))],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "materials": [{"name": "own", "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "meshes": [{"name": "tri", "primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}],
        "nodes": [
            {"name": "part", "mesh": 0, "translation": [0, 0, 1]},
            {"name": "lamp", "translation": [0, 2, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"name": "view", "camera": 0, "translation": [0, 0, 5]},
        ],
        "scenes": [{"nodes": [0, 1, 2]}],
    }
    if animated:
        gltf["animations"] = [
            {
                "name": "move",
                "samplers": [{"input": 1, "output": 2}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
            }
        ]
    path.write_text(json.dumps(gltf))
    return path


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


BOX = '[[object]]\nshape = "box"\n'
BAD = [
    ("[camra.main]", 'hall.toml: unknown key "camra"; did you mean "camera"?'),
    ("a = ", "hall.toml: not valid TOML"),
    ("[camera.main]\neye = [0,0,0]", "hall.toml: [camera.main]: needs target"),
    (
        "[camera.main]\neye = [0,0,0]\ntarget = [0,0,0]",
        "[camera.main]: target = [0, 0, 0]: must not be where the eye is",
    ),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nup = [0,0,0]", "up = [0, 0, 0]: must not be zero"),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nfov_y_deg = 180", "fov_y_deg = 180: must be between 0 and 180"),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nnear = 0", "near = 0: must be greater than 0"),
    ("[camera.main]\neye = [0,0,0]\ntarget = [0,0,1]\nfov = 1", 'unknown key "fov"; did you mean "fov_y_deg"?'),
    ("[camera.main]\neye = [0,0,nan]\ntarget = [0,0,1]", "must be finite"),
    ("[camera.main]\neye = [0,0]\ntarget = [0,0,1]", "eye = [0, 0]: must be a list of 3 numbers"),
    ("camera = 3", "camera = 3: must hold named tables: write [camera.main]"),
    ("[camera]\neye = [0,0,0]", "write [camera.main]"),
    ("[environment]\nintensity = 1", "hall.toml: [environment]: needs exactly one of file, constant, sky"),
    ("[environment]\nconstant = [1,1,1]\nsky = {}", "has constant and sky"),
    ("[environment]\nconstant = [1,1,-1]", "must not be negative"),
    ("[environment]\nsky = {turbidity = 0}", "hall.toml: [environment]: sky: turbidity = 0: must be between 1 and 10"),
    ("[environment]\nsky = {sun_elevation = 3}", 'did you mean "sun_elevation_deg"?'),
    ('[environment]\nfile = "no.hdr"', 'file = "no.hdr": there is no file'),
    ('[environment]\nfile = "."', "is not a file"),
    ("[[light]]", 'hall.toml: [[light]] 1: needs kind = "directional"'),
    ('[[light]]\nkind = "sun"', 'unknown kind "sun"'),
    ('[[light]]\nkind = "point"', "a point light needs position"),
    ('[[light]]\nkind = "point"\nposition = [0,0,0]\ndirection = [1,0,0]', "does not apply to a point light"),
    ('[[light]]\nkind = "directional"\ndirection = [0,0,0]', "direction = [0, 0, 0]: must not be zero"),
    ('[[light]]\nkind = "directional"\nintensity = -1', "intensity = -1: must not be negative"),
    (
        '[[light]]\nname = "key"\nkind = "spot"\nposition = [0,0,0]\ninner_cone_deg = 30\nouter_cone_deg = 20',
        'hall.toml: [[light]] 1 "key": inner_cone_deg = 30: must be less than outer_cone_deg (20)',
    ),
    ("[light]\nkind = 3", "must be an array of tables: write [[light]]"),
    ("[[material]]", "a material needs a name"),
    ('[[material]]\nname = "a"\n[[material]]\nname = "a"', "another material has this name already"),
    (
        '[[material]]\nname = "a"\nroughness = 2',
        'hall.toml: [[material]] 1 "a": roughness = 2: must be between 0 and 1',
    ),
    ('[[material]]\nname = "a"\nrougness = 0', 'did you mean "roughness"?'),
    ('[[material]]\nname = "a"\nalpha_mode = "CUT"', 'unknown alpha_mode "CUT"'),
    ('[[material]]\nname = "a"\nunlit = 1', "unlit = 1: must be true or false"),
    ('[[material]]\nname = "a"\nbase_color = "red"', 'base_color = "red": must be a list of 4 numbers'),
    ('[[material]]\nname = "a"\ntextures = { base_colour = "a.png" }', 'textures: unknown key "base_colour"'),
    ('[[material]]\nname = "a"\ntextures = { normal = "no.png" }', 'normal = "no.png": there is no file'),
    ('[[material]]\nname = "a"\ntextures = { normal = { pattern = "marbel" } }', 'did you mean "marble"?'),
    (
        '[[material]]\nname = "a"\ntextures = { normal = { pattern = "noise", cells = [0, 1] } }',
        "cells = [0, 1]: must be",
    ),
    ('[[material]]\nname = "a"\ntextures = { normal = {} }', "needs either file or pattern"),
    (BOX + "scale = 1e30", "scale = 1e+30: must not be 0, and between 1e-9 and 1e9"),
    (BOX + "translate = [1e13, 0, 0]", "must be within 1e12 m"),
    (BOX + "size = [1e30, 1, 1]", "greater than 0 and at most 1e9"),
    ('[[light]]\nkind = "directional"\nintensity = 1e300', "nor greater than 1e15"),
    ("[camera.main]\neyes = [0,0,1]\ntarget = [0,0,0]", 'unknown key "eyes"; did you mean "eye"?'),
    ('[[light]]\nkinds = "point"', 'unknown key "kinds"; did you mean "kind"?'),
    ('[[material]]\nnam = "a"', 'unknown key "nam"; did you mean "name"?'),
    ('[[material]]\nname = ""', "must not be empty"),
    ('[[object]]\nshap = "box"', 'unknown key "shap"; did you mean "shape"?'),
    (BOX + "scale = 0", "hall.toml: [[object]] 1: scale = 0: must not be 0"),
    (BOX + 'name = "lamp"\nscale = [1,0,1]', 'hall.toml: [[object]] 1 "lamp": scale = [1, 0, 1]: must not be 0'),
    (BOX + "count = 0\nstep = [1,0,0]", "count = 0: must be between 1 and"),
    (BOX + "count = [1,2.5,1]\nstep = [1,1,0]", "must be whole and at least 1"),
    (BOX + "count = 3", "count = 3: needs a step that is not 0 where it repeats"),
    (BOX + "count = [2,2,1]\nstep = [1,0,0]", "needs a step that is not 0"),
    (BOX + "count = 2000000\nstep = [1,0,0]", "more than 1000000 instances"),
    (BOX + "count = true", "count = true: must be a whole number"),
    (BOX + 'material = "wod"\n[[material]]\nname = "wood"', 'unknown material "wod"; did you mean "wood"?'),
    (BOX + "size = [1,-1,1]", "[[object]] 1: size = [1, -1, 1]: must be greater than 0"),
    (BOX + "radius = 1", 'unknown key "radius"'),
    (BOX + "smooth = true", 'unknown key "smooth"'),
    ('[[object]]\nshape = "bax"', 'unknown shape "bax"; did you mean "box"?'),
    ("[[object]]", "needs either file or shape"),
    (BOX + 'file = "a.glb"', "needs either file or shape"),
    ('[[object]]\nfile = "no.glb"', 'hall.toml: [[object]] 1: file = "no.glb": there is no file'),
    ('[[object]]\nfile = "hall.toml"', "a scene file inside a scene file is not supported"),
    ('[[object]]\nfile = "/etc/passwd"', "lies outside the scene file's folder"),
    ('[[object]]\nfile = "../x.glb"', "use --allow-outside"),
    ('[[object]]\nshape = "grid"\ncells = [5000, 5]', "cells = [5000, 5]: must be between 1 and 4096"),
    ('[[object]]\nshape = "grid"\ncells = [2.5, 5]', "must be whole numbers"),
    ('[[object]]\nshape = "torus"\nsegments = 3.5', "segments = 3.5: must be a whole number"),
]


@pytest.mark.parametrize(("text", "says"), BAD, ids=[f"{i}" for i in range(len(BAD))])
def test_bad_files_say_where_and_what(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(LoadError) as caught:
        scene(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "hall.toml")) and says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_outside_files_are_allowed_when_asked(tmp_path: Path) -> None:
    model(tmp_path / "m.gltf")
    inner = tmp_path / "scenes"
    inner.mkdir()
    text = '[[object]]\nfile = "../m.gltf"'
    with pytest.raises(LoadError, match="outside"):
        scene(inner, text)
    (inner / "link.gltf").symlink_to(tmp_path / "m.gltf")
    with pytest.raises(LoadError, match="outside"):
        scene(inner, text.replace("../m", "link"))
    assert len(scene(inner, text, allow_outside=True).instances) == 1


STUDY = """
[study]
title = "acne"
why = "texels"
measure = "wrong shadow"
size = [64, 48]
set = { reflections = "none" }
[[study.fails]]
set = { shadows = "map", "shadows.map.slope_bias" = 0 }
expected = [30, 50]
because = "half"
[[study.holds]]
set = { shadows = "ray" }
expected = [0, 0.01]
"""


def test_study_table(tmp_path: Path) -> None:
    study = scene(tmp_path, STUDY).study
    assert study is not None and (study.title, study.size, study.measure) == ("acne", (64, 48), "wrong shadow")
    assert study.settings == {"reflections": "none"} and study.options == {}
    fails, holds = study.expectations
    assert fails.fails and (fails.low, fails.high, fails.because) == (30, 50, "half")
    assert fails.settings == {"shadows": "map", "shadows.map.slope_bias": 0}
    assert not holds.fails and holds.settings == {"shadows": "ray"}
    assert scene(tmp_path, "").study is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("title", "titel", r'unknown key "titel"; did you mean "title"'),
        ('why = "texels"', "", "needs why"),
        ("[64, 48]", "[64, 0]", "size = .*whole and between 1 and 8192"),
        ("[30, 50]", "[50, 30]", "the lowest value comes first"),
        ("expected = [30, 50]", "", r"\[\[fails\]\] 1: needs expected"),
        ("expected = [30, 50]", "expect = [30, 50]", r'unknown key "expect"; did you mean "expected"'),
        ('because = "half"', "", "needs because"),
        ('because = "half"', 'because = "half"\nbar = 3', 'unknown key "bar"'),
        ('set = { shadows = "ray" }', "", "needs either set, .*, or control"),
        ("[[study", "[[studies", r'unknown key "studies"; did you mean "study"|needs \[\[study.fails\]\]'),
        ('set = { reflections = "none" }', "set = 3", "set = 3: must be a table"),
    ],
)
def test_study_table_is_read_strictly(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in STUDY
    with pytest.raises(LoadError, match=message):
        scene(tmp_path, STUDY.replace(old, new))


def test_an_orthographic_camera(tmp_path: Path) -> None:
    text = "[camera.plan]\neye = [0, 5, 0]\ntarget = [0, 0, 0]\nup = [0, 0, -1]\nheight = 3\n"
    (camera,) = scene(tmp_path, text).cameras
    assert camera.fov_y == 0 and camera.ymag == 1.5
    with pytest.raises(LoadError, match="either height or fov_y_deg"):
        scene(tmp_path, text + "fov_y_deg = 40")


# load() ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("atriun", 'unknown built-in scene "atriun"; did you mean "atrium"?'),
        ("no.glb", "no.glb: there is no such file"),
        ("no.toml", "no.toml: there is no such file"),
        ("scene.fbx", 'cannot read ".fbx" files'),
        ("..", "is a folder"),
        ("folder.glb", "is a folder"),
        ("plain", "a file without suffix"),
        ("picture.png", 'cannot read ".png" files; supported: .gltf, .glb, .obj'),
        ("../atrium", "nor is there such a file"),
        ("bytes.toml", "not a text file"),
    ],
)
def test_load_refuses_with_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.glb").mkdir()
    (tmp_path / "plain").write_text("x")
    (tmp_path / "picture.png").write_text("x")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LoadError) as caught:
        load(source)
    assert says in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".gltf", ".glb", ".toml", ".hdr", ".exr"])
def test_files_that_are_not_what_they_say(tmp_path: Path, suffix: str) -> None:
    from PIL import Image

    wrong = tmp_path / f"wrong{suffix}"
    Image.new("RGB", (8, 8)).save(wrong, format="PNG")
    with pytest.raises(LoadError, match="wrong"):
        if suffix in (".hdr", ".exr"):
            scene(tmp_path, f'[environment]\nfile = "wrong{suffix}"')
        else:
            load(wrong)


def test_defaults_are_added_and_said(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(BOX)
    made = load(tmp_path / "a.toml")
    assert len(made.cameras) == 1 and len(made.lights) == 1 and made.environment is not None
    assert len(made.warnings) == 2 and "default sky and sun" in made.warnings[0] and "camera" in made.warnings[1]
    strict = load(str(tmp_path / "a.toml"), strict=True)  # nothing was dropped
    assert len(strict.lights) == 1
    (tmp_path / "b.toml").write_text(BOX + "[environment]\nconstant = [0, 0, 0]\n")
    assert load(tmp_path / "b.toml").lights == ()
    (tmp_path / "c.toml").write_text(BOX + '[[light]]\nkind = "directional"\n')
    assert load(tmp_path / "c.toml").environment is None


def test_default_light_makes_white_about_one() -> None:
    sky, sun = defaults.default_light(Scene("x"))
    height = len(sky.radiance)
    polar = (np.arange(height // 2) + 0.5) / height * np.pi
    up = (sky.radiance[: height // 2].mean((1, 2)) * np.cos(polar) * np.sin(polar)).sum() * (np.pi / height) * 2 * np.pi
    sunlit = up * sky.intensity + sun.intensity * float(np.mean(sun.color)) * -sun.direction[1]
    assert 0.6 < sunlit / np.pi < 1.1
    assert sun.direction[1] < -0.5 and sun.direction[2] < 0, "from above and from the default camera's side"


@pytest.mark.parametrize("seed", range(6))
def test_default_camera_sees_everything(seed: int) -> None:
    random = np.random.default_rng(seed)
    points = random.normal(0, 1, (30, 3)).astype(np.float32)
    cloud = Triangles(points, np.arange(30, dtype=np.uint32).reshape(-1, 3), np.zeros((30, 3), np.float32))
    meshes = [Mesh("cloud", (cloud,)), Mesh("ball", (Sphere(0.7),))]
    instances = []
    for i in range(5):
        world = np.eye(4)
        world[:3, :3] = random.normal(0, 1, (3, 3)) * 10.0 ** random.uniform(-2, 2)
        world[:3, 3] = random.normal(0, 50, 3)
        instances.append(Instance(i % 2, world))
    made = Scene("x", tuple(meshes), tuple(instances))
    camera = default_camera(made)
    view_from_world = np.linalg.inv(camera.world_from_view)
    seen = []
    for instance in instances:
        w = instance.world_from_object
        if instance.mesh == 0:
            seen.append(points @ w[:3, :3].T + w[:3, 3])
        else:
            way = random.normal(0, 1, (200, 3))
            seen.append(0.7 * way / np.linalg.norm(way, axis=1, keepdims=True) @ w[:3, :3].T + w[:3, 3])
    p = np.concatenate(seen) @ view_from_world[:3, :3].T + view_from_world[:3, 3]
    assert (-p[:, 2] > camera.near).all()
    for size in ((100, 200), (100, 100), (200, 100)):
        clip = np.concatenate([p, np.ones((len(p), 1))], axis=1) @ camera.world_from_view.T
        view = make_view(camera, size, made)
        clip = (clip - [*view.origin, 0]) @ view.clip_from_world.T
        assert np.abs(clip[:, :2] / clip[:, 3:]).max() <= 1.0001
        assert np.abs(clip[:, :2] / clip[:, 3:]).max(0).max() > 0.3, "too far away"


def test_default_camera_of_nothing_and_of_a_point() -> None:
    for made in (Scene("empty"), Scene("none", (Mesh("m", ()),), (Instance(0, np.eye(4)),))):
        camera = default_camera(made)
        assert np.isfinite(camera.world_from_view).all() and camera.near > 0


# Built-in scenes -------------------------------------------------------------------------------------------------


def test_builtin_scenes_are_listed_and_described() -> None:
    listed = {s.name: s for s in builtin.scenes()}
    assert {"atrium", "plaza", "showroom"} <= set(listed)
    for s in listed.values():
        assert s.path.is_file() and 10 < len(s.description) < 100 and "\n" not in s.description
    assert builtin.data_folder("scenes").name == "scenes"
    assert builtin.scene_path("../scenes/atrium") is None and builtin.scene_path("nope") is None


@pytest.mark.parametrize(
    ("name", "triangles"),
    [("atrium", 150_000), ("plaza", 1_000_000), ("showroom", 50_000), ("cornell", 24), ("grey", 2)],
)
def test_builtin_scenes_load(name: str, triangles: int) -> None:
    started = time.process_time()
    made = load(name, strict=True)
    assert made.triangle_count() >= triangles and made.warnings == () and made.cameras
    assert time.process_time() - started < 10  # 0.6 s on an idle machine; this only catches what got very slow
    used = {m for i in made.instances for m in i.materials or ()}
    assert used == set(range(len(made.materials))), "a material nobody uses"
    if name == "atrium":
        assert {m.alpha_mode for m in made.materials} == {"OPAQUE", "MASK"}
        assert len(made.meshes) < len(made.instances) / 2
    if name == "showroom":
        ladder = sorted(m.roughness for m in made.materials if m.name.startswith("ladder"))
        assert np.allclose(ladder, np.linspace(0, 1, 11))


def test_readme_lists_every_shape_and_pattern_with_its_parameters() -> None:
    text = (builtin.data_folder("scenes") / "README.md").read_text()
    rows = {line.split("`")[1]: line for line in text.splitlines() if line.startswith("| `")}
    for names, parameters, common in (
        (shapes.SHAPES, shapes.parameters, {}),
        (patterns.PATTERNS, patterns.parameters, patterns.COMMON),
    ):
        for name in names:
            for key, default in parameters(name).items():
                assert key in common or f"`{key}" in rows[name] or f"{key} = " in rows[name], (name, key)
                if isinstance(default, int | float) and key not in common and f"{key} = " in rows[name]:
                    assert f"{key} = {default:g}" in rows[name], (name, key)
