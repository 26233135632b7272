"""What changes from frame to frame though nothing that lights it did: pans, and animations seen from a fixed camera.

A *fixed point* is a point of a surface that two frames both sample at a pixel's centre. A technique without memory and
noise gives it the same shadow and the same reflection in both, unless something moved through one of its rays: those
changes are *explained*, all others are the technique's own. For hard traced shadows and mirrors there are none.

Frames are of equal size, in the order of time. Percentages are of fixed
points and steps from one frame to the next.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from glhybrid import pose as posing
from glhybrid.layout import CONSTANTS
from glhybrid.motion import Motion
from glhybrid.scene import F64, Camera, Light, Scene
from glhybrid.settings import Settings
from glhybrid.stream import Shot
from glhybrid.study.picture import LUMINANCE
from glhybrid.view import choose_camera

if TYPE_CHECKING:
    from glhybrid.image import Frame
    from glhybrid.renderer import Renderer

Mask = NDArray[np.bool_]
AOVS = (
    "radiance", "visibility", "position", "normal", "reflection", "reflection_hit", "motion", "triangle_id",
    "instance_id",
)  # fmt: skip
WHOLE = 1e-2  # pixels that a point may lie beside a pixel's centre and still be sampled there: `motion` is float32
CHANGED = 1e-3  # relative: a reflection that differs by more is another one
NOWHERE = CONSTANTS["ID_NONE"]


@dataclass(frozen=True)
class Stability:
    """flips: shadows of fixed points that change sides of one half; changes: reflections of theirs that differ by more
    than a thousandth. own_*: those that nothing moving explains. All per cent of points and steps.

    flicker, flicker_p99: |change of luminance| of surface points followed by motion vectors, over mean luminance, mean
    and 99th percentile. points: how many fixed points, over all steps.
    """

    flips: float
    own_flips: float
    changes: float
    own_changes: float
    flicker: float
    flicker_p99: float
    points: int


class Layers(Protocol):
    """AOVs by name: a Frame, or a dict of arrays."""

    def __getitem__(self, name: str, /) -> Any: ...


class Matches(NamedTuple):
    """Fixed points of a frame (H, W) bool, and the pixel (row, column) (H, W) where the frame before shows each."""

    fixed: Mask
    row: NDArray[np.int64]
    column: NDArray[np.int64]


def matches(old: Layers, new: Layers) -> Matches:
    """By motion vectors and ids. A pixel whose motion is not whole is none: the frame before sampled another point."""
    motion = new["motion"].astype(np.float64)
    height, width = motion.shape[:2]
    whole = np.rint(motion)
    row = np.arange(height)[:, None] + whole[..., 1].astype(np.int64)
    column = np.arange(width) + whole[..., 0].astype(np.int64)
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    fixed = inside & (np.abs(motion - whole).max(-1) < WHOLE) & (new["instance_id"] != NOWHERE)
    for name in ("instance_id", "triangle_id"):
        fixed &= new[name] == old[name][row, column]
    return Matches(fixed, row, column)


def flip_rate(frames: Sequence[Layers], counted: Sequence[Mask] | None = None) -> float:
    """Per cent of the shadows of fixed points that change sides of one half, a step.

    counted: (H, W) masks, one a step: only these pixels of the later frame. Each light of each point counts.
    """
    flipped = total = 0
    for k, (old, new) in enumerate(pairwise(frames)):
        fixed, row, column = matches(old, new)
        if counted is not None:
            fixed = fixed & counted[k]
        sides = (old["visibility"][row, column] > 0.5) != (new["visibility"] > 0.5)
        flipped += int(sides[fixed].sum())
        total += int(fixed.sum()) * sides.shape[-1]
    return 100.0 * flipped / max(total, 1)


def change_rate(frames: Sequence[Layers], counted: Sequence[Mask] | None = None) -> float:
    """Per cent of fixed points whose reflection differs by more than a thousandth of itself, a step."""
    changed = total = 0
    for k, (old, new) in enumerate(pairwise(frames)):
        fixed, row, column = matches(old, new)
        if counted is not None:
            fixed = fixed & counted[k]
        before, after = (x.astype(np.float64) for x in (old["reflection"][row, column], new["reflection"]))
        far = np.abs(after - before).max(-1) > CHANGED * np.maximum(before, after).max(-1)
        changed += int(far[fixed].sum())
        total += int(fixed.sum())
    return 100.0 * changed / max(total, 1)


def flicker(frames: Sequence[Layers]) -> tuple[float, float]:
    """Mean and 99th percentile of |L(t) - L(t-1)| over mean luminance, of surface points followed by `motion`.

    The frame before is read between its pixels (bilinear) where all four show the same instance.
    """
    changes, levels = [np.zeros(0)], [np.zeros(0)]
    for old, new in pairwise(frames):
        height, width = new["instance_id"].shape
        place = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1) + new["motion"].astype(np.float64)
        x, y = place[..., 0], place[..., 1]
        left, top = np.floor(x + 1e-6).astype(np.int64), np.floor(y + 1e-6).astype(np.int64)
        u, v = np.clip(x - left, 0, 1), np.clip(y - top, 0, 1)
        u, v = np.where(u < WHOLE, 0, u), np.where(v < WHOLE, 0, v)
        seen = new["instance_id"] != NOWHERE
        value = np.zeros((height, width))
        luminance = old["radiance"].astype(np.float64) @ LUMINANCE
        for dx, dy, weight in ((0, 0, (1 - u) * (1 - v)), (1, 0, u * (1 - v)), (0, 1, (1 - u) * v), (1, 1, u * v)):
            row, column = np.clip(top + dy, 0, height - 1), np.clip(left + dx, 0, width - 1)
            inside = (row == top + dy) & (column == left + dx) & (old["instance_id"][row, column] == new["instance_id"])
            seen &= inside | (weight == 0)
            value += weight * luminance[row, column]
        now = new["radiance"].astype(np.float64) @ LUMINANCE
        changes.append(np.abs(now - value)[seen])
        levels.append(now[seen])
    change, level = np.concatenate(changes), np.concatenate(levels)
    if not len(change):
        return 0.0, 0.0
    mean = float(level.mean()) or 1.0
    return float(change.mean()) / mean, float(np.percentile(change, 99)) / mean


def over_pan(
    renderer: "Renderer", scene: Scene, camera: Camera, size: tuple[int, int], settings: Settings, steps: int = 32
) -> Stability:
    """`steps` frames of a scene at rest, each seen a pixel further to the right. camera: orthographic, so that every
    point moves by one pixel and nothing is resampled. Nothing moves, so every change is the technique's own."""
    assert camera.fov_y <= 0 and steps > 0
    pixel = 2 * (camera.xmag / size[0] if camera.xmag else camera.ymag / size[1])
    shots = []
    for k in range(steps + 1):
        pose = camera.world_from_view.copy()
        pose[:3, 3] += k * pixel * pose[:3, 0]
        shots.append(Shot(None, Camera("pan", pose, fov_y=0.0, near=camera.near, xmag=camera.xmag, ymag=camera.ymag)))
    return _summed(renderer.frames(scene, shots, size, settings, AOVS), None)


def over_animation(
    renderer: "Renderer",
    scene: Scene,
    camera: int | str | Camera | None,
    size: tuple[int, int],
    settings: Settings,
    times: Sequence[float],
) -> Stability:
    """A clip seen from a fixed camera: only what moves through a point's rays may change its light.

    times: seconds, rising. settings.clip names the clip. camera: one of the scene, held where it is at the first time.
    """
    clip = posing.find_clip(scene, settings.clip)
    assert clip is not None and len(times) > 1
    motion = Motion(scene, clip)
    moments = [motion.at(t) for t in times]
    fixed = choose_camera(scene.replace(cameras=moments[0].cameras), camera)
    boxes = [_boxes(motion, m) for m in moments]
    sweeps = []
    for a, b, before, after in zip(boxes, boxes[1:], moments, moments[1:], strict=False):
        moved = (a != b).any((1, 2)) | (before.world_from_object != after.world_from_object).any((1, 2))
        moved[list(_deformed(motion))] = True
        sweep = np.stack([np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 1], b[:, 1])], axis=1)[moved]
        sweeps.append((sweep[np.isfinite(sweep).all((1, 2))], before.lights, after.lights))
    shots = [Shot(t, fixed) for t in times]
    return _summed(renderer.frames(scene, shots, size, settings, AOVS), (fixed, sweeps))


def _summed(frames: "Iterable[Frame]", moving: tuple[Camera, list[Any]] | None) -> Stability:
    """Frame by frame, so that two are held at a time. moving: the camera, and what moved in each step."""
    totals = np.zeros(4)
    flick, weights, points = [], [], 0
    before: Any = None
    for step, frame in enumerate(frames, start=-1):
        if before is not None:
            pair = (before, frame)
            fixed = matches(*pair).fixed
            shadow, mirror = np.zeros_like(fixed), np.zeros_like(fixed)
            if moving is not None:
                shadow, mirror = explained(frame, moving[0], *moving[1][step])
            count = int(fixed.sum())
            # Rates of the unexplained are of all fixed points too, so that the figures compare.
            own = [100 * _share(fixed & ~mask, fixed) for mask in (shadow, mirror)]
            totals += count * np.array([
                flip_rate(pair), flip_rate(pair, [~shadow]) * own[0] / 100,
                change_rate(pair), change_rate(pair, [~mirror]) * own[1] / 100,
            ])  # fmt: skip
            flick.append(flicker(pair))
            weights.append(count)
            points += count
        before = frame
    flips, own_flips, changes, own_changes = (totals / max(points, 1)).tolist()
    mean, p99 = np.average(np.array(flick or [(0, 0)]), axis=0, weights=np.maximum(weights or [1], 1)).tolist()
    return Stability(flips, own_flips, changes, own_changes, mean, p99, points)


def _share(part: Mask, whole: Mask) -> float:
    return float(part.sum()) / max(int(whole.sum()), 1)


def explained(
    frame: Layers, camera: Camera, sweep: F64, lights: tuple[Light, ...], later: tuple[Light, ...]
) -> tuple[Mask, Mask]:
    """(H, W) masks: points whose shadow, and whose reflection, may change because something moved.

    sweep: (K, 2, 3) world boxes of what moved, before and after together. lights, later: the scene's, at both times.
    A reflection's rays are its mirror ray up to what it hits, and the shadow rays from there.
    """
    point = frame["position"].astype(np.float64)
    shape = point.shape[:2]
    if lights is not later and any(_other(a, b) for a, b in zip(lights, later, strict=True)):
        return np.ones(shape, bool), np.ones(shape, bool)
    shadow = _blocked_by(point, lights, sweep)
    normal, eye = frame["normal"].astype(np.float64), camera.world_from_view[:3, 3]
    view = point - eye if camera.fov_y > 0 else np.broadcast_to(-camera.world_from_view[:3, 2], point.shape)
    view = view / np.maximum(np.linalg.norm(view, axis=-1, keepdims=True), 1e-30)
    mirror = view - 2 * (view * normal).sum(-1, keepdims=True) * normal
    length = frame["reflection_hit"].astype(np.float64)
    reach = np.where(np.isfinite(length), length, 1e6)[..., None]
    end = point + np.where(np.isfinite(length), length, 0)[..., None] * mirror
    # A thing that came out from behind what was hit lies no further than the sky.
    met = _crossed(point, mirror * reach, sweep) | _crossed(point, mirror * 1e6, sweep)
    return shadow, met | _blocked_by(end, lights, sweep)


def _blocked_by(point: F64, lights: tuple[Light, ...], sweep: F64) -> Mask:
    found = np.zeros(point.shape[:2], bool)
    for light in lights:
        if light.kind == "directional":
            way = np.broadcast_to(-1e6 * np.asarray(light.direction), point.shape)
        else:
            way = np.asarray(light.position) - point
        found |= _crossed(point, way, sweep, slack=light.radius + 1e6 * np.tan(light.angular_diameter / 2))
    return found


def _crossed(point: F64, way: F64, boxes: F64, slack: float = 0.0) -> Mask:
    """(H, W) bool: whether point + [0, 1] way meets a box (K, 2, 3), all grown a little. slack: how far the end of a
    ray may lie from where it is said to be; rays to lights with a size count as met by anything in their cone's box."""
    found = np.zeros(point.shape[:2], bool)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = 1 / np.where(way == 0, 1e-300, way)
        for low, high in boxes:
            grow = 1e-4 * float((high - low).max()) + 1e-6 * float(np.abs(boxes).max())
            if slack:
                reach = np.linalg.norm((low + high) / 2 - point, axis=-1) / np.linalg.norm(way, axis=-1)
                grow = grow + (slack * np.minimum(reach, 1))[..., None]
            a, b = (low - grow - point) * inverse, (high + grow - point) * inverse
            found |= np.minimum(np.maximum(a, b).min(-1), 1) >= np.maximum(np.minimum(a, b).max(-1), 0)
    return found


def _other(a: Light, b: Light) -> bool:
    return a is not b and (a.position, a.direction, a.intensity) != (b.position, b.direction, b.intensity)


def _deformed(motion: Motion) -> set[int]:
    return {i for d in motion.deformers for i in d.instances}


def _boxes(motion: Motion, moment: Any) -> F64:
    """(I, 2, 3) float64 world boxes of all instances at a moment."""
    start = motion.start
    own = np.array([start.meshes[p.mesh].bounds for p in start.instances]).reshape(-1, 2, 3)
    for deformer, shape in zip(motion.deformers, moment.shapes, strict=True):
        own[list(deformer.instances)] = shape.bounds
    world = moment.world_from_object
    middle, half = own.mean(1), (own[:, 1] - own[:, 0]) / 2
    middle = np.einsum("iab,ib->ia", world[:, :3, :3], middle) + world[:, :3, 3]
    half = np.einsum("iab,ib->ia", np.abs(world[:, :3, :3]), half)
    return np.stack([middle - half, middle + half], axis=1)
