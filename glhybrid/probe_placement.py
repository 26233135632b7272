"""Where probes go in a scene that does not say: one that sees far, in a box fitted to what it sees. No OpenGL."""

import numpy as np

from glhybrid.scene import F64, Probe, Scene

WALL = 0.02  # share of all directions that may end beyond a wall of the fitted box
FACES = (  # right, up and forward of +X -X +Y -Y +Z -Z, as lib/probe.glsl reads them
    ((0, 0, 1), (0, 1, 0), (1, 0, 0)), ((0, 0, -1), (0, 1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, 1), (0, 1, 0)), ((-1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1)), ((1, 0, 0), (0, 1, 0), (0, 0, -1)),
)  # fmt: skip


def candidates(scene: Scene, bounds: F64) -> list[F64]:
    """Points to try, (3,) world: the middle of the scene, and the first camera, which is where there is room.

    bounds: (2, 3) of what is drawn.
    """
    points = [bounds.mean(0)]
    for camera in scene.cameras[:1]:
        eye = camera.world_from_view[:3, 3]
        if (eye > bounds[0]).all() and (eye < bounds[1]).all():
            points += [eye, (eye + bounds.mean(0)) / 2]
    return points


def openness(distance: F64, solid_angle: F64, reach: float) -> float:
    """How far a point sees: the geometric mean of distances, (...,) m, up to `reach`. In a corner it is small."""
    near = np.clip(distance, 1e-4 * reach, reach)
    return float(np.exp(np.average(np.log(near), weights=np.broadcast_to(solid_angle, near.shape))))


def fit(position: F64, points: F64, solid_angle: F64, bounds: F64) -> Probe:
    """A probe and its box: as far along each axis as all but WALL of the directions see; to the bounds where sky is.

    points: (N, 3) what it sees, not finite where nothing is; solid_angle: (N,).
    """
    low, high = bounds[0].copy(), bounds[1].copy()
    seen = np.isfinite(points).all(-1)
    if seen.any():
        points, weight = points[seen], solid_angle[seen]
        for axis in range(3):
            order = np.argsort(points[:, axis])
            share = np.cumsum(weight[order]) / solid_angle.sum()
            values = points[order, axis]
            low[axis] = max(low[axis], values[min(np.searchsorted(share, WALL / 2), len(values) - 1)])
            high[axis] = min(high[axis], values[np.searchsorted(share, share[-1] - WALL / 2).clip(0, len(values) - 1)])
    # The probe is inside, whatever it saw, and boxes have a size.
    least = 1e-3 * float(np.linalg.norm(bounds[1] - bounds[0])) or 1e-3
    low, high = np.minimum(low, position - least), np.maximum(high, position + least)
    return Probe(tuple(position.tolist()), tuple(low.tolist()), tuple(high.tolist()), name="automatic")


def face_pose(position: F64, face: int) -> F64:
    """(4, 4) world_from_view of a face's camera."""
    right, up, forward = (np.array(v, np.float64) for v in FACES[face])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, up, -forward, position
    return pose


def solid_angles(size: int) -> F64:
    """(size, size) of the texels of a face with a border texel on each side, which count nothing."""
    edge = (np.arange(size) + 0.5 - size / 2) / (size / 2 - 1)
    u, v = np.meshgrid(edge, edge)
    inside = (np.abs(u) < 1) & (np.abs(v) < 1)
    return np.where(inside, (1 + u * u + v * v) ** -1.5, 0.0)


def equirect(faces: F64, width: int, height: int) -> F64:
    """(6, S, S, 3) faces with a border texel, row 0 at the bottom, as an equirect (H, W, 3), row 0 at +Y; bilinear."""
    theta = ((np.arange(height) + 0.5) / height * np.pi)[:, None]
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    d = np.stack(np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)), -1)
    axis = np.abs(d).argmax(-1)
    major = np.take_along_axis(d, axis[..., None], -1)[..., 0]
    face = 2 * axis + (major < 0)
    right, up = (np.array([f[k] for f in FACES], np.float64)[face] for k in (0, 1))
    size = faces.shape[1]
    u, v = (((d * way).sum(-1) / np.abs(major) * 0.5 + 0.5) * (size - 2) + 0.5 for way in (right, up))
    i, j = (np.clip(np.floor(x).astype(int), 0, size - 2) for x in (u, v))
    fu, fv = (u - i)[..., None], (v - j)[..., None]
    low = faces[face, j, i] * (1 - fu) + faces[face, j, i + 1] * fu
    high = faces[face, j + 1, i] * (1 - fu) + faces[face, j + 1, i + 1] * fu
    result: F64 = low * (1 - fv) + high * fv
    return result
