// passes/difference.comp -- two displayed pictures' difference as colours: the largest over channels, times a gain.
#include "lib/math.glsl"
#include "lib/tile.glsl"

layout(rgba8) readonly uniform image2D ours, theirs;
layout(rgba8) writeonly uniform image2D out_difference;
uniform sampler2D palette;                                                 // 256 colours
uniform float gain;

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, imageSize(ours)))) return;                // groups overhang the edge
    float d = max3(abs(imageLoad(ours, px).rgb - imageLoad(theirs, px).rgb)) * 255.0;
    imageStore(out_difference, px, texelFetch(palette, ivec2(int(min(d * gain + 0.5, 255.0)), 0), 0));
}
