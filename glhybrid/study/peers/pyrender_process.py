"""pyrender on a bundle, in a process of its own: `python -m ... FOLDER ANSWER.npz`."""

import os
import sys
from typing import Any

import numpy as np

from glhybrid.study.peers import common

NOTES = [
    "the sky is one colour, its mean, that lights all surfaces alike and is seen behind them: nothing is reflected",
    "shadow maps of fixed size for suns and spots; point lights cast none",
    "8-bit pictures: radiance from three exposures, which shining surfaces do not follow; emission is squared",
    "roughness and metal of a texture from its red and green, not green and blue",
]


def main(folder: str, out: str) -> None:
    """Renders what common.read finds in `folder`; common.answer writes `out`."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    import pyrender
    import trimesh

    vars(np).setdefault("infty", np.inf)  # pyrender is older than NumPy 2
    path, about, sky = common.read(folder)
    loaded = trimesh.load(path, force="scene")
    width, height = about["size"]
    rows = np.sin((np.arange(len(sky)) + 0.5) / len(sky) * np.pi)[:, None]
    ambient = (sky.mean(1) * rows).sum(0) / rows.sum()
    scene = pyrender.Scene.from_trimesh_scene(loaded, bg_color=(0, 0, 0, 0))
    pose = np.array(about["world_from_view"])
    if about["fov_y"] > 0:
        camera = pyrender.PerspectiveCamera(about["fov_y"], znear=about["near"], aspectRatio=width / height)
    else:
        camera = pyrender.OrthographicCamera(about["ymag"] * width / height, about["ymag"], znear=about["near"])
    scene.add(camera, pose=pose)
    lamps = [_light(pyrender, light, about["extent"]) for light in about["lights"]]
    for lamp, at in lamps:
        scene.add(lamp, pose=at)
    renderer = pyrender.OffscreenRenderer(width, height)
    flags = pyrender.RenderFlags.SHADOWS_DIRECTIONAL | pyrender.RenderFlags.SHADOWS_SPOT

    def draw(gain: float) -> np.ndarray:
        scene.ambient_light = ambient * gain
        scene.bg_color = common.encoded(ambient * gain)
        for (lamp, _), light in zip(lamps, about["lights"], strict=True):
            lamp.intensity = light["intensity"] * gain
        return renderer.render(scene, flags=flags)[0]

    radiance = common.bracketed(draw, about["mean"])
    _, times = common.timed(lambda: draw(0.18 / about["mean"]))
    common.answer(out, radiance, times, pyrender.__version__, NOTES)


def _light(pyrender: Any, light: dict[str, Any], extent: float) -> tuple[Any, Any]:
    """The lamp and its pose; lamps shine along -Z."""
    pose = np.eye(4)
    back = -np.array(light["direction"])
    right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
    right /= np.linalg.norm(right)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(back, right), back
    pose[:3, 3] = light["position"]
    color = np.array(light["color"], float)
    if light["kind"] == "directional":
        return pyrender.DirectionalLight(color), pose
    reach = light["range"] or extent * 10
    if light["kind"] == "point":
        return pyrender.PointLight(color, range=reach), pose
    cones = max(light["inner_cone"], 1e-3), max(light["outer_cone"], 2e-3)
    return pyrender.SpotLight(color, range=reach, innerConeAngle=cones[0], outerConeAngle=cones[1]), pose


if __name__ == "__main__":
    main(*sys.argv[1:])
