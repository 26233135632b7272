// lib/texture.glsl -- texture lookups with our own filter.
// All images of a scene lie in the pages of one array texture, any number, size and sampler; wrapping and trilinear
// filtering are done here. Chosen over hardware samplers: those need one unit an image (16 to 32 in all), blend with
// 8-bit weights, and differ by driver; these do not. Rejected too: bindless handles, which Mesa's llvmpipe lacks.
#include "lib/geometry.glsl"
#include "lib/loop.glsl"

// Is any material's slot k filled? The code of empty ones goes.
#define HAS_SLOT(k) ((uint(TEXTURE_SLOTS) >> (k) & 1u) == 1u)

#if USE_TEXTURES
uniform sampler2DArray texture_pages;                                      // rgba8, as in the files
layout(std430) readonly buffer Textures { Texture textures[]; };
layout(std430) readonly buffer TextureLevels { uvec4 texture_levels[]; };  // x, y, width | height << 16, page

vec3 srgb_to_linear(vec3 c) {
    return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, lessThanEqual(c, vec3(0.04045)));
}

// Texels of a coordinate that wrap_uv has brought near: at most one past either end.
int wrap(int i, int n, uint mode) {
    if (mode == WRAP_CLAMP) return clamp(i, 0, n - 1);
    int period = mode == WRAP_MIRROR ? 2 * n : n;
    i = i < 0 ? i + period : (i >= period ? i - period : i);
    return i < n ? i : 2 * n - 1 - i;
}

// To the first period, where float32 has the most bits for the fraction.
float wrap_uv(float x, uint mode) {
    if (mode == WRAP_CLAMP) return clamp(x, -1.0, 2.0);
    return mode == WRAP_MIRROR ? x - 2.0 * floor(0.5 * x) : x - floor(x);
}

vec2 texture_uv(Texture tex, vec2 uv0, vec2 uv1) {
    vec3 uv = vec3((tex.sampling & 32u) != 0u ? uv1 : uv0, 1.0);
    return vec2(wrap_uv(dot(tex.u_row, uv), tex.sampling & 3u), wrap_uv(dot(tex.v_row, uv), (tex.sampling >> 2u) & 3u));
}

// log2_area: log2 of the footprint's area over the area of the unit uv square; FINEST_LEVEL for level 0.
// One loop over four texels of one level, or eight of two: unrolled and inlined everywhere it is called, compilers
// would see the texel code a hundred times.
vec4 sample_texture(int index, vec2 uv0, vec2 uv1, float log2_area, bool srgb) {
    Texture tex = texture_row(index);
    vec2 uv = texture_uv(tex, uv0, uv1);
    float lod = clamp(0.5 * (log2_area + tex.log2_texels), 0.0, float(tex.level_count - 1u));
    bool nearest = (tex.sampling & 16u) != 0u;
    float between = fract(lod);
    int taps = between > 0.0 ? 8 : 4;
    vec4 sum = vec4(0.0);
    FOR_SOME(int, k, 0, taps) {
        uvec4 level = texture_level_row(tex.first_level + uint(lod) + uint(k >> 2));
        ivec2 size = ivec2(level.z & 0xFFFFu, level.z >> 16u);
        vec2 p = uv * vec2(size) - (nearest ? 0.0 : 0.5), whole = floor(p);
        ivec2 corner = ivec2(k & 1, (k >> 1) & 1), i = ivec2(whole) + corner;
        vec2 f = nearest ? vec2(0.0) : p - whole;
        vec2 w = mix(1.0 - f, f, vec2(corner));
        ivec2 at = ivec2(level.xy) + ivec2(wrap(i.x, size.x, tex.sampling & 3u), wrap(i.y, size.y, (tex.sampling >> 2u) & 3u));
        vec4 c = texelFetch(texture_pages, ivec3(at, int(level.w)), 0);
        if (srgb) c.rgb = srgb_to_linear(c.rgb);
        sum += c * (w.x * w.y * (k < 4 ? 1.0 - between : between));
    } END_FOR(k, taps)
    return sum;
}
#endif

// Interpolated attributes of a hit. Absent ones have the value that leaves a factor alone.
struct Attributes { vec2 uv0, uv1; vec4 color; };

Attributes attributes_at(Hit hit) {
    Attributes a = Attributes(vec2(0.0), vec2(0.0), vec4(1.0));
#if USE_TEXTURES || USE_EXTRA_ATTRIBUTES
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    vec3 w = vec3(1.0 - hit.bary.x - hit.bary.y, hit.bary);
#if USE_SPHERES
    if (tri.x == tri.y) return Attributes(hit.bary, hit.bary, vec4(1.0));      // one row of vertices stands for a sphere
#endif
    for (int i = 0; i < 3; i++) {
        int v = int(tri[i]);
        a.uv0 += w[i] * vec2(uintBitsToFloat(texelFetch(vertices, v * 2).w), uintBitsToFloat(texelFetch(vertices, v * 2 + 1).w));
    }
#if USE_EXTRA_ATTRIBUTES
    a.color = vec4(0.0);
    for (int i = 0; i < 3; i++) {
        uvec4 extra = texelFetch(attributes, int(tri[i]));
        a.uv1 += w[i] * uintBitsToFloat(extra.xy);
        a.color += w[i] * vec4(unpackHalf2x16(extra.z), unpackHalf2x16(extra.w));
    }
#endif
#endif
    return a;
}

const float FINEST_LEVEL = -1e9;

// Base colour and alpha at the finest level: what alpha tests use in raster and rays alike, so that both cut the same holes.
// By row, not by value: a copy of the whole material costs traversal its registers.
vec4 base_color_at(uint material, Hit hit) {
    Attributes a = attributes_at(hit);
    vec4 color = material_row(material).base_color * a.color;
#if USE_TEXTURES
    int image = material_row(material).texture[SLOT_BASE_COLOR];
    if (image >= 0) color *= sample_texture(image, a.uv0, a.uv1, FINEST_LEVEL, true);
#endif
    return color;
}

// The same as hit_known, but through a hole in a sphere its far side.
Hit hit_uncut(Ray ray, uint instance, uint triangle, out bool met, out bool front) {
    Hit hit = hit_known(ray, instance, triangle, met, front);
#if USE_SPHERES && USE_ALPHA_TEST
    HitGroup group = hit_group_of(instance, hit.geometry);
    if (group.kind == KIND_SPHERE && group.any_hit == ANY_HIT_MASK && met && front) {
        if (base_color_at(group.material, hit).a < material_row(group.material).alpha_cutoff) {
            ray.t_min = next_after(hit.t);
            hit = hit_known(ray, instance, triangle, met, front);
        }
    }
#endif
    return hit;
}

// How much of a surface is there, by the alpha of its base colour.
float coverage(Material m, float alpha) {
    return m.alpha_mode == ALPHA_BLEND ? alpha : (m.alpha_mode == ALPHA_MASK && alpha < m.alpha_cutoff ? 0.0 : 1.0);
}

// What a blended or transmissive surface lets through of light that meets it at this angle: `transmitted` of lib/brdf.glsl
// without normal maps and textures of the interface, which shadows can do without.
vec3 tint_at(Material m, vec4 color, Hit hit, float cos_theta) {
    float transmission = m.transmission, metallic = m.metallic;
#if USE_TEXTURES
    if (HAS_SLOT(SLOT_TRANSMISSION) && m.texture[SLOT_TRANSMISSION] >= 0) {
        Attributes a = attributes_at(hit);
        transmission *= sample_texture(m.texture[SLOT_TRANSMISSION], a.uv0, a.uv1, FINEST_LEVEL, false).r;
    }
    if (HAS_SLOT(SLOT_METALLIC_ROUGHNESS) && transmission > 0.0 && m.texture[SLOT_METALLIC_ROUGHNESS] >= 0) {
        Attributes a = attributes_at(hit);
        metallic *= sample_texture(m.texture[SLOT_METALLIC_ROUGHNESS], a.uv0, a.uv1, FINEST_LEVEL, false).b;
    }
#endif
    vec3 f0 = min(m.dielectric_f0 * m.specular_color, vec3(1.0)) * m.specular;
    float passes = transmission * (1.0 - metallic) * (1.0 - max3(fresnel_schlick(f0, m.specular, cos_theta)));
    passes *= 1.0 - m.clearcoat * (0.04 + 0.96 * pow5(1.0 - cos_theta));
    return mix(vec3(1.0), color.rgb * passes, coverage(m, color.a));
}
