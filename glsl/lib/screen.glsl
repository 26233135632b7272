// lib/screen.glsl -- what the G-buffer says about the space before it: a plane a pixel (passes/screen_plane.comp) and a
// pyramid of depths over them (passes/screen_depth.comp).
#include "lib/frame.glsl"

uniform sampler2D screen_plane;

// Levels lie below each other in one image; level k has cells of 2^k pixels. Rows are counted as if the height were a
// power of two.
ivec2 pyramid_texel(ivec2 cell, int level) {
    int padded = 2 << findMSB(max(frame.size_px.y - 1, 1));
    return cell + ivec2(0, padded - (padded >> (level - 1)));
}
