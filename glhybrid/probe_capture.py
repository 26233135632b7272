"""Captures reflection probes: the six faces of each are frames of the renderer itself, that reflect the sky."""

from typing import TYPE_CHECKING, Any

import numpy as np

from glhybrid import probe_placement
from glhybrid.passes.probe import Probe
from glhybrid.scene import F64, Camera
from glhybrid.scene import Probe as Placed
from glhybrid.timing import Timing
from glhybrid.view import View, make_view

if TYPE_CHECKING:
    from glhybrid.staged import Staged


class Capture:
    """Renders what a staging shows from other points, with its trees, buffers and lights."""

    def __init__(self, staged: "Staged", probe: Probe) -> None:
        self._staged, self._probe = staged, probe
        size = (probe.face_size, probe.face_size)
        settings = staged.settings.replace(reflections="env", aa=1)
        self._inner = type(staged)(
            staged.context, staged.shaders, staged.scene, settings, size, (), (staged.upload, staged.mover)
        )
        # A border texel around 90 degrees, so that texels are blended across edges with what lies there.
        self._fov = 2 * float(np.arctan(1 + 2 / probe.resolution))
        bounds = staged.bounds
        self._near = min(0.01, 1e-4 * float(np.linalg.norm(bounds[1] - bounds[0])) or 0.01)

    def run(self) -> None:
        """Places the probes if they are not yet, and captures them."""
        inner, probe, staged = self._inner, self._probe, self._staged
        inner.scene, inner.drawn = staged.scene, staged.drawn
        inner.constants.under(staged.scene, inner.settings)
        inner.resume(staged.scene, inner.settings, inner.targets.size)
        if not probe.placed:
            probe.place(staged.scene.probes or (self._automatic(),))
        timing = Timing(staged.context.gl.finish, enabled=False)
        for k, placed in enumerate(probe.placed):
            for face in range(6):
                inner.look(self._view(np.asarray(placed.position), face))
                inner.set(jitter_px=(0, 0), accumulate=0)
                probe.store(k, face, inner.frame(timing))
        probe.blur(keep=staged.mover is None)
        probe.stale = False

    def _view(self, position: F64, face: int) -> View:
        staged = self._staged
        camera = Camera("probe", probe_placement.face_pose(position, face), fov_y=self._fov, near=self._near)
        clip_control = staged.context.limits.clip_control
        return make_view(camera, self._inner.targets.size, staged.drawn, clip_control, staged.bounds)

    def _automatic(self) -> Placed:
        """The candidate that sees farthest, in a box fitted to what it sees."""
        bounds = self._staged.bounds
        reach = float(np.linalg.norm(bounds[1] - bounds[0])) or 1.0
        weight = np.tile(probe_placement.solid_angles(self._probe.face_size).ravel(), 6)
        best: tuple[float, Any, Any] | None = None
        for position in probe_placement.candidates(self._staged.drawn, bounds):
            points = self._surroundings(position)
            distance = np.linalg.norm(points - position, axis=-1)
            score = probe_placement.openness(np.where(np.isfinite(distance), distance, reach), weight, reach)
            if best is None or score > best[0]:
                best = score, position, points
        assert best is not None
        return probe_placement.fit(best[1], best[2], weight, bounds)

    def _surroundings(self, position: F64) -> F64:
        """(6 S S, 3) the point that each texel of the faces sees, +inf where none."""
        found = []
        for face in range(6):
            view = self._view(position, face)
            self._inner.look(view)
            points = self._inner.aov("position", view).astype(np.float64)
            points[self._inner.aov("distance", view) == np.inf] = np.inf
            found.append(points.reshape(-1, 3))
        return np.concatenate(found)

    def release(self) -> None:
        self._inner.release(keep_upload=True)
