"""What is right, without the tracer: Embree for the many, brute force in float64 for what the two disagree about."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rays import NO_HIT, Found, Rays, Tracer

from glhybrid.scene import F64, U32

RELATIVE_T = 1e-5


@dataclass(frozen=True)
class Verdict:
    """Counts over the rays of one comparison. disputed: Embree says otherwise; the rest: what float64 says of those."""

    rays: int
    hits: int
    disputed: int
    missed: int
    invented: int
    wrong_t: int
    border: int  # excused: the ray passes an edge closer than float32 coordinates can tell
    tiny: int  # excused: t is off by more than 1e-5 of itself, but within 2 ulp of the coordinates
    worst: float  # largest relative error of t among the rest

    @property
    def wrong(self) -> int:
        return self.missed + self.invented + self.wrong_t


class Embree:
    """Embree in robust mode over (T, 3, 3) corners. Answers are rows of those."""

    def __init__(self, corners: Any) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene(robust=True)
        corners = np.ascontiguousarray(corners, np.float32)
        self._mesh = TriangleMesh(
            self._scene, corners.reshape(-1, 3), np.arange(len(corners) * 3, dtype=np.int32).reshape(-1, 3)
        )

    def closest(self, rays: Rays) -> tuple[F64, NDArray[np.int64]]:
        """t, inf = a miss; row of corners, -1 = a miss. Asks from t = 0 on."""
        far = np.minimum(rays.t_max, np.float32(1e30))
        out = self._scene.run(
            rays.origin.copy(), rays.direction.copy(), dists=far.astype(np.float32), query="INTERSECT", output=True
        )
        row = np.asarray(out["primID"]).astype(np.int64)
        return np.where(row >= 0, np.asarray(out["tfar"], np.float64), np.inf), row


def compare(tracer: Tracer, rays: Rays, found: Found, embree: Embree, corners: F64, rows: U32) -> Verdict:
    """Holds what the GPU found against Embree, and every disagreement against brute force in float64."""
    t_embree, _ = embree.closest(rays)
    assert not np.isnan(found.t).any() and np.array_equal(np.isfinite(found.t), found.hit)
    error = relative(found.t, t_embree)
    # Any hit must say what closest hit says, ray by ray, whatever Embree thinks.
    disagree = ~(error <= RELATIVE_T) | (found.blocked != found.hit)
    worst = float(error[~disagree].max(initial=0))
    part = (found.t[disagree], found.triangle[disagree], found.instance[disagree])
    missed, invented, wrong_t, border, tiny, judged_worst = judge(rays[disagree], *part, tracer, corners, rows)
    # Closest and any hit test the same triangles in the same arithmetic: no rounding excuses a difference.
    missed += int((found.blocked != found.hit).sum())
    counts = (len(rays), int(found.hit.sum()), int(disagree.sum()), missed, invented, wrong_t, border, tiny)
    return Verdict(*counts, max(worst, judged_worst))


def relative(t: F64, truth: F64) -> F64:
    """|t - truth| / truth; 0 where both miss, or both start on the surface; inf where one misses."""
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.abs(t - truth) / truth
    same = ~np.isfinite(t) & ~np.isfinite(truth) | (np.maximum(t, truth) < 1e-15)
    return np.where(same, 0, np.where(np.isnan(error), np.inf, error))


def judge(
    rays: Rays, t: F64, triangle: U32, instance: U32, tracer: Tracer, corners: F64, rows: U32
) -> tuple[int, int, int, int, int, float]:
    """All triangles in float64: missed, invented, wrong t, excused at a border, excused as tiny, worst relative t."""
    from glhybrid import reference

    if not len(rays):
        return 0, 0, 0, 0, 0, 0.0
    truth = reference.closest_hit(corners, rays.origin, rays.direction, rays.t_min, rays.t_max)
    hit = triangle != NO_HIT
    error = relative(t, truth.t)
    fine = error <= RELATIVE_T
    worst = float(error[fine].max(initial=0))
    missed = invented = wrong_t = border = tiny = 0
    keys = tracer.triangles()[2].astype(np.int64) << 32 | rows
    order = np.argsort(keys)
    for k in np.flatnonzero(~fine):
        key = int(instance[k]) << 32 | int(triangle[k])
        ours = int(order[np.searchsorted(keys, key, sorter=order)]) if hit[k] else -1
        theirs = int(truth.triangle[k]) if truth.hit[k] else -1
        o, d = rays.origin[k].astype(np.float64), rays.direction[k].astype(np.float64)
        # Whoever sees something nearer makes the claim.
        claim = ours if theirs < 0 or (ours >= 0 and t[k] < truth.t[k]) else theirs
        slack = rounding_of(corners[claim], o, tracer)
        if ours >= 0 and theirs >= 0 and abs(t[k] - truth.t[k]) <= slack / 2 * plane_condition(corners[theirs], d):
            tiny += 1
        elif border_distance(corners[claim], o, d) <= slack:
            border += 1
        elif ours == theirs:
            wrong_t += 1
        elif claim == ours:
            invented += 1
        else:
            missed += 1
    return missed, invented, wrong_t, border, tiny, worst


def plane_condition(corners: F64, direction: F64) -> float:
    """How much further than a point rounding may move a triangle's plane along a ray: grazing rays, thin triangles."""
    e1, e2 = corners[1] - corners[0], corners[2] - corners[0]
    n = np.cross(e1, e2)
    area = float(np.linalg.norm(n))
    facing = abs(float(n @ direction)) / (area * float(np.linalg.norm(direction)))
    return float(np.linalg.norm(e1) * np.linalg.norm(e2)) / area / facing


def border_distance(corners: F64, origin: F64, direction: F64) -> float:
    """Smallest distance between the line of the ray and the triangle's edges, metres."""
    d = direction / np.linalg.norm(direction)
    flat = [v - origin - ((v - origin) @ d) * d for v in corners]  # seen along the ray, the ray is the zero vector
    best = np.inf
    for a, b in zip(flat, flat[1:] + flat[:1], strict=True):
        edge = b - a
        length = edge @ edge
        s = np.clip(-(a @ edge) / length, 0, 1) if length > 0 else 0.0
        best = min(best, float(np.linalg.norm(a + s * edge)))
    return best


def rounding_of(corners: F64, origin: F64, tracer: Tracer) -> float:
    """What float32 may move a point by, metres: 4 ulp of the largest coordinate that takes part."""
    far = max(float(np.abs(corners).max()), float(np.abs(origin).max()))
    if tracer.features.two_level:  # also of the way into object space and back
        far += float(np.abs(tracer.geometry.world_from_object[:, :3, 3] - tracer.origin).max())
    return 4 * 2.0**-23 * far
