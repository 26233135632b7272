"""Mirror rays for a part of the pixels, and for those between them only where the neighbours do not tell -> reflection.

`half` sends a ray for one pixel in four, `checkerboard` for one in two. A pixel between two that sent one takes their
mean if its own ray would lie midway between theirs and the picture could not tell what they see apart (`contrast`, a
share of all that the pixel shows); all others are put on a list on the GPU and traced by indirect dispatches of the
same programs, so nothing is read back. What is lost: things in the reflection that are thinner than the distance
between rays.
"""

from typing import Any

import moderngl

from glhybrid.layout import CONSTANTS
from glhybrid.passes.reflect import handed_on, programs
from glhybrid.setup import Setup
from glhybrid.targets import Targets


class ReflectSparse:
    """In one program or in parts, as `reflect`. Owns the list of pixels that need rays of their own, and its length."""

    name = "reflect"

    def __init__(self, setup: Setup) -> None:
        shaders, features, split = setup.shaders, setup.features, setup.plan.split
        self._gl, self._scene, self._features = setup.context.gl, setup.scene, features
        stems = programs(features, split)
        self._grid = [shaders.compute(stem, features) for stem in stems]
        self._guide = shaders.compute("reflect_guide", features) if split else None
        self._resolve = shaders.compute("reflect_resolve", features)
        # Its shadow rays apart, too: in the program of the mirror rays they take an H100 up to 1.7 times as long.
        self._rest = [shaders.compute(stem, features.replace(pixel_list=True)) for stem in stems]
        self._images = handed_on(features) if split else ()
        self._contrast = setup.settings.parameter("reflections.ray-lerp.contrast")
        self._count = self._gl.buffer(reserve=16)
        self._list: moderngl.Buffer | None = None
        self._given: dict[str, Any] = {}

    def begin(self, targets: Targets, ids: Any) -> None:
        """All up to the rays of the list, which are few and take as long as the longest of them: a GPU has room for
        what else the frame has to do before finish(), if it does not look at reflections."""
        width, height = targets.size
        if self._list is None or self._list.size != 4 * width * height:
            self._release_list()
            self._list = self._gl.buffer(reserve=4 * width * height)
        half = self._features.reflect_grid == CONSTANTS["GRID_HALF"]
        cells = (-(-width // 2), -(-height // 2) if half else height)
        reflection, guide = targets.get("reflection"), targets.get("reflection_guide", size=cells)
        given = {
            **self._scene.resources, "gbuffer_id": ids, "PixelCount": self._count, "PixelList": self._list,
            "out_guide": guide, "guide": guide, "out_reflection": reflection, "contrast": self._contrast,
        }  # fmt: skip
        given |= {name: targets.get(name) for name in self._images}
        if self._features.reason:
            given["out_reason"] = targets.get("reason")
        self._grid[0].dispatch(given, cells)
        if self._guide is not None:
            self._grid[1].dispatch(given, cells, wait=False)
            self._guide.dispatch(given, cells)  # while the last of those are on their way
        for program in (*self._grid[2:], self._resolve):
            program.dispatch(given, cells)
        self._rest[0].dispatch_indirect(given, self._count, wait=False)
        self._given = given

    def finish(self) -> dict[str, Any]:
        """The rest of it. Returns `reflection` of layout.py, by its channel."""
        given, self._given = self._given, {}
        self._gl.memory_barrier()
        for program in self._rest[1:]:
            program.dispatch_indirect(given, self._count)
        return {"reflection": given["out_reflection"]}

    def _release_list(self) -> None:
        if self._list is not None:
            self._list.release()
            self._list = None

    def release(self) -> None:
        self._release_list()
        self._count.release()
