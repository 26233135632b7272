"""Methods that no technique here uses, on the CPU: what the failure library shows to fail where the renderer holds.

Each is what is commonly written, and stands beside the rows of robustness, which would otherwise only ever hold.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from glhybrid import reference
from glhybrid.errors import SettingError, unknown
from glhybrid.image import Frame
from glhybrid.scene import F32, F64, Camera, Scene, Triangles
from glhybrid.study.oracle import I64, Oracle
from glhybrid.study.subject import Picture, Subject, developed, grey
from glhybrid.view import make_view

EPSILON = 1e-3  # m: the offset that many renderers have as a constant


class FixedEpsilon(Subject):
    """Vertices, camera and hits in float32 world space, hits at o + t d, shadow rays 1 mm off the surface."""

    def visibility(self, camera: int = 0, light: int = 0) -> tuple[F64, Picture]:
        scene, lamp = self.case.scene, self.case.scene.lights[light]
        rounded = Oracle(scene, precision=np.float32)
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


class DepthRebuilt(Subject):
    """Points from a depth buffer of 24 bits, moved off by 256 steps of float32 along the normal (Waechter & Binder, "A
    Fast and Robust Method for Avoiding Self-Intersection", Ray Tracing Gems (2019)), which asks for exact points."""

    NEAR, FAR, BITS = 0.01, 1000.0, 24

    def visibility(self, camera: int = 0, light: int = 0) -> tuple[F64, Picture]:
        seen, lamp = self.case.seen(camera), self.case.scene.lights[light]
        forward = -self.case.scene.cameras[camera].world_from_view[:3, 2]
        n, f, steps = self.NEAR, self.FAR, 2**self.BITS - 1
        lit, counted = np.zeros(seen.covered.shape), self.case.oracle.facing(seen, lamp)
        origin, way, normal = seen.origin[counted], seen.direction[counted], seen.hit.normal[counted]
        depth = (seen.position[counted] - origin) @ forward
        stored = np.round(f / (f - n) * (1 - n / depth) * steps) / steps
        point = origin + way * (n * f / (f - stored * (f - n)) / (way @ forward))[:, None]
        point = point.astype(np.float32)
        steps_off = np.where(point < 0, -1, 1) * (256 * normal).astype(np.int64)
        by_steps = (point.view(np.int32) + steps_off).astype(np.int32).view(np.float32)
        start = np.where(np.abs(point) < 1 / 32, point + normal / 65536, by_steps).astype(np.float64)
        toward = np.broadcast_to(-np.asarray(lamp.direction), start.shape).copy()
        lit[counted] = ~self.case.oracle.blocked(start, toward)
        lambert = np.where(counted, np.maximum(seen.hit.normal @ -np.asarray(lamp.direction), 0), 0)
        return lit, grey(lit * lambert * lamp.intensity / np.pi + 0.02 * seen.covered)


class NaiveSlabs(Subject):
    """Boxes are tested by dividing by the direction: 0 over 0, and every comparison with it, is a miss."""

    def hits(self, camera: int = 0) -> tuple[I64, F64, Picture]:
        seen = self.case.seen(camera)
        shape = seen.covered.shape
        origin, direction = seen.origin.reshape(-1, 3), seen.direction.reshape(-1, 3)
        instance, t = seen.hit.instance.copy().reshape(-1), seen.hit.t.copy().reshape(-1)
        for number, box in enumerate(self.case.scene.instance_bounds):
            rows = np.flatnonzero(instance == number)
            with np.errstate(divide="ignore", invalid="ignore"):
                planes = (box[:, None] - origin[rows]) / direction[rows]
                near, far = planes.min(0).max(1), planes.max(0).min(1)  # NumPy's: NaN wins
            lost = rows[~(near <= far)]
            instance[lost], t[lost] = -1, np.inf
        return instance.reshape(shape), t.reshape(shape), grey(0.2 + 0.6 * (instance >= 0).reshape(shape))


class ShortStack(Subject):
    """A tree that halves space, walked with a stack of 32 entries: what no longer fits is left out, without a word."""

    ENTRIES = 32

    def hits(self, camera: int = 0) -> tuple[I64, F64, Picture]:
        seen, oracle = self.case.seen(camera), self.case.oracle
        shape = seen.covered.shape
        origin, direction = seen.origin.reshape(-1, 3), seen.direction.reshape(-1, 3)
        corners, found = oracle.triangles, np.full(len(origin), np.inf)
        # (rows of triangles, rays, entries on their stacks); the nearer half first, as seen from the first ray
        todo = [(np.arange(len(corners)), np.arange(len(origin)), np.zeros(len(origin), np.int64))]
        while todo:
            rows, rays, depth = todo.pop()
            if not len(rays):
                continue
            if len(rows) == 1:
                hit = reference.closest_hit(corners[rows], origin[rays], direction[rays])
                found[rays] = np.minimum(found[rays], hit.t)
                continue
            centre = corners[rows].mean(1)
            axis = int(np.ptp(centre, axis=0).argmax())
            side = centre[:, axis] > (centre[:, axis].min() + centre[:, axis].max()) / 2
            halves = [rows[~side], rows[side]]
            halves.sort(key=lambda half: float(np.linalg.norm(corners[half].mean((0, 1)) - origin[0])))
            near, far = (_enters(corners[half], origin[rays], direction[rays]) for half in halves)
            both = near & far
            kept = far & (~both | (depth < self.ENTRIES))
            todo.append((halves[1], rays[kept], depth[kept]))
            todo.append((halves[0], rays[near], depth[near] + both[near]))
        instance = np.where(np.isfinite(found), 0, -1).reshape(shape)
        return instance, found.reshape(shape), grey(0.2 + 0.6 * (instance >= 0))


class MoellerTrumbore(Subject):
    """The test of Moeller & Trumbore (1997) in float32 world space: neighbours decide on their edge one by one."""

    def hits(self, camera: int = 0) -> tuple[I64, F64, Picture]:
        seen, f32 = self.case.seen(camera), np.float32
        shape = seen.covered.shape
        origin, direction = (a.reshape(-1, 3).astype(f32) for a in (seen.origin, seen.direction))
        v0, v1, v2 = Oracle(self.case.scene, precision=np.float32).triangles.astype(f32).transpose(1, 0, 2)
        a, b = v1 - v0, v2 - v0
        nearest = np.full(len(origin), np.inf)
        for first in range(0, len(origin), 256):  # rays at once, each with all triangles
            o, d = origin[first : first + 256, None], direction[first : first + 256, None]
            p, s = np.cross(d, b), o - v0
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = f32(1) / (a * p).sum(-1)
                q = np.cross(s, a)
                u, v, t = (s * p).sum(-1) * scale, (d * q).sum(-1) * scale, (b * q).sum(-1) * scale
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
            nearest[first : first + 256] = np.where(hit, t, np.inf).min(1)
        instance = np.where(np.isfinite(nearest), 0, -1).reshape(shape)
        return instance, nearest.reshape(shape), grey(0.2 + 0.6 * (instance >= 0))


class InverseMatrix(Subject):
    """Camera rays from two points of a pixel, on the near and far plane, by the inverse of projection times view, in
    float32 as a shader has it: the depths' ratio is lost to it, and the camera's place."""

    NEAR, FAR = 0.01, 1000.0

    def hits(self, camera: int = 0) -> tuple[I64, F64, Picture]:
        scene, (width, height) = self.case.scene, self.case.study.size
        view = make_view(scene.cameras[camera], (width, height), scene)
        pose, n, f = scene.cameras[camera].world_from_view, self.NEAR, self.FAR
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = 1 / np.linalg.norm(view.right), 1 / np.linalg.norm(view.up)
        projection[2, 2:], projection[3, 2] = ((f + n) / (n - f), 2 * f * n / (n - f)), -1
        inverse = np.linalg.inv((projection @ np.linalg.inv(pose)).astype(np.float32))
        x = ((np.arange(width) + 0.5) / width * 2 - 1).astype(np.float32)
        y = (1 - (np.arange(height) + 0.5) / height * 2).astype(np.float32)
        ends = []
        for depth in (-1, 1):
            grid = np.stack(np.broadcast_arrays(x[None], y[:, None], np.float32(depth), np.float32(1)), -1)
            point = grid.reshape(-1, 4) @ inverse.T
            ends.append((point[:, :3] / point[:, 3:]).astype(np.float64))
        way = ends[1] - ends[0]
        hit = self.case.oracle.closest(ends[0], way / np.linalg.norm(way, axis=1, keepdims=True))
        instance = hit.instance.reshape(height, width)
        distance = hit.t + np.linalg.norm(ends[0] - view.eye - view.origin, axis=1)
        return instance, distance.reshape(height, width), grey(0.2 + 0.6 * (instance >= 0))


class NanBounds(Subject):
    """Boxes grown by a minimum and a maximum to which a NaN is contagious: no ray enters one that had a NaN within, and
    the root's is around all."""

    def frame(self, *aovs: str, camera: int | Camera = 0, scene: Scene | None = None, **changes: Any) -> Frame:
        scene = scene or self.case.scene
        corners = [
            piece.position for instance in scene.instances for piece in scene.meshes[instance.mesh].primitives
            if isinstance(piece, Triangles)
        ]  # fmt: skip
        root = np.array([[np.minimum.reduce(c), np.maximum.reduce(c)] for c in corners if len(c)]).sum((0, 1))
        seen = scene if np.isfinite(root).all() else scene.replace(instances=())
        return super().frame(*aovs, camera=camera, scene=seen, **changes)


class OwnTriangle(Subject):
    """Shadow rays start on the surface, in float32, and pass over the triangle that they start from: no offset."""

    def frame(self, *aovs: str, camera: int | Camera = 0, scene: Scene | None = None, **changes: Any) -> Frame:
        assert isinstance(camera, int)
        scene = scene or self.case.scene
        oracle, lamp = Oracle(scene), scene.lights[0]
        seen = oracle.seen(scene.cameras[camera], self.case.study.size)
        origin, way = (a.reshape(-1, 3) for a in (seen.origin, seen.direction))
        own = reference.closest_hit(oracle.triangles, origin, way)
        facing = oracle.facing(seen, lamp).reshape(-1)
        start = seen.position.reshape(-1, 3).astype(np.float32).astype(np.float64)
        toward = np.broadcast_to(-np.asarray(lamp.direction, np.float64), start.shape)
        flat = facing & np.isclose(own.t, seen.hit.t.reshape(-1))  # not of a sphere
        lit = np.zeros(len(start))
        lit[facing & ~flat] = 1
        for triangle in np.unique(own.triangle[flat]):
            rays = np.flatnonzero(flat & (own.triangle == triangle))
            others = np.delete(oracle.triangles, triangle, axis=0)
            lit[rays] = ~reference.any_hit(others, start[rays], toward[rays].copy(), 0.0, np.inf)
        lambert = np.maximum((seen.hit.normal.reshape(-1, 3) * toward).sum(1), 0)
        shown = (lit * lambert * lamp.intensity / np.pi + 0.02).reshape(seen.covered.shape) * seen.covered
        return Frame(grey(shown), {"radiance": np.repeat(shown[..., None], 3, -1).astype(np.float32)})


class FresnelOnly(Subject):
    """Metals mirror the sky times Schlick's Fresnel at N.V: nothing knows how much of a rough lobe is lost."""

    def frame(self, *aovs: str, camera: int | Camera = 0, scene: Scene | None = None, **changes: Any) -> Frame:
        assert isinstance(camera, int)
        scene, seen = scene or self.case.scene, self.case.seen(camera)
        sky = scene.environment
        assert sky is not None and sky.constant
        base = np.array([m.base_color[:3] for m in scene.materials] + [(0, 0, 0)])[seen.hit.material]
        cosine = np.abs((seen.hit.normal * seen.direction).sum(-1, keepdims=True))
        level = np.where(seen.covered[..., None], base + (1 - base) * (1 - cosine) ** 5, 1.0)
        shown = (level * sky.radiance[0, 0] * sky.intensity).astype(np.float32)
        return Frame(developed(shown), {"radiance": shown})


class RunningMean(Subject):
    """Unfiltered frames, each mixed with a tenth into what earlier ones have left, wherever that came from."""

    SHARE = 0.1

    def film(self, times: Sequence[float | None], scene: Scene | None = None) -> list[F32]:
        raw = {"reflections": "ray-glossy", "reflections.ray-glossy.denoise": False}
        frames = Subject(self.renderer, self.case, self.settings.replace(**raw)).film(times, scene)
        for k in range(1, len(frames)):
            frames[k] = (1 - self.SHARE) * frames[k - 1] + self.SHARE * frames[k]
        return frames


class Clamped(Subject):
    """The mean of frames of one ray along the lobe, each cut off where it is brighter than LIMIT: no specks."""

    LIMIT, FRAMES = 10.0, 16

    def frame(self, *aovs: str, camera: int | Camera = 0, scene: Scene | None = None, **changes: Any) -> Frame:
        key = "reflections.ray-glossy."
        raw = {"reflections": "ray-glossy", f"{key}samples": 1, f"{key}denoise": False, f"{key}sky_rays": False}
        film = Subject(self.renderer, self.case, self.settings.replace(**raw)).film([None] * self.FRAMES, scene)
        shown = np.mean([np.minimum(f, self.LIMIT) for f in film], axis=0)
        return Frame(developed(shown), {"radiance": shown})


def _enters(corners: F64, origin: F64, direction: F64) -> Any:
    """(R,) whether rays meet the box around some triangles."""
    low, high = corners.min((0, 1)), corners.max((0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = (low - origin) / direction, (high - origin) / direction
    near, far = np.fmin(first, last).max(1), np.fmax(first, last).min(1)
    return (near <= far) & (far >= 0)


CONTROLS: dict[str, type[Subject]] = {
    "clamped": Clamped,
    "depth-rebuilt": DepthRebuilt,
    "fixed-epsilon": FixedEpsilon,
    "fresnel-only": FresnelOnly,
    "inverse-matrix": InverseMatrix,
    "moeller-trumbore": MoellerTrumbore,
    "naive-slabs": NaiveSlabs,
    "nan-bounds": NanBounds,
    "own-triangle": OwnTriangle,
    "running-mean": RunningMean,
    "short-stack": ShortStack,
}


def find(name: str) -> type[Subject]:
    """The method of that name. Raises SettingError with the nearest one."""
    if name not in CONTROLS:
        raise SettingError(unknown("control", name, CONTROLS))
    return CONTROLS[name]
