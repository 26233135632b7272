"""Light maps: visibility of every light at texels of every surface, traced once, looked up per pixel: as `shadow`.

Visibility, not light, is what is baked, a layer a light: the composite stays the same formula, and colours, intensities
and ranges of lights may change without another bake. A light without size is one any-hit ray from the texel's point,
one with a size is `shadows.baked.samples` rays over its disc. Points inside solids are pushed out along their surface
(baked_push.comp) or take their neighbours' values. Hits of reflection rays and blended layers read the same maps.

Kept on disk by content: geometry, lights, what rays may pass through, numbers, shaders and device. What moves cannot be
baked: plan.py refuses it.
"""

import math
import zlib
from typing import Any

import moderngl
import numpy as np

from glhybrid import content_cache, layout, lightmap
from glhybrid.context import Context
from glhybrid.gl import BufferTexture
from glhybrid.gpu_scene import GpuScene, light_rows
from glhybrid.lightmap import Lightmap, Limits, Progress
from glhybrid.needs import Features
from glhybrid.scene import F32
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets

ROWS_AT_ONCE = 1 << 18  # texels in a dispatch
RAYS_AT_ONCE = 8  # of an invocation: llvmpipe ends all its loops at 65,535 turns, rays included
BAKE_INSIDE = 2.0  # as in lib/bake.glsl


class Baked:
    """Owns the maps. `resources` has what lib/lightmap.glsl reads, for every pass that looks into them."""

    name = "baked"

    def __init__(
        self, context: Context, shaders: Shaders, scene: GpuScene, features: Features, settings: Settings,
        progress: Progress | None = None,
    ) -> None:  # fmt: skip
        self._context, self._shaders, self._scene, self._settings = context, shaders, scene, settings
        self._features = features
        self._owned: list[Any] = []
        self.channel = "visibility_tint" if features.blended else "visibility"
        self._components = 4 if features.blended else 1
        limits = Limits(min(context.limits.texture_size, 16384), context.limits.texture_layers)
        count = len(scene.lights)
        self.layout = layout_ = lightmap.make(
            scene.geometry, count, self._number("texels"), self._number("budget"), self._number("triangles"), limits,
            self._components, progress,
        )  # fmt: skip
        pages, height, width = layout_.pages
        name = self._key()
        kept = content_cache.read("bake", name)
        texels = _inflated(kept, count * pages * height * width * self._components) if kept is not None else None
        self.from_cache = texels is not None
        if texels is None:
            texels = self._bake(progress).tobytes()
            content_cache.write("bake", name, zlib.compress(texels, 1))
        atlas = context.gl.texture_array((width, height, count * pages), self._components, texels, alignment=1)
        atlas.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._owned.append(atlas)
        self.resources: dict[str, Any] = {
            "lightmap": atlas, "lightmap_uv": self._texels(layout_.uv), "lightmap_places": self._texels(layout_.places),
            "lightmap_pages": pages,
        }  # fmt: skip
        self._program = shaders.compute("baked", features)

    def _number(self, name: str) -> Any:
        return self._settings.parameter(f"shadows.baked.{name}")

    def _texels(self, rows: np.ndarray) -> BufferTexture:
        buffer = self._context.gl.buffer(np.ascontiguousarray(rows))
        view = BufferTexture(self._context.raw, buffer)
        self._owned += [buffer, view]
        return view

    @property
    def bytes(self) -> int:
        pages, height, width = self.layout.pages
        tables = sum(o.size for o in self._owned if isinstance(o, moderngl.Buffer))
        return len(self._scene.lights) * pages * height * width * self._components + tables

    def _key(self) -> str:
        """Name of this bake: all that visibility depends on. Colours and intensities of lights are no part of it."""
        geometry = self._scene.geometry
        lights = light_rows(self._scene.lights, np.zeros(3))
        where = [lights[n].tobytes() for n in ("kind", "position", "direction", "size")]
        opaque = layout.CONSTANTS["ANY_HIT_OPAQUE"]
        passing = sorted({int(g[1]) for g in geometry.hit_groups if g[2] != opaque})
        shades = []
        for row in passing:
            material = geometry.materials[row]
            textures = [
                (slot, t.uv_set, t.wrap_u, t.wrap_v, t.nearest, t.uv_transform is not None and t.uv_transform.tolist())
                for slot, t in sorted(material.textures.items())
            ]
            plain = {k: v for k, v in vars(material).items() if k not in ("textures", "name")}
            shades.append(repr((row, sorted(plain.items()), textures)).encode())
            shades += [material.textures[slot].image.texels.tobytes() for slot in sorted(material.textures)]
        arrays = (
            geometry.vertices, geometry.triangles, geometry.instance_mesh, geometry.world_from_object, geometry.records,
            geometry.first_record, geometry.hit_groups,
            *([geometry.attributes] if passing and geometry.attributes is not None else []),
        )  # fmt: skip
        made_by = [self._shaders.text(stem) for stem in ("baked_push", "baked_trace")]
        made_by.append(str(self._context.device).encode())
        map_ = (self.layout.index, self.layout.instance, self.layout.triangle, self.layout.bary)
        numbers = repr((self.layout.pages, *(self._number(n) for n in ("samples", "push", "dilation")))).encode()
        return content_cache.key(
            *where, *shades, *(np.ascontiguousarray(a).tobytes() for a in (*arrays, *map_)), *made_by, numbers
        )

    def _bake(self, progress: Progress | None) -> np.ndarray:
        """(lights * pages, height, width, components) uint8 visibility."""
        map_, lights = self.layout, self._scene.lights
        pages, height, width = map_.pages
        values = np.zeros((len(lights), pages * height * width, self._components), np.uint8)
        if not len(map_.index):
            return values
        valid = np.zeros(pages * height * width, bool)
        sums = np.zeros((len(lights), len(map_.index), self._components), np.float32)
        inside = np.zeros(len(map_.index), bool)
        tracer = _Tracer(self._context, self._shaders, self._scene, self._features, self._settings, map_.density)
        try:
            for first in range(0, len(map_.index), ROWS_AT_ONCE):
                rows = slice(first, min(first + ROWS_AT_ONCE, len(map_.index)))
                inside[rows] = tracer.place(_rows(map_, rows))
                for light in range(len(lights)):
                    sums[light, rows] = tracer.trace(light, lights[light].angular_diameter + lights[light].radius > 0)[
                        :, : self._components
                    ]
                    if progress is not None:
                        done = first * len(lights) + (rows.stop - first) * (light + 1)
                        progress("baking", done, len(map_.index) * len(lights))
        finally:
            tracer.release()
        valid[map_.index] = ~inside
        chart = np.zeros(pages * height * width, np.int32)
        chart[map_.index] = map_.chart
        for light in range(len(lights)):
            plane = np.zeros((pages * height * width, self._components), np.float32)
            plane[map_.index] = sums[light]
            if inside.any() and self._number("dilation"):
                from glhybrid.lightmap_kernels import spread

                spread(
                    plane.reshape(pages, height, width, -1), valid.reshape(pages, height, width).copy(),
                    chart.reshape(pages, height, width), self._number("dilation"),
                )  # fmt: skip
            values[light] = np.rint(np.clip(plane, 0, 1) * 255)
        return values

    def run(self, targets: Targets, ids: Any, set_lights: Any) -> Any:
        """All lights in one dispatch: set_lights, which `shadow` needs, is not called."""
        visibility = targets.get(self.channel, layers=len(self._scene.lights))
        resources = {**self._scene.resources, **self.resources, "gbuffer_id": ids, "out_visibility": visibility}
        self._program.dispatch(resources, targets.size)
        return visibility

    def release(self) -> None:
        for owned in reversed(self._owned):
            owned.release()
        self._owned.clear()
        self.resources.clear()


def _rows(map_: Lightmap, rows: slice) -> np.ndarray:
    """(N, 4) uint32 of lib/bake.glsl."""
    bary = np.ascontiguousarray(map_.bary[rows], np.float32).view(np.uint32)
    return np.column_stack([map_.instance[rows], map_.triangle[rows], bary])


def _inflated(data: bytes, size: int) -> bytes | None:
    try:
        texels = zlib.decompress(data)
    except zlib.error:
        return None
    return texels if len(texels) == size else None


class _Tracer:
    """The two programs of the bake and their buffers, in a world rebased on its middle: no camera has a say."""

    def __init__(
        self, context: Context, shaders: Shaders, scene: GpuScene, features: Features, settings: Settings,
        density: float,
    ) -> None:  # fmt: skip
        gl, self._scene = context.gl, scene
        centre = np.round(scene.scene.bounds().mean(0))
        scene.rebase(centre)
        constants = np.zeros(1, layout.dtype("FrameConstants"))
        constants["top_root"], constants["light_count"] = scene.top_root, len(scene.lights)
        constants["top_grid_min"], constants["top_grid_step"] = scene.top_grid(centre)
        self._samples = settings.parameter("shadows.baked.samples")
        self._buffers = {
            "Frame": gl.buffer(constants), "BakeTexels": gl.buffer(reserve=16 * ROWS_AT_ONCE),
            "BakePoints": gl.buffer(reserve=16 * ROWS_AT_ONCE), "BakeSums": gl.buffer(reserve=16 * ROWS_AT_ONCE),
        }  # fmt: skip
        # Both sides of everything are met: what is behind a face says whether a point is inside.
        self._push = None
        if settings.parameter("shadows.baked.push"):
            self._push = shaders.compute("baked_push", features.replace(single_sided=False))
        self._trace = shaders.compute("baked_trace", features)
        self._reach = lightmap.REACH / density
        self._count = 0

    def _given(self, **more: Any) -> dict[str, Any]:
        return {**self._scene.resources, **self._buffers, "bake_count": self._count, **more}

    def _dispatch(self, program: Any, **more: Any) -> None:
        across = min(self._count, 1 << 16)
        program.dispatch(self._given(**more), (across, math.ceil(self._count / across)), (64, 1))

    def place(self, rows: np.ndarray) -> np.ndarray:
        """Takes the texels (N, 4) that the next traces are from; returns (N,) bool: inside a solid."""
        self._count = len(rows)
        self._buffers["BakeTexels"].write(np.ascontiguousarray(rows))
        if self._push is None:
            self._buffers["BakePoints"].write(bytes(16 * self._count))
            return np.zeros(self._count, bool)
        self._dispatch(self._push, bake_reach=self._reach)
        points: F32 = np.frombuffer(self._buffers["BakePoints"].read(16 * self._count), np.float32).reshape(-1, 4)
        return points[:, 3] == BAKE_INSIDE

    def trace(self, light: int, sized: bool) -> F32:
        """(N, 4) float32: the share of one light that arrives."""
        samples = self._samples if sized else 1
        for first in range(0, samples, RAYS_AT_ONCE):
            self._dispatch(
                self._trace, bake_light=light, bake_first=first, bake_end=min(first + RAYS_AT_ONCE, samples),
                bake_samples=samples,
            )  # fmt: skip
        return np.frombuffer(self._buffers["BakeSums"].read(16 * self._count), np.float32).reshape(-1, 4)

    def release(self) -> None:
        for buffer in self._buffers.values():
            buffer.release()
