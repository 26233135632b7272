// passes/ssao_filter.comp -- the mean over the 5 x 5 pixels whose points lie in the plane of this one: neighbours drew
// different slices, and a surface has no edges in its own plane.
#include "lib/screen.glsl"
#include "lib/tile.glsl"

uniform sampler2D occlusion_raw;
layout(r32f) writeonly uniform image2D out_occlusion;

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    vec4 own = texelFetch(screen_plane, px, 0);
    float sum = texelFetch(occlusion_raw, px, 0).r, weights = 1.0;
    float unit = frame.orthographic == 1u ? frame.pixel_angle : frame.pixel_angle * own.x;    // a pixel's side, in depth
    for (int i = 0; i < 25 && own.w > 0.0; i++) {
        ivec2 offset = ivec2(i % 5, i / 5) - 2, q = px + offset;
        if (offset == ivec2(0) || any(lessThan(q, ivec2(0))) || any(greaterThanEqual(q, frame.size_px))) continue;
        vec4 other = texelFetch(screen_plane, q, 0);
        if (other.w == 0.0) continue;
        // Each lies in the other's plane: half a pixel off is no more the same surface.
        float off = max(abs(own.x + dot(own.yz, vec2(offset)) - other.x), abs(other.x - dot(other.yz, vec2(offset)) - own.x));
        float w = clamp(1.0 - 2.0 * off / unit, 0.0, 1.0);
        sum += w * texelFetch(occlusion_raw, q, 0).r;
        weights += w;
    }
    imageStore(out_occlusion, px, vec4(sum / weights));
}
