"""Refuses scenes and cameras that could only be drawn wrong: numbers that are none, or beyond what float32 rays bear.

Loaders refuse or mend what files hold; this is for what comes through the API, and for cameras against the scene.
"""

import math
import operator
from collections.abc import Callable, Iterable
from typing import Any, get_args

import numpy as np

from glhybrid.errors import SettingError
from glhybrid.mesh_checks import check_meshes
from glhybrid.scene import AlphaMode, Camera, Environment, Light, Material, Scene, Sphere
from glhybrid.settings import Settings
from glhybrid.view import View

FARTHEST = 1e12  # m: as geometry.LARGEST
BRIGHTEST = 1e20  # radiance, lux, candela: what is left of float32 bears squares of distances
WIDEST = math.radians(179)
TELLS = 2.0**-23  # of 1: what float32 tells apart
AFFINE = 1e-6  # how far a last row may be from 0 0 0 1
KINDS = ("directional", "point", "spot")

Rule = tuple[Callable[[Any], bool], str]


def _within(low: float, high: float) -> Rule:
    """One number or several, each in a range."""

    def fits(value: Any) -> bool:
        numbers = np.asarray(value, np.float64)
        return bool(((numbers >= low) & (numbers <= high)).all())  # False for NaN

    return fits, f"must be from {low:g} to {high:g}"


_PLACE, _SHARE, _LIGHT = _within(-FARTHEST, FARTHEST), _within(0, 1), _within(0, BRIGHTEST)
_LIGHTS: dict[str, Rule] = {
    "kind": (lambda v: v in KINDS, f"must be one of {', '.join(KINDS)}"), "color": _LIGHT, "intensity": _LIGHT,
    "position": _PLACE, "radius": _within(0, FARTHEST), "range": _within(0, 3e38), "angular_diameter": _within(0, 3.14),
}  # fmt: skip
_MATERIALS: dict[str, Rule] = {
    "base_color": _within(0, 1e6), "metallic": _SHARE, "roughness": _SHARE, "emissive": _LIGHT,
    "alpha_mode": (lambda v: v in get_args(AlphaMode), f"must be one of {', '.join(get_args(AlphaMode))}"),
    "alpha_cutoff": _within(-1e6, 1e6), "normal_scale": _within(-1e6, 1e6), "occlusion_strength": _SHARE,
    "ior": (lambda v: v == 0 or 1 <= v < 1e6, "must be 0 or at least 1"), "specular": _SHARE, "clearcoat": _SHARE,
    "specular_color": _within(0, 1e6), "clearcoat_roughness": _SHARE, "transmission": _SHARE,
}  # fmt: skip


def check_scene(scene: Scene) -> None:
    """Raises SettingError naming the first light, material, instance, matrix or texel that cannot be drawn.

    GeometryError for arrays of meshes (mesh_checks.py).
    """
    _refuse(scene, "light", scene.lights, _LIGHTS)
    for number, light in enumerate(scene.lights):
        length = float(np.linalg.norm(np.asarray(light.direction, np.float64)))
        if light.kind != "point" and not 1e-6 < length < FARTHEST:
            raise SettingError(
                f"{scene.name}: {_named('light', number, light)}: direction = {light.direction}: {DIRECTION}"
            )
    _refuse(scene, "material", scene.materials, _MATERIALS)
    if scene.environment is not None:
        _check_sky(scene.name, scene.environment)
    for number, mesh in enumerate(scene.meshes):
        for piece in mesh.primitives:
            if isinstance(piece, Sphere) and piece.radius < 0:
                raise SettingError(
                    f"{scene.name}: {_named('mesh', number, mesh)}: radius = {piece.radius:g}: at least 0"
                )
    for number, probe in enumerate(scene.probes):
        if not all(a < p < b for a, p, b in zip(probe.low, probe.position, probe.high, strict=True)):
            raise SettingError(
                f"{scene.name}: {_named('probe', number, probe)}: position {probe.position} must lie in the box from "
                f"{probe.low} to {probe.high}"
            )
    check_meshes(scene)
    meshes, materials = len(scene.meshes), len(scene.materials)
    for number, instance in enumerate(scene.instances):
        what = f'{scene.name}: instance {number} "{instance.name}"'
        if not 0 <= instance.mesh < meshes:
            raise SettingError(f"{what}: mesh = {instance.mesh}: there are {meshes}, numbered from 0")
        if not isinstance(instance.world_from_object, np.ndarray) or instance.world_from_object.shape != (4, 4):
            given = np.shape(instance.world_from_object)
            raise SettingError(f"{what}: world_from_object is {given}, not a NumPy array of shape (4, 4)")
        if instance.materials:
            pieces = len(scene.meshes[instance.mesh].primitives)
            if len(instance.materials) != pieces:
                raise SettingError(
                    f"{what}: {len(instance.materials)} materials for the {pieces} primitives of its mesh"
                )
            if not 0 <= min(instance.materials) <= max(instance.materials) < materials:
                raise SettingError(f"{what}: materials = {instance.materials}: there are {materials}, numbered from 0")
    _check_matrices(scene)


def _check_matrices(scene: Scene) -> None:
    """All are affine, and instances are where rays can reach. What is not finite is left out later, and said."""
    instances, nodes = scene.instances, [(n.name, n.matrix) for n in scene.nodes if n.matrix is not None]
    poses = np.array([i.world_from_object for i in instances], np.float64).reshape(-1, 4, 4)
    _refuse_rows(scene, poses, lambda k: f'instance {k} "{instances[k].name}": world_from_object')
    for name, matrix in nodes:
        if np.shape(matrix) != (4, 4):
            raise SettingError(f'{scene.name}: node "{name}": matrix is {np.shape(matrix)}, not (4, 4)')
    _refuse_rows(scene, np.array([m for _, m in nodes]).reshape(-1, 4, 4), lambda k: f'node "{nodes[k][0]}": matrix')
    for number, skin in enumerate(scene.skins):
        if np.shape(skin.inverse_bind) != (len(skin.joints), 4, 4):
            shape, want = np.shape(skin.inverse_bind), (len(skin.joints), 4, 4)
            raise SettingError(f'{scene.name}: skin {number} "{skin.name}": inverse_bind is {shape}, not {want}')
        what = f'skin {number} "{skin.name}": inverse_bind'
        _refuse_rows(scene, skin.inverse_bind, lambda k, what=what: f"{what}[{k}]")  # type: ignore[misc]
    if (far := np.flatnonzero((np.abs(poses[:, :3, 3]) > FARTHEST).any(1) & np.isfinite(poses).all((1, 2)))).size:
        k = int(far[0])
        what = f'{scene.name}: instance {k} "{instances[k].name}"'
        raise SettingError(
            f"{what}: world_from_object puts it at {poses[k, :3, 3].tolist()}: at most {FARTHEST:g} m from zero"
        )


def _refuse_rows(scene: Scene, matrices: np.ndarray, named: Callable[[int], str]) -> None:
    """matrices: (N, 4, 4), destination from source."""
    if (wrong := np.flatnonzero((np.abs(matrices[:, 3] - (0, 0, 0, 1)) > AFFINE).any(1))).size:
        k = int(wrong[0])
        turned = " (it is transposed)" if np.abs(matrices[k, :, 3] - (0, 0, 0, 1)).max() <= AFFINE else ""
        raise SettingError(
            f"{scene.name}: {named(k)}: its last row is {matrices[k, 3].tolist()}, must be [0, 0, 0, 1]{turned}"
        )


DIRECTION = "must have a length, such as (0, -1, 0)"


def _named(kind: str, number: int, thing: Any) -> str:
    name = getattr(thing, "name", "")
    return f'{kind} {number} "{name}"' if name else f"{kind} {number}"


def _refuse(scene: Scene, kind: str, things: Iterable[Light | Material], rules: dict[str, Rule]) -> None:
    for number, thing in enumerate(things):
        for name, (fits, says) in rules.items():
            value = getattr(thing, name)
            try:
                fine = fits(value)
            except (TypeError, ValueError):
                fine = False
            if not fine:
                raise SettingError(f"{scene.name}: {_named(kind, number, thing)}: {name} = {value!r}: {says}")


def _check_sky(name: str, sky: Environment) -> None:
    shape = np.shape(sky.radiance)
    if len(shape) != 3 or shape[2] != 3 or 0 in shape:
        raise SettingError(f"{name}: environment: radiance is {shape}, not (height, width, 3)")
    for what, value, high in (("intensity", sky.intensity, BRIGHTEST), ("rotation", abs(sky.rotation), 1e6)):
        if not 0 <= value <= high:
            raise SettingError(
                f"{name}: environment: {what} = {getattr(sky, what)!r}: must be finite, at most {high:g}"
            )
    low, high = float(np.min(sky.radiance)), float(np.max(sky.radiance))  # NaN if any is
    if not (math.isfinite(low) and high <= BRIGHTEST) or (sky.constant and low < 0):
        wrong = ~np.isfinite(sky.radiance) | (sky.radiance > BRIGHTEST) | (sky.radiance < 0)
        row, column, _ = (int(k[0]) for k in np.nonzero(wrong))
        raise SettingError(
            f"{name}: environment: texel ({row}, {column}) = {sky.radiance[row, column].tolist()}: must be from 0 to "
            f"{BRIGHTEST:g}: mend the image, such as with numpy.nan_to_num"
        )


def check_kinds(scene: object, settings: object) -> None:
    """Raises SettingError for what is no Scene or no Settings: a file's name, a dictionary."""
    if not isinstance(scene, Scene):
        raise SettingError(f"scene = {scene!r:.80}: must be a Scene, such as glhybrid.load gives for a file's name")
    if not isinstance(settings, Settings):
        raise SettingError(f'settings = {settings!r:.80}: must be Settings, such as Settings(shadows="ray")')


def check_size(size: tuple[int, int]) -> None:
    """Raises SettingError unless it is two whole numbers; how large they may be is the device's to say (targets.py)."""
    try:
        width, height = size
        operator.index(width), operator.index(height)
    except (TypeError, ValueError):
        raise SettingError(f"size = {size!r}: must be two whole numbers of pixels, such as (1280, 720)") from None


def check_camera(camera: Camera) -> None:
    """Raises SettingError for a camera without a place, a direction, or an angle."""
    pose, what = np.asarray(camera.world_from_view), f'camera "{camera.name}"'
    if pose.shape != (4, 4) or not all(map(math.isfinite, pose.ravel().tolist())):
        raise SettingError(f"{what}: world_from_view must be a (4, 4) matrix of finite numbers: {pose.tolist()}")
    if not _is_rigid(pose.tolist()):
        raise SettingError(f"{what}: world_from_view must be rigid, without scale: {pose.tolist()}")
    if not camera.fov_y <= WIDEST:
        degrees = math.degrees(camera.fov_y)
        raise SettingError(f"{what}: fov = {degrees:g} degrees: at most 179, wider ones show everything as a point")
    if camera.fov_y <= 0 and not (0 < camera.ymag <= FARTHEST and 0 <= camera.xmag <= FARTHEST):
        raise SettingError(
            f"{what}: orthographic with half extents of {camera.xmag:g} and {camera.ymag:g} m: must be from 0 to "
            f"{FARTHEST:g}, and the height not 0"
        )
    if not (math.isfinite(camera.near) and (camera.near > 0 or camera.fov_y <= 0)):
        raise SettingError(f"{what}: near = {camera.near:g} m: must be finite and more than 0")
    if not (camera.far == 0 or camera.far > camera.near):
        raise SettingError(
            f"{what}: far = {camera.far:g} m: must be 0, for no limit, or more than near ({camera.near:g} m)"
        )


def _is_rigid(pose: list[list[float]]) -> bool:
    """Every frame in motion asks: plain numbers take a fifth of what NumPy would."""
    (a, b, c, _), (d, e, f, _), (g, h, i, _), (x, y, z, w) = pose
    lengths = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
    products = a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i
    off = max(*(abs(v - 1) for v in lengths), *map(abs, products))
    return off <= 1e-3 and max(abs(x), abs(y), abs(z), abs(w - 1)) <= AFFINE


def check_view(view: View, bounds: np.ndarray) -> list[str]:
    """Raises SettingError where float32 rays cannot tell the scene's points or the picture's pixels apart.

    bounds: (2, 3) of what is drawn. Returns a sentence for each thing that makes a picture of nothing.
    """
    camera, (low, high) = view.camera, bounds.tolist()
    extent, what = math.dist(low, high), f'camera "{camera.name}"'
    eye = np.asarray(camera.world_from_view)[:3, 3].tolist()
    if max(map(abs, eye)) > FARTHEST:
        raise SettingError(f"{what}: eye = {eye}: at most {FARTHEST:g} m from zero")
    if not view.orthographic and view.pixel_angle < TELLS:
        least = math.degrees(2 * math.atan(TELLS * view.size[1] / 2))
        raise SettingError(
            f"{what}: fov = {math.degrees(camera.fov_y):g} degrees is {view.pixel_angle:g} rad a pixel, and float32 "
            f"rays tell {TELLS:.1e} apart: take at least {least:.2g} degrees, or go nearer"
        )
    if not extent > 0 or not math.isfinite(extent):
        return []
    away = math.hypot(*(max(a - x, x - b, 0.0) for x, a, b in zip(eye, low, high, strict=True)))
    if away * TELLS > 0.1 * extent:
        raise SettingError(
            f"{what}: eye = {eye} is {away:g} m from a scene of {extent:g} m: float32 rays tell "
            f"{away * TELLS:g} m apart there: go nearer than {0.1 * extent / TELLS:.1g} m"
        )
    pixel = view.pixel_angle if view.orthographic else view.pixel_angle * away
    if view.orthographic and pixel < TELLS * extent * 1e-3:
        raise SettingError(
            f"{what}: height = {camera.ymag:g} m is {pixel:g} m a pixel, and a scene of {extent:g} m is told apart to "
            f"{TELLS * extent:g} m: take more"
        )
    said = []
    if pixel > extent:
        said.append(f"{what}: the whole scene, {extent:g} m, is smaller than a pixel, {pixel:g} m at its distance")
    if not view.orthographic and camera.near > away + extent:
        said.append(f"{what}: near = {camera.near:g} m is behind the whole scene, which ends at {away + extent:g} m")
    return said
