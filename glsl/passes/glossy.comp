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
#if USE_EMITTERS
#include "lib/emitters.glsl"
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

#if USE_EMITTERS
const uint EMITTER_SEQUENCE = 0xE317u;

float balance(float pdf, float other) { return pdf / (pdf + other); }      // heuristic, as mis() of the sky

// A ray to a point that shines.
vec3 emitter_light(Shine a, float pick, vec2 xi) {
    float density;
    Surface there;
    vec3 l = emitter_sample(a.s.point.position, pick, xi, there, density);
    float NoL = dot(a.lobe.n, l);
    if (density <= 0.0 || NoL <= 0.0 || dot(a.s.point.n_geo, l) <= 0.0) return vec3(0.0);
    vec3 h = normalize(a.v + l);
    float of_lobe = ggx_pdf(a.lobe.n, a.v, h, a.lobe.alpha);
    vec3 light = lobe_weight(a, h, NoL) * there.emissive * there.alpha * balance(of_lobe, density);
    if (max3(light) <= 0.0) return vec3(0.0);
    vec3 from = ray_origin(a.s.point, l), target = ray_origin(there.point, -l);
    return light * any_hit(Ray(from, 0.0, target - from, 1.0));
}

// What of the light that a ray of the lobe met by chance the rays to emitters have brought already.
vec3 counted_twice(Ray ray, Hit hit, float of_lobe) {
    if (hit.triangle == ID_NONE) return vec3(0.0);
    Material m = material_row(hit_group_of(hit.instance, hit.geometry).material);
    if (m.unlit == 1u || max3(m.emissive) <= 0.0) return vec3(0.0);
    Surface there = surface_at(hit, ray, 0.0);
    return there.emissive * balance(emitter_pdf(hit, ray, there), of_lobe);
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    Shine a = shine_of(p);
    int end = min(ray_end, a.count);
    if (ray_first > 0 && ray_first >= end) return;
    Gathered g = NOTHING;
    bool bent = false;
#if USE_SKY_SAMPLES
    uvec2 sky_start = sequence_start(px, SKY_SEQUENCE + uint(GLOSSY_COAT), frame.seed);
    uvec2 texel_start = sequence_start(px, SKY_SEQUENCE + 2u + uint(GLOSSY_COAT), frame.seed);
#endif
    FOR_EACH(int, i, ray_first, end) {
        Drawn d = draw_ray(a, px, i);
        bent = d.bent;
        float sky = 1.0;
        Hit hit = MISS;
        vec3 seen = vec3(0.0), beside = vec3(0.0);
#if USE_SKY_SAMPLES
        if (!is_mirror(a.lobe)) {
            uint turn = frame.number * uint(a.count) + uint(i);
            beside = sky_light(a, sequence_point(sky_start, turn), sequence_point(texel_start, turn));
            sky = mis(ggx_pdf(a.lobe.n, a.v, d.h, a.lobe.alpha), environment_pdf(d.dir));
        }
#endif
#if USE_EMITTERS
        if (!is_mirror(a.lobe)) {
            uint turn = frame.number * uint(a.count) + uint(i);
            // Which one: the golden ratio, since the point on it is drawn by other steps at the same turns.
            uint pick = sequence_start(px, EMITTER_SEQUENCE + uint(GLOSSY_COAT), frame.seed).x + turn * 2654435769u;
            uvec2 point_start = sequence_start(px, EMITTER_SEQUENCE + 2u + uint(GLOSSY_COAT), frame.seed);
            beside += emitter_light(a, float(pick >> 8u) * (1.0 / 16777216.0), sequence_point(point_start, turn));
        }
#endif
        if (d.sent) {
            Ray ray = Ray(ray_origin(a.s.point, d.dir), 0.0, d.dir, INFINITY);
            seen = trace_radiance(ray, footprint(p.hit.t), frame.orthographic == 1u ? 0.0 : frame.pixel_angle, sky, hit);
#if USE_EMITTERS
            if (!is_mirror(a.lobe)) seen = max(seen - counted_twice(ray, hit, ggx_pdf(a.lobe.n, a.v, d.h, a.lobe.alpha)), vec3(0.0));
#endif
            seen *= d.weight;
        }
        gather(g, a, px, i, d, hit, seen, beside);
    } END_FOR(i, end)
    store_rays(px, a, g, bent, ray_first, end);
}
