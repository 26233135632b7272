// passes/shadow.comp -- one any-hit ray per pixel and light.
#include "lib/shadow_rays.glsl"
#include "lib/tile.glsl"

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    send_shadow_rays(px, load_pixel(px));
}
