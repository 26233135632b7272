"""The G-buffer: which instance and triangle a pixel shows. Rasterised, or traced where a device rasterises slowly.

Chosen: ids only, and depth for the raster itself; points, normals and materials are rebuilt from the ids by the same
code as at ray hits. Rejected: a fat G-buffer; an H100 takes 0.3 ms for every 4 bytes a pixel, and any format short of
float32 costs accuracy that the tracer then has to live with.
"""

from functools import cached_property

import moderngl
import numpy as np

from glhybrid import draws
from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene
from glhybrid.layout import CONSTANTS
from glhybrid.needs import Features
from glhybrid.owned import Owned
from glhybrid.shaders import Program, Shaders
from glhybrid.targets import Targets


class GBufferRaster:
    """Draws every instance. One multi-draw per raster state: (cut out or not, culled or not, mirrored or not)."""

    name = "gbuffer"

    def __init__(self, context: Context, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._context, self._scene = context, scene
        self._owned = Owned()
        self._batches: list[tuple[moderngl.VertexArray, moderngl.Buffer, int, int, bool]] = []
        gl, geometry = context.gl, scene.geometry
        self._programs = {
            False: shaders.raster("gbuffer", features.replace(alpha_test=False, sphere_proxy=False)),
        }
        if features.alpha_test:
            self._programs[True] = shaders.raster("gbuffer", features.replace(sphere_proxy=False))
        self._turned = scene.turned
        batches, pairs = draws.batches(geometry, scene.flipped)
        if batches:
            index = self._owned.add(gl.buffer(np.ascontiguousarray(geometry.triangles[:, :3])))
            per_instance = self._owned.add(gl.buffer(np.array(pairs, np.uint32)))
            for (masked, culled, mirrored), commands in batches:
                program = self._programs[masked]
                vertices = scene.resources["vertices"].buffer
                layout = [(vertices, "3f 20x", "in_position"), (per_instance, "2u4/i", "in_draw")]
                vao = self._owned.add(gl.vertex_array(program.program, layout, index_buffer=index))
                indirect = self._owned.add(gl.buffer(np.array(commands, np.uint32)))
                cull = (2 if mirrored else 1) if culled else 0
                self._batches.append((vao, indirect, len(commands), cull, masked))
        self._spheres = None
        if spheres := draws.sphere_rows(geometry):
            self._sphere_program = shaders.raster("gbuffer", features.replace(sphere_proxy=True))
            data = np.zeros(len(spheres), [("sphere", np.float32, 4), ("draw", np.uint32, 2)])
            data["sphere"], data["draw"] = [s[0] for s in spheres], [s[1] for s in spheres]
            buffer = self._owned.add(gl.buffer(data))
            content = [(buffer, "4f 2u4/i", "in_sphere", "in_draw")]
            self._spheres = self._owned.add(gl.vertex_array(self._sphere_program.program, content))
            self._sphere_count = len(spheres)

    @property
    def outdated(self) -> bool:
        """Whether other instances are mirrored than when the batches were made."""
        return self._turned != self._scene.turned

    def run(self, targets: Targets) -> moderngl.Texture:
        """Returns the ids, gbuffer_id of layout.py."""
        gl = self._context.gl
        framebuffer = targets.framebuffer("gbuffer_id")
        framebuffer.use()
        if self._context.limits.clip_control:
            self._context.raw.set_depth_zero_to_one()
        framebuffer.depth_mask = True
        self._context.raw.clear_ids(CONSTANTS["ID_NONE"])
        gl.enable_only(moderngl.DEPTH_TEST)
        gl.depth_func = ">"  # reversed depth; of equal depths the first drawn, the lowest id, stays
        for vao, indirect, count, cull, masked in self._batches:
            if cull:
                gl.enable(moderngl.CULL_FACE)
                gl.cull_face = "front" if cull == 2 else "back"
            else:
                gl.disable(moderngl.CULL_FACE)
            self._programs[masked].bind(self._scene.resources)
            vao.render_indirect(indirect, moderngl.TRIANGLES, count)
        if self._spheres is not None:
            gl.disable(moderngl.CULL_FACE)
            self._sphere_program.bind(self._scene.resources)
            self._spheres.render(moderngl.TRIANGLES, draws.SPHERE_VERTICES, instances=self._sphere_count)
        gl.enable_only(moderngl.NOTHING)
        gl.memory_barrier()
        ids: moderngl.Texture = targets.get("gbuffer_id")
        return ids

    def release(self) -> None:
        self._owned.release()


class GBufferTrace:
    """The same ids from primary rays in compute."""

    name = "gbuffer"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._shaders, self._scene, self._features = shaders, scene, features

    @cached_property
    def _program(self) -> Program:
        return self._shaders.compute("gbuffer", self._features)

    def run(self, targets: Targets) -> moderngl.Texture:
        """Returns the ids, gbuffer_id of layout.py."""
        ids: moderngl.Texture = targets.get("gbuffer_id")
        self._program.dispatch({**self._scene.resources, "out_id": ids}, targets.size)
        return ids

    def release(self) -> None:
        """Owns nothing."""
