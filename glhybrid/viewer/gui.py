"""Dear ImGui on moderngl: its draw lists, its textures and its input, on any framebuffer.

imgui-bundle's own OpenGL backend needs PyOpenGL, which chooses a platform at import; this one uses the context we have.
Coordinates are pixels of the framebuffer; `scale` enlarges fonts and spacing.
"""

import ctypes
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from glhybrid.context import Context
from glhybrid.viewer import need
from glhybrid.viewer.events import DIGITS, Button, Event, Focus, Key, Move, Text, Wheel
from glhybrid.viewer.surface import Surface

FONT_PX, SMALL_PX = 15.0, 14.0
_VERTEX = """#version 430 core
layout(location = 0) in vec2 in_position;
layout(location = 1) in vec2 in_uv;
layout(location = 2) in vec4 in_color;
uniform vec2 pixels;
out vec2 uv;
out vec4 color;
void main() {
    uv = in_uv;
    color = in_color;
    gl_Position = vec4(in_position.x / pixels.x * 2.0 - 1.0, 1.0 - in_position.y / pixels.y * 2.0, 0.0, 1.0);
}
"""
_FRAGMENT = """#version 430 core
in vec2 uv;
in vec4 color;
uniform sampler2D image;
layout(location = 0) out vec4 out_color;
void main() { out_color = color * texture(image, uv); }
"""
_MODIFIERS = {"ctrl": "mod_ctrl", "shift": "mod_shift", "alt": "mod_alt", "super": "mod_super"}


class Gui:
    """One ImGui context and its GL objects. begin() ... widgets ... draw(framebuffer)."""

    def __init__(self, context: Context, surface: Surface) -> None:
        self.imgui = imgui = need("imgui_bundle", "viewer").imgui
        self._context, self._surface = context, surface
        self._imgui_context = imgui.create_context()
        imgui.set_current_context(self._imgui_context)
        self.io = imgui.get_io()
        self.io.set_ini_filename("")
        self.io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
        self.io.config_windows_move_from_title_bar_only = True
        platform = imgui.get_platform_io()
        platform.renderer_texture_max_width = platform.renderer_texture_max_height = context.limits.texture_size
        platform.platform_get_clipboard_text_fn = lambda _: surface.get_clipboard()
        platform.platform_set_clipboard_text_fn = lambda _, text: surface.set_clipboard(text)
        gl = context.gl
        self._program: Any = gl.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._vertices = gl.buffer(reserve=1 << 16, dynamic=True)
        self._indices = gl.buffer(reserve=1 << 16, dynamic=True)
        self._vao = self._make_vao()
        self._own: dict[int, moderngl.Texture] = {}
        self._given: dict[int, moderngl.Texture] = {}
        self._cursor = ""
        self.scale = surface.scale
        self._load_fonts()
        self._style(self.scale)

    def _load_fonts(self) -> None:
        folder = Path(need("imgui_bundle", "viewer").__file__ or "").parent / "assets" / "fonts"
        fonts = self.io.fonts
        files = (folder / "Roboto" / "Roboto-Regular.ttf", FONT_PX), (folder / "Inconsolata-Medium.ttf", SMALL_PX)
        self.font, self.mono = (
            fonts.add_font_from_file_ttf(str(file), size) if file.is_file() else fonts.add_font_default()
            for file, size in files
        )

    def _style(self, scale: float) -> None:
        imgui = self.imgui
        style = imgui.get_style()
        imgui.style_colors_dark(style)
        style.window_rounding = style.child_rounding = 0.0
        style.frame_rounding = style.grab_rounding = style.popup_rounding = 3.0
        style.window_border_size = style.frame_border_size = 0.0
        style.window_padding, style.frame_padding = imgui.ImVec2(10, 8), imgui.ImVec2(6, 3)
        style.item_spacing, style.item_inner_spacing = imgui.ImVec2(6, 5), imgui.ImVec2(5, 4)
        style.scrollbar_size, style.grab_min_size, style.indent_spacing = 11.0, 9.0, 12.0
        accent, surface = (0.93, 0.62, 0.26), (0.115, 0.12, 0.13)
        c = imgui.Col_
        colors: dict[Any, tuple[float, ...]] = {
            c.window_bg: (*surface, 1.0), c.popup_bg: (0.14, 0.145, 0.155, 0.99), c.text: (0.90, 0.90, 0.88, 1.0),
            c.text_disabled: (0.55, 0.56, 0.57, 1.0), c.frame_bg: (0.19, 0.20, 0.215, 1.0),
            c.frame_bg_hovered: (0.25, 0.26, 0.28, 1.0), c.frame_bg_active: (0.30, 0.31, 0.33, 1.0),
            c.header: (0.165, 0.172, 0.185, 1.0), c.header_hovered: (0.235, 0.245, 0.26, 1.0),
            c.header_active: (0.28, 0.29, 0.31, 1.0), c.button: (0.215, 0.225, 0.24, 1.0),
            c.button_hovered: (0.29, 0.30, 0.32, 1.0), c.button_active: (*accent, 0.75), c.slider_grab: (*accent, 0.9),
            c.slider_grab_active: (*accent, 1.0), c.check_mark: (*accent, 1.0), c.separator: (0.23, 0.24, 0.255, 1.0),
            c.plot_lines: (*accent, 1.0), c.plot_histogram: (*accent, 0.85), c.text_selected_bg: (*accent, 0.35),
            c.scrollbar_bg: (0, 0, 0, 0), c.table_row_bg_alt: (1, 1, 1, 0.025), c.border: (0.25, 0.26, 0.28, 1.0),
            c.nav_cursor: (*accent, 0.8), c.title_bg: (0.165, 0.172, 0.185, 1.0),
            c.title_bg_active: (0.2, 0.21, 0.225, 1.0),
        }  # fmt: skip
        for index, color in colors.items():
            style.set_color_(index, imgui.ImVec4(*color))
        style.scale_all_sizes(scale)
        style.font_scale_dpi = scale

    def _make_vao(self) -> Any:
        content = [(self._vertices, "2f4 2f4 4f1", "in_position", "in_uv", "in_color")]
        return self._context.gl.vertex_array(
            self._program, content, self._indices, index_element_size=self.imgui.INDEX_SIZE
        )

    def feed(self, events: Iterable[Event]) -> None:
        """Input for ImGui. What it does not want (`wants_pointer`, `wants_keys`) is the picture's."""
        imgui, io = self.imgui, self.io
        for event in events:
            if isinstance(event, Move):
                io.add_mouse_pos_event(event.x, event.y)
            elif isinstance(event, Button):
                if event.button < 3:
                    io.add_mouse_button_event(event.button, event.down)
            elif isinstance(event, Wheel):
                io.add_mouse_wheel_event(event.dx, event.dy)
            elif isinstance(event, Key):
                name = f"_{event.name}" if event.name in DIGITS else event.name
                modifier = _MODIFIERS.get(event.name.partition("_")[2])
                if modifier is not None and event.name.startswith(("left_", "right_")):
                    io.add_key_event(getattr(imgui.Key, modifier), event.down)
                io.add_key_event(getattr(imgui.Key, name), event.down)
            elif isinstance(event, Text):
                for character in event.text:
                    if character.isprintable():
                        io.add_input_character(ord(character))
            elif isinstance(event, Focus):
                io.add_focus_event(event.focused)

    @property
    def wants_pointer(self) -> bool:
        """Whether the panel, not the camera, gets what the pointer does."""
        return bool(self.io.want_capture_mouse)

    @property
    def wants_keys(self) -> bool:
        """Whether a text is being typed."""
        return bool(self.io.want_text_input)

    def begin(self, seconds: float) -> None:
        """A new frame, this long after the one before."""
        self.imgui.set_current_context(self._imgui_context)
        self.io.display_size = self.imgui.ImVec2(*self._surface.size)
        self.io.delta_time = max(seconds, 1e-4)
        self.imgui.new_frame()

    def texture(self, image: moderngl.Texture) -> Any:
        """What widgets take for an image. It must live until draw()."""
        self._given[image.glo] = image
        return self.imgui.ImTextureRef(image.glo)

    def draw(self, framebuffer: Any) -> None:
        """Ends the frame and draws it over what the framebuffer holds."""
        imgui, gl = self.imgui, self._context.gl
        imgui.render()
        data = imgui.get_draw_data()
        for texture in imgui.get_platform_io().textures:
            if texture.status != imgui.ImTextureStatus.ok:
                self._update(texture)
        width, height = framebuffer.size
        framebuffer.use()
        framebuffer.viewport = (0, 0, width, height)
        gl.enable_only(moderngl.BLEND)
        blend: Any = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA, moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        gl.blend_func = blend
        self._program["pixels"].value = width, height
        self._program["image"].value = 0
        for commands in data.cmd_lists:
            self._upload(commands)
            for command in commands.cmd_buffer:
                left, top, right, bottom = (round(v) for v in command.clip_rect)
                x0, y0, x1, y1 = max(left, 0), max(top, 0), min(right, width), min(bottom, height)
                number = command.tex_ref.get_tex_id()
                image = self._own.get(number) or self._given.get(number)
                if x1 <= x0 or y1 <= y0 or image is None:
                    continue
                framebuffer.scissor = x0, height - y1, x1 - x0, y1 - y0
                image.use(0)
                self._vao.render(moderngl.TRIANGLES, command.elem_count, first=command.idx_offset)
        framebuffer.scissor = None
        gl.enable_only(moderngl.NOTHING)
        self._given.clear()
        self._show_cursor()

    def _upload(self, commands: Any) -> None:
        imgui = self.imgui
        vertices = ctypes.string_at(commands.vtx_buffer.data_address(), commands.vtx_buffer.size() * imgui.VERTEX_SIZE)
        indices = ctypes.string_at(commands.idx_buffer.data_address(), commands.idx_buffer.size() * imgui.INDEX_SIZE)
        if len(vertices) > self._vertices.size or len(indices) > self._indices.size:
            self._vao.release()
            for buffer, needed in ((self._vertices, len(vertices)), (self._indices, len(indices))):
                if needed > buffer.size:
                    buffer.orphan(1 << needed.bit_length())
            self._vao = self._make_vao()
        self._vertices.write(vertices)
        self._indices.write(indices)

    def _update(self, texture: Any) -> None:
        """What ImGui's own backends do: atlases of glyphs are made, grown and freed as it asks."""
        imgui, status = self.imgui, self.imgui.ImTextureStatus
        if texture.status in (status.want_create, status.want_updates):
            pixels = np.asarray(texture.get_pixels_array(), np.uint8)
            if texture.status == status.want_create:
                made = self._context.gl.texture((texture.width, texture.height), 4, pixels.tobytes())
                made.repeat_x = made.repeat_y = False
                self._own[made.glo] = made
                texture.set_tex_id(made.glo)
            else:
                image = pixels.reshape(texture.height, texture.width, 4)
                for r in texture.updates:
                    part = np.ascontiguousarray(image[r.y : r.y + r.h, r.x : r.x + r.w])
                    self._own[texture.tex_id].write(part, viewport=(r.x, r.y, r.w, r.h))
            texture.status = status.ok
        elif texture.status == status.want_destroy:
            if old := self._own.pop(texture.tex_id, None):
                old.release()
            texture.set_tex_id(0)
            texture.status = imgui.ImTextureStatus.destroyed

    def _show_cursor(self) -> None:
        names = {
            self.imgui.MouseCursor_.hand: "hand", self.imgui.MouseCursor_.text_input: "text",
            self.imgui.MouseCursor_.resize_ew: "resize_ew", self.imgui.MouseCursor_.resize_ns: "resize_ns",
        }  # fmt: skip
        name = next((n for value, n in names.items() if self.imgui.get_mouse_cursor() == value), "arrow")
        if name != self._cursor:
            self._cursor = name
            self._surface.cursor(name)

    def close(self) -> None:
        """Frees everything. Twice is harmless."""
        if self._imgui_context is None:
            return
        imgui = self.imgui
        imgui.set_current_context(self._imgui_context)
        for texture in imgui.get_platform_io().textures:
            texture.set_tex_id(0)
            texture.status = imgui.ImTextureStatus.destroyed
        self.io.backend_flags &= ~int(imgui.BackendFlags_.renderer_has_textures)
        imgui.destroy_context(self._imgui_context)
        self._imgui_context = None
        self._context.raw.glUseProgram(0)  # a program in use outlives its release
        for thing in (*self._own.values(), self._vao, self._vertices, self._indices, self._program):
            thing.release()
        self._own.clear()
