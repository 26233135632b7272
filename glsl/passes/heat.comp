// passes/heat.comp -- values of 0 to 1 as colours.
#include "lib/tile.glsl"

layout(r32f) readonly uniform image2D values;
layout(rgba8) writeonly uniform image2D out_heat;
uniform sampler2D palette;                                                 // 256 colours

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, imageSize(values)))) return;              // groups overhang the edge
    int row = int(clamp(imageLoad(values, px).r * 255.0 + 0.5, 0.0, 255.0));
    imageStore(out_heat, px, texelFetch(palette, ivec2(row, 0), 0));
}
