"""FrameConstants on the host: one block, written in place and uploaded whole, so that a frame makes no objects.

Assigning to a field of a NumPy record costs a microsecond and more; views on the fields, made once, cost a fraction.
"""

from typing import Any

import numpy as np

from glhybrid import layout, techniques
from glhybrid.context import Context
from glhybrid.scene import Scene
from glhybrid.settings import Settings
from glhybrid.view import View


class FrameConstants:
    """Owns the storage block "Frame". rows: (1,) of layout FrameConstants, what the next upload writes."""

    def __init__(self, context: Context, scene: Scene, settings: Settings) -> None:
        self.rows = np.zeros(1, layout.dtype("FrameConstants"))
        self.buffer, self._write = context.gl.buffer(reserve=self.rows.nbytes), context.write
        # reshape: a scalar's view is an array of one, which can be written to.
        self._views = {
            name: self.rows[name][0] if self.rows[name].ndim > 1 else self.rows[name]
            for name in self.rows.dtype.names or ()
        }
        floats = self.rows.view(np.float32)
        self._previous_clip, self._clip = self._views["previous_clip_from_world"], self._views["clip_from_world"]
        at = (self.rows.dtype.fields or {})["eye_ws"][1] // 4  # then right_ws and up_ws, a number behind each
        self._rays = floats[at : at + 12].reshape(3, 4)[:, :3]
        self._view: View | None = None  # of the look before
        self._lens: tuple[object, ...] = ()  # what is the same in most views
        self._lights = (0, 0, 0)  # first, end, count
        self._still = False  # the view before that was the same
        self._put: dict[str, Any] = {}  # values given last
        self._changed = True  # since the last upload
        self._turn: tuple[Any, dict[str, Any]] | None = None  # of the environment
        self.under(scene, settings)

    def under(self, scene: Scene, settings: Settings) -> None:
        """The fields of settings and environment."""
        sky = scene.environment
        if self._turn is None or self._turn[0] is not sky:
            angle = sky.rotation if sky else 0.0
            x, z = (np.cos(angle), 0.0, -np.sin(angle)), (np.sin(angle), 0.0, np.cos(angle))
            named = {"environment_x": x, "environment_z": z, "environment_intensity": sky.intensity if sky else 0.0}
            self._turn = sky, named
        self.exposure_ev = None if settings.exposure == "auto" else float(settings.exposure)  # None: of the picture
        self.put(
            seed=settings.seed, bounces=settings.bounces, mirror_cutoff=techniques.cutoff(settings),
            tone_map=layout.CONSTANTS[f"TONE_{settings.tone.upper().replace('-', '_')}"], **self._turn[1],
        )  # fmt: skip

    @property
    def sky(self) -> dict[str, Any]:
        """Turn and intensity of the environment, by field."""
        return {} if self._turn is None else self._turn[1]

    def put(self, **values: Any) -> None:
        """Changes fields; upload() sends them."""
        known = self._put
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                known.pop(name, None)
            elif known.get(name) == value:
                continue
            else:
                known[name] = value
            self._views[name][...] = value
            self._changed = True

    def upload(self) -> None:
        """Sends all fields as they are, if any has changed since."""
        if self._changed:
            self._write(self.buffer, self.rows)
            self._changed = False

    def choose_lights(self, first: int, end: int) -> None:
        """Which lights the next dispatch is for: first..end-1."""
        self._lights = (first, end, self._lights[2])
        self.put(light_first=first, light_end=end)
        self.upload()

    def look(self, view: View, light_count: int) -> None:
        """The fields of a camera, and where the one before was: in this frame's world, whose origin may be another."""
        if (lights := (0, light_count, light_count)) != self._lights:
            self._lights = lights
            self.put(light_first=0, light_end=light_count, light_count=light_count)
        if (lens := (view.pixel_angle, view.orthographic, view.camera.near, view.size)) != self._lens:
            self._lens = lens
            self.put(
                pixel_angle=view.pixel_angle,
                orthographic=view.orthographic,
                near=view.camera.near,
                size_px=view.size,
            )
        before = self._view
        if view is before and self._still:
            return  # all there since the look before
        self._changed = True
        if before is None:
            self._clip[...] = view.clip_from_world.T  # columns first, as GLSL has it
            before = view
        self._view, self._still = view, view is before
        eye, forward, origin = before.eye, before.forward.tolist(), before.origin
        self._previous_clip[...] = self._clip
        if view.origin.tolist() != origin.tolist():
            moved = view.origin - origin
            clip, eye = before.clip_from_world.copy(), eye - moved
            clip[:, 3] += clip[:, :3] @ moved
            self._previous_clip[...] = clip.T
        x, y, z = eye.tolist()
        self._views["previous_depth"][...] = (*forward, -(forward[0] * x + forward[1] * y + forward[2] * z))
        self._clip[...] = view.clip_from_world.T
        self._rays[...] = view.rays
        self._views["forward_ws"][...] = view.forward

    def release(self) -> None:
        self.buffer.release()
