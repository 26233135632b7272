"""Linear radiance -> what is looked at, through the renderer's own exposure and tone map, whoever made the radiance."""

import numpy as np
from numpy.typing import NDArray

from glhybrid.image import Frame
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.settings import Settings


def develop(
    renderer: Renderer, scene: Scene, camera: Camera, radiance: F32, exposure: float | None = None
) -> tuple[Frame, float]:
    """A frame of (H, W, 3) radiance, and its exposure in EV: as given, else the automatic one."""
    height, width = radiance.shape[:2]
    settings = Settings(shadows="none", reflections="none", aa=1, exposure="auto" if exposure is None else exposure)
    staged = renderer.stage(scene, settings, (width, height))
    staged.aim(settings, camera)
    staged.set()
    image = staged.targets.get("radiance")
    texels = np.concatenate([radiance, np.ones((height, width, 1), np.float32)], -1)[::-1]
    image.write(np.ascontiguousarray(texels, np.float32).tobytes())
    shown = staged.display.run(staged.targets, image)
    rgb: NDArray[np.uint8] = np.frombuffer(shown.read(), np.uint8).reshape(height, width, 4)[::-1, :, :3]
    frame = Frame(np.ascontiguousarray(rgb), {"radiance": np.ascontiguousarray(radiance, np.float32)})
    return frame, float(staged.display.exposure_ev() if exposure is None else exposure)
