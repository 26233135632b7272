// passes/screen_depth.comp -- one level of the pyramid: the nearest screen depth of 2 x 2 cells of the level below, and
// the farthest. The lowest level looks at planes over whole pixels, so that no cell is nearer than it says.
#include "lib/screen.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
uniform int level;                                     // the one to make, from 1
uniform ivec2 level_size;
#if USE_MIRROR_RAYS
layout(r32f) uniform image2D pyramid;
#else
layout(rg32f) uniform image2D pyramid;
#endif

vec2 below(ivec2 cell) {
    if (level > 1) return imageLoad(pyramid, pyramid_texel(cell, level - 1)).xy;
    vec4 plane = texelFetch(screen_plane, cell, 0);
    float half_change = 0.5 * (abs(plane.y) + abs(plane.z));
    return vec2(plane.x + half_change, plane.x - half_change);
}

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(cell, level_size))) return;
    ivec2 last = ((frame.size_px - 1) >> (level - 1));                     // of the level below
    vec2 result = below(2 * cell);
    for (int i = 1; i < 4; i++) {
        vec2 other = below(min(2 * cell + ivec2(i & 1, i >> 1), last));
        result = vec2(max(result.x, other.x), min(result.y, other.y));
    }
    imageStore(pyramid, pyramid_texel(cell, level), vec4(result, 0.0, 0.0));
}
