"""Mirror rays for a part of the pixels, and for those between them only where the neighbours do not tell -> reflection.

`half` sends a ray for one pixel in four, `checkerboard` for one in two. A pixel between two that sent one takes their
mean if its own ray would lie midway between theirs and both see about the same (`contrast`); all others are put on a
list on the GPU and traced by an indirect dispatch, so nothing is read back. What is lost: things in the reflection that
are thinner than the distance between rays.
"""

from typing import Any

import moderngl

from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene
from glhybrid.layout import CONSTANTS
from glhybrid.needs import Features
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets


class ReflectSparse:
    """Owns the list of pixels that need a ray of their own, and their number."""

    name = "reflect"

    def __init__(
        self, context: Context, shaders: Shaders, scene: GpuScene, features: Features, settings: Settings
    ) -> None:
        self._gl, self._scene, self._features = context.gl, scene, features
        self._sparse = shaders.compute("reflect_sparse", features)
        self._resolve = shaders.compute("reflect_resolve", features)
        self._rest = shaders.compute("reflect_sparse", features.replace(pixel_list=True))
        self._contrast = settings.parameter("reflections.ray-lerp.contrast")
        self._count = context.gl.buffer(reserve=16)
        self._list: moderngl.Buffer | None = None

    def run(self, targets: Targets, ids: Any) -> dict[str, Any]:
        """Returns `reflection` of layout.py, by its channel."""
        width, height = targets.size
        if self._list is None or self._list.size != 4 * width * height:
            self._release_list()
            self._list = self._gl.buffer(reserve=4 * width * height)
        half = self._features.reflect_grid == CONSTANTS["GRID_HALF"]
        cells = (-(-width // 2), -(-height // 2) if half else height)
        reflection = targets.get("reflection")
        sparse, guide = (targets.get(name, size=cells) for name in ("reflection_sparse", "reflection_guide"))
        given = {
            **self._scene.resources, "gbuffer_id": ids, "PixelCount": self._count, "PixelList": self._list,
            "out_sparse": sparse, "sparse": sparse, "out_guide": guide, "guide": guide,
            "out_reflection": reflection, "contrast": self._contrast,
        }  # fmt: skip
        if self._features.reason:
            given["out_reason"] = targets.get("reason")
        self._sparse.dispatch(given, cells)
        self._resolve.dispatch(given, targets.size)
        self._rest.dispatch_indirect(given, self._count)
        return {"reflection": reflection}

    def _release_list(self) -> None:
        if self._list is not None:
            self._list.release()
            self._list = None

    def release(self) -> None:
        self._release_list()
        self._count.release()
