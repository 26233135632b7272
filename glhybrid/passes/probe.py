"""Reflection probes: cube maps captured in place, seen through boxes -> what specular lobes show.

The faces are rendered by the renderer itself (glhybrid/probe_capture.py) with the sky in their own specular lobes: no
inter-reflection. They are blurred like the sky. A probe answers for surfaces in its reach, as if all it saw lay on the
walls of its box; elsewhere the sky does. Captured are those whose surfaces are in view, once they are. No tree is
looked at, and a frame costs no pass: the image exists for AOVs only.
"""

import time
from collections.abc import Callable
from typing import Any

import moderngl
import numpy as np

from glhybrid import layout
from glhybrid.errors import SettingError
from glhybrid.owned import Owned
from glhybrid.passes.sky import convolve
from glhybrid.probe_placement import equirect
from glhybrid.scene import F64
from glhybrid.scene import Probe as Placed
from glhybrid.setup import Setup
from glhybrid.targets import Targets
from glhybrid.view import View


class Probe:
    """Owns faces, blurred maps and boxes. `resources` has what lib/probe.glsl reads."""

    name = "probe"

    def __init__(self, setup: Setup) -> None:
        shaders, features, settings = setup.shaders, setup.features, setup.settings
        self._context, self._shaders, self._scene, self._features = setup.context, shaders, setup.scene, features
        self._program = shaders.compute("probe", features)
        self._store = shaders.compute("probe_store", features)
        self.resolution = int(settings.parameter("reflections.probe.resolution"))
        self._blend = float(settings.parameter("reflections.probe.blend"))
        self._reason = features.reason
        self.placed: tuple[Placed, ...] = ()
        self.captured: set[int] = set()  # numbers of those that hold what is there now
        self._wanted: list[F64 | None] = []  # (2, 3) the box of surfaces that show each, None: there are none
        self.ms = 0.0
        self._owned = Owned()
        self.resources: dict[str, Any] = {}

    @property
    def face_size(self) -> int:
        """Texels a side, a border texel on each included."""
        return self.resolution + 2

    def place(self, placed: tuple[Placed, ...], surfaces: F64 | None) -> None:
        """Makes room for these, the smallest reach first. surfaces: (N, 2, 3) of what reflects; None: anywhere."""
        limit, key = self._context.limits, "reflections.probe.resolution"
        if 6 * len(placed) > limit.texture_layers or self.face_size > limit.texture_size:
            raise SettingError(
                f"{len(placed)} probes of {key} = {self.resolution} need {6 * len(placed)} layers of "
                f"{self.face_size} texels a side; this device has {limit.texture_layers} of {limit.texture_size}"
            )
        self.release()
        self.placed = tuple(sorted(placed, key=lambda p: float(np.prod(np.subtract(*_reach(p)[::-1])))))
        self._wanted = [_wanted(_reach(p), self._fade(p), surfaces) for p in self.placed]
        gl, count, side = self._context.gl, len(placed), self.face_size if placed else 1
        self.resources = {
            "probe_faces": self._owned.add(gl.texture_array((side, side, 6 * max(count, 1)), 4, dtype="f2")),
            "Probes": self._owned.add(gl.buffer(reserve=max(count, 1) * layout.dtype("Probe").itemsize)),
            "probe_count": count,
        }
        if self._features.probes_blurred:
            sizes = layout.PREFILTER_SIZES
            rough = gl.texture_array((sum(s + 2 for s in sizes), max(sizes) + 2, max(count, 1)), 4, dtype="f2")
            self.resources["probe_rough"] = self._owned.add(rough)
        for texture in (t for t in self._owned if isinstance(t, moderngl.TextureArray)):
            texture.repeat_x = texture.repeat_y = False
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def store(self, probe: int, face: int, radiance: Any) -> None:
        """A rendered face, face_size texels a side."""
        given = {"radiance": radiance, "layer": 6 * probe + face, "out_faces": self.resources["probe_faces"]}
        self._store.dispatch(given, (self.face_size, self.face_size))

    def blur(self, probe: int, keep: bool) -> None:
        """Maps of all roughnesses from the stored faces, if not only mirrors show them. keep: on disk, by content."""
        if not self._features.probes_blurred:
            return
        size, faces, rough = self.face_size, self.resources["probe_faces"], self.resources["probe_rough"]
        texels = np.frombuffer(faces.read(), np.float16).reshape(-1, 6, size, size, 4)[probe, ..., :3]
        around = equirect(texels.astype(np.float64), 1024, 512).astype(np.float32)
        data = convolve(self._context, self._shaders, self._features, around, keep)[0]
        rough.write(data, viewport=(0, 0, probe, rough.width, rough.height, 1))

    def missing(self, view: View) -> list[int]:
        """Those that surfaces in view may show, and that are not captured."""
        return [
            k for k, box in enumerate(self._wanted) if k not in self.captured and box is not None and _seen(box, view)
        ]

    @property
    def complete(self) -> bool:
        """Whether no view will ask for more."""
        return all(k in self.captured or box is None for k, box in enumerate(self._wanted))

    def _fade(self, probe: Placed) -> float:
        return self._blend if probe.fade is None else probe.fade

    def look(self, origin: F64) -> None:
        """Boxes in the world of this frame."""
        rows = np.zeros(len(self.placed), layout.dtype("Probe"))
        for row, probe in zip(rows, self.placed, strict=True):
            row["position"], row["box_min"], row["box_max"], row["reach_min"], row["reach_max"] = (
                np.asarray(p) - origin for p in (probe.position, probe.low, probe.high, *_reach(probe))
            )
            row["fade"] = self._fade(probe)
        if len(rows):
            self._context.write(self.resources["Probes"], rows)

    def timed(self, work: Callable[[], None]) -> None:
        """Runs work() and notes its milliseconds in `ms`, from finish() to finish()."""
        self._context.gl.finish()
        start = time.perf_counter()
        work()
        self._context.gl.finish()
        self.ms = (time.perf_counter() - start) * 1e3

    def run(self, targets: Targets, ids: Any) -> Any:
        """The image `reflection`, for AOVs."""
        reflection = targets.get("reflection")
        resources = {**self._scene.resources, "gbuffer_id": ids, "out_reflection": reflection}
        if self._reason:
            resources["out_reason"] = targets.get("reason")
        self._program.dispatch(resources, targets.size)
        return reflection

    @property
    def bytes(self) -> int:
        """Of the cube maps and their rougher levels."""
        images = [t for t in self._owned if isinstance(t, moderngl.TextureArray)]
        return sum(8 * t.width * t.height * t.layers for t in images)

    def release(self) -> None:
        self._owned.release()
        self.resources = {}
        self.placed, self._wanted = (), []
        self.captured.clear()


def _reach(probe: Placed) -> tuple[Any, Any]:
    """Corners of the box of the surfaces that show it."""
    return probe.reach or (probe.low, probe.high)


def _wanted(reach: tuple[Any, Any], fade: float, surfaces: F64 | None) -> F64 | None:
    """(2, 3) the box of all surfaces (N, 2, 3) in reach; None if there are none."""
    box = np.array([np.subtract(reach[0], fade), np.add(reach[1], fade)])
    if surfaces is None:
        return box
    low, high = np.maximum(surfaces[:, 0], box[0]), np.minimum(surfaces[:, 1], box[1])
    inside = (low <= high).all(1)
    return np.stack([low[inside].min(0), high[inside].max(0)]) if inside.any() else None


def _seen(box: F64, view: View) -> bool:
    """Whether a box (2, 3) may be in a view: not wholly beyond one of its sides by a pixel, nor behind it."""
    corners = np.stack(np.meshgrid(*(box - view.origin).T, indexing="ij"), -1).reshape(-1, 3)
    clip = corners @ view.clip_from_world[:, :3].T + view.clip_from_world[:, 3]
    w = clip[:, 3]
    out = [(side * clip[:, k] > w * (1 + 2 / view.size[k])).all() for k in (0, 1) for side in (1, -1)]
    return not (any(out) or (w <= 0).all())
