"""The viewer on a surface in memory: every part but the window itself. Skipped where its libraries are absent."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("imgui_bundle", reason="the extra `viewer` is not installed")

import glhybrid
from glhybrid.context import Context
from glhybrid.scene import Scene
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.panels import WIDTH
from glhybrid.viewer.session import Session
from glhybrid.viewer.surface import Memory

PICTURE_SIZE = (96, 64)
Open = Callable[..., Viewer]


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CONFIG", str(tmp_path / "config"))


@pytest.fixture
def open_viewer(context: Context) -> Iterator[Open]:
    """open_viewer(scene, name, **session): a viewer whose picture has PICTURE_SIZE, panel shown."""
    opened: list[Viewer] = []

    def open_(scene: Scene | str = "cornell", size: tuple[int, int] = PICTURE_SIZE, **state: Any) -> Viewer:
        loaded = glhybrid.load(scene) if isinstance(scene, str) else scene
        session = Session(loaded, scene if isinstance(scene, str) else "scene.glb", **state)
        surface = Memory(context, (size[0] + WIDTH, size[1]))
        opened.append(Viewer(surface, session, glhybrid.load, watch=False))
        return opened[-1]

    yield open_
    for viewer in opened:
        viewer.close()
