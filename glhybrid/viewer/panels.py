"""The panel: every choice of a session as a widget. Widgets only read and write the session, or name an action."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from glhybrid import techniques
from glhybrid.image import AOVS
from glhybrid.settings import TONE_MAPS, Settings
from glhybrid.viewer import camera_control, transport_bar
from glhybrid.viewer.controls import Controls
from glhybrid.viewer.gui import Gui
from glhybrid.viewer.pictures import Pictures
from glhybrid.viewer.session import MODES, Mode, Session
from glhybrid.viewer.store import Bookmarks
from glhybrid.viewer.views import PICTURE

WIDTH = 330
TITLES: dict[Mode, str] = {"single": "One", "split": "Split", "difference": "Difference", "flip": "FLIP"}


class Panels:
    """act: carries out an action by its name, as Controls.act."""

    def __init__(
        self, gui: Gui, session: Session, pictures: Pictures, controls: Controls, bookmarks: Bookmarks,
        act: Callable[[str], None], scale: float,
    ) -> None:  # fmt: skip
        self._gui, self._session, self._pictures, self._controls = gui, session, pictures, controls
        self._bookmarks, self._act, self._scale = bookmarks, act, scale

    @property
    def width(self) -> int:
        """Pixels at the right that the panel takes."""
        return round(WIDTH * self._scale) if self._session.panel else 0

    def draw(self, size: tuple[int, int]) -> None:
        """All of it, for this frame. size: of the surface, pixels."""
        imgui = self._gui.imgui
        if self._session.scene.animations:
            transport_bar.draw(self._gui, self._session, self._controls, (size[0] - self.width, size[1]), self._scale)
        if not self._session.panel:
            return
        flags = imgui.WindowFlags_
        imgui.set_next_window_pos((size[0] - self.width, 0))
        imgui.set_next_window_size((self.width, size[1]))
        fixed = flags.no_title_bar | flags.no_resize | flags.no_move | flags.no_saved_settings
        imgui.begin("panel", None, fixed | flags.no_bring_to_front_on_focus)
        imgui.push_item_width(-96 * self._scale)
        self._heading()
        for title, draw, open_ in (
            ("Techniques", self._techniques, True),
            ("View", self._view, True),
            ("Picked", self._picked, True),
            ("Passes", self._passes, True),
            ("Display", self._display, False),
            ("Light", self._light, False),
            ("Camera", self._camera, False),
        ):
            if title == "Picked" and self._session.picked is None:
                continue
            if imgui.collapsing_header(title, imgui.TreeNodeFlags_.default_open if open_ else 0):
                draw()
                imgui.spacing()
        imgui.pop_item_width()
        imgui.spacing()
        wide = (imgui.get_content_region_avail().x - 6 * self._scale) / 2
        if imgui.button("Save picture", (wide, 0)):
            self._act("save")
        imgui.same_line()
        if imgui.button("Copy command", (wide, 0)):
            self._act("copy")
        if imgui.button("Bookmark", (wide, 0)):
            self._act("bookmark")
        imgui.same_line()
        if imgui.button("Help", (wide, 0)):
            self._session.help = not self._session.help
        imgui.end()

    # Sections

    def _heading(self) -> None:
        imgui, session = self._gui.imgui, self._session
        device, scene = self._pictures.renderer.context.device, session.scene
        imgui.text(scene.name)
        imgui.same_line()
        imgui.text_disabled(f"{scene.triangle_count():,} triangles, {_count(len(scene.lights), 'light')}")
        imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
        name = device.renderer.partition(" (")[0] + (", software" if device.software else "")
        imgui.text_wrapped(f"{name}, {self._pictures.size[0]} x {self._pictures.size[1]}")
        imgui.pop_style_color()
        if scene.warnings and imgui.tree_node(f"{_count(len(scene.warnings), 'note')} on loading"):
            for warning in scene.warnings[:20]:
                imgui.text_wrapped(warning)
            imgui.tree_pop()
        imgui.spacing()

    def _techniques(self) -> None:
        imgui, session = self._gui.imgui, self._session
        for i, mode in enumerate(MODES):
            if i:
                imgui.same_line()
            if imgui.radio_button(TITLES[mode], session.mode == mode):
                session.mode = mode
                session.edited()
        self._side("a")
        if session.mode == "split" or session.flipped or session.against == "b":
            self._side("b")
        elif imgui.small_button("flip to B  (X)"):
            self._controls.flip()
        changed, value = imgui.checkbox("Reference", session.reference)
        if changed:
            session.reference = value
            session.edited()
        picture = self._pictures.picture("reference")
        if self._pictures.measured:
            imgui.same_line()
            imgui.progress_bar(picture.share, (-1, 0), f"{picture.done} of {picture.total} paths")
            self._slider("samples", "paths", 1, 4096)
        if session.mode in ("difference", "flip"):
            imgui.align_text_to_frame_padding()
            imgui.text("Against")
            for key, label in (("reference", "reference"), ("b", "B")):
                imgui.same_line()
                if imgui.radio_button(label, session.against == key):
                    session.against = key  # type: ignore[assignment]
                    session.edited()
            if session.mode == "difference":
                curve = imgui.SliderFlags_.logarithmic
                changed, gain = imgui.slider_float("gain", session.gain, 1.0, 64.0, "%.0f x", curve)
                session.gain = gain if changed else session.gain

    def _side(self, side: Literal["a", "b"]) -> None:
        imgui, session = self._gui.imgui, self._session
        settings: Settings = getattr(session, side)
        imgui.push_id(side)
        looked_at = side in self._pictures.shown()
        imgui.align_text_to_frame_padding()
        imgui.text_colored((0.93, 0.62, 0.26, 1.0) if looked_at else (0.6, 0.6, 0.6, 1.0), side.upper())
        imgui.same_line()
        imgui.begin_group()
        for kind in techniques.TECHNIQUES:
            current = getattr(settings, kind)
            if imgui.begin_combo(kind, current):
                for name, technique in techniques.TECHNIQUES[kind].items():
                    if imgui.selectable(name, name == current)[0]:
                        session.set(side, **{kind: name})
                    if imgui.is_item_hovered():
                        imgui.set_tooltip(technique.summary)
                imgui.end_combo()
        chosen = [table[getattr(settings, kind)] for kind, table in techniques.TECHNIQUES.items()]
        if any(t.parameters for t in chosen) and imgui.tree_node("parameters"):
            for technique in chosen:
                for parameter in technique.parameters:
                    self._parameter(side, settings, technique, parameter)
            imgui.tree_pop()
        imgui.end_group()
        imgui.pop_id()

    def _parameter(
        self, side: Literal["a", "b"], settings: Settings, technique: techniques.Technique, row: techniques.Parameter
    ) -> None:
        imgui, key = self._gui.imgui, technique.key(row)
        value = settings.parameter(key)
        label = f"{row.name.replace('_', ' ')}##{key}"
        low, high = row.low if row.low is not None else 0, row.high if row.high is not None else 1e6
        new = value
        if row.choices:
            index = row.choices.index(value)
            new = row.choices[imgui.combo(label, index, list(row.choices))[1]]
        elif isinstance(row.default, bool):
            new = imgui.checkbox(label, value)[1]
        elif isinstance(row.default, int):
            new = imgui.slider_int(label, value, int(low), int(high), "%d", self._curve(low, high))[1]
        elif isinstance(row.default, float):
            new = imgui.slider_float(label, value, low, high, "%.3g", self._curve(low, high))[1]
        if imgui.is_item_hovered():
            imgui.set_tooltip(f"{row.summary}\n{key}")
        if new != value:
            if isinstance(new, (int, float)) and not isinstance(new, bool):
                new = type(row.default)(min(max(new, low), high))
            self._session.set(side, parameters={key: new})

    def _curve(self, low: float, high: float) -> Any:
        flags = self._gui.imgui.SliderFlags_
        return flags.logarithmic if high - low > 50 else 0

    def _slider(self, name: str, label: str, low: int, high: int) -> None:
        imgui, session = self._gui.imgui, self._session
        value = int(getattr(session.a, name))
        changed, new = imgui.slider_int(label, value, low, high, "%d", imgui.SliderFlags_.logarithmic)
        if changed and imgui.is_item_deactivated_after_edit() is False and new != value:
            session.set("a", **{name: min(max(new, low), high)})

    def _view(self) -> None:
        imgui, session = self._gui.imgui, self._session
        if imgui.begin_combo("shows", session.show.replace("_", " ")):
            for name in self.views():
                if imgui.selectable(name.replace("_", " "), name == session.show)[0]:
                    session.show = name
                    session.edited()
                if name in AOVS and imgui.is_item_hovered():
                    imgui.set_tooltip(AOVS[name].meaning)
            imgui.end_combo()
        if session.show == "visibility" and len(session.scene.lights) > 1:
            names = ["all", *(f"{i} {p.name or p.kind}" for i, p in enumerate(session.scene.lights))]
            changed, index = imgui.combo("light", session.light_shown + 1, names)
            if changed:
                session.light_shown = index - 1
                session.edited()

    def views(self) -> tuple[str, ...]:
        """The picture, every AOV, and every image that a pass keeps besides."""
        rest = (c for c in self._pictures.channels() if c not in AOVS and c not in ("aov", "display"))
        return (PICTURE, *AOVS, *rest)

    def _passes(self) -> None:
        imgui, session = self._gui.imgui, self._session
        for side in self._pictures.shown():
            picture = self._pictures.picture(side)
            medians = picture.medians()
            total = sum(medians.values())
            if not medians:
                imgui.text_disabled("measured at rest")
                continue
            flags = imgui.TableFlags_
            if imgui.begin_table(f"passes {side}", 3, flags.row_bg | flags.sizing_stretch_prop):
                imgui.table_setup_column("pass", 0, 0.34)
                imgui.table_setup_column("ms", 0, 0.24)
                imgui.table_setup_column("share", 0, 0.42)
                for name, ms in (*medians.items(), ("all", total)):
                    imgui.table_next_row()
                    imgui.table_next_column()
                    if name == "all":
                        imgui.text_disabled(f"{side.upper()} all")
                    elif imgui.selectable(name, False, imgui.SelectableFlags_.span_all_columns)[0]:
                        session.show = self._pictures.pass_view(name)
                        session.edited()
                    imgui.table_next_column()
                    imgui.push_font(self._gui.mono, 0)
                    imgui.text(f"{ms:8.2f}")
                    imgui.pop_font()
                    imgui.table_next_column()
                    if name != "all":
                        imgui.progress_bar(ms / max(total, 1e-9), (-1, 0.8 * imgui.get_text_line_height()), "")
                imgui.end_table()
            rows = [np.array(v, np.float32) for v in picture.ms.values()]
            count = min(len(r) for r in rows)
            history = np.sum([r[len(r) - count :] for r in rows], axis=0, dtype=np.float32)
            if count > 1:
                top = float(history.max()) * 1.6  # room for the text, which stands at the top
                text = f"median {float(np.median(history)):.2f} ms of {count} samples"
                imgui.plot_lines(f"##history {side}", history, 0, text, 0.0, top, (-1, 48 * self._scale))
            if error := self._pictures.measure.errors.get(side):
                flip = f"   FLIP {error.flip:.4f}" if error.flip is not None else ""
                imgui.text(f"{side.upper()}  {total:.1f} ms{flip}")
                imgui.text_disabled(f"{error.psnr:.2f} dB, relMSE {error.rel_mse:.3g}, {error.samples} paths")
        imgui.text_disabled("click a pass to see its image" if session.show == PICTURE else "V or Esc: other views")

    def _picked(self) -> None:
        imgui, session = self._gui.imgui, self._session
        picked = session.picked
        assert picked is not None
        scene = session.scene
        if picked.instance < 0:
            imgui.text(f"pixel {picked.pixel[0]}, {picked.pixel[1]}: nothing but the environment")
            return
        instance = scene.instances[picked.instance]
        name = instance.name or scene.meshes[instance.mesh].name
        material = scene.materials[picked.material]
        rows = [
            ("object", f"{picked.instance}  {name}"),
            ("material", f"{picked.material}  {material.name}"),
            (
                "",
                f"roughness {material.roughness:.3g}, metallic {material.metallic:.3g}, {material.alpha_mode.lower()}",
            ),
            ("triangle", f"{picked.triangle:,}"),
            ("position", ", ".join(f"{v:.4g}" for v in picked.position) + " m"),
            ("normal", ", ".join(f"{v:.3f}" for v in picked.normal)),
            ("distance", f"{picked.distance:.5g} m"),
            ("visibility", ", ".join(f"{v:.2g}" for v in picked.visibility[:8])),
            ("ray steps", f"{picked.steps} nodes and triangles" if picked.steps else "none: no ray is sent here"),
        ]
        if imgui.begin_table("picked", 2):
            imgui.table_setup_column("what", imgui.TableColumnFlags_.width_fixed, 66 * self._scale)
            for what, text in rows:
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text_disabled(what)
                imgui.table_next_column()
                imgui.text_wrapped(text)
            imgui.end_table()
        if imgui.small_button("frame it  (F)"):
            self._act("frame")

    def _display(self) -> None:
        imgui, session = self._gui.imgui, self._session
        auto = session.a.exposure == "auto"
        changed, wanted = imgui.checkbox("automatic exposure", auto)
        if changed:
            session.set("a", exposure="auto" if wanted else round(self._pictures.sides["a"].exposure_ev(), 2))
        if not auto:
            changed, value = imgui.slider_float("exposure", float(session.a.exposure), -12.0, 12.0, "%+.2f EV")
            if changed:
                session.set("a", exposure=round(value, 2))
        tone = TONE_MAPS.index(session.a.tone)
        changed, index = imgui.combo("tone map", tone, list(TONE_MAPS))
        if changed:
            session.set("a", tone=TONE_MAPS[index])
        changed, count = imgui.slider_int("samples", session.a.aa or 4, 1, 64)
        if changed:
            session.set("a", aa=min(max(count, 1), 64))

    def _light(self) -> None:
        imgui, session = self._gui.imgui, self._session
        for i, light in enumerate(session.scene.lights[:16]):
            imgui.push_id(str(i))
            imgui.text(f"{i}  {light.name or light.kind}")
            if light.kind == "point":
                imgui.same_line()
                imgui.text_disabled("no direction")
            else:
                azimuth, elevation = session.light_angle(i)
                turned, azimuth = imgui.slider_float("azimuth", azimuth, -180.0, 180.0, "%.1f deg")
                raised, elevation = imgui.slider_float("elevation", elevation, -90.0, 90.0, "%.1f deg")
                if turned or raised:
                    session.turn_light(i, azimuth, elevation)
            imgui.pop_id()
        if session.scene.environment is not None:
            changed, angle = imgui.slider_float("environment", session.environment_angle, -180.0, 180.0, "%.1f deg")
            if changed:
                session.turn_environment(angle)
        if (session.light_angles or session.environment_deg is not None) and imgui.small_button("as in the file"):
            session.light_angles.clear()
            session.environment_deg = None
            session.moved()

    def _camera(self) -> None:
        imgui, session = self._gui.imgui, self._session
        names = [c.name or str(i) for i, c in enumerate(session.scene.cameras)]
        shown = "free" if session.pose is not None else names[session.camera_index]
        if imgui.begin_combo("camera", shown):
            for i, name in enumerate(names):
                if imgui.selectable(f"{name}##{i}", session.pose is None and i == session.camera_index)[0]:
                    session.use_camera(i)
            imgui.end_combo()
        if imgui.small_button("frame  (F)"):
            self._act("frame")
        if session.pose is not None:
            eye = session.pose.eye
            imgui.same_line()
            imgui.text_disabled(f"eye {eye[0]:.3g}, {eye[1]:.3g}, {eye[2]:.3g}")
            if session.pose.fov:
                changed, fov = imgui.slider_float("field of view", session.pose.fov, 5.0, 150.0, "%.1f deg")
                if changed:
                    session.move_to(replace(session.pose, fov=round(fov, 2)))
        for name, pose in self._bookmarks.of(session.source):
            imgui.push_id(name)
            if imgui.small_button("x"):
                self._bookmarks.remove(session.source, name)
            imgui.same_line()
            if imgui.selectable(name, session.pose == pose)[0]:
                session.move_to(pose)
            imgui.pop_id()
        away = camera_control.distance(session.pose) if session.pose is not None else 0.0
        if away:
            imgui.text_disabled(f"{away:.4g} m to what it turns about; flying speed x {self._controls.speed:.2g}")


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
