"""The real window under Xvfb, with a window manager, driven by xdotool; and what happens where there is no display."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

DRIVER = Path(__file__).with_name("drive_window.py")
ROOT = DRIVER.parent.parent.parent


@pytest.fixture
def display() -> Iterator[str]:
    """A display of its own, 1024x768."""
    for name in ("Xvfb", "xdotool", "openbox"):
        if shutil.which(name) is None:
            pytest.skip(f"no {name}: .ci/setup.sh dev installs it")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1024x768x24", "-nolisten", "tcp"],
        pass_fds=(write,), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    name = f":{number}"
    manager = subprocess.Popen(
        ["openbox"], env=os.environ | {"DISPLAY": name}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    time.sleep(0.5)
    yield name
    for process in (manager, server):
        process.terminate()
        process.wait(10)


def environment(**more: str) -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_SESSION_TYPE")}
    return kept | {"PYTHONPATH": str(ROOT)} | more


def test_the_window_does_what_a_user_does(display: str) -> None:
    pytest.importorskip("glfw", reason="the extra `viewer` is not installed")
    done = subprocess.run(
        [sys.executable, str(DRIVER)], env=environment(DISPLAY=display), capture_output=True, text=True, timeout=120
    )
    if done.returncode == 3:
        pytest.skip(f"the display gives no OpenGL 4.3: {done.stderr}")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.pop("backend") == "window" and found.pop("size") == [490, 200] and found.pop("picture") == [160, 200]
    assert found.pop("clipboard").startswith("glhybrid render cornell --size 160x200 --camera 'eye=")
    assert found.pop("errors") == []
    assert found and all(value is True for value in found.values()), found


def run_view(*words: str, **more: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "glhybrid", "view", "cornell", "--size", "64x48", *words]
    return subprocess.run(command, env=environment(**more), capture_output=True, text=True, timeout=60)


def test_without_a_display_it_says_what_to_use() -> None:
    done = run_view()
    assert done.returncode == 3 and "Traceback" not in done.stderr
    assert "no display" in done.stderr and "--web" in done.stderr and "render" in done.stderr


def test_a_display_that_is_not_there() -> None:
    done = run_view(DISPLAY=":987")
    assert done.returncode == 3 and "Traceback" not in done.stderr and "--web" in done.stderr


def test_a_window_on_another_device_is_refused() -> None:
    done = run_view("--device", "egl:0")
    assert done.returncode == 2 and "--web" in done.stderr


def test_a_display_without_opengl_43(display: str) -> None:
    pytest.importorskip("glfw", reason="the extra `viewer` is not installed")
    done = run_view(DISPLAY=display, MESA_GL_VERSION_OVERRIDE="3.3", LIBGL_ALWAYS_SOFTWARE="1")
    assert done.returncode == 3 and "4.3" in done.stderr and "Traceback" not in done.stderr


def test_places_in_points_are_told_in_pixels() -> None:
    """As on Wayland and macOS, whose windows count points: here twice as many pixels across, and 1.5 times as high."""
    from types import SimpleNamespace

    pytest.importorskip("imgui_bundle", reason="the extra `viewer` is not installed")
    from glhybrid.viewer.window import Window

    window = object.__new__(Window)
    window._window = None
    window._glfw = SimpleNamespace(
        get_window_size=lambda _: (100, 80), get_framebuffer_size=lambda _: (200, 120),
        get_window_content_scale=lambda _: (2.0, 1.5),
    )  # fmt: skip
    assert window._pixels(50, 40) == (100, 60) and window.size == (200, 120) and window.scale == 2.0
