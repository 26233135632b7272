// passes/probe.comp -- what probes say along the mirror direction, as an image: the composite pass asks them itself.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

layout(rgba32f) writeonly uniform image2D out_reflection;    // radiance, distance to the box (inf: sky, 0: not asked)
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    vec4 result = vec4(0.0);
    uint reason = REASON_NONE;
    if (covered(p)) {
        Surface s = load_surface(p);
        reason = REASON_ROUGH;
        if (sends_mirror_ray(s)) {
            bool bent;
            vec3 r = mirror_direction(s, -p.ray.dir, bent);
            result.rgb = probes_prefiltered(s.point.position, r, mirror_roughness(s), result.a);
            reason = result.a == INFINITY ? REASON_OUTSIDE_PROBE : (bent ? REASON_BELOW : REASON_NONE);
        }
    }
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
