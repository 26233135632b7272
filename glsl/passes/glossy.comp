// passes/glossy.comp -- rays along GGX-distributed directions, each hit lit with its own shadow rays: the radiance that one
// specular lobe gathers, over the lobe's albedo.
//
// Directions follow the normals that the viewer sees (Heitz 2018), so a ray weighs F G1(l): with separable Smith nothing
// else is left. Those that end up under the surface count, as nothing. A mirror takes one ray. Where the sky has lamps, each
// ray has a second one beside it, to where the sky is bright, and both are weighed by the balance heuristic (Veach 1997).
#include "lib/glossy_rays.glsl"
#if USE_SKY_SAMPLES
#include "lib/environment_sample.glsl"
#endif
#include "lib/tile.glsl"

#if USE_SKY_SAMPLES
// A ray to where the sky is bright.
vec3 sky_light(Shine a, vec2 xi, vec2 within) {
    float density;
    vec3 l = environment_sample(xi, within, density);
    float NoL = dot(a.lobe.n, l);
    if (density <= 0.0 || NoL <= 0.0 || dot(a.s.point.n_geo, l) <= 0.0) return vec3(0.0);
    vec3 h = normalize(a.v + l);
    float of_lobe = ggx_pdf(a.lobe.n, a.v, h, a.lobe.alpha);
    // The lobe over the density is its weight times of_lobe / density, and the heuristic's share density / (density + of_lobe).
    vec3 light = lobe_weight(a, h, NoL) * environment_radiance(l) * mis(of_lobe, density);
    if (max3(light) <= 0.0) return vec3(0.0);
    return light * any_hit(Ray(ray_origin(a.s.point, l), 0.0, l, INFINITY));
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    Shine a = shine_of(p);
    int end = min(ray_end, a.count);
    if (ray_first > 0 && ray_first >= end) return;
    Gathered g = Gathered(vec3(0.0), 0.0, 0.0, 0);
    bool bent = false;
#if USE_SKY_SAMPLES
    uvec2 sky_start = sequence_start(px, SKY_SEQUENCE + uint(GLOSSY_COAT), frame.seed);
    uvec2 texel_start = sequence_start(px, SKY_SEQUENCE + 2u + uint(GLOSSY_COAT), frame.seed);
#endif
    for (int i = ray_first; i < end; i++) {
        Drawn d = draw_ray(a, px, i);
        bent = d.bent;
        float sky = 1.0, distance = INFINITY;
        vec3 seen = vec3(0.0), beside = vec3(0.0);
#if USE_SKY_SAMPLES
        if (!is_mirror(a.lobe)) {
            uint turn = frame.number * uint(a.count) + uint(i);
            beside = sky_light(a, sequence_point(sky_start, turn), sequence_point(texel_start, turn));
            sky = mis(ggx_pdf(a.lobe.n, a.v, d.h, a.lobe.alpha), environment_pdf(d.dir));
        }
#endif
        if (d.sent) {
            Hit hit;
            seen = d.weight * trace_radiance(Ray(ray_origin(a.s.point, d.dir), 0.0, d.dir, INFINITY), footprint(p.hit.t),
                                             frame.orthographic == 1u ? 0.0 : frame.pixel_angle, sky, hit);
            distance = hit.t;
        }
        gather(g, px, i, d, distance, seen, beside);
    }
    store_rays(px, a, g, bent, ray_first, end);
}
