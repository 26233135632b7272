// passes/gbuffer.comp -- the same ids by tracing: for devices that rasterise slowly (see glhybrid/plan.py).
#include "lib/bvh.glsl"
#include "lib/tile.glsl"

layout(rg32ui) writeonly uniform uimage2D out_id;

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Hit hit = closest_hit(primary_ray(px));
    imageStore(out_id, px, uvec4(hit.instance, hit.triangle, 0u, 0u));
}
