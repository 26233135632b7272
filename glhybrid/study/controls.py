"""Methods that no technique here uses, on the CPU: what the failure library shows to fail where the renderer holds.

Each is what is commonly written, and stands beside the rows of robustness, which would otherwise only ever hold.
"""

from typing import Any

import numpy as np

from glhybrid.errors import SettingError, unknown
from glhybrid.scene import F64
from glhybrid.study.subject import Picture, Subject, grey
from glhybrid.study.truth import Truth

EPSILON = 1e-3  # m: the offset that many renderers have as a constant


class FixedEpsilon(Subject):
    """Vertices, camera and hits in float32 world space, hits at o + t d, shadow rays 1 mm off the surface."""

    def visibility(self, camera: int = 0, light: int = 0) -> tuple[F64, Picture]:
        scene, lamp = self.case.scene, self.case.scene.lights[light]
        rounded = Truth(scene, precision=np.float32)
        seen = self.case.seen(camera)
        shape = seen.covered.shape
        f32: Any = np.float32
        origin, direction = (a.reshape(-1, 3).astype(f32).astype(np.float64) for a in (seen.origin, seen.direction))
        hit = rounded.closest(origin, direction)
        found = np.isfinite(hit.t)
        t = np.where(found, hit.t, 0).astype(f32)[:, None]
        point = origin.astype(f32) + t * direction.astype(f32)
        start = point + f32(EPSILON) * hit.normal.astype(f32)
        toward = np.broadcast_to(-np.asarray(lamp.direction), point.shape)
        counted = found & ((hit.normal * toward).sum(1) > 0)
        lit = np.zeros(len(point))
        lit[counted] = ~rounded.blocked(start[counted].astype(np.float64), toward[counted].copy())
        out = lit.reshape(shape)
        lambert = np.maximum((hit.normal * toward).sum(1), 0).reshape(shape)
        return out, grey(out * lambert * lamp.intensity / np.pi + 0.02 * found.reshape(shape))


CONTROLS: dict[str, type[Subject]] = {"fixed-epsilon": FixedEpsilon}


def find(name: str) -> type[Subject]:
    if name not in CONTROLS:
        raise SettingError(unknown("control", name, CONTROLS))
    return CONTROLS[name]
