// passes/display.comp -- linear radiance to what a screen shows.
#include "lib/tone.glsl"
#include "lib/tile.glsl"

layout(rgba32f) readonly uniform image2D radiance;

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    show(px, imageLoad(radiance, px).rgb);
}
