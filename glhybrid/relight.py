"""Scenes under other light: where a light comes from and how the environment is turned. Plain data in and out.

A scene changed this way is not staged anew by Renderer.stage. Azimuth is from +Z towards +X, elevation from the
horizon, both of where the light comes from, in degrees.
"""

import re
from dataclasses import replace

import numpy as np

from glhybrid.errors import SettingError
from glhybrid.scene import Light, Scene

MOST_DEGREES = 360_000


def angles(light: Light) -> tuple[float, float]:
    """(azimuth, elevation) in degrees of where a directional or spot light comes from."""
    x, y, z = (-float(v) for v in light.direction)
    return float(np.rad2deg(np.arctan2(x, z))), float(np.rad2deg(np.arctan2(y, np.hypot(x, z))))


def turn_light(scene: Scene, index: int, azimuth: float, elevation: float) -> Scene:
    """The scene with one light coming from there. Raises SettingError for a light that has no direction."""
    if not 0 <= index < len(scene.lights):
        raise SettingError(f"light {index}: {scene.name} has {len(scene.lights)}, numbered from 0")
    light = scene.lights[index]
    if light.kind == "point":
        raise SettingError(f"light {index}: a point light has no direction")
    _check(f"light {index}", azimuth, elevation)
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    x, y, z = -np.sin(a) * np.cos(e), -np.sin(e), -np.cos(a) * np.cos(e)
    lights = list(scene.lights)
    lights[index] = replace(light, direction=(float(x), float(y), float(z)))
    return scene.replace(lights=tuple(lights))


def _check(what: str, *degrees: float) -> None:
    for angle in degrees:
        if not abs(angle) <= MOST_DEGREES:  # NaN is not
            raise SettingError(f"{what}: {angle:g}: expected degrees, up to {MOST_DEGREES} either way")


def turn_environment(scene: Scene, degrees: float) -> Scene:
    """The scene with its environment turned to an angle about +Y. Raises SettingError where there is none."""
    if scene.environment is None:
        raise SettingError(f"environment: {scene.name} has none to turn")
    _check("environment rotation", degrees)
    return scene.replace(environment=replace(scene.environment, rotation=float(np.deg2rad(degrees))))


def apply(scene: Scene, lights: tuple[str, ...] = (), environment: float | None = None) -> Scene:
    """As the command line says it: lights as `INDEX:AZIMUTH,ELEVATION`, and the angle of the environment."""
    number = r"([-+]?[0-9.]+(?:e[-+]?\d+)?)"
    for text in lights:
        match = re.fullmatch(rf"(\d+):{number},{number}", text.strip())
        try:
            index, azimuth, elevation = int(match[1]), float(match[2]), float(match[3])  # type: ignore[index]
        except (TypeError, ValueError):
            raise SettingError(
                f'--light "{text}": expected INDEX:AZIMUTH,ELEVATION in degrees, such as 0:45,30'
            ) from None
        scene = turn_light(scene, index, azimuth, elevation)
    return scene if environment is None else turn_environment(scene, environment)
