"""A hundred scenes one after the other leave no GL object behind, nor does a closed viewer."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glhybrid.context import Context
from glhybrid.errors import LoadError
from glhybrid.scene import Camera, Environment, Instance, Light, Material, Mesh, Scene, Sphere, Triangles
from glhybrid.viewer.app import Viewer

KINDS = ("Buffer", "Texture", "Program", "Framebuffer", "VertexArray")
GL_CURRENT_PROGRAM = 0x8B8D
LOADS, MOST_NAMES = 100, 100_000  # names grow all through a run


def objects(context: Context) -> dict[str, int]:
    """GL objects alive, by kind: every name that the driver says is one."""
    return {k: sum(getattr(context.raw, f"glIs{k}")(n) for n in range(1, MOST_NAMES)) for k in KINDS}


def small(number: int) -> Scene:
    """One of three kinds of scene: triangles with a lamp, a sphere under a sky, nothing."""
    camera = Camera.look_at((0, 1, 4), (0, 0, 0))
    if number % 3 == 2:
        return Scene("empty", cameras=(camera,))
    if number % 3 == 1:
        sky = Environment(np.full((4, 8, 3), 0.5 + number % 2, np.float32))
        return Scene(
            "ball", (Mesh("ball", (Sphere(1.0),)),), (Instance(0, np.eye(4)),), (Material(metallic=1.0, roughness=0.1),),
            cameras=(camera,), environment=sky,
        )  # fmt: skip
    corner = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    facing = np.tile(np.array([0, 0, 1], np.float32), (3, 1))
    piece = Triangles(corner, np.array([[0, 1, 2]], np.uint32), facing)
    return Scene("leaf", (Mesh("leaf", (piece,)),), (Instance(0, np.eye(4)),), lights=(Light("directional"),), cameras=(camera,))  # fmt: skip


def test_a_hundred_scenes_leave_nothing(open_viewer: Callable[..., Viewer], context: Context, monkeypatch: Any) -> None:
    viewer = open_viewer(small(0), size=(24, 16), mode="split", a=_settings("ray"), b=_settings("map"))
    counts = []
    for number in range(LOADS):
        viewer._load = lambda _, n=number: small(n)  # type: ignore[misc]
        viewer.open(f"scene {number}.glb")
        for _ in range(4):
            viewer.tick()
        if number in (11, 98):  # empty scenes; programs and glyphs are all made by then
            counts.append(objects(context))
    assert not [s.text for s in viewer.session.said if s.error]
    assert counts[0] == counts[1], counts
    assert max(counts[-1].values()) < MOST_NAMES // 2


def _settings(shadows: str) -> Any:
    from glhybrid import Settings

    return Settings(shadows=shadows, aa=1)


def test_a_closed_viewer_leaves_nothing(open_viewer: Callable[..., Viewer], context: Context) -> None:
    """Nor a program: one that is in use when it is released would live until the next one is used."""
    open_viewer(small(0), size=(24, 16)).close()  # whatever is made once in a context is made now
    before = objects(context)
    viewer = open_viewer(small(1), size=(24, 16), mode="flip", reference=True)
    viewer.settle()
    viewer.session.show = "normal"
    viewer.session.mode = "single"
    viewer.settle()
    assert objects(context) != before
    viewer.close()
    viewer.close()
    assert objects(context) == before and context.raw.get_integer(GL_CURRENT_PROGRAM) == 0


def test_a_file_that_cannot_be_read_leaves_the_scene(open_viewer: Callable[..., Viewer]) -> None:
    viewer = open_viewer(small(0), size=(24, 16))
    viewer.settle()
    kept = viewer.session.scene

    def load(path: str) -> Scene:
        raise LoadError(f"{path}: cannot be read")

    viewer._load = load
    viewer.open("broken.glb")
    viewer.act("reload")
    viewer.settle()
    assert viewer.session.scene is kept and any(s.error and "cannot be read" in s.text for s in viewer.session.said)


def test_what_is_written_beside_the_scene_leaves_it(open_viewer: Callable[..., Viewer], tmp_path: Any) -> None:
    """A picture saved over another one in the scene's folder is no reason to begin anew; F5 is."""
    import glhybrid

    file = tmp_path / "scene.toml"
    file.write_text('[[object]]\nshape = "sphere"\nradius = 1\n')
    viewer = open_viewer(glhybrid.load(file), size=(24, 16))
    viewer.session.source = str(file)
    viewer.settle()
    scene, edits = viewer.session.scene, viewer.session.edits
    viewer.act("follow")
    assert viewer.session.scene is scene and viewer.session.edits == edits and not viewer.session.said
    viewer.act("reload")
    assert viewer.session.scene is not scene
    file.write_text('[[object]]\nshape = "sphere"\nradius = 1.5\n')
    viewer.act("follow")
    assert viewer.session.scene.sha256 != scene.sha256


@pytest.mark.parametrize("written", ["scene", "shader"])
def test_written_files_are_read_again(
    open_viewer: Callable[..., Viewer], context: Context, tmp_path: Any, monkeypatch: Any, written: str
) -> None:
    import shutil
    import time

    import glhybrid
    from glhybrid import shaders
    from glhybrid.load.builtin import data_folder
    from glhybrid.viewer.watch import Watch

    folder, file = tmp_path / "glsl", tmp_path / "scene.toml"
    shutil.copytree(data_folder("glsl"), folder)
    monkeypatch.setattr(shaders, "data_folder", lambda kind: folder)
    text = '[[object]]\nshape = "sphere"\nradius = {}\n[camera.main]\neye = [0, 0, 5]\ntarget = [0, 0, 0]\n'
    file.write_text(text.format(1.0))
    viewer = open_viewer(glhybrid.load(file), size=(24, 16))
    viewer.session.source = str(file)
    viewer._watching, viewer._watch = True, Watch(file)
    viewer.settle()
    before = viewer.pictures.sides["a"].rgb().copy()
    shader = folder / "passes" / "composite.comp"
    source = shader.read_text()

    def wait(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 10
        while not condition() and time.monotonic() < end:
            viewer.tick()
        assert condition(), [s.text for s in viewer.session.said]

    if written == "scene":
        file.write_text("nonsense = = 1")
        wait(lambda: any(s.error for s in viewer.session.said))
        file.write_text(text.format(1.7))
        wait(lambda: any(s.text.startswith("reloaded") for s in viewer.session.said))
    else:
        shader.write_text(source.replace("vec4 result = vec4(color,", "vec4 result = vec4(colour,"))
        wait(lambda: any("the last good program stays" in s.text for s in viewer.session.said))
        assert any("glsl/passes/composite.comp:" in s.text for s in viewer.session.said)
        viewer.settle()
        assert np.array_equal(viewer.pictures.sides["a"].rgb(), before)
        shader.write_text(
            source.replace("vec4 result = vec4(color,", "vec4 result = vec4(color.bgr * vec3(3.0, 1.0, 0.2),")
        )
        wait(lambda: any("compiled anew" in s.text for s in viewer.session.said))
    viewer.settle()
    assert not np.array_equal(viewer.pictures.sides["a"].rgb(), before)
