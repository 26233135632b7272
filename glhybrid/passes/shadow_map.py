"""Depth maps from the lights, and a look into them per pixel and light -> visibility, a layer a light: as `shadow`.

Techniques `map`, `pcf`, `pcss` and `csm` are one pass: they differ in the filter (a feature), in numbers (uniforms) and
in where the maps look from (shadow_fit.py). Opaque surfaces and cut-outs cast, from both sides, as they block shadow
rays; blended ones do not: a depth map knows no tint. Hits of reflection rays and blended layers use the same maps.

All maps are tiles of one 32-bit float atlas. Those that follow the camera, cascades, are drawn every frame, as a moving
one needs it, so that their time is that of motion, but for the instances beside them (shadow_cull.py); others once, and
again when what they depend on has changed.
"""

from typing import Any

import moderngl
import numpy as np

from glhybrid import draws, shadow_cull, shadow_fit, techniques
from glhybrid.needs import Features
from glhybrid.owned import Owned
from glhybrid.scene import F64
from glhybrid.settings import Settings
from glhybrid.setup import Setup
from glhybrid.shaders import Program, Shaders
from glhybrid.targets import Targets
from glhybrid.view import View

MOST_CULLED = 100_000  # instances; more of them take the host longer to look through than is gained
LIGHTS_AT_ONCE = 8  # in a dispatch: llvmpipe ends all loops of an invocation at 65,535 turns, taps included


class ShadowMap:
    """Owns the atlas. `resources` has what lib/shadow_map.glsl reads, for every pass that looks into the maps."""

    name = "shadow_map"

    def __init__(self, setup: Setup) -> None:
        context, scene, features, settings = setup.context, setup.scene, setup.features, setup.settings
        self._context, self._scene, self._settings = context, scene, settings
        self._reason = features.reason_shadows
        self.channel = "visibility_tint" if features.blended else "visibility"
        self._fit = fit = shadow_fit.Fit.of(settings)
        self._owned = Owned()
        self._maps: Any = None
        self._tiles: Any = None  # (maps,) of the atlas
        self._follow: Any = None  # (maps,) bool: those that move with the camera
        count = sum(shadow_fit.map_counts(scene.lights, fit))
        key = f"shadows.{settings.shadows}.resolution"
        self._across = shadow_fit.columns(count, fit.resolution, context.limits.texture_size, key)
        size = (self._across * fit.resolution, -(-count // self._across) * fit.resolution)
        gl = context.gl
        atlas = self._owned.add(context.raw.depth32f(gl, size))
        atlas.repeat_x = atlas.repeat_y = False
        self._framebuffer: Any = self._owned.add(gl.framebuffer([], atlas))
        rows = shadow_fit.empty_rows(scene.lights, fit)
        self._drawn = np.zeros_like(_bytes(rows[0]))  # by tile: the row of what is in it
        self.resources: dict[str, Any] = {
            "shadow_atlas": atlas, "ShadowMaps": self._owned.add(gl.buffer(rows[0].tobytes())),
            "ShadowLights": self._owned.add(gl.buffer(rows[1].tobytes())), "map_margin": fit.margin,
        }  # fmt: skip
        self.resources |= uniforms(settings)
        self._program = setup.shaders.compute("shadow_map", features)
        self._cull: dict[int, tuple[shadow_cull.Commands, Any]] = {}  # by batch; where commands of cascades are kept
        self._boxes: Any = None  # of what is culled
        self._culled: dict[tuple[int, int], tuple[int, int]] = {}  # by batch and map: first command and count
        self._culled_for = b""
        self._batches = self._make_batches(setup.shaders, features)

    def _make_batches(self, shaders: Shaders, features: Features) -> list[tuple[Program, Any, Any, int]]:
        """(program, vertex array, indirect buffer or None, count) of every draw into a map."""
        gl, geometry = self._context.gl, self._scene.geometry
        made: list[tuple[Program, Any, Any, int]] = []
        batches, pairs = draws.batches(geometry, np.zeros(len(geometry.instance_mesh), bool))
        if batches:
            index = self._owned.add(gl.buffer(np.ascontiguousarray(geometry.triangles[:, :3])))
            per_instance = self._owned.add(gl.buffer(np.array(pairs, np.uint32)))
            vertices = self._scene.resources["vertices"].buffer
            for masked in (False, True):  # nothing is culled: both sides block light
                commands = [c for (cut, _, _), some in batches if cut == masked for c in some]
                if not commands:
                    continue
                program = shaders.raster("shadow_map", features.replace(alpha_test=masked, sphere_proxy=False))
                layout = [(vertices, "3f 20x", "in_position"), (per_instance, "2u4/i", "in_draw")]
                vao = self._owned.add(gl.vertex_array(program.program, layout, index_buffer=index))
                if self._settings.shadows == "csm":
                    self._make_cull(len(made), shadow_cull.Commands(commands, pairs))
                made.append((program, vao, self._owned.add(gl.buffer(np.array(commands, np.uint32))), len(commands)))
        if spheres := draws.sphere_rows(geometry):
            data = np.zeros(len(spheres), [("sphere", np.float32, 4), ("draw", np.uint32, 2)])
            data["sphere"], data["draw"] = [s[0] for s in spheres], [s[1] for s in spheres]
            program = shaders.raster("shadow_map", features.replace(sphere_proxy=True))
            content = [(self._owned.add(gl.buffer(data)), "4f 2u4/i", "in_sphere", "in_draw")]
            made.append((program, self._owned.add(gl.vertex_array(program.program, content)), None, len(spheres)))
        return made

    def _make_cull(self, batch: int, commands: shadow_cull.Commands) -> None:
        """Room for a batch's commands in every cascade that follows the camera."""
        suns = sum(light.kind == "directional" for light in self._scene.lights)
        cascades = suns * (self._fit.cascades - 1)
        if cascades and len(self._scene.geometry.instance_mesh) > 1 and commands.most <= MOST_CULLED:
            if self._boxes is None:
                self._boxes = shadow_cull.boxes(self._scene.geometry)
            buffer = self._owned.add(self._context.gl.buffer(reserve=20 * cascades * commands.most))
            self._cull[batch] = commands, buffer

    def _choose(self, origin: F64, moving: bool) -> None:
        """Commands of each batch for each map that follows the camera, once a view."""
        maps = np.flatnonzero(self._follow)
        key = self._maps[maps].tobytes() + origin.tobytes()
        if moving:
            self._culled.clear()
        elif key != self._culled_for and self._cull:
            self._culled_for = key
            left_out = [shadow_cull.beside(self._maps[k], self._boxes - origin) for k in maps]
            for batch, (commands, buffer) in self._cull.items():
                rows = [commands.without(out) for out in left_out]
                first = 0
                for k, some in zip(maps.tolist(), rows, strict=True):
                    self._culled[batch, k] = first, len(some)
                    first += len(some)
                if first:
                    self._context.write(buffer, np.concatenate(rows))

    @property
    def bytes(self) -> int:
        """Of the atlas."""
        atlas = self.resources["shadow_atlas"]
        return 4 * atlas.width * atlas.height

    def look(self, view: View, moving: F64 | None = None) -> None:
        """Fits the maps to a view. Those that this changes are drawn with the next frame.

        moving: (2, 3) world box of all that will ever be drawn, of a scene that moves: drawn after every look.
        """
        scene = self._scene.scene
        boxes = scene.instance_bounds if moving is None else moving[None]
        maps, lights = shadow_fit.rows(boxes, self._scene.lights, view, self._fit, self._across)
        if moving is not None:
            self._drawn[:] = 0
        self._maps, self._follow = maps, shadow_fit.following(self._scene.lights, lights, len(maps))
        self._choose(view.origin, moving is not None)
        self._tiles = maps["corner"] // self._fit.resolution @ (1, self._across)
        self._context.write(self.resources["ShadowMaps"], maps)
        self._context.write(self.resources["ShadowLights"], lights)

    def draw(self) -> None:
        """Depth of every map whose tile does not hold it, or that follows the camera, into its tile."""
        wanted = _bytes(self._maps)
        due = np.flatnonzero(self._follow | (self._drawn[self._tiles] != wanted).any(1)).tolist()
        if not due:
            return
        self._drawn[self._tiles] = wanted
        gl = self._context.gl
        self._framebuffer.use()
        if self._context.limits.clip_control:
            self._context.raw.set_depth_zero_to_one()
        self._framebuffer.depth_mask = True
        gl.enable_only(moderngl.DEPTH_TEST)
        gl.depth_func = ">"  # reversed
        resources = {**self._scene.resources, **self.resources}
        for k in due:
            size = int(self._maps[k]["size"])
            tile = (*self._maps[k]["corner"].tolist(), size, size)
            self._framebuffer.viewport = self._framebuffer.scissor = tile
            self._context.raw.clear_depth()
            for batch, (program, vao, indirect, count) in enumerate(self._batches):
                first = 0
                if self._follow[k] and (batch, k) in self._culled:
                    indirect, (first, count) = self._cull[batch][1], self._culled[batch, k]
                if not count:
                    continue
                program.bind(resources | {"map_index": k})
                if indirect is None:
                    vao.render(moderngl.TRIANGLES, draws.SPHERE_VERTICES, instances=count)
                else:
                    vao.render_indirect(indirect, moderngl.TRIANGLES, count, first=first)
        self._framebuffer.scissor = None
        gl.enable_only(moderngl.NOTHING)
        gl.memory_barrier()

    def run(self, targets: Targets, ids: Any, set_lights: Any) -> Any:
        """set_lights(first, end) says which lights the next dispatch is for."""
        self.draw()
        count = len(self._scene.lights)
        visibility = targets.get(self.channel, layers=count)
        resources = {**self._scene.resources, **self.resources, "gbuffer_id": ids, "out_visibility": visibility}
        if self._reason:
            resources["out_reason_shadows"] = targets.get("reason_shadows")
        for first in range(0, count, LIGHTS_AT_ONCE):
            if count > LIGHTS_AT_ONCE or first:
                set_lights(first, min(first + LIGHTS_AT_ONCE, count))
            self._program.dispatch(resources, targets.size)
        return visibility

    def release(self) -> None:
        # moderngl binds the last used framebuffer again when it makes the next one: that must not be one of ours.
        self._context.gl.detect_framebuffer(0).use()
        self._owned.release()
        self.resources.clear()


def _bytes(rows: Any) -> Any:
    """(N, bytes) uint8 of (N,) structures, padding included."""
    return rows.view((np.uint8, rows.itemsize))


def uniforms(settings: Settings) -> dict[str, float | int]:
    """Numbers of lib/shadow_map.glsl, from the parameters of the technique in use; 0 for those that it has not."""
    name = settings.shadows
    known = {p.name for p in techniques.SHADOWS[name].parameters}
    values: dict[str, float | int] = {}
    for uniform, kind in (
        ("bias", float), ("slope_bias", float), ("normal_bias", float), ("receiver_plane", float), ("radius", float),
        ("search", float), ("blend", float), ("taps", int), ("blockers", int),
    ):  # fmt: skip
        values[f"map_{uniform}"] = (
            kind(settings.parameter(f"shadows.{name}.{uniform}")) if uniform in known else kind(0)
        )
    return values
