// lib/mirror_guide.glsl -- what pixels between must know of a mirror ray, to share what it sees (passes/reflect_resolve.comp).
#include "lib/gbuffer.glsl"
#include "lib/mirror_pixel.glsl"
#include "lib/shade.glsl"

const bool GUIDES = bool(USE_REFLECT_GRID) && !bool(USE_PIXEL_LIST);
#if USE_REFLECT_GRID && !USE_PIXEL_LIST
layout(rgba32ui) writeonly restrict uniform uimage2D out_guide;
layout(std430) writeonly buffer PixelCount { uint groups_x, groups_y, groups_z, pixel_count; };
#endif

// The list of pixels that passes/reflect_resolve.comp appends to is empty: one invocation says so, that of pixel 0.
void begin_list(ivec2 px) {
#if USE_REFLECT_GRID && !USE_PIXEL_LIST
    if (px == ivec2(0)) { groups_x = GROUPS_ACROSS; groups_y = 0u; groups_z = 1u; pixel_count = 0u; }
#endif
}

// direction, distance of the surface that it leaves, `beside`.
uvec4 guide_of(Pixel p, Surface s, vec3 dir) {
    // The share of what the ray sees that the pixel shows, and what it shows beside it without a lamp: in that, errors of the
    // reflection go under. Weights as in indirect_light.
    Bsdf b = s.bsdf;
    float blurred = is_mirror(b) ? 0.0 : b.roughness;
    vec3 share = specular_albedo(b, -p.ray.dir), rest = diffuse_sky(s);
    if (SPECULAR_SKY) rest += share * blurred * environment_prefiltered(dir, b.roughness);
    share *= 1.0 - blurred;
    if (CLEARCOAT && b.clearcoat > 0.0) {
        float f = coat_fresnel(b, -p.ray.dir);
        share = share * (1.0 - f) + f * (1.0 - b.clearcoat_roughness);
        rest *= 1.0 - f;
    }
    float beside = luminance(rest + s.emissive) / max(max3(share), 1e-4);
    return uvec4(packUnorm2x16(oct_encode(dir)), floatBitsToUint(p.hit.t), floatBitsToUint(beside), s.material);
}

// All 0: no ray.
void store_guide(ivec2 px, uvec4 guide) {
#if USE_REFLECT_GRID && !USE_PIXEL_LIST
    imageStore(out_guide, cell_of(px), guide);
#endif
}
