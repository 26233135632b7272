"""Scene files on the GPU: the sky stands where its sun does, and the built-in scenes give finite, balanced pictures."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import glhybrid as gh
from glhybrid.load import load
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera

if TYPE_CHECKING:
    from glhybrid.context import Context


@pytest.mark.parametrize(("azimuth", "rotation"), [(0, 0), (120, 0), (250, 70)])
def test_sky_and_sun_agree(context: "Context", tmp_path: Path, azimuth: float, rotation: float) -> None:
    """Looking against the sun's light, the brightest of the sky is in the middle, whatever the rotation."""
    path = tmp_path / "sky.toml"
    path.write_text(
        f"[environment]\nrotation_deg = {rotation}\n"
        f"sky = {{ sun_elevation_deg = 40, sun_azimuth_deg = {azimuth}, sun = true }}\n"
        '[[object]]\nshape = "box"\nsize = [0.01, 0.01, 0.01]\ntranslate = [0, -50, 0]\n'
    )
    scene = load(path)
    away = -np.array(scene.lights[0].direction)
    camera = Camera.look_at((0, 0, 0), tuple(away), fov_y=np.radians(60))
    with Renderer(context=context) as renderer:
        radiance = renderer.render(scene, camera, (96, 96), gh.Settings(aa=1))["radiance"]
    row, column = np.unravel_index(radiance.sum(2).argmax(), (96, 96))
    assert abs(column - 47.5) < 2 and 44 < row < 54  # a degree or two under the sun: there is more air


@pytest.mark.slow
def test_builtin_scenes_are_well_exposed(context: "Context") -> None:
    with Renderer(context=context) as renderer:  # one for all: equal programs are compiled once
        for name in ("atrium", "plaza", "showroom"):
            frame = renderer.render(load(name), 0, (160, 90), gh.Settings(aa=1))
            assert np.isfinite(frame["radiance"]).all() and frame["radiance"].min() >= 0
            grey = frame.rgb.mean(2)
            assert 60 < grey.mean() < 170 and grey.std() > 25, f"{name}: too dark, too bright or flat"
            assert (grey > 250).mean() < 0.08, f"{name}: burnt out"
