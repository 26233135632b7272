"""Materials, textures, samplers and images of a glTF asset.

Images are decoded by a pool of threads that starts before the geometry is read: `Materials.parse` orders what a
material needs, `Materials.build` waits for it.
"""

import math
import os
import urllib.parse
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from glhybrid.load.gltf_document import Document, Item, printable
from glhybrid.load.images import load_image
from glhybrid.scene import F64, Image, Material, Texture, Wrap

MAX_UV_SET = 1  # TEXCOORD_0 and TEXCOORD_1
WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
MAG_NEAREST = {9728: True, 9729: False}
MIN_MIPMAP = {9728: False, 9729: False, 9984: True, 9985: True, 9986: True, 9987: True}
SOURCE_EXTENSIONS = ("EXT_texture_webp", "EXT_texture_avif")  # Pillow reads these; both name an image as `source`


@dataclass(frozen=True)
class TextureRef:
    """A texture as a material has it, its image still being decoded. Fields as in scene.Texture."""

    image: int  # in the file
    uv_set: int
    transform: tuple[float, ...] | None  # the six numbers of uv_transform, row by row
    wrap_u: Wrap
    wrap_v: Wrap
    nearest: bool
    mipmap: bool

    @property
    def uv_transform(self) -> F64 | None:
        """As scene.Texture has it: (2, 3) float64, None where uv stay as they are."""
        return None if self.transform is None else np.array(self.transform).reshape(2, 3)

    def texture(self, image: Image) -> Texture:
        """The scene's texture, once its image is there."""
        return Texture(
            image,
            uv_set=self.uv_set,
            uv_transform=self.uv_transform,
            wrap_u=self.wrap_u,
            wrap_v=self.wrap_v,
            nearest=self.nearest,
            mipmap=self.mipmap,
        )


@dataclass(frozen=True)
class ParsedMaterial:
    """A material whose images are not read yet: only those that are used will be."""

    fields: dict[str, Any]  # of scene.Material, but for the textures
    textures: dict[str, TextureRef]

    @property
    def tangent_texture(self) -> TextureRef | None:
        """The normal map that tangents have to follow, if there is any."""
        return self.textures.get("normal") or self.textures.get("clearcoat_normal")


class Materials:
    """The materials a scene uses, in the order they are asked for. A context manager: leaving it ends the threads."""

    def __init__(self, doc: Document) -> None:
        self.doc = doc
        self._pool = ThreadPoolExecutor(min(16, os.cpu_count() or 1), thread_name_prefix="image")
        self._parsed: dict[int, ParsedMaterial] = {}
        self._slots: dict[int, int] = {}  # index in the file -> index in the scene; -1 = the default material
        self._decoding: dict[int, Future[tuple[Image, list[str]]]] = {}
        self._images: dict[int, Image] = {}
        self._shared: dict[TextureRef, Texture] = {}

    def __enter__(self) -> "Materials":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def use(self, index: int | None) -> int:
        """The scene's index for a material of the file, or for the default one (None)."""
        key = -1 if index is None else index
        if key not in self._slots:
            if index is not None:
                self._parsed[index] = self._parse(self.doc.items("materials")[index])
            self._slots[key] = len(self._slots)
        return self._slots[key]

    def parsed(self, index: int | None) -> ParsedMaterial | None:
        """A material that was asked for; None for the default one and those nobody asked for."""
        return None if index is None else self._parsed.get(index)

    def build(self) -> tuple[Material, ...]:
        """All used materials; raises LoadError where an image cannot be decoded."""
        return tuple(self._build(key) for key in self._slots) or (Material(),)

    def _build(self, key: int) -> Material:
        if key == -1:
            return Material()
        parsed = self._parsed[key]
        return Material(**parsed.fields, textures={slot: self._texture(ref) for slot, ref in parsed.textures.items()})

    def _texture(self, ref: TextureRef) -> Texture:
        if ref not in self._shared:
            self._shared[ref] = ref.texture(self._image(ref.image))
        return self._shared[ref]

    def _image(self, index: int) -> Image:
        """The decoded image; one Image however many textures show it."""
        if index not in self._images:
            self._images[index], remarks = self._decoding[index].result()
            for remark in remarks:
                self.doc.items("images")[index].warn(remark)
        return self._images[index]

    def _parse(self, item: Item) -> ParsedMaterial:
        fields: dict[str, Any] = {"name": item.name}
        textures: dict[str, TextureRef] = {}

        def texture(owner: Item | None, key: str, slot: str) -> Item | None:
            info = owner.child(key) if owner else None
            ref = self._texture_ref(info) if info else None
            if ref:
                textures[slot] = ref
            return info

        pbr = item.child("pbrMetallicRoughness") or Item(self.doc, item.label, {})
        fields["base_color"] = _unit_range(pbr, "baseColorFactor", pbr.numbers("baseColorFactor", 4, (1.0,) * 4))
        fields["metallic"] = _unit_range(pbr, "metallicFactor", (pbr.number("metallicFactor", 1.0),))[0]
        fields["roughness"] = _unit_range(pbr, "roughnessFactor", (pbr.number("roughnessFactor", 1.0),))[0]
        texture(pbr, "baseColorTexture", "base_color")
        texture(pbr, "metallicRoughnessTexture", "metallic_roughness")
        if info := texture(item, "normalTexture", "normal"):
            fields["normal_scale"] = info.number("scale", 1.0)
        if info := texture(item, "occlusionTexture", "occlusion"):
            fields["occlusion_strength"] = _unit_range(info, "strength", (info.number("strength", 1.0),))[0]
        texture(item, "emissiveTexture", "emissive")
        emissive = _positive(item, "emissiveFactor", item.numbers("emissiveFactor", 3, (0.0,) * 3))
        if extension := item.extension("KHR_materials_emissive_strength"):
            strength = _positive(extension, "emissiveStrength", (extension.number("emissiveStrength", 1.0),))[0]
            emissive = tuple(e * strength for e in emissive)
        fields["emissive"] = emissive
        fields["alpha_mode"] = item.choice("alphaMode", "OPAQUE", {m: m for m in ("OPAQUE", "MASK", "BLEND")})
        fields["alpha_cutoff"] = item.number("alphaCutoff", 0.5)
        fields["double_sided"] = item.boolean("doubleSided")
        fields["unlit"] = item.extension("KHR_materials_unlit") is not None
        if extension := item.extension("KHR_materials_ior"):
            fields["ior"] = extension.number("ior", 1.5)
            if fields["ior"] != 0.0 and fields["ior"] < 1.0:  # 0 stands for "reflects everything"
                raise extension.fail(f'"ior" is {fields["ior"]}, must be 0 or >= 1')
        if extension := item.extension("KHR_materials_specular"):
            fields["specular"] = _unit_range(extension, "specularFactor", (extension.number("specularFactor", 1.0),))[0]
            color = extension.numbers("specularColorFactor", 3, (1.0,) * 3)
            fields["specular_color"] = _positive(extension, "specularColorFactor", color)
            texture(extension, "specularTexture", "specular")
            texture(extension, "specularColorTexture", "specular_color")
        if extension := item.extension("KHR_materials_clearcoat"):
            for key, name in (("clearcoatFactor", "clearcoat"), ("clearcoatRoughnessFactor", "clearcoat_roughness")):
                fields[name] = _unit_range(extension, key, (extension.number(key, 0.0),))[0]
            texture(extension, "clearcoatTexture", "clearcoat")
            texture(extension, "clearcoatRoughnessTexture", "clearcoat_roughness")
            if info := texture(extension, "clearcoatNormalTexture", "clearcoat_normal"):
                fields["clearcoat_normal_scale"] = info.number("scale", 1.0)
        if extension := item.extension("KHR_materials_transmission"):
            key = "transmissionFactor"
            fields["transmission"] = _unit_range(extension, key, (extension.number(key, 0.0),))[0]
            texture(extension, "transmissionTexture", "transmission")
        parsed = ParsedMaterial(fields, textures)
        self._compare_normal_maps(item, parsed)
        return parsed

    def _compare_normal_maps(self, item: Item, parsed: ParsedMaterial) -> None:
        coat, base = parsed.textures.get("clearcoat_normal"), parsed.textures.get("normal")
        if coat and base and coat.uv_set != base.uv_set:
            item.warn("its clearcoat normal map uses the tangents of its normal map, made for another UV set")

    def _texture_ref(self, info: Item) -> TextureRef | None:
        """A textureInfo; None, with a warning, where it shows nothing that can be drawn."""
        texture = self.doc.items("textures")[info.required_index("index", "textures")]
        uv_set = info.integer("texCoord", 0)
        transform = None
        if extension := info.extension("KHR_texture_transform"):
            transform = _uv_transform(extension)
            uv_set = extension.integer("texCoord", uv_set)
        if uv_set > MAX_UV_SET:
            info.warn(f"left out: it reads TEXCOORD_{uv_set}, only TEXCOORD_0 and TEXCOORD_1 are drawn")
            return None
        image = self._image_index(texture)
        if image is None:
            texture.warn("left out: it has no image")
            return None
        if image not in self._decoding:
            self._decoding[image] = self._pool.submit(_decode, *self._encoded(image))
        sampler_index = texture.index("sampler", "samplers")
        sampler = Item(self.doc, "", {}) if sampler_index is None else self.doc.items("samplers")[sampler_index]
        return TextureRef(
            image,
            uv_set,
            transform,
            wrap_u=sampler.choice("wrapS", 10497, WRAPS),
            wrap_v=sampler.choice("wrapT", 10497, WRAPS),
            nearest=sampler.choice("magFilter", 9729, MAG_NEAREST),
            mipmap=sampler.choice("minFilter", 9987, MIN_MIPMAP),
        )

    def _image_index(self, texture: Item) -> int | None:
        for name in SOURCE_EXTENSIONS:
            extension = texture.extension(name)
            if extension and "source" in extension.data:
                return extension.required_index("source", "images")
        image: int | None = texture.index("source", "images")
        if image is None and "extensions" in texture.data:
            names = ", ".join(texture.child("extensions").data)  # type: ignore[union-attr]
            raise texture.fail(f"its image is only there in a form not read here ({names}); export it as PNG or JPEG")
        return image

    def _encoded(self, index: int) -> tuple[bytes | memoryview, str, str]:
        """The bytes of an image, what messages call it, and its name. Read here and in order: they are hashed."""
        item = self.doc.items("images")[index]
        uri, view = item.string("uri", None), item.index("bufferView", "bufferViews")
        if uri is None and view is None:
            raise item.fail('has neither "uri" nor "bufferView"')
        data = self.doc.read_uri(uri, item) if uri is not None else self.doc.view(view)
        file_name = printable(urllib.parse.unquote(uri)) if uri and uri[:5].lower() != "data:" else ""
        label = f"{item.label} ({file_name})" if file_name else item.label
        return data, f"{self.doc.path}: {label}", item.name or file_name or item.label


def _decode(data: bytes | memoryview, label: str, name: str) -> tuple[Image, list[str]]:
    remarks: list[str] = []
    return replace(load_image(data, label, remarks.append), name=name), remarks


def _uv_transform(item: Item) -> tuple[float, ...] | None:
    """T R S of KHR_texture_transform, (2, 3) row by row.

    The extension's text rotates counter-clockwise as seen on the image, v down, so u' = c u + s v; its GLSL listing has
    the sine's sign the other way. The Khronos test model, its viewer and this follow the text.
    """
    offset, scale = item.numbers("offset", 2, (0.0, 0.0)), item.numbers("scale", 2, (1.0, 1.0))
    angle = item.number("rotation", 0.0)
    if offset == (0.0, 0.0) and scale == (1.0, 1.0) and angle == 0.0:
        return None
    c, s = math.cos(angle), math.sin(angle)
    return (c * scale[0], s * scale[1], offset[0], -s * scale[0], c * scale[1], offset[1])


def _unit_range(item: Item, key: str, values: tuple[float, ...]) -> tuple[float, ...]:
    if any(not 0.0 <= v <= 1.0 for v in values):
        item.warn(f'"{key}" is outside 0 to 1 and was clamped')
        return tuple(min(max(v, 0.0), 1.0) for v in values)
    return values


def _positive(item: Item, key: str, values: tuple[float, ...]) -> tuple[float, ...]:
    if any(v < 0.0 for v in values):
        item.warn(f'"{key}" is negative and was set to 0')
        return tuple(max(v, 0.0) for v in values)
    return values
