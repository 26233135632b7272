"""A window of the desktop, by glfw: an OpenGL 4.3 core context of its own, and events.

glfw reports through callbacks; they only append to a list, so nothing runs in the middle of glfw's own code.
"""

import logging
import os
import sys
from typing import Any, Self

from glhybrid import egl
from glhybrid.context import Context, is_software
from glhybrid.errors import DeviceError, SettingError
from glhybrid.gl import GL_COLOR_BUFFER_BIT, GL_DRAW_FRAMEBUFFER, GL_NEAREST, GL_READ_FRAMEBUFFER
from glhybrid.viewer import need
from glhybrid.viewer.events import (
    DIGITS,
    LETTERS,
    Button,
    Close,
    Drop,
    Event,
    Focus,
    Key,
    Move,
    Text,
    Wheel,
)  # fmt: skip

log = logging.getLogger("glhybrid")
WITHOUT = "use `glhybrid render`, or `glhybrid view SCENE --web 8080` for the viewer in a browser"
DEVICES = ("auto", "gpu", "software")


class Native:
    """The window's context as glhybrid.context.Context wants it."""

    def __init__(self, glfw: Any, window: Any) -> None:
        self._glfw, self._window = glfw, window
        self.make_current()

    def load_opengl_function(self, name: str) -> int:
        return self._glfw.get_proc_address(name) or 0

    load = load_opengl_function

    def make_current(self) -> None:
        egl.unbind()  # libglvnd refuses a GLX context while one of EGL's is current
        self._glfw.make_context_current(self._window)

    def is_current(self) -> bool:
        return True  # the viewer's process has no other

    def __enter__(self) -> Self:
        self.make_current()
        return self

    def __exit__(self, *_: object) -> None:
        self.make_current()

    def release(self) -> None:
        """Frees the context with its window. Twice is harmless."""
        if self._window is not None:
            self._glfw.make_context_current(None)
            self._glfw.destroy_window(self._window)
            self._window = None


class Window:
    """A surface on the desktop.

    Raises DeviceError where there is no display or the display's OpenGL is below 4.3 or not the device asked for.
    """

    def __init__(
        self, size: tuple[int, int], device: str = "auto", title: str = "glhybrid", vsync: bool = True
    ) -> None:
        if device not in DEVICES:
            raise SettingError(
                f"--device {device}: a window is drawn by the display's own device ({', '.join(DEVICES)}); "
                "--web draws on any"
            )
        if device == "software":
            os.environ["LIBGL_ALWAYS_SOFTWARE"] = "1"  # Mesa reads it when the context is made
        glfw = _load_glfw()
        self._glfw = glfw
        glfw.ERROR_REPORTING = "ignore"
        self._failure = ""
        glfw.set_error_callback(self._note)
        if not glfw.init():
            raise DeviceError(f"no display for a window ({self._failure or 'glfw cannot start'}): {WITHOUT}")
        hints = (
            (glfw.CLIENT_API, glfw.OPENGL_API), (glfw.CONTEXT_VERSION_MAJOR, 4), (glfw.CONTEXT_VERSION_MINOR, 3),
            (glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE), (glfw.OPENGL_FORWARD_COMPAT, 1),
            (glfw.DEPTH_BITS, 0), (glfw.STENCIL_BITS, 0), (glfw.SAMPLES, 0), (glfw.SCALE_TO_MONITOR, 1),
        )  # fmt: skip
        for hint, value in hints:
            glfw.window_hint(hint, value)
        self._window = glfw.create_window(*size, title, None, None)
        if not self._window:
            failure = self._failure or "no reason given"
            glfw.terminate()
            raise DeviceError(f"the display gives no OpenGL 4.3 core context ({failure}): {WITHOUT}")
        self._closed = False
        try:
            self.context = Context(Native(glfw, self._window), "window")
            software = self.context.device.software
            if device == "gpu" and software:
                raise DeviceError(f"the display draws in software ({self.context.device.renderer}), not on a GPU")
            if device == "software" and not is_software(self.context.device.renderer):
                raise DeviceError(f"the display draws on {self.context.device.renderer} whatever is asked for: --web")
        except DeviceError:
            glfw.terminate()
            raise
        log.info("device: %s", self.context.device)
        glfw.swap_interval(1 if vsync else 0)
        self._events: list[Event] = []
        self._keys = _keys(glfw)
        self._listen()

    def _note(self, code: int, text: bytes | str) -> None:
        self._failure = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
        log.debug("glfw %#x: %s", code, self._failure)

    def _listen(self) -> None:
        glfw, window, add = self._glfw, self._window, self._events.append
        glfw.set_cursor_pos_callback(window, lambda _, x, y: add(Move(*self._pixels(x, y))))
        glfw.set_mouse_button_callback(window, lambda _, b, action, mods: add(Button(b, action == glfw.PRESS)))
        glfw.set_scroll_callback(window, lambda _, dx, dy: add(Wheel(dx, dy)))
        glfw.set_char_callback(window, lambda _, code: add(Text(chr(code))))
        glfw.set_drop_callback(window, lambda _, paths: add(Drop(tuple(paths))))
        glfw.set_window_focus_callback(window, lambda _, focused: add(Focus(bool(focused))))
        glfw.set_window_close_callback(window, lambda _: add(Close()))

        def key(_: Any, code: int, scan: int, action: int, mods: int) -> None:
            if name := self._keys.get(code):
                add(Key(name, action != glfw.RELEASE, action == glfw.REPEAT))

        glfw.set_key_callback(window, key)

    def _pixels(self, x: float, y: float) -> tuple[float, float]:
        """Screen coordinates as pixels: they differ on some displays."""
        (width, height), (w, h) = self._glfw.get_window_size(self._window), self.size
        return x * w / max(width, 1), y * h / max(height, 1)

    @property
    def size(self) -> tuple[int, int]:
        """Of the framebuffer, pixels; 1x1 while minimised."""
        width, height = self._glfw.get_framebuffer_size(self._window)
        return max(width, 1), max(height, 1)

    def resize(self, size: tuple[int, int]) -> None:
        """Asks for another size, in screen coordinates; the window manager decides."""
        self._glfw.set_window_size(self._window, *size)

    @property
    def scale(self) -> float:
        return max(1.0, float(self._glfw.get_window_content_scale(self._window)[0]))

    @property
    def visible(self) -> bool:
        size = self._glfw.get_framebuffer_size(self._window)
        return min(size) > 0 and not self._glfw.get_window_attrib(self._window, self._glfw.ICONIFIED)

    @property
    def handle(self) -> Any:
        """glfw's window."""
        return self._window

    def poll(self, timeout: float) -> list[Event]:
        if timeout > 0:
            self._glfw.wait_events_timeout(timeout)
        else:
            self._glfw.poll_events()
        found = list(self._events)
        self._events.clear()
        return found

    def present(self, image: Any, moving: bool) -> None:
        raw, (width, height) = self.context.raw, self.size
        raw.glBindFramebuffer(GL_READ_FRAMEBUFFER, image.glo)
        raw.glBindFramebuffer(GL_DRAW_FRAMEBUFFER, 0)
        w, h = min(width, image.width), min(height, image.height)
        taken, shown = (0, image.height - h, w, image.height), (0, height - h, w, height)  # from the top
        raw.glBlitFramebuffer(*taken, *shown, GL_COLOR_BUFFER_BIT, GL_NEAREST)
        self._glfw.swap_buffers(self._window)

    def title(self, text: str) -> None:
        self._glfw.set_window_title(self._window, text)

    def cursor(self, name: str) -> None:
        """arrow, hand, text, resize_ew, resize_ns or none."""
        glfw = self._glfw
        shapes = {
            "hand": glfw.HAND_CURSOR, "text": glfw.IBEAM_CURSOR, "resize_ew": glfw.HRESIZE_CURSOR,
            "resize_ns": glfw.VRESIZE_CURSOR,
        }  # fmt: skip
        made = self.__dict__.setdefault("_cursors", {})
        if name in shapes and name not in made:
            made[name] = glfw.create_standard_cursor(shapes[name])
        glfw.set_cursor(self._window, made.get(name))

    def get_clipboard(self) -> str:
        text = self._glfw.get_clipboard_string(self._window) or b""
        return text.decode("utf-8", "replace")

    def set_clipboard(self, text: str) -> None:
        self._glfw.set_clipboard_string(self._window, text)

    def close(self) -> None:
        """Frees window and context. Twice is harmless."""
        if not self._closed:
            self._closed = True
            self.context.close()
            self._glfw.terminate()


def _load_glfw() -> Any:
    """imgui-bundle comes first: it brings a glfw for X11, needs that one, and would take any that is there before.

    On a Wayland desktop it works by Xwayland; where there is none, glfw's own for Wayland is loaded beside it.
    """
    need("imgui_bundle", "viewer")
    if os.environ.get("WAYLAND_DISPLAY") and not os.environ.get("DISPLAY"):
        os.environ.pop("PYGLFW_LIBRARY", None)  # imgui-bundle has set it to its own, and imported it
        os.environ["PYGLFW_LIBRARY_VARIANT"] = "wayland"
        for name in [name for name in sys.modules if name.partition(".")[0] == "glfw"]:
            del sys.modules[name]
    return need("glfw", "viewer")


def _keys(glfw: Any) -> dict[int, str]:
    """glfw's codes by our names."""
    codes = {getattr(glfw, f"KEY_{c.upper()}"): c for c in (*LETTERS, *DIGITS)}
    codes |= {getattr(glfw, f"KEY_F{i}"): f"f{i}" for i in range(1, 13)}
    codes |= {getattr(glfw, f"KEY_KP_{i}"): str(i) for i in range(10)}
    for name in (
        "tab", "page_up", "page_down", "home", "end", "insert", "delete", "backspace", "space", "enter", "escape",
        "apostrophe", "comma", "minus", "period", "slash", "semicolon", "equal", "left_bracket", "backslash",
        "right_bracket", "grave_accent", "left_shift", "left_alt", "left_super", "right_shift", "right_alt",
        "right_super",
    ):  # fmt: skip
        codes[getattr(glfw, f"KEY_{name.upper()}")] = name
    for ours, theirs in (
        ("left_ctrl", "LEFT_CONTROL"), ("right_ctrl", "RIGHT_CONTROL"), ("left_arrow", "LEFT"),
        ("right_arrow", "RIGHT"), ("up_arrow", "UP"), ("down_arrow", "DOWN"), ("enter", "KP_ENTER"),
        ("equal", "KP_ADD"), ("minus", "KP_SUBTRACT"),
    ):  # fmt: skip
        codes[getattr(glfw, f"KEY_{theirs}")] = ours
    return codes
