// passes/reflect_sparse.comp -- the mirror rays of a part of the pixels: of every second in both directions or of one colour
// of a checkerboard, with what passes/reflect_resolve.comp needs to know of them; or of the pixels in a list.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/sparse.glsl"

#if USE_PIXEL_LIST
layout(std430) readonly buffer PixelList { uint pixel_list[]; };
layout(std430) readonly buffer PixelCount { uint groups_x, groups_y, groups_z, pixel_count; };
layout(rgba32f) writeonly uniform image2D out_reflection;    // radiance, distance (inf: sky, 0: no ray)
#else
layout(std430) writeonly buffer PixelCount { uint groups_x, groups_y, groups_z, pixel_count; };
layout(rgba32f) writeonly uniform image2D out_sparse;        // the same, a texel a ray
layout(rgba32ui) writeonly uniform uimage2D out_guide;       // mirror direction, distance of the surface (0: no ray), REASON_*
#endif
#if USE_REASON && USE_PIXEL_LIST
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif

void main() {
#if USE_PIXEL_LIST
    uint i = (tile().y * GROUPS_ACROSS + tile().x) * 64u + gl_LocalInvocationIndex;
    if (i >= pixel_count) return;
    ivec2 px = ivec2(pixel_list[i] & 0xFFFFu, pixel_list[i] >> 16u);
#else
    if (gl_GlobalInvocationID == uvec3(0u) && tile_rows.x == 0u) { groups_x = GROUPS_ACROSS; groups_y = 0u; groups_z = 1u; pixel_count = 0u; }
    ivec2 cell = tile_pixel();
    ivec2 px = pixel_of(cell);
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
#endif
    Pixel p = load_pixel(px);
    vec4 result = vec4(0.0);
    uvec4 guide = uvec4(0u);
    uint reason = REASON_NONE;
    if (covered(p)) {
        Surface s = load_surface(p);
        bool bent;
        vec3 r = mirror_direction(s, -p.ray.dir, bent);
        reason = REASON_ROUGH;
        if (sends_mirror_ray(s)) {
            Hit hit;
            Ray ray = Ray(ray_origin(s.point, r), 0.0, r, INFINITY);
            result.rgb = trace_radiance(ray, footprint(p.hit.t), frame.orthographic == 1u ? 0.0 : frame.pixel_angle, hit);
            result.a = hit.t;
            guide = uvec4(packUnorm2x16(oct_encode(r)), floatBitsToUint(p.hit.t), 0u, 0u);
            reason = bent ? REASON_BELOW : hit.triangle == ID_NONE ? REASON_ENVIRONMENT : REASON_NONE;
        }
    }
#if USE_PIXEL_LIST
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
#else
    imageStore(out_sparse, cell, result);
    imageStore(out_guide, cell, uvec4(guide.xy, reason, 0u));
#endif
}
