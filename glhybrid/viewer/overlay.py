"""What is drawn over the picture region: the pictures themselves, divider, labels, legend, selection, messages."""

import math
import textwrap
import time as clock
from typing import Any

import numpy as np

from glhybrid.viewer import views
from glhybrid.viewer.controls import HELP, Controls
from glhybrid.viewer.gui import Gui
from glhybrid.viewer.pictures import Pictures, Side
from glhybrid.viewer.session import Session
from glhybrid.viewer.turns import Job
from glhybrid.viewer.views import PICTURE

ACCENT, INK, DIM, BAD = 0xFF429EED, 0xFFE6E6E6, 0xFFB4B0AC, 0xFF5A6CFF  # ABGR
BACK = 0xC0181614


class Overlay:
    """What lies over the picture: labels, legend, divider, messages, help."""

    def __init__(self, gui: Gui, session: Session, pictures: Pictures, controls: Controls, scale: float) -> None:
        self._gui, self._session, self._pictures, self._controls = gui, session, pictures, controls
        self._scale = scale
        self._ramps: dict[str, Any] = {}

    def draw(self, size: tuple[int, int], ramp: Any, job: Job | None = None) -> None:
        """ramp(name): a palette's texture, 256 x 1. job: what is being prepared."""
        imgui = self._gui.imgui
        under, over = imgui.get_background_draw_list(), imgui.get_background_draw_list()
        width, height = size
        under.push_clip_rect((0, 0), size, False)
        self._images(under, width, height)
        self._selection(over, size)
        self._labels(over, width)
        self._legend(over, height, ramp)
        self._messages(over, width, height)
        if job is not None and job.shown:
            self._preparation(over, width, height, job)
        under.pop_clip_rect()
        if self._session.help:
            self._help()

    def _images(self, paint: Any, width: int, height: int) -> None:
        session, pictures = self._session, self._pictures
        if session.mode == "split":
            middle = round(session.divider * width)
            self._image(paint, "a", (0, 0, middle, height), (width, height))
            self._image(paint, "b", (middle, 0, width, height), (width, height))
            color = ACCENT if self._controls.over_divider() or self._controls.dragging == "divider" else INK
            paint.add_line((middle, 0), (middle, height), 0xA0000000, 3.0 * self._scale)
            paint.add_line((middle, 0), (middle, height), color, 1.0 * self._scale)
            radius = 9.0 * self._scale
            paint.add_circle_filled((middle, height / 2), radius, color)
            paint.add_text((middle - 4.2 * self._scale, height / 2 - 8.0 * self._scale), 0xFF202020, "||")
            if self._controls.over_divider():
                self._gui.imgui.set_mouse_cursor(self._gui.imgui.MouseCursor_.resize_ew)
        else:
            self._image(paint, pictures.shown()[0], (0, 0, width, height), (width, height))

    def _image(self, paint: Any, side: Side, clip: tuple[int, int, int, int], size: tuple[int, int]) -> None:
        found = self._pictures.image(side)
        if found is None:
            return
        image, flipped = found
        low, high = ((0, 1), (1, 0)) if flipped else ((0, 0), (1, 1))
        paint.push_clip_rect(clip[:2], clip[2:], True)
        paint.add_image(self._gui.texture(image), (0, 0), size, low, high)
        paint.pop_clip_rect()

    def _label(self, paint: Any, x: float, y: float, lines: list[tuple[str, int]], right: bool = False) -> float:
        """A box of lines at a corner; returns its lower edge."""
        imgui, pad = self._gui.imgui, 6 * self._scale
        sizes = [imgui.calc_text_size(text) for text, _ in lines]
        width, step = max(s.x for s in sizes), sizes[0].y + 2 * self._scale
        left = x - width - 2 * pad if right else x
        bottom = y + step * len(lines) + 2 * pad
        paint.add_rect_filled((left, y), (left + width + 2 * pad, bottom), BACK, 4 * self._scale)
        for i, (text, color) in enumerate(lines):
            paint.add_text((left + pad, y + pad + i * step), color, text)
        return float(bottom)

    def _describe(self, side: Side) -> list[tuple[str, int]]:
        session, pictures = self._session, self._pictures
        settings, picture = session.settings(side), pictures.picture(side)
        chosen = [settings.shadows, settings.reflections, *([settings.ao] if settings.ao != "none" else [])]
        name = "reference" if settings.reflections == "reference" else " + ".join(chosen)
        lines = [(f"{'A' if side == 'a' else 'B'}   {name}", INK)]
        if session.show != PICTURE and session.mode in ("single", "split"):
            lines.append((session.show.replace("_", " "), ACCENT))
        elif session.mode in ("difference", "flip"):
            lines.append((f"{'FLIP' if session.mode == 'flip' else 'difference'} from {self._other()}", ACCENT))
        if pictures.moving and not pictures.frame_ms:
            pass  # nothing was drawn yet
        elif pictures.moving:
            rate = 1e3 / pictures.frame_ms
            if other := pictures.stands_in(side):
                lines.append((f"{other} while light moves", ACCENT))
            lines.append((f"{rate:.{0 if rate >= 10 else 1}f} frames/s at {pictures.scale:.0%}", DIM))
        elif session.show != PICTURE and session.mode in ("single", "split"):
            lines.append(("one ray through each pixel's centre", DIM))
        else:
            ms = sum(picture.medians().values())
            if picture.total:
                text = f"{picture.done} of {picture.total} samples"
                lines.append((text + (f", {_time(ms)} each" if ms else ""), DIM))
        if error := pictures.measure.errors.get(side):
            flip = f"FLIP {error.flip:.3f}   " if error.flip is not None else ""
            lines.append((f"{flip}{error.psnr:.1f} dB   relMSE {error.rel_mse:.2g}", ACCENT))
        return lines

    def _other(self) -> str:
        """What maps are against."""
        return "B" if self._session.against == "b" else "the reference"

    def _labels(self, paint: Any, width: int) -> None:
        session, pictures, gap = self._session, self._pictures, 10 * self._scale
        shown = pictures.shown()
        self._label(paint, gap, gap, self._describe(shown[0]))
        if session.mode == "split":
            self._label(paint, width - gap, gap, self._describe("b"), right=True)
        elif pictures.measured:
            picture = pictures.picture("reference")
            lines = [("reference", INK), (f"{picture.done} of {picture.total} paths a pixel", DIM)]
            self._label(paint, width - gap, gap, lines, right=True)

    def _legend(self, paint: Any, height: int, ramp: Any) -> None:
        session, legend = self._session, self._pictures.legend
        if legend is None:
            return
        imgui, s = self._gui.imgui, self._scale
        line = imgui.get_text_line_height() + 4 * s
        rows = len(legend.rows) if isinstance(legend, views.Swatches) else 1
        tall = line * (rows + (2 if isinstance(legend, views.Scale) else 1)) + 12 * s
        x, y, pad = 10 * s, height - 10 * s - tall - self._below(), 8 * s
        heading = session.show if session.mode in ("single", "split") else f"{session.mode} from {self._other()}"
        heading = heading.replace("flip", "FLIP")
        wide = 250 * s
        if isinstance(legend, views.Note):
            wide = max(wide, imgui.calc_text_size(legend.text).x + 2 * pad)
        paint.add_rect_filled((x, y), (x + wide, y + tall), BACK, 4 * s)
        paint.add_text((x + pad, y + 5 * s), INK, heading.replace("_", " "))
        top = y + 5 * s + line
        if isinstance(legend, views.Note):
            paint.add_text((x + pad, top), DIM, legend.text)
        elif isinstance(legend, views.Scale):
            image = self._gui.texture(ramp(legend.palette))
            paint.add_image(image, (x + pad, top), (x + wide - pad, top + line * 0.7))
            under = top + line * 0.8
            low, high = f"{legend.low:.4g}", f"{legend.high:.4g}"
            paint.add_text((x + pad, under), DIM, low)
            paint.add_text((x + wide - pad - imgui.calc_text_size(high).x, under), DIM, high)
            middle = x + wide / 2 - imgui.calc_text_size(legend.unit).x / 2
            paint.add_text((middle, under), DIM, legend.unit)
        else:
            for i, (label, color, share) in enumerate(legend.rows):
                level = top + i * line
                packed = 0xFF000000 | color[2] << 16 | color[1] << 8 | color[0]
                paint.add_rect_filled((x + pad, level + 2 * s), (x + pad + 12 * s, level + 14 * s), packed, 2 * s)
                paint.add_text((x + pad + 19 * s, level), INK, label[:26])
                percent = f"{share:.1%}"
                paint.add_text((x + wide - pad - imgui.calc_text_size(percent).x, level), DIM, percent)

    def _below(self) -> float:
        """Height of the bar under the legend."""
        return 46 * self._scale if self._session.scene.animations else 0.0

    def _selection(self, paint: Any, size: tuple[int, int]) -> None:
        """The box of the picked instance, and a cross at the picked point."""
        picked, view = self._session.picked, self._pictures.picture(self._pictures.shown()[0]).view
        if picked is None or picked.instance < 0 or view is None:
            return
        box = self._session.bounds()
        corners = np.array([[box[i & 1, 0], box[i >> 1 & 1, 1], box[i >> 2 & 1, 2]] for i in range(8)])
        points = np.concatenate([corners, [picked.position]]) - view.origin
        clip = np.concatenate([points, np.ones((9, 1))], 1) @ view.clip_from_world.T
        behind = clip[:, 3] <= 1e-6
        with np.errstate(divide="ignore", invalid="ignore"):
            screen = (clip[:, :2] / clip[:, 3:] * [0.5, -0.5] + 0.5) * size
        if not self._session.transport.playing and self._session.transport.clip < 0:
            for i in range(8):
                for bit in (1, 2, 4):
                    j = i | bit
                    if j != i and not behind[i] and not behind[j]:
                        paint.add_line(tuple(screen[i]), tuple(screen[j]), 0xB0429EED, 1.2 * self._scale)
        if not behind[8]:
            x, y = screen[8]
            paint.add_circle((x, y), 5 * self._scale, 0xFF000000, 0, 3.0 * self._scale)
            paint.add_circle((x, y), 5 * self._scale, ACCENT, 0, 1.6 * self._scale)

    def _messages(self, paint: Any, width: int, height: int) -> None:
        now, y, imgui = clock.monotonic(), height - 14 * self._scale - self._below(), self._gui.imgui
        room = max(int((width - 40 * self._scale) / imgui.calc_text_size("n").x), 20)  # characters
        for said in reversed([s for s in self._session.said if s.until > now]):
            broken = [part for line in said.text.splitlines() for part in textwrap.wrap(line, min(room, 110)) or [""]]
            lines = [(line, BAD if said.error else INK) for line in broken[:14]]
            tall = (imgui.get_text_line_height() + 2 * self._scale) * len(lines) + 12 * self._scale
            y -= tall + 6 * self._scale
            self._label(paint, width - 10 * self._scale, y, lines, right=True)

    def _preparation(self, paint: Any, width: int, height: int, job: Job) -> None:
        """A bar in the middle; it runs to and fro where nobody knows how much there is."""
        imgui, s = self._gui.imgui, self._scale
        line, pad = imgui.get_text_line_height(), 12 * s
        hint = "Esc ends it"
        wide = max(imgui.calc_text_size(job.what).x, imgui.calc_text_size(hint).x, 260 * s) + 2 * pad
        tall = 2 * line + 10 * s + 3 * pad
        x, y = (width - wide) / 2, (height - tall) / 2
        paint.add_rect_filled((x, y), (x + wide, y + tall), 0xE8181614, 6 * s)
        paint.add_text((x + pad, y + pad), INK, job.what)
        left, right, top = x + pad, x + wide - pad, y + 1.5 * pad + line
        paint.add_rect_filled((left, top), (right, top + 8 * s), 0xFF383532, 4 * s)
        if job.total > 0:
            part = left, left + (right - left) * min(job.done / job.total, 1.0)
        else:
            at = 0.5 - 0.5 * math.cos(2.0 * (clock.monotonic() - job.since))
            start = left + 0.75 * (right - left) * at
            part = start, start + 0.25 * (right - left)
        paint.add_rect_filled((part[0], top), (part[1], top + 8 * s), ACCENT, 4 * s)
        seconds = f"{clock.monotonic() - job.since:.0f} s"
        under = top + 8 * s + 0.6 * pad
        paint.add_text((left, under), DIM, hint)
        paint.add_text((right - imgui.calc_text_size(seconds).x, under), DIM, seconds)

    def _help(self) -> None:
        imgui, s = self._gui.imgui, self._scale
        imgui.set_next_window_pos((24 * s, 90 * s), imgui.Cond_.appearing)
        flags = imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_collapse
        shown, open_ = imgui.begin("Keys and pointer", True, flags)
        if shown and imgui.begin_table("help", 2):
            for keys, meaning in HELP:
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text_disabled(keys)
                imgui.table_next_column()
                imgui.text(meaning)
            imgui.end_table()
        imgui.end()
        self._session.help = bool(open_)


def _time(ms: float) -> str:
    return f"{ms:.1f} ms" if ms < 1000 else f"{ms / 1000:.2f} s"
