"""Light maps: visibility of every light at texels of every surface, traced once, looked up per pixel: as `shadow`.

Visibility, not light, is what is baked, a layer a light: the composite stays the same formula, and colours, intensities
and ranges of lights may change without another bake. A light without size is one any-hit ray from the texel's point,
one with a size is `shadows.baked.samples` rays over its disc, or the first few where these agree with each other and
with those of all texels around. Points inside solids are pushed out along their surface (baked_push.comp) or take their
neighbours' values. Hits of reflection rays and blended layers read the same maps.

Kept on disk light by light, by content: geometry, the light, what rays may pass through, numbers, shaders and device; a
light that is moved or added is the only one baked. What moves by itself cannot be: plan.py refuses it.
"""

import contextlib
import zlib
from typing import Any

import moderngl
import numpy as np

from glhybrid import content_cache, layout, lightmap
from glhybrid.bake import Bake
from glhybrid.gl import BufferTexture
from glhybrid.gpu_rows import light_rows
from glhybrid.lightmap import Limits
from glhybrid.owned import Owned
from glhybrid.setup import Setup
from glhybrid.targets import Targets
from glhybrid.timing import Progress

VERSION = 3  # of what the host makes of rays


class Baked:
    """Owns the maps. `resources` has what lib/lightmap.glsl reads, for every pass that looks into them."""

    name = "baked"

    def __init__(self, setup: Setup, progress: Progress | None = None) -> None:
        self._setup, self._scene, self._features = setup, setup.scene, setup.features
        context, scene, features = setup.context, setup.scene, setup.features
        self._owned = Owned()
        self.channel = "visibility_tint" if features.blended else "visibility"
        self._components = 4 if features.blended else 1
        limits = Limits(min(context.limits.texture_size, 16384), context.limits.texture_layers)
        count = len(scene.lights)
        self.layout = layout_ = lightmap.make(
            scene.geometry, count, self._number("texels"), self._number("budget"), self._number("triangles"), limits,
            self._components, progress,
        )  # fmt: skip
        pages, height, width = layout_.pages
        size = (width, height, max(count, 1) * pages)
        atlas = self._owned.add(context.gl.texture_array(size, self._components, alignment=1))
        atlas.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.resources: dict[str, Any] = {
            "lightmap": atlas, "lightmap_uv": self._texels(layout_.uv), "lightmap_places": self._texels(layout_.places),
            "lightmap_pages": pages,
        }  # fmt: skip
        try:
            self.from_cache = self._fill(atlas, progress)
            self._program = setup.shaders.compute("baked", features)
        except BaseException:  # a bake may be given up: nobody else knows of these
            self.release()
            raise

    def _number(self, name: str) -> Any:
        return self._setup.settings.parameter(f"shadows.baked.{name}")

    def _texels(self, rows: np.ndarray) -> BufferTexture:
        context = self._setup.context
        buffer = self._owned.add(context.gl.buffer(np.ascontiguousarray(rows)))
        return self._owned.add(BufferTexture(context.raw, buffer))

    @property
    def bytes(self) -> int:
        """Of the atlas and its tables."""
        pages, height, width = self.layout.pages
        return len(self._scene.lights) * pages * height * width * self._components + self._owned.buffer_bytes

    def _keys(self) -> list[str]:
        """Name of the bake of each light: all that its visibility depends on. Its colour and intensity are no part."""
        geometry = self._scene.geometry
        lights = light_rows(self._scene.lights, np.zeros(3))
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
        made_by = [self._setup.shaders.text(stem) for stem in ("baked_push", "baked_hard", "baked_trace")]
        made_by.append(str(self._setup.context.device).encode())
        map_ = (self.layout.index, self.layout.instance, self.layout.triangle, self.layout.bary)
        numbers = repr(
            (VERSION, self.layout.pages, *(self._number(n) for n in ("samples", "push", "dilation")))
        ).encode()
        surfaces = content_cache.key(
            *shades, *(np.ascontiguousarray(a).tobytes() for a in (*arrays, *map_)), *made_by, numbers
        ).encode()
        where = ("kind", "position", "direction", "size")
        return [content_cache.key(surfaces, *(row[name].tobytes() for name in where)) for row in lights]

    def _fill(self, atlas: moderngl.TextureArray, progress: Progress | None) -> bool:
        """Visibility of every light, from the disk where it is kept. Whether all of it was."""
        pages, height, width = self.layout.pages

        def put(light: int, texels: bytes) -> None:
            atlas.write(texels, viewport=(0, 0, light * pages, width, height, pages), alignment=1)

        names = self._keys()
        size = pages * height * width * self._components
        missing = []
        for light, name in enumerate(names):
            kept = content_cache.read("bake", name)
            texels = _inflated(kept, size) if kept is not None else None
            if texels is not None:
                put(light, texels)
            elif len(self.layout.index):
                missing.append(light)
            else:
                put(light, bytes(size))
        if not missing:
            return True

        def keep(light: int, texels: bytes) -> None:
            content_cache.write("bake", names[light], zlib.compress(texels, 1))

        with contextlib.closing(Bake(self._setup, self.layout, progress)) as work:
            for light, texels in work.lights(missing, keep):
                put(light, texels)
        return False

    def run(self, targets: Targets, ids: Any, set_lights: Any) -> Any:
        """All lights in one dispatch: set_lights, which `shadow` needs, is not called."""
        visibility = targets.get(self.channel, layers=len(self._scene.lights))
        resources = {**self._scene.resources, **self.resources, "gbuffer_id": ids, "out_visibility": visibility}
        if self._features.reason_shadows:
            resources["out_reason_shadows"] = targets.get("reason_shadows")
        self._program.dispatch(resources, targets.size)
        return visibility

    def release(self) -> None:
        self._owned.release()
        self.resources.clear()


def _inflated(data: bytes, size: int) -> bytes | None:
    try:
        texels = zlib.decompress(data)
    except zlib.error:
        return None
    return texels if len(texels) == size else None
