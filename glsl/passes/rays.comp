// passes/rays.comp -- what the camera sees, and what light reaches it: both rays of a pixel in one program. A third, the
// mirror ray, does not go with them: an H100 then needs twice the time for all.
// The point is found from the ids, by the code that other programs find it with: the same to the bit.
#include "lib/shadow_rays.glsl"
#include "lib/tile.glsl"

layout(rg32ui) writeonly uniform uimage2D out_id;

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Hit hit = closest_hit(primary_ray(px));
    uvec2 id = uvec2(hit.instance, hit.triangle);
    imageStore(out_id, px, uvec4(id, 0u, 0u));
    send_shadow_rays(px, pixel_of(px, id));
}
