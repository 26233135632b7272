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
        self.buffer = context.gl.buffer(reserve=self.rows.nbytes)
        # reshape: a scalar's view is an array of one, which can be written to.
        self._views = {
            name: self.rows[name][0] if self.rows[name].ndim > 1 else self.rows[name]
            for name in self.rows.dtype.names or ()
        }
        self._view: View | None = None  # of the look before
        self._still = False  # the view before that was the same
        self.under(scene, settings)

    def under(self, scene: Scene, settings: Settings) -> None:
        """The fields of settings and environment."""
        angle = scene.environment.rotation if scene.environment else 0.0
        self.exposure_ev = None if settings.exposure == "auto" else float(settings.exposure)  # None: of the picture
        self.put(
            seed=settings.seed, bounces=settings.bounces, mirror_cutoff=techniques.cutoff(settings),
            tone_map=layout.CONSTANTS[f"TONE_{settings.tone.upper().replace('-', '_')}"],
            environment_x=(np.cos(angle), 0, -np.sin(angle)), environment_z=(np.sin(angle), 0, np.cos(angle)),
            environment_intensity=scene.environment.intensity if scene.environment else 0.0,
        )  # fmt: skip

    def put(self, **values: Any) -> None:
        """Changes fields; upload() sends them."""
        views = self._views
        for name, value in values.items():
            views[name][...] = value

    def upload(self) -> None:
        """Sends all fields as they are."""
        self.buffer.write(self.rows)

    def choose_lights(self, first: int, end: int) -> None:
        """Which lights the next dispatch is for: first..end-1."""
        self.put(light_first=first, light_end=end)
        self.upload()

    def look(self, view: View, light_count: int) -> None:
        """The fields of a camera, and where the one before was: in this frame's world, whose origin may be another."""
        self.put(light_first=0, light_end=light_count, light_count=light_count)
        before = self._view or view
        if view is before and self._still:
            return  # all there since the look before
        self._view, self._still = view, view is before
        views, clip, eye = self._views, before.clip_from_world, before.eye
        if (moved := view.origin - before.origin).any():
            clip, eye = clip.copy(), eye - moved
            clip[:, 3] += clip[:, :3] @ moved
        views["previous_clip_from_world"][...] = clip.T  # columns first, as GLSL has it
        views["previous_depth"][...] = (*before.forward, -(before.forward @ eye))
        views["clip_from_world"][...] = view.clip_from_world.T
        views["eye_ws"][...] = view.eye
        views["right_ws"][...] = view.right
        views["up_ws"][...] = view.up
        views["forward_ws"][...] = view.forward
        self.put(
            pixel_angle=view.pixel_angle,
            orthographic=view.orthographic,
            near=view.camera.near,
            size_px=view.size,
        )

    def release(self) -> None:
        self.buffer.release()
