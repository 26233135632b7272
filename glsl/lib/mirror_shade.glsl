// lib/mirror_shade.glsl -- the radiance that comes back along the mirror ray of a pixel, from what it met.
#include "lib/mirror.glsl"
#include "lib/shade.glsl"

#if USE_SHADOW_BITS
layout(r32ui) readonly restrict uniform uimage2D mirror_lit;
#endif

// Radiance, distance (inf: sky, 0: no ray).
vec4 mirror_radiance(ivec2 px, Pixel p) {
    Ray ray;
    Hit hit = load_mirror(px, p, ray);
    vec4 result = vec4(0.0, 0.0, 0.0, hit.t);
    if (hit.triangle != ID_NONE) {
        uint lit = 0u;
#if USE_SHADOW_BITS
        lit = imageLoad(mirror_lit, px).x;
#endif
        float spread = frame.orthographic == 1u ? 0.0 : frame.pixel_angle;
        result.rgb = shade_hit(hit, ray, footprint(p.hit.t) + spread * hit.t, lit);
    }
    else if (hit.t > 0.0) result.rgb = environment_radiance(ray.dir);
    return result;
}
