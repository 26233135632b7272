// passes/reflect_shade.comp -- `reflect` in parts, 3: the radiance that comes back along the mirror rays.
#include "lib/mirror.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

layout(rgba32f) writeonly restrict uniform image2D out_reflection;    // radiance, distance (inf: sky, 0: no ray)
#if USE_SHADOW_BITS
layout(r32ui) readonly restrict uniform uimage2D mirror_lit;
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
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
    imageStore(out_reflection, px, result);
}
