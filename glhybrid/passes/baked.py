"""Light maps: visibility of every light at texels of every surface, traced once, looked up per pixel: as `shadow`.

Visibility, not light, is what is baked, a layer a light: the composite stays the same formula, and colours, intensities
and ranges of lights may change without another bake. A light without size is one any-hit ray from the texel's point,
one with a size is `shadows.baked.samples` rays over its disc, or the first few where these agree with each other and
with those of all texels around. Points inside solids are pushed out along their surface (baked_push.comp) or take their
neighbours' values. Hits of reflection rays and blended layers read the same maps.

Kept on disk by content: geometry, lights, what rays may pass through, numbers, shaders and device. What moves cannot be
baked: plan.py refuses it.
"""

import math
import zlib
from collections.abc import Callable
from typing import Any

import moderngl
import numpy as np

from glhybrid import content_cache, layout, lightmap, lightmap_seams
from glhybrid.context import Context
from glhybrid.gl import BufferTexture
from glhybrid.gpu_scene import GpuScene, light_rows
from glhybrid.lightmap import Lightmap, Limits
from glhybrid.needs import Features
from glhybrid.scene import F32
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets
from glhybrid.timing import Progress

VERSION = 2  # of what the host makes of rays
ROWS_AT_ONCE = 1 << 17  # texels in a dispatch
STAGES = (4, 16)  # rays to a light with a size: everywhere, then all of them where these find a penumbra, and so on
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
        numbers = repr(
            (VERSION, self.layout.pages, *(self._number(n) for n in ("samples", "push", "dilation")))
        ).encode()
        return content_cache.key(
            *where, *shades, *(np.ascontiguousarray(a).tobytes() for a in (*arrays, *map_)), *made_by, numbers
        )

    def _bake(self, progress: Progress | None) -> np.ndarray:
        """(lights * pages, height, width, components) uint8 visibility."""
        map_, lights, components = self.layout, self._scene.lights, self._components
        values = np.zeros((len(lights), math.prod(map_.pages), components), np.uint8)
        if not len(map_.index):
            return values
        tracer = _Tracer(self._context, self._shaders, self._scene, self._features, self._settings, map_.density)
        chart = np.zeros(map_.pages, np.int32)
        chart.reshape(-1)[map_.index] = map_.chart
        try:
            points = tracer.points(map_, progress)
            inside = points[:, 3] == BAKE_INSIDE
            valid = np.zeros(map_.pages, bool)
            valid.reshape(-1)[map_.index] = ~inside
            for light, row in enumerate(lights):
                many = self._number("samples") if row.has_size else 1
                what = f"baking light {light + 1} of {len(lights)}"
                rows, done = np.arange(len(map_.index)), min(many, STAGES[0])
                sums = tracer.trace(map_, points, rows, light, 0, done, _bar(progress, what))
                counts = np.full(len(rows), done)
                away = sums[:, 3]
                plane = np.zeros((*map_.pages, components), np.float32)
                flat = plane.reshape(-1, components)
                flat[map_.index] = sums[:, :components] / done
                for upto in (*(n for n in STAGES[1:] if n < many), many) if done < many else ():
                    rows = np.flatnonzero(_uneven(plane[..., 0], chart).reshape(-1)[map_.index] & ~inside)
                    bar = _bar(progress, f"{what}: penumbrae, {upto} rays")
                    # All of them have had as many: a penumbra found later than its neighbours is caught up with.
                    for had in np.unique(taken := counts[rows]).tolist():
                        mine = rows[taken == had]
                        sums[mine] += tracer.trace(map_, points, mine, light, had, upto, bar)
                    counts[rows] = upto
                    flat[map_.index[rows]] = sums[rows, :components] / upto
                if inside.any() and self._number("dilation"):
                    from glhybrid.lightmap_kernels import spread

                    spread(plane, valid.copy(), chart, self._number("dilation"))
                _soften_terminator(plane, chart, map_.index, away <= 0)
                if row.has_size:
                    facing = np.full(len(flat), -1, np.float32)
                    facing[map_.index] = away
                    lightmap_seams.stitch(flat, facing, lightmap_seams.lookups(self._scene.geometry, map_))
                values[light] = np.rint(np.clip(plane, 0, 1) * 255).reshape(-1, components)
        finally:
            tracer.release()
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


def _uneven(plane: F32, chart: np.ndarray) -> np.ndarray:
    """(P, H, W) bool: texels at most two from one of their chart that differs from a neighbour, or is between 0 and 1.

    Only there is a penumbra: all others are lit or dark by their first samples, and so are all around them.
    """
    uneven = (plane > 0) & (plane < 1)
    for axis in (1, 2):
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        a, b = tuple(ahead), tuple(behind)
        differs = (plane[a] != plane[b]) & (chart[a] == chart[b])
        uneven[a] |= differs
        uneven[b] |= differs
    for _ in range(2):
        for axis in (1, 2):
            before = uneven.copy()
            ahead, behind = [slice(None)] * 3, [slice(None)] * 3
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            uneven[tuple(ahead)] |= before[tuple(behind)]
            uneven[tuple(behind)] |= before[tuple(ahead)]
    return uneven


def _soften_terminator(plane: F32, chart: np.ndarray, index: np.ndarray, away: np.ndarray) -> None:
    """Dark texels whose fronts face away from the light take the value of those beside them that face it, in place.

    A facet that faces away is dark by itself, and looks up nothing; but its texels are neighbours of lit facets'.
    """
    from glhybrid.lightmap_kernels import spread

    dark = np.zeros(plane.shape[:3], bool)
    dark.reshape(-1)[index] = away & ~plane.reshape(-1, plane.shape[3])[index].any(1)
    if dark.any():
        spread(plane, ~dark, chart, 2)


def _bar(progress: Progress | None, stage: str) -> Callable[[int, int], None]:
    return (lambda done, total: progress(stage, done, total)) if progress is not None else lambda done, total: None


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
        self._buffers = {"Frame": gl.buffer(constants)} | {
            name: gl.buffer(reserve=16 * ROWS_AT_ONCE) for name in ("BakeTexels", "BakePoints", "BakeSums")
        }
        # Both sides of everything are met: what is behind a face says whether a point is inside.
        self._push = None
        if settings.parameter("shadows.baked.push"):
            self._push = shaders.compute("baked_push", features.replace(single_sided=False))
        self._trace = shaders.compute("baked_trace", features)
        self._reach = lightmap.REACH / density

    def _dispatch(self, program: Any, count: int, **more: Any) -> None:
        across = min(count, 1 << 16)
        given = {**self._scene.resources, **self._buffers, "bake_count": count, **more}
        program.dispatch(given, (across, math.ceil(count / across)), (64, 1))

    def _load(self, map_: Lightmap, rows: np.ndarray) -> None:
        bary = np.ascontiguousarray(map_.bary[rows], np.float32).view(np.uint32)
        self._buffers["BakeTexels"].write(np.column_stack([map_.instance[rows], map_.triangle[rows], bary]))

    def _read(self, name: str, count: int) -> F32:
        return np.frombuffer(self._buffers[name].read(16 * count), np.float32).reshape(-1, 4)

    def points(self, map_: Lightmap, progress: Progress | None) -> F32:
        """(N, 4) float32 of all texels: where those that were in a solid are now, and BAKE_*."""
        found = np.zeros((len(map_.index), 4), np.float32)
        if self._push is None:
            return found
        bar = _bar(progress, "placing texels")
        for rows in _parts(np.arange(len(found))):
            self._load(map_, rows)
            self._dispatch(self._push, len(rows), bake_reach=self._reach)
            found[rows] = self._read("BakePoints", len(rows))
            bar(int(rows[-1]) + 1, len(found))
        return found

    def trace(
        self, map_: Lightmap, points: F32, rows: np.ndarray, light: int, first: int, end: int,
        bar: Callable[[int, int], None],
    ) -> F32:  # fmt: skip
        """(N, 4) float32 over texels `rows` (N,): how much of samples first to end of one light arrives, summed."""
        found = np.zeros((len(rows), 4), np.float32)
        done = 0
        for part in _parts(rows):
            self._load(map_, part)
            self._buffers["BakePoints"].write(np.ascontiguousarray(points[part]))
            for sample in range(first, end, RAYS_AT_ONCE):
                self._dispatch(
                    self._trace, len(part), bake_light=light, bake_first=sample,
                    bake_end=min(sample + RAYS_AT_ONCE, end), bake_more=sample > first,
                )  # fmt: skip
            found[done : done + len(part)] = self._read("BakeSums", len(part))
            done += len(part)
            bar(done, len(rows))
        return found

    def release(self) -> None:
        for buffer in self._buffers.values():
            buffer.release()


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    return [rows[k : k + ROWS_AT_ONCE] for k in range(0, len(rows), ROWS_AT_ONCE)]
