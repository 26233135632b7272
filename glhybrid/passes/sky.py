"""The environment on the GPU: the map, its convolutions (made once), and the split-sum table."""

from typing import Any

import moderngl
import numpy as np

from glhybrid import content_cache, layout, sky_tree
from glhybrid.context import Context
from glhybrid.environment_cdf import EVEN, environment_cdf
from glhybrid.needs import Features
from glhybrid.scene import F32, Environment
from glhybrid.shaders import Program, Shaders


class Sky:
    """Owns the textures; `resources` has them by GLSL name, only those that the features read."""

    def __init__(self, context: Context, shaders: Shaders, environment: Environment | None, features: Features) -> None:
        self.resources: dict[str, Any] = {}
        gl = context.gl
        if features.specular_sky or features.reflections or features.probes:
            size = layout.DFG_SIZE
            dfg = self.resources["dfg"] = gl.texture((size, size), 4, dtype="f2")
            dfg.repeat_x = dfg.repeat_y = False
            shaders.compute("sky_dfg", features).dispatch({"out_dfg": dfg}, (size, size))
        if environment is None or not features.environment:
            return
        if not features.environment_map:
            self.resources["environment_constant"] = tuple(environment.radiance[0, 0].tolist())
            return
        radiance = np.maximum(environment.radiance, 0)
        height, width = radiance.shape[:2]
        exact = self.resources["environment_map"] = gl.texture((width, height), 4, _rgba(radiance), dtype="f4")
        exact.filter = (moderngl.NEAREST, moderngl.NEAREST)
        if features.sky_samples:
            cdf = environment_cdf(environment, above=EVEN if features.glossy else 0.0)
            self.resources["environment_cdf"] = gl.texture(cdf.shape[::-1], 1, cdf.tobytes(), dtype="f4")
        if not features.blurred_sky:
            return
        sizes = layout.PREFILTER_SIZES
        rough = _atlas(context, sum(s + 2 for s in sizes), max(sizes) + 2)
        diffuse = _atlas(context, layout.IRRADIANCE_SIZE + 2, layout.IRRADIANCE_SIZE + 2)
        self.resources["environment_rough"], self.resources["environment_diffuse"] = rough, diffuse
        made = convolve(context, shaders, features, radiance)
        rough.write(made[0])
        diffuse.write(made[1])

    @property
    def bytes(self) -> int:
        """Of its textures."""
        textures = [t for t in self.resources.values() if isinstance(t, moderngl.Texture)]
        return sum(t.width * t.height * t.components * (4 if t.dtype == "f4" else 2) for t in textures)

    def release(self) -> None:
        for texture in self.resources.values():
            if isinstance(texture, moderngl.Texture):
                texture.release()
        self.resources.clear()


def convolve(
    context: Context, shaders: Shaders, features: Features, radiance: F32, keep: bool = True
) -> tuple[bytes, bytes]:
    """Surroundings, an equirect (H, W, 3), blurred: texels of the atlas of growing roughness, and of the cosine's.

    keep: on disk, by content.
    """
    sizes = layout.PREFILTER_SIZES
    rough = _atlas(context, sum(s + 2 for s in sizes), max(sizes) + 2)
    diffuse = _atlas(context, layout.IRRADIANCE_SIZE + 2, layout.IRRADIANCE_SIZE + 2)
    made_by = shaders.text("sky_prefilter"), bytes([sky_tree.VERSION]), str(context.device).encode()
    name = content_cache.key(radiance.tobytes(), *made_by) if keep else ""
    border = 8 * rough.width * rough.height
    made = content_cache.read("sky", name, border + 8 * diffuse.width * diffuse.height) if keep else None
    if made is None:
        _convolve(context, shaders.compute("sky_prefilter", features), radiance, rough, diffuse)
        made = rough.read() + diffuse.read()
        if keep:
            content_cache.write("sky", name, made)
    rough.release()
    diffuse.release()
    return made[:border], made[border:]


def _atlas(context: Context, width: int, height: int) -> moderngl.Texture:
    texture = context.gl.texture((width, height), 4, dtype="f2")
    texture.repeat_x = texture.repeat_y = False
    return texture


def _convolve(
    context: Context, program: Program, radiance: F32, rough: moderngl.Texture, diffuse: moderngl.Texture
) -> None:
    """Fills the atlas of growing roughness, and the cosine's."""
    nodes = sky_tree.sky_nodes(radiance)
    buffer = context.gl.buffer(nodes.tobytes())
    mean = float(nodes[:32, :3].max(1) @ nodes[:32, 3]) / (4 * np.pi)
    given = {"SkyNodes": buffer, "levels": sky_tree.LEVELS, "mean_radiance": mean}
    column = 0
    for lobe, size in enumerate(layout.PREFILTER_SIZES):
        program.dispatch(given | {"lobe": lobe, "column": column, "out_atlas": rough}, (size + 2, size + 2))
        column += size + 2
    size = layout.IRRADIANCE_SIZE + 2
    program.dispatch(given | {"lobe": -1, "column": 0, "out_atlas": diffuse}, (size, size))
    buffer.release()


def _rgba(rgb: F32) -> bytes:
    return np.concatenate([rgb, np.ones_like(rgb[..., :1])], axis=-1, dtype=np.float32).tobytes()
