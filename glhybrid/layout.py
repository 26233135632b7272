"""Every struct, image and enum that Python and GLSL both read: one table, from which both faces are made.

STRUCTS rows are (GLSL type, name, meaning). `dtype` follows std430 (OpenGL 4.6 core, 7.6.2.2) and keeps the order;
`glsl` prints the same rows as a GLSL struct. Shaders get them through `#include "layout.glsl"`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.scene import TEXTURE_SLOTS

Row = tuple[str, str, str]

TEXTURE_ROWS: list[Row] = [
    ("uint", "first_level", "row of texture_levels that holds level 0"),
    ("uint", "level_count", "levels in a row"),
    ("uint", "sampling", "WRAP_U bits 0-1, WRAP_V bits 2-3, NEAREST bit 4, UV1 bit 5"),
    ("float", "log2_texels", "log2 of width * height of level 0, for the level of detail"),
    ("vec3", "u_row", "u' = dot(u_row, (u, v, 1)): KHR_texture_transform"),
    ("vec3", "v_row", "v' likewise"),
]

STRUCTS: dict[str, list[Row]] = {
    "FrameConstants": [
        ("mat4", "clip_from_world", "world is origin-relative: the renderer rebases it on the camera"),
        ("mat4", "previous_clip_from_world", "of the frame before, in this frame's world"),
        ("vec4", "previous_depth", "dot with (point, 1): its depth along the view axis of the frame before"),
        ("vec3", "eye_ws", "origin of primary rays (perspective)"),
        ("float", "pixel_angle", "rad a pixel, at the image centre; footprint in m if orthographic"),
        ("vec3", "right_ws", "ray direction per unit of ndc.x; half extent in m if orthographic"),
        ("uint", "orthographic", "1 = parallel rays along forward_ws"),
        ("vec3", "up_ws", "ray direction per unit of ndc.y"),
        ("uint", "seed", "of every random sequence"),
        ("uint", "history", "HISTORY_*"),
        ("uint", "number", "of this frame since the picture began: the next points of every sequence"),
        ("vec3", "forward_ws", "unit"),
        ("float", "near", "m along forward_ws: nothing closer is seen"),
        ("uint", "sample_first", "index of the first sample of this dispatch"),
        ("vec2", "jitter_px", "offset of the ray from the pixel centre"),
        ("ivec2", "size_px", "width, height"),
        ("uint", "light_first", "first light of this dispatch"),
        ("uint", "light_end", "one past the last light of this dispatch"),
        ("uint", "light_count", "all lights"),
        ("uint", "bounces", "surface bounces after the first hit (reference)"),
        ("uint", "sample_count", "samples in this dispatch"),
        ("float", "accumulate", "weight of what the image already holds: 0 = overwrite"),
        ("uint", "tone_map", "TONE_*"),
        ("float", "mirror_cutoff", "roughness from which a surface sends no mirror ray; 1 = Kim's"),
        ("vec3", "environment_x", "rows of environment_from_world: rotation about +Y"),
        ("float", "environment_intensity", "texels times this are radiance"),
        ("vec3", "environment_z", "third row"),
        ("uint", "top_root", "root node of the top-level tree"),
        ("vec3", "top_grid_min", "of the top-level tree, origin-relative"),
        ("vec3", "top_grid_step", ""),
        ("float", "emissive_weight", "sum of area times luminance over emissive triangles and spheres (reference)"),
    ],
    "Instance": [
        ("mat4x3", "world_from_object", "origin-relative, m"),
        ("mat4x3", "object_from_world", "its inverse"),
        ("vec3", "grid_min", "of the Blas, object space"),
        ("uint", "root", "node of the Blas in the packed node array"),
        ("vec3", "grid_step", "of the Blas"),
        ("uint", "first_record", "row of records for geometry 0"),
        ("uint", "flipped", "1 = negative determinant: front faces turn clockwise"),
        ("uint", "id", "row of Scene.instances; ID_NONE: the record knows"),
    ],
    "Record": [
        ("uint", "hit_group", "row of hit_groups"),
        ("uint", "instance_id", "row of Scene.instances, for the AOV"),
    ],
    "HitGroup": [
        ("uint", "kind", "KIND_*: the intersection function"),
        ("uint", "material", "row of materials"),
        ("uint", "any_hit", "ANY_HIT_*: what a shadow ray does here"),
        ("uint", "single_sided", "1 = back faces are invisible to camera and reflection rays"),
    ],
    "Material": [
        ("vec4", "base_color", "linear"),
        ("vec3", "emissive", "radiance"),
        ("float", "metallic", ""),
        ("vec3", "specular_color", "KHR_materials_specular"),
        ("float", "roughness", "perceptual; alpha = roughness squared"),
        ("float", "specular", "KHR_materials_specular"),
        ("float", "dielectric_f0", "((ior - 1) / (ior + 1))^2"),
        ("float", "alpha_cutoff", ""),
        ("float", "normal_scale", ""),
        ("float", "occlusion_strength", ""),
        ("float", "clearcoat", ""),
        ("float", "clearcoat_roughness", ""),
        ("float", "clearcoat_normal_scale", ""),
        ("float", "transmission", "thin"),
        ("uint", "alpha_mode", "ALPHA_*"),
        ("uint", "unlit", "1 = base colour is radiance"),
        ("uint", "texture_slots", "bit k: texture[k] is set"),
        ("int[11]", "texture", "row of textures by slot (SLOT_*), -1 = none"),
    ],
    "Texture": TEXTURE_ROWS,
    "Light": [
        ("vec3", "color", "colour times intensity: lux or candela"),
        ("uint", "kind", "LIGHT_*"),
        ("vec3", "position", "origin-relative, m"),
        ("float", "range", "m; 0 = unlimited"),
        ("vec3", "direction", "unit, the way the light travels"),
        ("float", "cone_scale", "1 / (cos inner - cos outer)"),
        ("float", "cone_offset", "-cos outer * cone_scale"),
        ("float", "size", "tan of half the angular diameter, or radius in m; 0 = hard"),
    ],
    "Placement": [  # of an instance, a frame ago
        ("mat4x3", "world_from_object", "in this frame's world"),
    ],
    "SkinPiece": [  # one primitive of a mesh that changes shape
        ("uint", "vertex_first", "row of vertices of its first one"),
        ("uint", "rest_first", "row of rest_vertices"),
        ("uint", "vertex_count", ""),
        ("uint", "influence_first", "row of influences"),
        ("uint", "influence_count", "a vertex; 0 = not skinned"),
        ("uint", "joint_first", "row of joints for joint 0"),
        ("uint", "delta_first", "row of deltas: by target, then vertex, then part"),
        ("uint", "delta_parts", "bits: 1 position, 2 normal, 4 tangent"),
        ("uint", "morph_first", "row of morphs"),
        ("uint", "morph_count", "targets with a weight now"),
        ("uint", "flat_shaded", "1 = normals of the moved faces; three vertices a triangle, in order"),
        ("uint", "has_tangents", ""),
    ],
    "RestVertex": [
        ("vec3", "position", "as in the file, before targets and joints"),
        ("uint", "piece", "row of skin pieces"),
        ("vec3", "normal", ""),
        ("vec4", "tangent", ""),
    ],
    "Influence": [("uint", "joint", "in its skin"), ("float", "weight", "")],
    "Morph": [("uint", "target", "in its piece"), ("float", "weight", "")],
    "Joint": [("mat4x3", "anchored_from_bind", "m")],
    "RefitTree": [
        ("vec3", "grid_min", "of the Blas, object space"),
        ("float", "pad", "m that boxes are wider on every side"),
        ("vec3", "grid_step", ""),
        ("uint", "node_first", "row of nodes of its root"),
        ("uvec2", "axes", "that the bits of Morton codes halve, the topmost first, two bits each"),
        ("uint", "key_bits", "of a Morton code"),
        ("uint", "entry_first", "row of refit_nodes of its root"),
        ("uint", "node_count", "rows from node_first on that it takes"),
    ],
    "BuildItem": [  # a triangle of a tree that the GPU builds
        ("uint", "triangle", "row of triangles"),
        ("uint", "geometry", "word of its slot: geometry and SLOT_*"),
        ("uint", "tree", "row of refit_trees"),
    ],
    "BuildChunk": [  # what one work group merges
        ("uint", "tree", "row of refit_trees"),
        ("uint", "first", "row of sorted pairs, or of clusters"),
        ("uint", "count", "of those, at most MERGE_WIDTH"),
        ("uint", "kept", "clusters that may be left"),
        ("uint", "highest", "nodes above one another that nearest pairs make"),
        ("uint", "free_turns", "that merge nearest pairs"),
        ("uint", "turns", "at most"),
        ("uint", "node_first", "in the tree, of the nodes made here"),
        ("uint", "node_count", "room for them"),
        ("uint", "out_first", "row of clusters for what is left"),
        ("uint", "slot_first", "row of slots for its triangles"),
        ("uint", "leaves", "1 = of triangles, not of clusters"),
        ("uint", "root", "1 = the last one is the root"),
    ],
    # A depth map in its tile of the atlas: texels are (right, up) / texel - first_texel, depth is along axis - start.
    "ShadowMap": [
        ("vec3", "origin", "origin-relative, m; 0 for parallel rays"),
        ("float", "start", "m along axis where the map begins; 0 from a point"),
        ("vec3", "right", "unit"),
        ("float", "near", "near plane of a map from a point, m; 0 = parallel rays"),
        ("vec3", "up", "unit"),
        ("float", "range", "m from start to end"),
        ("vec3", "axis", "unit, the way the light travels"),
        ("uint", "size", "texels a side"),
        ("vec2", "texel", "m a texel; from a point: tangent a texel"),
        ("vec2", "first_texel", "of the tile, on the grid that starts at the origin"),
        ("ivec2", "corner", "of the tile in the atlas"),
    ],
    "ShadowLight": [
        ("uint", "first_map", "row of ShadowMaps"),
        ("uint", "map_count", "cascades, finest first; 6 = faces +X -X +Y -Y +Z -Z"),
        ("uint", "cube", "1 = faces"),
    ],
    "Probe": [
        ("vec3", "position", "where it was captured, origin-relative, m"),
        ("float", "fade", "m around its reach over which it gives way to the next"),
        ("vec3", "box_min", "whose walls stand for what it saw"),
        ("vec3", "box_max", ""),
        ("vec3", "reach_min", "of the surfaces that show it"),
        ("vec3", "reach_max", ""),
    ],
    "Emitter": [  # reference only
        ("uint", "instance", "row of instances"),
        ("uint", "triangle", "row of triangles: a triangle or a sphere"),
        ("float", "cdf", "upper end of its share of emissive_weight, 0 to 1"),
    ],
}

CONSTANTS: dict[str, int] = {
    "ID_NONE": 0xFFFFFFFF,
    # In a slot's geometry word: its any-hit function must be asked; opaque, without a back; the index itself.
    "SLOT_ASK": 0x80000000, "SLOT_SINGLE_SIDED": 0x40000000, "SLOT_GEOMETRY": 0x3FFFFFFF,
    "KIND_TRIANGLE": 0, "KIND_SPHERE": 1,
    "ANY_HIT_OPAQUE": 0, "ANY_HIT_MASK": 1, "ANY_HIT_TINT": 2,
    "ALPHA_OPAQUE": 0, "ALPHA_MASK": 1, "ALPHA_BLEND": 2,
    # What earlier frames a filter may use: none, the one before, or one of this very view.
    "HISTORY_NONE": 0, "HISTORY_BEFORE": 1, "HISTORY_SAME_VIEW": 2,
    "LIGHT_DIRECTIONAL": 0, "LIGHT_POINT": 1, "LIGHT_SPOT": 2,
    # How depth maps are looked up: nearest texel, box over texels, turned disc of taps, disc sized by the blockers.
    "FILTER_TAP": 0, "FILTER_BOX": 1, "FILTER_DISC": 2, "FILTER_PCSS": 3,
    "WRAP_REPEAT": 0, "WRAP_CLAMP": 1, "WRAP_MIRROR": 2,
    "TONE_NONE": 0, "TONE_ACES": 1, "TONE_AGX": 2, "TONE_PBR_NEUTRAL": 3,
    # Texture slots of a material, in the order of scene.TEXTURE_SLOTS.
    **{f"SLOT_{slot.upper()}": i for i, slot in enumerate(TEXTURE_SLOTS)},
    # Of paths on their way (lib/path.glsl): to a row of their image; texels of one, and of a light it looks for; lists.
    "PATH_WIDTH": 2048, "PATH_PARTS": 5, "PATH_LIGHT_PARTS": 4, "PATH_LISTS": 4,
    # Of trees over moved vertices: clusters that a work group merges; in place of a parent.
    "MERGE_WIDTH": 1024, "REFIT_ROOT": 0xFFFFFFFE,
    # What passes/aov.comp writes, by the names of glhybrid/image.py; kinds that share a program.
    "AOVS_POINT": 0, "AOVS_MATERIAL": 1, "AOVS_MOTION": 2, "AOVS_RAYS": 3,
    "AOV_DEPTH": 1, "AOV_DISTANCE": 2, "AOV_POSITION": 3, "AOV_NORMAL": 4, "AOV_NORMAL_GEOMETRIC": 5, "AOV_ALBEDO": 6,
    "AOV_ROUGHNESS": 7, "AOV_METALLIC": 8, "AOV_EMISSIVE": 9, "AOV_INSTANCE_ID": 10, "AOV_MATERIAL_ID": 11,
    "AOV_TRIANGLE_ID": 12, "AOV_MOTION": 13, "AOV_BVH_STEPS": 14,
    # Pixels that send a mirror ray of their own, before what their neighbours do not tell.
    "GRID_FULL": 0, "GRID_HALF": 1, "GRID_CHECKERBOARD": 2,
    # Why a technique gave up at a pixel (the AOVs `reason`, of reflections, `reason_shadows` and `reason_ao`).
    "REASON_NONE": 0,          # nothing to answer here, or answered
    "REASON_ROUGH": 1,         # too rough to spend a ray
    "REASON_BELOW": 2,         # the direction pointed under the surface and was bent back
    "REASON_ENVIRONMENT": 3,   # no object in that direction
    "REASON_OFF_SCREEN": 4,    # the march left the picture
    "REASON_HIDDEN": 5,        # it went behind something that is seen
    "REASON_BACK_FACE": 6,     # it came upon a surface from behind
    "REASON_FACING": 7,        # it came to the camera
    "REASON_STEPS": 8,         # it ran out of steps
    "REASON_THICKNESS": 9,     # answered by a guess: what is seen there counts as so thick
    "REASON_OUTSIDE_PROBE": 10,  # in no probe's box
    "REASON_COARSE": 11,       # a shadow's border, which is known to a texel only, and that is larger than the pixel
    "REASON_SEARCH": 12,       # in a penumbra; the light is larger than what was searched for casters
    "REASON_SMALL": 13,        # what it looks for is smaller than a pixel
}  # fmt: skip

PREFILTER_SIZES = (128, 64, 32, 16, 16, 16, 16)  # octahedral map of roughness 1/7, 2/7 .. 1: lobes widen, maps shrink
IRRADIANCE_SIZE = 32
DFG_SIZE = 64

_TYPES: dict[str, tuple[Any, tuple[int, ...], int, int]] = {  # dtype, shape, alignment, size (std430)
    "float": (np.float32, (), 4, 4), "uint": (np.uint32, (), 4, 4), "int": (np.int32, (), 4, 4),
    "vec2": (np.float32, (2,), 8, 8), "ivec2": (np.int32, (2,), 8, 8), "uvec2": (np.uint32, (2,), 8, 8),
    "vec3": (np.float32, (3,), 16, 12), "uvec3": (np.uint32, (3,), 16, 12),
    "vec4": (np.float32, (4,), 16, 16), "uvec4": (np.uint32, (4,), 16, 16),
    "mat4": (np.float32, (4, 4), 16, 64),    # columns first: write the transpose
    "mat4x3": (np.float32, (4, 4), 16, 64),  # four vec3 columns, each padded to 16 bytes
}  # fmt: skip


def _type(kind: str) -> tuple[Any, tuple[int, ...], int, int]:
    """dtype, shape, alignment, size; `int[11]` is an array, whose elements keep their own alignment in std430."""
    kind, _, count = kind.partition("[")
    base, shape, align, size = _TYPES[kind]
    if not count:
        return base, shape, align, size
    number = int(count.rstrip("]"))
    return base, (number, *shape), align, number * (-(-size // align) * align)


def dtype(name: str) -> np.dtype[Any]:
    """NumPy dtype of a STRUCTS entry with std430 offsets; itemsize is the array stride."""
    offset, largest = 0, 4
    names, formats, offsets = [], [], []
    for kind, field, _ in STRUCTS[name]:
        base, shape, align, size = _type(kind)
        offset = -(-offset // align) * align
        names.append(field)
        formats.append((base, shape))
        offsets.append(offset)
        offset += size
        largest = max(largest, align)
    itemsize = -(-offset // largest) * largest
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": itemsize})


def glsl(name: str) -> str:
    """The same rows as a GLSL struct, meanings as comments."""
    rows = "\n".join(f"    {kind} {field};  // {meaning}".rstrip(" /") for kind, field, meaning in STRUCTS[name])
    return f"struct {name} {{\n{rows}\n}};\n"


def glsl_header() -> str:
    """Text of the virtual include "layout.glsl"."""
    constants = "\n".join(f"const uint {k} = {v}u;" for k, v in CONSTANTS.items())
    sizes = ", ".join(str(s) for s in PREFILTER_SIZES)
    tables = (
        f"const int PREFILTER_LEVELS = {len(PREFILTER_SIZES)};\n"
        f"const int PREFILTER_SIZES[PREFILTER_LEVELS] = int[]({sizes});\n"
        f"const int IRRADIANCE_SIZE = {IRRADIANCE_SIZE};\nconst int DFG_SIZE = {DFG_SIZE};\n"
    )
    return constants + "\n" + tables + "".join(glsl(name) for name in STRUCTS)


TABLES = ("Light", "Material", "Instance", "Texture")  # rows of whole texels, which some devices read faster


def _read(kind: str, offset: int) -> str:
    """GLSL that makes a value from texels t0, t1 ... of four words, at a byte offset."""
    base, _, count = kind.partition("[")
    if count:
        number = int(count.rstrip("]"))
        return f"{base}[{number}]({', '.join(_read(base, offset + 4 * k) for k in range(number))})"
    if base == "mat4x3":
        return f"mat4x3({', '.join(_read('vec3', offset + 16 * k) for k in range(4))})"
    first, words = offset % 16 // 4, int(base[-1]) if base[-1].isdigit() else 1
    text = f"t{offset // 16}.{'xyzw'[first : first + words]}"
    return {"f": f"uintBitsToFloat({text})", "v": f"uintBitsToFloat({text})", "i": f"int({text})"}.get(base[0], text)


def glsl_readers() -> str:
    """Text of the virtual include "tables.glsl": for each of TABLES a function that reads a row by texels."""
    functions = []
    for name in TABLES:
        fields, texels = dtype(name), dtype(name).itemsize // 16
        assert fields.itemsize % 16 == 0 and fields.fields is not None
        values = ", ".join(_read(kind, fields.fields[field][1]) for kind, field, _ in STRUCTS[name])
        fetched = "".join(f"    uvec4 t{k} = texelFetch(table, int(row) * {texels} + {k});\n" for k in range(texels))
        functions.append(
            f"{name} read_{name}(usamplerBuffer table, uint row) {{\n{fetched}    return {name}({values});\n}}\n"
        )
    return "".join(functions)


def columns(matrix: Any) -> Any:
    """(..., 4, 4) or (..., 3, 4) row-major matrices as GLSL columns (..., 4, 4) float32: the one transpose."""
    matrix = np.asarray(matrix)
    out = np.zeros((*matrix.shape[:-2], 4, 4), np.float32)
    out[..., :, : matrix.shape[-2]] = np.swapaxes(matrix, -1, -2)
    return out


@dataclass(frozen=True)
class Channel:
    """One image that passes share: moderngl components and dtype, the GLSL format qualifier, what it means."""

    name: str
    components: int
    dtype: str
    glsl_format: str
    meaning: str

    @property
    def bytes_per_pixel(self) -> int:
        """Of the image that holds it."""
        return self.components * {"f1": 1, "f2": 2, "f4": 4, "u4": 4, "u1": 1}[self.dtype]


CHANNELS: dict[str, Channel] = {
    c.name: c
    for c in (
        Channel("gbuffer_id", 2, "u4", "rg32ui", "row of instances, row of triangles; ID_NONE = a miss"),
        Channel("visibility", 1, "f1", "r8", "1 = light arrives; a layer a light"),
        Channel("visibility_tint", 4, "f2", "rgba16f", "the same through tinted surfaces"),
        Channel("visibility_soft", 4, "f4", "rgba32f", "the same with penumbras; their half width, m, 0 = not known"),
        Channel("occlusion", 1, "f4", "r32f", "open share of the sky, 1 = all"),
        Channel("occlusion_rays", 4, "f4", "rgba32f", "the same thrice; how far away what occludes is, < 0 no ray"),
        Channel("occlusion_raw", 1, "f4", "r32f", "the same before its filter"),
        Channel("reflection", 4, "f4", "rgba32f", "radiance along the mirror direction, distance to what is seen"),
        Channel("reflection_guide", 4, "u4", "rgba32ui", "of a pixel a cell: what others must know to share its ray"),
        Channel("screen_plane", 4, "f4", "rgba32f", "screen depth, its change along x and y, whether anything is seen"),
        Channel("screen_nearest", 1, "f4", "r32f", "pyramid over the planes: nearest screen depth"),
        Channel("screen_span", 2, "f4", "rg32f", "pyramid over the planes: nearest and farthest screen depth"),
        Channel("reflection_coat", 4, "f4", "rgba32f", "the same of the clearcoat (ray-glossy)"),
        Channel("reflection_noise", 2, "f2", "rg16f", "mean square luminance of rays over squared mean; how many"),
        Channel("reflection_coat_noise", 2, "f2", "rg16f", "the same of the clearcoat"),
        Channel("paths", 4, "u4", "rgba32ui", "of the reference: paths on their way (lib/path.glsl)"),
        Channel("reflection_rays", 4, "u4", "rgba32ui", "a layer a ray: direction, distance, radiance over albedo"),
        Channel("reflection_coat_rays", 4, "u4", "rgba32ui", "the same of the clearcoat"),
        Channel("mirror_hit", 4, "u4", "rgba32ui", "of split reflections: distance, barycentrics, row of triangles"),
        Channel("mirror_ray", 2, "u4", "rg32ui", "of split reflections: direction, octahedral"),
        Channel("mirror_instance", 1, "u4", "r32ui", "of split reflections, in two levels: row of instances"),
        Channel("mirror_lit", 1, "u4", "r32ui", "of split reflections: a bit for each light that arrives"),
        *(
            Channel(f"{name}_{frame}", parts, kind, form, meaning)
            for frame in ("even", "odd")
            for name, parts, kind, form, meaning in (
                ("guide", 4, "u4", "rgba32ui", "normal, depth along the view axis, row of records, roughness"),
                *(
                    (f"{signal}_{kept}", parts, "f2" if "16f" in form else "f4", form, f"{what}: {meaning}")
                    for signal, what in (
                        ("reflection", "reflections"),
                        ("reflection_coat", "those of the clearcoat"),
                        ("occlusion", "the open share of the sky"),
                        ("visibility", "of lights, a layer a light"),
                    )
                    for kept, parts, form, meaning in (
                        ("history", 4, "rgba32f", "mean of all frames; over how many m it changes"),
                        ("counts", 2, "rg16f", "rays; root of the luminance about each pixel in the last frames"),
                        ("counts_moving", 4, "rgba16f", "the same where things move; drift about each pixel"),
                        ("level", 2, "rg32f", "luminance about each pixel, its variance"),
                    )
                ),
            )
        ),
        *(
            Channel(f"{signal}_drift", 1, "f2", "r16f", f"how far {what} slide in a frame, over what they change over")
            for signal, what in (
                ("reflection", "reflections"),
                ("reflection_coat", "those of the clearcoat"),
                ("visibility", "shadows"),
            )
        ),
        Channel("denoise_moved", 4, "f4", "rgba32f", "how far the point has come since the frame before, m"),
        Channel("denoise_ping", 4, "f4", "rgba32f", "a signal between filters; variance of its luminance"),
        Channel("denoise_pong", 4, "f4", "rgba32f", ""),
        Channel("radiance", 4, "f4", "rgba32f", "linear Rec. 709 radiance, coverage"),
        Channel("aov", 4, "u4", "rgba32ui", "bits of one AOV"),
        Channel("reason", 1, "u1", "r8ui", "REASON_* of reflections"),
        Channel("reason_shadows", 1, "u1", "r8ui", "REASON_*, of the last light that has one"),
        Channel("reason_ao", 1, "u1", "r8ui", "REASON_*"),
        Channel("display", 4, "f1", "rgba8", "sRGB-encoded"),
    )
}
