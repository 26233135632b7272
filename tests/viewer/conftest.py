"""The viewer on a surface in memory: every part but the window itself. Skipped where its libraries are absent."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("imgui_bundle", reason="the extra `viewer` is not installed")

import glhybrid
from glhybrid.context import Context
from glhybrid.scene import Camera, Environment, Instance, Light, Material, Mesh, Scene, Sphere, Triangles
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.panels import WIDTH
from glhybrid.viewer.session import Session
from glhybrid.viewer.surface import Memory

PICTURE_SIZE = (96, 64)
Open = Callable[..., Viewer]


def load(source: str) -> Scene:
    """ "yard" is the scene below; others are files and built-in scenes."""
    return yard() if source == "yard" else glhybrid.load(source)


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CONFIG", str(tmp_path / "config"))


def yard() -> Scene:
    """Two balls on a floor under a sun and a sky with a bright side: small, quick, and nothing is symmetric."""
    sky = np.linspace(0.1, 1.0, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
    corner = np.array([[-4, 0, -4], [4, 0, -4], [4, 0, 4], [-4, 0, 4]], np.float32)
    up = np.tile(np.array([0, 1, 0], np.float32), (4, 1))
    floor = Triangles(corner, np.array([[0, 2, 1], [0, 3, 2]], np.uint32), up, material=1)
    left, right = np.eye(4), np.eye(4)
    left[:3, 3], right[:3, 3] = (-0.9, 0.7, 0.2), (0.8, 0.7, -0.4)
    return Scene(
        "yard",
        (Mesh("floor", (floor,)), Mesh("ball", (Sphere(0.7),))),
        (Instance(0, np.eye(4)), Instance(1, left, "left"), Instance(1, right, "right")),
        (Material("metal", metallic=1.0, roughness=0.2), Material("clay", base_color=(0.6, 0.4, 0.3, 1.0), roughness=0.7)),
        lights=(Light("directional", intensity=3.0, direction=(0.48, -0.8, -0.36)),),
        cameras=(Camera.look_at((0.5, 1.4, 5.0), (0.0, 0.5, 0.0)), Camera.look_at((4.0, 2.0, 1.0), (0.0, 0.5, 0.0))),
        environment=Environment(sky),
    )  # fmt: skip


@pytest.fixture
def open_viewer(context: Context) -> Iterator[Open]:
    """open_viewer(scene, name, **session): a viewer whose picture has PICTURE_SIZE, panel shown."""
    opened: list[Viewer] = []

    def open_(scene: Scene | str = "cornell", size: tuple[int, int] = PICTURE_SIZE, **state: Any) -> Viewer:
        loaded = load(scene) if isinstance(scene, str) else scene
        session = Session(loaded, scene if isinstance(scene, str) else "scene.glb", **state)
        surface = Memory(context, (size[0] + WIDTH, size[1]))
        opened.append(Viewer(surface, session, load, watch=False))
        return opened[-1]

    yield open_
    for viewer in opened:
        viewer.close()
