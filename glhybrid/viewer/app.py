"""The viewer's loop: input -> session -> pictures -> panels -> surface. It knows neither windows nor browsers."""

import logging
import time as clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from glhybrid import aside
from glhybrid.errors import GlhybridError, ShaderError
from glhybrid.image import Frame
from glhybrid.renderer import Renderer
from glhybrid.scene import U8, Scene
from glhybrid.viewer import camera_control, picking, store, views
from glhybrid.viewer.controls import Controls
from glhybrid.viewer.events import Close, Drop, Event, merged
from glhybrid.viewer.gui import Gui
from glhybrid.viewer.overlay import Overlay
from glhybrid.viewer.panels import Panels
from glhybrid.viewer.pictures import Pictures
from glhybrid.viewer.session import Session
from glhybrid.viewer.surface import Surface
from glhybrid.viewer.turns import Turns
from glhybrid.viewer.watch import PERIOD_S, Watch

log = logging.getLogger("glhybrid")
IDLE_S = 0.1  # between two looks at the input while nothing is to be drawn
WAIT_S = 0.02  # while another process measures, or what moved may move again
SETTLE_FRAMES = 3  # ImGui needs a few after input until all widgets have their place


class Viewer:
    """tick() is one turn of the loop, run() all of them. Owns renderer and GUI, not the surface.

    load: reads a scene by path or name; used for dropped and reloaded files.
    """

    def __init__(
        self, surface: Surface, session: Session, load: Callable[[str], Scene], *, saved: dict[str, Any] | None = None,
        watch: bool = True,
    ) -> None:  # fmt: skip
        self.surface, self.session, self._load = surface, session, load
        self.running = True
        self.renderer = Renderer(context=surface.context, interactive=True)
        self._textures: dict[str, Any] = {}
        self._canvas: Any = None
        self._saved = saved or {}
        self.bookmarks = store.Bookmarks(self._saved)
        self.controls = Controls(session, self.act, self._focus, lambda: self.panels.views())
        self.turns = Turns(surface, self.controls, self._take, self._present, self._stale)
        self.renderer.shaders.progress = self.turns.progress
        self.pictures = Pictures(self.renderer, session, self._upload, self.turns.turn, self.turns.progress)
        self._asked: list[str] = []  # actions that the panel's buttons name
        self._make_gui()
        self._watching = watch
        self._watch = Watch(session.scene.path if watch else None)
        self._shader_check = clock.monotonic() + PERIOD_S
        self._frame_at = clock.perf_counter()
        self._presented_at = self._frame_at
        self._dirty = SETTLE_FRAMES
        self._caption = ""
        self.frames = 0  # presented
        self._probed = False

    def _make_gui(self) -> None:
        """For the display's scale of now."""
        surface, session = self.surface, self.session
        self.gui = self.turns.gui = Gui(surface.context, surface)
        about = self.gui, session, self.pictures, self.controls
        self.panels = Panels(*about, self.bookmarks, self._asked.append, self.gui.scale)
        self.overlay = Overlay(*about, self.gui.scale)

    # The loop

    def run(self) -> None:
        """Until it is closed."""
        while self.running:
            self.tick()

    def tick(self) -> bool:
        """One turn; whether a frame was presented."""
        drawing = self.pictures.drawing or self._dirty > 0 or self.controls.flying or self.session.transport.playing
        waiting = 0.0 if drawing or self.turns.pending or self._asked else WAIT_S if self.pictures.busy else IDLE_S
        events, self.turns.pending = self.turns.pending, []
        events = [*events, *self.surface.poll(waiting if self.surface.visible else IDLE_S)]
        taken = clock.perf_counter()
        if self.surface.scale != self.gui.scale:  # the window is on another display
            self.gui.close()
            self._make_gui()
            self._dirty = SETTLE_FRAMES
        self.controls.size = self.picture_size
        for event in merged(events):
            self._take(event)
        while self._asked:
            self.act(self._asked.pop(0))
        seconds = min(taken - self._frame_at, 0.25)
        if self.session.transport.advance(seconds):
            self._dirty = max(self._dirty, 1)
        self.controls.tick(seconds)
        self._check_files()
        if events:
            self._dirty = SETTLE_FRAMES
        self._frame_at = taken
        if not self.running or not self.surface.visible:
            return False  # a minimised window costs nothing
        changed = self.pictures.update(self.picture_size)
        self.turns.prepared()
        if not changed and self._dirty == 0 and not self._messages_change():
            return False
        self._dirty = max(self._dirty - 1, 0)
        self._present()
        if not self._probed and self.pictures.picture("a").done:
            self._probed = True
            self._focus()  # what the first drag asks for: its programs are compiled now
        return True

    @property
    def picture_size(self) -> tuple[int, int]:
        """Of the picture: the surface without the panel."""
        width, height = self.surface.size
        return max(width - self.panels.width, 1), height

    def settle(self, patience_s: float = 600.0) -> None:
        """Runs until every picture that is looked at is finished and shown."""
        end = clock.monotonic() + patience_s
        self._dirty = SETTLE_FRAMES
        while self.running and clock.monotonic() < end and (self.pictures.busy or self._dirty):
            self.tick()
        self.pictures.settle()
        self._present()

    def _take(self, event: Event) -> None:
        if isinstance(event, Close):
            self.running = False
        elif isinstance(event, Drop):
            for path in event.paths[:1]:
                self.open(path)
            if len(event.paths) > 1:
                self.session.say(f"one scene at a time: {len(event.paths) - 1} more dropped files are left out")
        else:
            self.gui.feed([event])
            over_panel = self.controls.pointer[0] >= self.picture_size[0]
            free = not over_panel and not self.gui.wants_pointer
            self.controls.feed(event, free, not self.gui.wants_keys)

    def _stale(self) -> bool:
        """Whether the sample that is being drawn is not worth its end."""
        return bool(self._asked) or self.pictures.stale(self.picture_size)

    def _present(self) -> None:
        now = clock.perf_counter()
        seconds, self._presented_at = now - self._presented_at, now
        self.frames += 1
        self.turns.presented = True
        canvas = self._get_canvas()
        canvas.clear(0.09, 0.092, 0.1, 1.0)
        self.turns.presenting = True
        try:
            self.gui.begin(seconds)
            self.overlay.draw(self.picture_size, self._ramp, self.turns.job)
            self.panels.draw(self.surface.size)
            self.gui.draw(canvas)
        finally:
            self.turns.presenting = False
        caption = f"{self.session.scene.name} - glhybrid"
        if caption != self._caption:
            self._caption = caption
            self.surface.title(caption)
        self.surface.present(canvas, moving=self.pictures.moving)

    def _messages_change(self) -> bool:
        """Whether a message has been shown for long enough."""
        now = clock.monotonic()
        old = len(self.session.said)
        self.session.said = [s for s in self.session.said if s.until > now]
        return len(self.session.said) != old

    # Actions

    def act(self, name: str, at: tuple[float, float] = (0.0, 0.0)) -> None:
        """pick, look_at, frame, save, copy, bookmark, reload, follow (what was written), quit."""
        try:
            getattr(self, f"_act_{name}")(at)
        except GlhybridError as error:
            self.session.say(str(error), error=True)
        self._dirty = SETTLE_FRAMES

    def _act_quit(self, at: tuple[float, float]) -> None:
        self.running = False

    def _act_pick(self, at: tuple[float, float]) -> None:
        self.session.picked = self.pick(at)

    def _act_look_at(self, at: tuple[float, float]) -> None:
        picked = self.session.picked = self.pick(at)
        if picked is not None and picked.instance >= 0:
            pose = self.session.start_moving(self._focus())
            self.session.move_to(replace(pose, target=picked.position))

    def _act_frame(self, at: tuple[float, float]) -> None:
        pose = self.session.start_moving(self._focus())
        self.session.move_to(camera_control.frame(pose, self.session.bounds(), self.picture_size))

    def _act_copy(self, at: tuple[float, float]) -> None:
        line = self.session.command(self.picture_size, "b" if self.session.flipped else "a")
        self.surface.set_clipboard(line)
        self.session.say(f"copied: {line}")

    def _act_save(self, at: tuple[float, float]) -> None:
        path = self.save()
        self.session.say(f"saved {path}")

    def _act_bookmark(self, at: tuple[float, float]) -> None:
        taken = {name for name, _ in self.bookmarks.of(self.session.source)}
        name = next(n for i in range(1, 10_000) if (n := f"view {i}") not in taken)
        pose = self.session.start_moving(self._focus())
        self.bookmarks.add(self.session.source, name, pose)
        self.session.say(f"bookmarked {name}")

    def _act_reload(self, at: tuple[float, float]) -> None:
        self.reload()

    def _act_follow(self, at: tuple[float, float]) -> None:
        self.reload(unless_equal=True)

    def pick(self, at: tuple[float, float]) -> Any:
        """What is under a point of the picture; None outside of it or before anything was drawn."""
        width, height = self.picture_size
        if not (0 <= at[0] < width and 0 <= at[1] < height):
            return None
        shown = self.pictures.shown()
        side = shown[0] if len(shown) == 1 or at[0] < self.session.divider * width else shown[1]
        picture = self.pictures.picture(side)
        w, h = picture.size
        if not w:
            return None
        found = picking.pick(picture, (min(int(at[0] * w / width), w - 1), min(int(at[1] * h / height), h - 1)))
        return None if found is None else replace(found, pixel=(int(at[0]), int(at[1])))

    def _focus(self) -> float:
        """Metres to what the view turns about: what its centre shows, else the middle of the scene."""
        if self.session.pose is not None:
            return camera_control.distance(self.session.pose)
        try:
            found = picking.focus(self.pictures.picture(self.pictures.shown()[0]))
        except GlhybridError:
            found = float("inf")
        if np.isfinite(found) and found > 0:
            return found
        pose = self.session.plain_camera().world_from_view
        ahead = float((self.session.scene.bounds().mean(0) - pose[:3, 3]) @ -pose[:3, 2])
        return max(ahead, 0.1 * self.session.extent())

    def save(self, path: Path | None = None) -> Path:
        """The picture as `render` makes it, finished first. path: default is a new name in the working folder."""
        side = self.pictures.shown()[0]
        picture = self.pictures.picture(side)
        while not picture.finished and self.running:
            self.pictures.update(self.picture_size)
        stem = Path(self.session.source).stem or "picture"
        if path is None:
            path = next(p for i in range(1, 100_000) if not (p := Path(f"{stem}-{i:03d}.png")).exists())
        picture.show()
        receipt = {"settings": self.session.settings(side).to_dict(), "scene": {"sha256": self.session.scene.sha256}}
        Frame(np.ascontiguousarray(picture.rgb()), {}, receipt).save(path)
        return path

    def screenshot(self, path: Path) -> None:
        """The whole surface, panel and all, as it was presented last."""
        Frame(self.canvas_rgb()).save(path)

    def canvas_rgb(self) -> U8:
        """(H, W, 3) uint8 of the whole surface, row 0 at the top."""
        width, height = self._canvas.size
        pixels = np.frombuffer(self._canvas.read(components=4), np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(pixels[::-1, :, :3])

    # Files

    def open(self, source: str) -> None:
        """Another scene; what is shown stays if it cannot be read."""
        try:
            scene = self._read(source)
        except GlhybridError as error:
            self.session.say(str(error), error=True)
            return
        session = self.session
        session.source, session.pose, session.camera_index = source, None, 0
        session.light_angles.clear()
        session.environment_deg = None
        session.transport = type(session.transport)()
        session.swap_scene(scene)
        self._watch = Watch(scene.path if self._watching else None)
        self.pictures.restart()
        session.say(f"opened {source}")
        self._dirty = SETTLE_FRAMES

    def _read(self, source: str) -> Scene:
        try:
            return aside.run(lambda: self._load(source), self.turns.progress, f"reading {Path(source).name}")
        finally:
            self.turns.prepared()

    def reload(self, unless_equal: bool = False) -> None:
        """The same file again. unless_equal: what is shown stays if all that was read is. Raises LoadError."""
        scene = self._read(self.session.source)
        if unless_equal and scene.sha256 and scene.sha256 == self.session.scene.sha256:
            return  # another file beside it was written
        self.session.swap_scene(scene)
        self.pictures.restart()
        self.session.say(f"reloaded {self.session.source}")
        self._dirty = SETTLE_FRAMES

    def _check_files(self) -> None:
        if self._watching and self._watch.due():
            self.act("follow")
        now = clock.monotonic()
        if self._watching and now >= self._shader_check:
            self._shader_check = now + PERIOD_S
            self._reload_shaders()

    def _reload_shaders(self) -> None:
        try:
            with self.turns.endless(self.renderer.shaders):
                count = self.renderer.reload_shaders()
        except ShaderError as error:
            self.session.say(f"the last good program stays. {error}", error=True)
            self._dirty = SETTLE_FRAMES
            return
        if count:
            self.session.say(f"{count} program{'s' if count > 1 else ''} compiled anew")
            self.pictures.restart()
            self._dirty = SETTLE_FRAMES

    # GL objects of the viewer itself

    def _get_canvas(self) -> Any:
        size = self.surface.size
        if self._canvas is None or self._canvas.size != size:
            self._free_canvas()
            gl = self.surface.context.gl
            self._canvas = gl.framebuffer([gl.texture(size, 4)])
        return self._canvas

    def _free_canvas(self) -> None:
        if self._canvas is not None:
            # moderngl binds the last used framebuffer again when it makes the next one: that must not be this one.
            self.surface.context.gl.detect_framebuffer(0).use()
            attachment = self._canvas.color_attachments[0]
            self._canvas.release()
            attachment.release()
            self._canvas = None

    def _upload(self, name: str, pixels: U8) -> Any:
        """A texture of (H, W, 3 or 4): with four channels it is as quick as can be."""
        height, width = pixels.shape[:2]
        if pixels.shape[2] == 3:
            pixels = views.opaque(pixels)
        texture = self._textures.get(name)
        if texture is None or texture.size != (width, height):
            if texture is not None:
                texture.release()
            texture = self._textures[name] = self.surface.context.gl.texture((width, height), 4)
            texture.repeat_x = texture.repeat_y = False
        texture.write(pixels)
        exact = (width, height) == self.picture_size
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST) if exact else (moderngl.LINEAR, moderngl.LINEAR)
        return texture

    def _ramp(self, name: str) -> Any:
        if (key := f"ramp {name}") not in self._textures:
            self._upload(key, views.palette(name)[None])
        return self._textures[key]

    def remember(self) -> None:
        """Saves settings and bookmarks for the next run."""
        store.write(store.snapshot(self.session) | self.bookmarks.to_dict())

    def close(self) -> None:
        """Frees everything but the surface. Twice is harmless."""
        self.running = False
        self.pictures.close()
        self.gui.close()
        self._free_canvas()
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()
        self.renderer.close()
