"""load(): what it refuses, the light and camera it adds and says so, the built-in scenes."""

from pathlib import Path

import numpy as np
import pytest
from scenefile_kit import BOX, scene

from glhybrid.errors import LoadError
from glhybrid.load import builtin, default_camera, defaults, load, patterns, shapes, with_defaults
from glhybrid.scene import Instance, Material, Mesh, Scene, Sphere, Triangles
from glhybrid.view import make_view


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
    sky, sun = defaults.default_light()
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


@pytest.mark.parametrize("mirrored", [False, True])
def test_default_camera_looks_at_fronts(mirrored: bool) -> None:
    """A sheet that faces away is seen from behind; what has two sides, or is closed, from the front as ever."""
    away = Triangles(*(np.array(a, t) for a, t in (
        ([[0, 0, 0], [0, 1, 0], [1, 0, 0]], np.float32), ([[0, 1, 2]], np.uint32), ([[0, 0, -1]] * 3, np.float32),
    )))  # fmt: skip
    pose = np.diag([-1.0, 1, 1, 1]) if mirrored else np.eye(4)  # turns the winding over: it faces away all the same
    for piece, double_sided, from_front in ((away, False, False), (away, True, True), (shapes.box(), False, True)):
        made = Scene("s", (Mesh("m", (piece,)),), (Instance(0, pose),), (Material(double_sided=double_sided),))
        camera = default_camera(made)
        assert (camera.world_from_view[2, 3] > made.bounds().mean(0)[2]) == from_front
        points = made.bounds() - camera.world_from_view[:3, 3]
        assert (points @ camera.world_from_view[:3, 2] < 0).all()  # in front of it, whichever way it looks
        full = with_defaults(made)
        assert full.environment is not None and abs(full.environment.rotation - np.pi * (not from_front)) < 1e-9
        lit = full.lights[0].direction[2] * (1 if from_front else -1)
        assert lit < 0  # the sun stays over the viewer's shoulder


def test_default_camera_of_nothing_and_of_a_point() -> None:
    for made in (Scene("empty"), Scene("none", (Mesh("m", ()),), (Instance(0, np.eye(4)),))):
        camera = default_camera(made)
        assert np.isfinite(camera.world_from_view).all() and camera.near > 0


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
    made = load(name, strict=True)
    assert made.triangle_count() >= triangles and made.warnings == () and made.cameras
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
