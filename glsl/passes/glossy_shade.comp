// passes/glossy_shade.comp -- `glossy` in parts, 3: the radiance that comes back along one ray of each pixel's lobe. Between
// the two goes passes/reflect_shadow.comp.
#include "lib/glossy_rays.glsl"
#include "lib/mirror.glsl"
#include "lib/tile.glsl"

#if USE_SHADOW_BITS
layout(r32ui) readonly restrict uniform uimage2D mirror_lit;
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    Shine a = shine_of(p);
    if (ray_first > 0 && ray_first >= a.count) return;
    Gathered g = NOTHING;
    bool bent = false;
    if (a.count > 0) {
        Drawn d = draw_ray(a, px, ray_first);
        bent = d.bent;
        Ray ray;
        Hit hit = load_mirror(px, p, ray);
        vec3 seen = vec3(0.0);
        if (hit.triangle != ID_NONE) {
            uint lit = 0u;
#if USE_SHADOW_BITS
            lit = imageLoad(mirror_lit, px).x;
#endif
            float spread = frame.orthographic == 1u ? 0.0 : frame.pixel_angle;
            seen = d.weight * shade_hit(hit, ray, footprint(p.hit.t) + spread * hit.t, lit);
        } else if (d.sent) seen = d.weight * environment_radiance(ray.dir);
        gather(g, a, px, ray_first, d, hit, seen, vec3(0.0));
    }
    store_rays(px, a, g, bent, ray_first, min(ray_first + 1, a.count));
}
