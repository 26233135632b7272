"""The G-buffer as planes, one a pixel, and a pyramid of the nearest depths over them: what a march in it skips by.

Made from the ids, so that it is the same for rastered and traced primary visibility, and exact where a depth buffer is
rounded. Only techniques that march have it.
"""

from typing import Any

from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class ScreenDepth:
    """Owns the pyramid. resources: what lib/march.glsl reads."""

    name = "screen_depth"

    def __init__(
        self, context: Context, shaders: Shaders, scene: GpuScene, features: Features, size: tuple[int, int]
    ) -> None:
        self._scene = scene
        self._planes = shaders.compute("screen_plane", features)
        self._reduce = shaders.compute("screen_depth", features)
        self._sizes = level_sizes(size)
        rows = 1 << max(size[1] - 1, 1).bit_length()
        # Rays that go on behind surfaces want the farthest depths as well as the nearest.
        components = 1 if features.mirror_rays else 2
        self._pyramid = context.gl.texture((self._sizes[0][0], rows), components, dtype="f4")
        self.resources: dict[str, Any] = {"screen_depth": self._pyramid, "screen_levels": len(self._sizes)}

    @property
    def bytes(self) -> int:
        return int(4 * self._pyramid.components * self._pyramid.width * self._pyramid.height)

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        """Returns the resources of a march: planes and pyramid."""
        plane = targets.get("screen_plane")
        self._planes.dispatch({**self._scene.resources, "gbuffer_id": ids, "out_plane": plane}, targets.size)
        given = {"Frame": self._scene.resources["Frame"], "screen_plane": plane, "pyramid": self._pyramid}
        for level, size in enumerate(self._sizes, start=1):
            self._reduce.dispatch({**given, "level": level, "level_size": size}, size)
        return {**self.resources, "screen_plane": plane}

    def release(self) -> None:
        self._pyramid.release()


def level_sizes(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Cells of the levels above the pixels, from 2 x 2 pixels a cell up to one cell for all."""
    sizes: list[tuple[int, int]] = []
    width, height = size
    while not sizes or max(width, height) > 1:
        width, height = (width + 1) // 2, (height + 1) // 2
        sizes.append((width, height))
    return sizes
