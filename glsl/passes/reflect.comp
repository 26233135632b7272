// passes/reflect.comp -- one mirror ray per pixel, its hit lit with one shadow ray a light (Kim, section 5). A surface
// of roughness 1 spends none.
#include "lib/mirror_guide.glsl"

layout(rgba32f) writeonly uniform image2D out_reflection;    // radiance, distance (inf: sky, 0: no ray)
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif

void main() {
    ivec2 px;
    if (!mirror_pixel(px)) return;
    Pixel p = load_pixel(px);
    vec4 result = vec4(0.0);
    uint reason = REASON_NONE;
    if (GUIDES) {
        begin_list(px);
        store_guide(px, uvec4(0u));
    }
    if (covered(p)) {
        Surface s = load_surface(p);
        vec3 v = -p.ray.dir;
        bool bent;
        vec3 r = mirror_direction(s, v, bent);
        bool smooth_enough = sends_mirror_ray(s);
        reason = smooth_enough ? (bent ? REASON_BELOW : REASON_NONE) : REASON_ROUGH;
        if (smooth_enough) {
            if (GUIDES) store_guide(px, guide_of(p, s, r));
            Hit hit;
            Ray ray = Ray(ray_origin(s.point, r), 0.0, r, INFINITY);
            result.rgb = trace_radiance(ray, footprint(p.hit.t), frame.orthographic == 1u ? 0.0 : frame.pixel_angle, hit);
            result.a = hit.t;
            if (hit.triangle == ID_NONE && !bent) reason = REASON_ENVIRONMENT;
        }
    }
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
