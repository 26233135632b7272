"""Where depth maps look from: rows of layout ShadowMap for lights, scene and view. No OpenGL, float64.

A directional light gets one map over the whole scene, or cascades: slices of what the camera sees, in their bounding
spheres, so that neither size nor grid of a map changes as the camera turns, and its texels are laid out from the
origin of the world in whole numbers, so that they stay where they are as it moves (Valient, "Stable Rendering of
Cascaded Shadow Maps", ShaderX6 (2008)). The last cascade is always the whole scene: nothing is without a map, and a
ray's hit behind the camera finds one. A spot light gets one perspective map, a point light six.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid import layout
from glhybrid.errors import SettingError
from glhybrid.scene import F64, Light
from glhybrid.settings import Settings
from glhybrid.view import View

WIDE_CONE = np.radians(60)  # half angle of a spot light from which six faces serve better than one stretched map
NEAR = 1e-4  # of the distance to the end of what is solid: reversed float depth loses nothing there (layout.py)


@dataclass(frozen=True)
class Fit:
    """What of the settings says where maps look from. margin: texels around each map that filters may reach into."""

    resolution: int
    margin: float
    cascades: int = 1
    split: float = 0.75
    distance: float = 0.0
    snap: bool = True

    @staticmethod
    def of(settings: Settings) -> "Fit":
        """From the parameters of the shadow technique in use."""
        name = settings.shadows
        value = lambda key: settings.parameter(f"shadows.{name}.{key}")  # noqa: E731
        reach = {"map": lambda: 0.5, "pcss": lambda: value("search")}.get(name, lambda: value("radius"))()
        fit = Fit(value("resolution"), reach + value("normal_bias") + 2)
        if fit.margin > fit.resolution / 4:
            raise SettingError(
                f"shadows.{name}.resolution = {fit.resolution}: filters reach {fit.margin:g} texels, more than a "
                "quarter of a map; raise the resolution or lower radius, search or normal_bias"
            )
        if name != "csm":
            return fit
        return Fit(fit.resolution, fit.margin, value("cascades"), value("split"), value("distance"), value("snap"))


def cube(light: Light) -> bool:
    """Whether six faces serve a light instead of one map."""
    return light.kind == "point" or (light.kind == "spot" and light.outer_cone > WIDE_CONE)


def map_counts(lights: tuple[Light, ...], fit: Fit) -> list[int]:
    """Maps a light, at most."""
    return [fit.cascades if light.kind == "directional" else 6 if cube(light) else 1 for light in lights]


def empty_rows(lights: tuple[Light, ...], fit: Fit) -> tuple[Any, Any]:
    """Arrays of the size that `rows` needs at most."""
    maps, row = max(sum(map_counts(lights, fit)), 1), max(len(lights), 1)
    return np.zeros(maps, layout.dtype("ShadowMap")), np.zeros(row, layout.dtype("ShadowLight"))


def columns(count: int, resolution: int, limit: int, key: str) -> int:
    """Tiles in a row of an atlas of `count` square maps. Raises SettingError where a texture cannot hold them."""
    most = limit // resolution
    if count > most * most:
        raise SettingError(
            f"{key} = {resolution}: the scene's lights need {count} maps, and a texture of this device holds "
            f"{most * most} of that size ({limit}x{limit}); lower the resolution"
        )
    return min(most, int(np.ceil(np.sqrt(count))))


def rows(boxes: F64, lights: tuple[Light, ...], view: View, fit: Fit, across: int) -> tuple[Any, Any]:
    """Rows of ShadowMap and of ShadowLight, relative to view.origin.

    boxes: (N, 2, 3) world, of all that casts or shows shadows; NaN = nothing. across: tiles in a row of the atlas.

    A light may have fewer maps than map_counts says: a slice of the view that is no smaller than the scene needs none.
    """
    boxes = boxes[np.isfinite(boxes).all((1, 2))] - view.origin
    if not len(boxes):
        boxes = np.zeros((1, 2, 3))
    lights_out = np.zeros(max(len(lights), 1), layout.dtype("ShadowLight"))
    made: list[dict[str, Any]] = []
    first = 0
    for light, row, most in zip(lights, lights_out, map_counts(lights, fit), strict=False):
        if light.kind == "directional":
            maps = _directional(light, boxes, view, fit)
        else:
            maps = _perspective(light, boxes, view.origin, fit)
        for k, item in enumerate(maps):
            tile = first + k
            item["corner"] = (tile % across * fit.resolution, tile // across * fit.resolution)
            item["size"] = fit.resolution
        row["first_map"], row["map_count"], row["cube"] = len(made), len(maps), cube(light)
        made += maps
        first += most
    out = np.zeros(max(len(made), 1), layout.dtype("ShadowMap"))
    for target, item in zip(out, made, strict=False):
        for name, value in item.items():
            target[name] = value
    return out, lights_out


def following(lights: tuple[Light, ...], rows: Any, count: int) -> Any:
    """(count,) bool: maps that a camera's motion changes, all cascades but the last. rows: of ShadowLight."""
    out = np.zeros(count, bool)
    for light, row in zip(lights, rows, strict=False):
        if light.kind == "directional":
            out[row["first_map"] : row["first_map"] + row["map_count"] - 1] = True
    return out


def _corners(boxes: F64) -> F64:
    """(..., 8, 3) corners of (..., 2, 3) boxes."""
    pick = np.array([(i >> 2 & 1, i >> 1 & 1, i & 1) for i in range(8)])
    return boxes[..., pick, np.arange(3)]


def _flat(boxes: F64) -> Any:
    """(N,) bool: boxes without thickness. What is in one cannot shadow itself."""
    size = boxes[:, 1] - boxes[:, 0]
    return size.min(1) <= 1e-6 * size.max(1)


def _shadowed(boxes: F64, plane: F64) -> F64:
    """(2, 2) low and high, in the plane (3, 2) across parallel rays, of where one thing can hide another.

    A ground that reaches to the horizon needs texels only where something stands on it: flat boxes count no further
    than solid ones, or each other, reach over them. Outside the map everything is lit.
    """
    across = _corners(boxes) @ plane
    rects = np.stack([across.min(1), across.max(1)], 1)
    flat = _flat(boxes)
    parts = rects[~flat]
    sheets = rects[flat]
    if len(sheets) > 2000:  # pairs of them are too many to look at
        parts, sheets = rects, sheets[:0]
    for k in range(1, len(sheets)):
        low, high = np.maximum(sheets[k, 0], sheets[:k, 0]), np.minimum(sheets[k, 1], sheets[:k, 1])
        over = (low < high).all(1)
        parts = np.concatenate([parts, np.stack([low[over], high[over]], 1)])
    if not len(parts):
        parts = rects
    return np.stack([parts[:, 0].min(0), parts[:, 1].max(0)])


def _frame(axis: F64) -> tuple[F64, F64]:
    """right and up of a map that looks along a unit axis; up leans to the world's."""
    helper = np.eye(3)[1] if abs(axis[1]) < 0.999 else np.eye(3)[2]
    right = np.cross(axis, helper)
    right /= np.linalg.norm(right)
    return right, np.cross(right, axis)


def _directional(light: Light, boxes: F64, view: View, fit: Fit) -> list[dict[str, Any]]:
    axis = np.asarray(light.direction, np.float64)
    axis = axis / np.linalg.norm(axis)
    right, up = _frame(axis)
    depth = _corners(boxes) @ axis
    reach = max(float(np.ptp(depth)), 1e-6)
    shared = {
        "origin": (0, 0, 0), "right": right, "up": up, "axis": axis, "near": 0.0,
        "start": depth.min() - 0.01 * reach, "range": 1.02 * reach,
    }  # fmt: skip
    inner = fit.resolution - 2 * fit.margin  # texels that the fitted part may cover; one more to snap
    low, high = _shadowed(boxes, np.stack([right, up], 1))
    size = np.maximum(high - low, 1e-3 * max(float((high - low).max()), 1e-6))
    texel = size / (inner - 1)
    whole = shared | {"texel": texel, "first_texel": (low + high) / 2 / texel - fit.resolution / 2}
    if fit.cascades == 1:
        return [whole]
    maps = []
    # Whole numbers of texels are counted from the world's origin, not from the camera's grid point.
    base = view.origin @ np.stack([right, up], 1)
    for centre, radius in _slices(view, boxes, fit):
        side = 2 * radius / (inner - 1)
        if side >= texel.max():  # the scene's own map is as fine
            break
        first = (centre @ np.stack([right, up], 1) + base) / side - fit.resolution / 2
        if fit.snap:
            # The rest, in steps that float32 holds: a fraction that differed in its last bit would be no fixed grid.
            first = np.round((np.round(first) - base / side) * 256) / 256
        else:
            first -= base / side
        maps.append(shared | {"texel": (side, side), "first_texel": first})
    return [*maps, whole]


def _slices(view: View, boxes: F64, fit: Fit) -> list[tuple[F64, float]]:
    """(centre, radius) of spheres about all but the last of `cascades` slices of the view, nearest first.

    Distances and radii are rounded up to steps, so that they do not follow every move of the camera.
    """
    along = (_solid_corners(boxes) - view.eye) @ view.forward
    far = float(along.max())
    if fit.distance > 0:
        far = min(far, fit.distance)
    near = max(view.camera.near, float(along.min()), far / 1000)
    if far <= near:
        return []
    far, near = _step_up(far, 4), 1 / _step_up(1 / near, 4)
    width, height = np.linalg.norm(view.right), np.linalg.norm(view.up)
    spheres = []
    low = near
    for k in range(1, fit.cascades):
        # Zhang et al., "Parallel-Split Shadow Maps" (2006): a mixture of logarithmic and even steps.
        share = k / fit.cascades
        high = fit.split * near * (far / near) ** share + (1 - fit.split) * (near + (far - near) * share)
        slope = float(np.hypot(width, height))
        if view.orthographic:
            middle, radius = (low + high) / 2, float(np.hypot(slope, (high - low) / 2))
        else:
            middle = min(high, (low + high) / 2 * (1 + slope**2))
            radius = float(np.hypot(slope * high, high - middle))
        spheres.append((view.eye + middle * view.forward, _step_up(radius, 32)))
        low = high
    return spheres


def _step_up(value: float, steps: int) -> float:
    """The next of `steps` even steps between powers of two; a hair of rounding does not lift it."""
    unit = 2.0 ** np.floor(np.log2(value)) / steps
    return float(np.ceil(value / unit - 1e-6) * unit)


def _solid_corners(boxes: F64) -> F64:
    """(N, 3) corners of the boxes that are not flat; of all if all are."""
    solid = boxes[~_flat(boxes)]
    return _corners(solid if len(solid) else boxes).reshape(-1, 3)


def _perspective(light: Light, boxes: F64, origin: F64, fit: Fit) -> list[dict[str, Any]]:
    position = np.asarray(light.position, np.float64) - origin
    reach = max(float(np.linalg.norm(_solid_corners(boxes) - position, axis=1).max()), 1e-6)
    if cube(light):
        axes, half = [sign * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0)], 1.0
    else:
        axis = np.asarray(light.direction, np.float64)
        axes, half = [axis / np.linalg.norm(axis)], float(np.tan(max(light.outer_cone, 1e-3)))
    texel = 2 * half / (fit.resolution - 2 * fit.margin)
    maps = []
    for axis in axes:
        right, up = _frame(axis)
        maps.append({
            "origin": position, "right": right, "up": up, "axis": axis, "start": 0.0, "near": NEAR * reach,
            "range": reach, "texel": (texel, texel), "first_texel": (-fit.resolution / 2,) * 2,
        })  # fmt: skip
    return maps
