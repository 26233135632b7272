"""filly (Google Filament) on a bundle, in a process of its own: `python -m ... FOLDER ANSWER.npz`."""

import sys
from importlib.metadata import version
from typing import Any

import numpy as np

from glhybrid.study.peers import common

SHADOW_TEXELS = 2048  # as `map` has here
NOTES = [
    "the sky is prefiltered and reflects without occlusion; height-correlated Smith term",
    "shadow maps; 8-bit pictures: radiance from three exposures, which unlit surfaces do not follow",
]


def main(folder: str, out: str) -> None:
    """Renders what common.read finds in `folder`; common.answer writes `out`."""
    import filly

    path, about, sky = common.read(folder)
    width, height = about["size"]
    with filly.Renderer() as renderer:
        scene = renderer.create_scene()
        scene.load(str(path))
        camera = scene.camera = renderer.create_camera()
        aspect, far = width / height, about["extent"] * 20
        if about["fov_y"] > 0:
            camera.set_perspective(
                fov_y_deg=float(np.degrees(about["fov_y"])), aspect=aspect, near=about["near"], far=far
            )
        else:
            half = about["ymag"]
            camera.set_orthographic(
                left=-half * aspect, right=half * aspect, bottom=-half, top=half, near=about["near"], far=far
            )
        camera.transform = np.array(about["world_from_view"], np.float32)
        scene.antialiasing, scene.msaa, scene.dithering, scene.ssao, scene.bloom = "none", 1, False, False, False
        scene.tone_mapping, scene.shadows = "linear", True
        middle = np.roll(sky, sky.shape[1] // 2, 1)  # its middle column looks along +Z
        scene.environment = renderer.create_environment(np.ascontiguousarray(middle, np.float32))
        scene.environment_visible, scene.environment_intensity = True, 1.0
        for light in about["lights"]:
            _light(scene, light, about["extent"])
        target = renderer.create_render_target(width=width, height=height)

        def draw(gain: float) -> np.ndarray:
            camera.exposure = -float(np.log2(1.2 * gain))  # EV100: Filament shows radiance / (1.2 * 2^EV)
            renderer.render(scene, target)
            return target.read()

        radiance = common.bracketed(draw, about["mean"])
        _, times = common.timed(lambda: draw(0.18 / about["mean"]))
    common.answer(out, radiance, times, version("filly"), NOTES)


def _light(scene: Any, light: dict[str, Any], extent: float) -> None:
    options = {"intensity": light["intensity"], "color": light["color"]}
    placed = {"position": light["position"], "range": light["range"] or extent * 10}
    if light["kind"] == "directional":
        lamp = scene.add_directional_light(direction=light["direction"], **options)
    elif light["kind"] == "point":
        lamp = scene.add_point_light(**options, **placed)
    else:
        cone = np.degrees([light["inner_cone"], light["outer_cone"]]).tolist()
        lamp = scene.add_spot_light(direction=light["direction"], cone_deg=cone, **options, **placed)
    lamp.casts_shadows, lamp.shadow_map_size = True, SHADOW_TEXELS


if __name__ == "__main__":
    main(*sys.argv[1:])
