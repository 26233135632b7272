"""Which point of the scene each pixel of a mirror shows, by how its technique found it.

Rays and marches tell how far along the mirror ray they met something; where a march guessed, what it shows is what the
pixel there shows; a probe shows what lies in a direction from its own place. What is blended of several is not told
apart: the nearest answer of the technique stands for it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid import probe_placement, techniques
from glhybrid.image import Frame
from glhybrid.layout import CONSTANTS
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, F64, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.view import View, make_view

GUESSED = CONSTANTS["REASON_THICKNESS"]
FACE = 512  # pixels a side of what is looked up for a probe
PLAIN = Settings(shadows="none", reflections="none", aa=1)


@dataclass(frozen=True, eq=False)
class Rays:
    """The mirror ray of each pixel: origin, direction (H, W, 3) world; plane: the unit normal that sends the view
    there. NaN where nothing is seen."""

    view: View
    origin: F64
    direction: F64
    plane: F64

    @staticmethod
    def of(scene: Scene, camera: Camera, size: tuple[int, int], frame: Frame) -> "Rays":
        """frame: of that camera, with position, normal, normal_geometric."""
        view = make_view(camera, size, scene)
        origin = frame["position"].astype(np.float64)
        normal, facet = (_unit(frame[name].astype(np.float64)) for name in ("normal", "normal_geometric"))
        way = _unit(origin - view.origin - view.eye) if not view.orthographic else np.broadcast_to(
            _unit(view.forward), origin.shape
        )  # fmt: skip
        direction = way - 2 * _dot(way, normal) * normal
        below = _dot(direction, facet)
        bent = _unit(direction + (1e-3 - below) * facet)  # as mirror_direction of lib/shade.glsl
        direction = np.where(below < 1e-4, bent, direction)
        return Rays(view, origin, direction, _unit(direction - way))

    def at(self, distance: F32) -> F64:
        """(H, W, 3) points so far along, m."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.origin + distance[..., None] * self.direction)

    def error_px(self, points: F64) -> F64:
        """(H, W) pixels between each pixel's middle and where the mirror image of its point is drawn."""
        height, width = points.shape[:2]
        with np.errstate(invalid="ignore"):
            image = points - 2 * _dot(points - self.origin, self.plane) * self.plane
            x, y = project(self.view, image)
            middle_x, middle_y = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
            return np.hypot(x - middle_x, y - middle_y)


def project(view: View, points: F64) -> tuple[F64, F64]:
    """Pixels (x, y), y down, of points (..., 3); not finite behind the eye."""
    width, height = view.size
    rel = points - view.origin
    clip = rel @ view.clip_from_world[:, :3].T + view.clip_from_world[:, 3]
    w = np.where(clip[..., 3] > 0, clip[..., 3], np.nan)
    return (clip[..., 0] / w * 0.5 + 0.5) * width, (0.5 - clip[..., 1] / w * 0.5) * height


def shown_points(renderer: Renderer, scene: Scene, rays: Rays, frame: Frame, settings: Settings) -> F64:
    """(H, W, 3) world, NaN or infinite where the technique found none. frame: with reflection_hit, reason, position."""
    technique = techniques.TECHNIQUES["reflections"][str(settings.reflections)]
    if not technique.mirror_pass:
        return np.full(rays.origin.shape, np.nan)
    distance = np.where(frame["reflection_hit"] > 0, frame["reflection_hit"], np.nan)
    points = rays.at(distance)
    placed = (frame.receipt.get("probes") or {}).get("placed", ())
    if placed:
        return _seen_by_probes(renderer, scene, rays, points, placed)
    guessed = frame["reason"] == GUESSED
    if guessed.any():
        beyond = rays.at(distance * np.float32(1.001))[guessed]
        points[guessed] = _at_pixels(rays.view, points[guessed], beyond, frame["position"])
    return points


def _at_pixels(view: View, points: F64, beyond: F64, position: F32) -> F64:
    """What is seen in the pixels that points (N, 3) lie in: on a border between two, in the one that is entered there
    on the way to `beyond`."""
    x, y = project(view, points)
    x1, y1 = project(view, beyond)
    step = 0.01 / np.maximum(np.hypot(x1 - x, y1 - y), 1e-9)
    x, y = x + step * (x1 - x), y + step * (y1 - y)
    found = np.full(points.shape, np.nan)
    inside = (x >= 0) & (y >= 0) & (x < view.size[0]) & (y < view.size[1])
    found[inside] = position[y[inside].astype(int), x[inside].astype(int)]
    return found


def _seen_by_probes(renderer: Renderer, scene: Scene, rays: Rays, walls: F64, placed: Any) -> F64:
    """walls: where the mirror rays leave the box of the probe that speaks for their origin: the first in reach."""
    found = np.full(walls.shape, np.nan)
    left = np.isfinite(walls).all(-1)
    for probe in placed:
        low, high = (np.asarray(corner) for corner in probe["reach"] or (probe["low"], probe["high"]))
        room = 1e-4 * float(np.linalg.norm(high - low))
        mine = left & ((rays.origin >= low - room) & (rays.origin <= high + room)).all(-1)
        if mine.any():
            position = np.asarray(probe["position"], np.float64)
            found[mine] = _surroundings(renderer, scene, position, walls[mine] - position)
            left &= ~mine
    return found


def _surroundings(renderer: Renderer, scene: Scene, position: F64, directions: F64) -> F64:
    """(N, 3) what lies in directions (N, 3) from a point."""
    found = np.full(directions.shape, np.nan)
    axis = np.abs(directions).argmax(-1)
    face = 2 * axis + (np.take_along_axis(directions, axis[:, None], -1)[:, 0] < 0)
    near = min(0.01, 1e-4 * float(np.linalg.norm(np.diff(scene.bounds(), axis=0))) or 0.01)
    for k in np.unique(face).tolist():
        camera = Camera("probe", probe_placement.face_pose(position, k), fov_y=np.pi / 2, near=near)
        seen = renderer.render(scene, camera, (FACE, FACE), PLAIN, aovs=("position", "distance"))
        points = np.where(np.isfinite(seen["distance"])[..., None], seen["position"], np.inf)
        x, y = project(make_view(camera, (FACE, FACE), scene), position + directions[face == k])
        rows, columns = (np.clip(v.astype(int), 0, FACE - 1) for v in (y, x))
        found[face == k] = points[rows, columns]
    return found


def _dot(a: F64, b: F64) -> F64:
    return (a * b).sum(-1, keepdims=True)


def _unit(v: F64) -> F64:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(length > 0, v / length, np.nan))
