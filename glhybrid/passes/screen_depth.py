"""The G-buffer as planes, one a pixel, and a pyramid of the nearest depths over them: what a march in it skips by.

Made from the ids, so that it is the same for rastered and traced primary visibility, and exact where a depth buffer is
rounded. Only techniques that march have it.
"""

from typing import Any

from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class ScreenDepth:
    """What a march through the screen skips by. Owns nothing."""

    name = "screen_depth"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._scene = scene
        self._planes = shaders.compute("screen_plane", features)
        self._reduce = shaders.compute("screen_depth", features)
        # Rays that go on behind surfaces want the farthest depths as well as the nearest.
        self.channel = "screen_nearest" if features.mirror_rays else "screen_span"

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        """Returns what lib/march.glsl reads: planes and pyramid."""
        plane, sizes = targets.get("screen_plane"), level_sizes(targets.size)
        self._planes.dispatch({**self._scene.resources, "gbuffer_id": ids, "out_plane": plane}, targets.size)
        rows = 1 << max(targets.size[1] - 1, 1).bit_length()
        pyramid = targets.get(self.channel, size=(sizes[0][0], rows))
        given = {"Frame": self._scene.resources["Frame"], "screen_plane": plane, "pyramid": pyramid}
        for level, size in enumerate(sizes, start=1):
            self._reduce.dispatch({**given, "level": level, "level_size": size}, size)
        return {"screen_plane": plane, "screen_depth": pyramid, "screen_levels": len(sizes)}


def level_sizes(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Cells of the levels above the pixels, from 2 x 2 pixels a cell up to one cell for all."""
    sizes: list[tuple[int, int]] = []
    width, height = size
    while not sizes or max(width, height) > 1:
        width, height = (width + 1) // 2, (height + 1) // 2
        sizes.append((width, height))
    return sizes
