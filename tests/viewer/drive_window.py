"""Run by test_window.py on a display of its own: the real window, real key presses and pointer moves by xdotool.

Prints one JSON object of what was seen. Not a test by itself.
"""

import json
import subprocess
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import ImageGrab

import glhybrid
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.panels import WIDTH
from glhybrid.viewer.session import Session
from glhybrid.viewer.window import Window

SIZE = (160, 200)


def xdotool(*words: object) -> None:
    subprocess.run(["xdotool", *(str(w) for w in words)], check=True, timeout=20)


def until(viewer: Viewer, condition: Callable[[], bool], patience: float = 20.0) -> bool:
    end = time.monotonic() + patience
    while time.monotonic() < end and viewer.running:
        viewer.tick()
        if condition():
            return True
    return condition()


def on_screen(viewer: Viewer) -> np.ndarray:
    """The window's pixels as the X server has them."""
    import glfw

    x, y = glfw.get_window_pos(viewer.surface.handle)  # type: ignore[attr-defined]
    w, h = viewer.surface.size
    end = time.monotonic() + 5
    want = viewer.canvas_rgb()
    while True:  # the server shows a frame some time after it was given one
        grabbed = np.asarray(ImageGrab.grab(bbox=(x, y, x + w, y + h)).convert("RGB"))
        if np.array_equal(grabbed, want) or time.monotonic() > end:
            return grabbed
        time.sleep(0.05)


def main() -> dict[str, Any]:
    found: dict[str, Any] = {}
    window = Window((SIZE[0] + WIDTH, SIZE[1]), vsync=False)
    viewer = Viewer(window, Session(glhybrid.load("cornell"), "cornell"), glhybrid.load, watch=False)
    session = viewer.session
    found["backend"], found["size"] = window.context.device.backend, list(window.size)
    viewer.settle()
    found["picture"] = viewer.picture_size
    shot = on_screen(viewer)
    found["canvas on screen"] = bool(np.array_equal(shot, viewer.canvas_rgb()))
    frame = viewer.renderer.render(session.scene, size=viewer.picture_size)
    region = shot[: viewer.picture_size[1], : viewer.picture_size[0]]
    found["render's pixels"] = bool(np.array_equal(region[60:], frame.rgb[60:]))  # under the label
    viewer.pictures.restart()

    import glfw

    left, top = glfw.get_window_pos(window.handle)
    middle = left + SIZE[0] // 2, top + 130
    xdotool("mousemove", *middle)
    until(viewer, lambda: viewer.controls.pointer[0] > 0)
    xdotool("mousedown", 1, "mousemove_relative", 10, 4, "mousemove_relative", 20, 6, "mouseup", 1)
    found["orbit"] = until(viewer, lambda: session.pose is not None)
    before = session.pose
    xdotool("click", 4)
    found["wheel"] = until(viewer, lambda: session.pose != before)
    xdotool("mousemove", *middle, "click", 1)
    found["pick"] = until(viewer, lambda: session.picked is not None)
    xdotool("key", "m")
    found["key"] = until(viewer, lambda: session.mode == "split")
    before = session.pose
    xdotool("mousemove", left + SIZE[0] // 2, top + 130, "mousedown", 3, "keydown", "w")
    found["fly"] = until(viewer, lambda: viewer.controls.flying and session.pose != before)
    xdotool("keyup", "w", "mouseup", 3)
    found["fly ends"] = until(viewer, lambda: not viewer.controls.flying)
    xdotool(
        "mousemove", left + SIZE[0] // 2, top + 170, "mousedown", 1, "mousemove_relative", "--", -40, 0, "mouseup", 1
    )
    found["divider"] = until(viewer, lambda: session.divider < 0.3)
    xdotool("key", "c")
    found["copied"] = until(viewer, lambda: any(s.text.startswith("copied:") for s in session.said))
    found["clipboard"] = window.get_clipboard()

    glfw.set_window_size(window.handle, SIZE[0] + WIDTH + 60, SIZE[1] + 40)
    found["resize"] = until(viewer, lambda: viewer.picture_size == (SIZE[0] + 60, SIZE[1] + 40))
    viewer.settle()
    found["resized on screen"] = bool(np.array_equal(on_screen(viewer), viewer.canvas_rgb()))

    frames = viewer.frames
    glfw.iconify_window(window.handle)
    found["minimised"] = until(viewer, lambda: not window.visible)
    session.moved()
    frames = viewer.frames
    for _ in range(5):
        viewer.tick()
    found["nothing drawn while minimised"] = viewer.frames == frames
    glfw.restore_window(window.handle)
    found["restored"] = until(viewer, lambda: window.visible and viewer.frames > frames)
    viewer.settle()
    found["errors"] = window.context.raw.errors() + [s.text for s in session.said if s.error]
    xdotool("key", "alt+F4")  # the window manager asks the window to close
    found["closed"] = until(viewer, lambda: not viewer.running)
    viewer.close()
    window.close()
    window.close()
    return found


if __name__ == "__main__":
    print(json.dumps(main()))
