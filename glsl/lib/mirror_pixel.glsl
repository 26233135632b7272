// lib/mirror_pixel.glsl -- whose mirror ray an invocation works on: its own pixel's, that of its cell, or that of one on a
// list, which passes/reflect_resolve.comp makes of those between that need their own.
#include "lib/frame.glsl"
#include "lib/sparse.glsl"

#if USE_PIXEL_LIST
layout(std430) readonly buffer PixelList { uint pixel_list[]; };
layout(std430) readonly buffer PixelCount { uint groups_x, groups_y, groups_z, pixel_count; };
#endif

// False: nobody's, groups overhang the edge.
bool mirror_pixel(out ivec2 px) {
#if USE_PIXEL_LIST
    uint i = (tile().y * GROUPS_ACROSS + tile().x) * 64u + gl_LocalInvocationIndex;
    uint at = i < pixel_count ? pixel_list[i] : 0u;
    px = ivec2(at & 0xFFFFu, at >> 16u);
    return i < pixel_count;
#elif USE_REFLECT_GRID
    px = pixel_of(tile_pixel());
    return all(lessThan(px, frame.size_px));
#else
    px = tile_pixel();
    return all(lessThan(px, frame.size_px));
#endif
}
