// passes/ray_ao.comp -- ambient occlusion by rays: the cosine-weighted share of the hemisphere from which no surface
// within a distance keeps the sky. Low-discrepancy over samples, pixels and frames.
#include "lib/gbuffer.glsl"
#include "lib/low_discrepancy.glsl"
#include "lib/tile.glsl"

#if USE_DENOISE_OCCLUSION
layout(rgba32f) uniform image2D out_occlusion;         // 1 = open, thrice; how far what occludes is, the harmonic mean; < 0: no ray
#else
layout(r32f) uniform image2D out_occlusion;            // 1 = open
#endif
uniform int rays, ray_first, ray_end;                  // a pixel; those of this dispatch
uniform float ao_radius;                               // m

const uint AO_SEQUENCE = 0xA0u;

// What of the lobe lies under the surface that the normal map leans over, or behind it, is not asked: it would be dark
// for want of a better model.
// Returns the open share and the distance.
vec2 open_share(Surface s, ivec2 px) {
    uvec2 start = sequence_start(px, AO_SEQUENCE, frame.seed);
    mat3 frame_n = basis(s.bsdf.n);
    float open = 0.0, asked = 0.0, nearness = 0.0, met = 0.0;
    FOR_EACH(int, i, ray_first, ray_end) {
        vec2 xi = sequence_point(start, frame.number * uint(rays) + uint(i));
        float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
        vec3 dir = frame_n * vec3(r * cos(phi), r * sin(phi), sqrt(max(0.0, 1.0 - xi.x)));
        if (dot(dir, s.point.n_geo) <= 0.0) continue;
        Hit hit;
        Ray ray = Ray(ray_origin(s.point, dir), 0.0, dir, ao_radius);
#if USE_DENOISE_OCCLUSION
        vec3 light = nearest_blocker(ray, hit);                               // a filter as wide as that of any would leave contacts
#else
        vec3 light = any_hit(ray, hit);
#endif
        open += (light.r + light.g + light.b) / 3.0;
        asked += 1.0;
        if (hit.t < ao_radius) {
            nearness += 1.0 / max(hit.t, 1e-30);
            met += 1.0;
        }
    } END_FOR(i, ray_end)
    return vec2(asked > 0.0 ? open / asked : 1.0, nearness > 0.0 ? met / nearness : ao_radius);
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    vec2 result = vec2(1.0, -1.0);
    if (covered(p)) {
        Surface s = load_surface(p);
        if (!s.unlit) result = open_share(s, px);
    }
    if (ray_first > 0) {
        vec4 before = imageLoad(out_occlusion, px);
        result.x = mix(before.r, result.x, float(ray_end - ray_first) / float(ray_end));
        if (DENOISE_OCCLUSION && before.a > 0.0) result.y = 2.0 / (1.0 / before.a + 1.0 / result.y);
    }
    imageStore(out_occlusion, px, result.xxxy);
}
