// passes/glossy_ray.comp -- `glossy` in parts, 1: one ray of each pixel's lobe, and what it meets.
#include "lib/glossy_rays.glsl"
#include "lib/mirror.glsl"
#include "lib/tile.glsl"

#if USE_MIRROR_SHADOWS
layout(r32ui) writeonly restrict uniform uimage2D mirror_lit;    // a bit a light
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Shine a = shine_of(load_pixel(px));
    Hit hit = MISS;
    hit.t = 0.0;
    Ray ray = Ray(vec3(0.0), 0.0, vec3(0.0), INFINITY);
    if (ray_first < a.count) {
        Drawn d = draw_ray(a, px, ray_first);
        if (d.sent) {
            ray.dir = d.dir;
            ray.origin = ray_origin(a.s.point, d.dir);
            hit = measured(closest_hit(ray), ray);
        }
    }
    store_mirror(px, ray.dir, hit);
#if USE_MIRROR_SHADOWS
    if (hit.triangle != ID_NONE) imageStore(mirror_lit, px, uvec4(lit_bits(hit, ray)));
#endif
}
