// passes/reflect_ray.comp -- `reflect` in parts, 1: the mirror ray of each pixel, and what it meets.
#include "lib/mirror.glsl"
#include "lib/mirror_pixel.glsl"
#include "lib/shade.glsl"

#if USE_MIRROR_SHADOWS
layout(r32ui) writeonly restrict uniform uimage2D mirror_lit;    // a bit a light
#endif
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif

void main() {
    ivec2 px;
    if (!mirror_pixel(px)) return;
    Pixel p = load_pixel(px);
    Hit hit = MISS;
    hit.t = 0.0;
    Ray ray = Ray(vec3(0.0), 0.0, vec3(0.0), INFINITY);
    uint reason = REASON_NONE;
    if (covered(p)) {
        Surface s = load_surface(p);
        bool bent;
        ray.dir = mirror_direction(s, -p.ray.dir, bent);
        bool smooth_enough = sends_mirror_ray(s);
        reason = smooth_enough ? (bent ? REASON_BELOW : REASON_NONE) : REASON_ROUGH;
        if (smooth_enough) {
            ray.origin = ray_origin(s.point, ray.dir);
            hit = measured(closest_hit(ray), ray);
            if (hit.triangle == ID_NONE && !bent) reason = REASON_ENVIRONMENT;
        }
    }
    // Nobody looks where nothing is seen. To know that after the traversal takes a register, which two levels do not have.
    if (TWO_LEVEL || covered(p)) store_mirror(px, ray.dir, hit);
#if USE_MIRROR_SHADOWS
    if (hit.triangle != ID_NONE) imageStore(mirror_lit, px, uvec4(lit_bits(hit, ray)));
#endif
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
