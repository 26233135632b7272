// passes/ray_ao.comp -- ambient occlusion by rays: the cosine-weighted share of the hemisphere from which no surface
// within a distance keeps the sky. Low-discrepancy over samples, pixels and frames.
#include "lib/gbuffer.glsl"
#include "lib/low_discrepancy.glsl"
#include "lib/tile.glsl"

layout(r32f) uniform image2D out_occlusion;            // 1 = open
uniform int rays, ray_first, ray_end;                  // a pixel; those of this dispatch
uniform float ao_radius;                               // m

const uint AO_SEQUENCE = 0xA0u;

// What of the lobe lies under the surface that the normal map leans over, or behind it, is not asked: it would be dark
// for want of a better model.
float open_share(Surface s, ivec2 px) {
    uvec2 start = sequence_start(px, AO_SEQUENCE, frame.seed);
    mat3 frame_n = basis(s.bsdf.n);
    float open = 0.0, asked = 0.0;
    for (int i = ray_first; i < ray_end; i++) {
        vec2 xi = sequence_point(start, frame.number * uint(rays) + uint(i));
        float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
        vec3 dir = frame_n * vec3(r * cos(phi), r * sin(phi), sqrt(max(0.0, 1.0 - xi.x)));
        if (dot(dir, s.point.n_geo) <= 0.0) continue;
        vec3 light = any_hit(Ray(ray_origin(s.point, dir), 0.0, dir, ao_radius));
        open += (light.r + light.g + light.b) / 3.0;
        asked += 1.0;
    }
    return asked > 0.0 ? open / asked : 1.0;
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    float result = 1.0;
    if (covered(p)) {
        Surface s = load_surface(p);
        if (!s.unlit) result = open_share(s, px);
    }
    if (ray_first > 0) result = mix(imageLoad(out_occlusion, px).r, result, float(ray_end - ray_first) / float(ray_end));
    imageStore(out_occlusion, px, vec4(result));
}
