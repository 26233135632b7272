// passes/glossy.comp -- rays along GGX-distributed directions, each hit lit with its own shadow rays: the radiance that one
// specular lobe gathers, over the lobe's albedo.
//
// Directions follow the normals that the viewer sees (Heitz 2018), so a ray weighs F G1(l): with separable Smith nothing
// else is left. Those that end up under the surface count, as nothing. A mirror takes one ray. Where the sky has lamps, each
// ray has a second one beside it, to where the sky is bright, and both are weighed by the balance heuristic (Veach 1997).
#include "lib/gbuffer.glsl"
#include "lib/glossy.glsl"
#if USE_SKY_SAMPLES
#include "lib/environment_sample.glsl"
#endif
#include "lib/tile.glsl"

layout(rgba32f) uniform image2D out_reflection;    // radiance; distance, the harmonic mean (inf: sky, 0: no ray)
#if USE_DENOISE
layout(rg16f) uniform image2D out_noise;           // mean square of the luminance over the square of its mean; rays
#endif
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif
uniform int rays, ray_first, ray_end;              // a pixel at most; those of this dispatch

const uint GLOSSY_SEQUENCE = 0x6105u, SKY_SEQUENCE = 0x5C1Eu;

// The noise of a ray grows with the lobe, up to a roughness of a quarter, where a few of them are worth their time.
int rays_of(Lobe lobe) {
    if (is_mirror(lobe)) return 1;
    return max(int(ceil(float(rays) * min(square(lobe.roughness / 0.25), 1.0))), 1);
}

// What a direction that the lobe was or might have been sent along counts for, over the lobe's albedo.
vec3 lobe_weight(Lobe lobe, Surface s, vec3 v, vec3 h, float NoL, vec3 albedo) {
    vec3 weight = vec3(smith_g1(NoL, lobe.alpha));
    if (!GLOSSY_COAT) weight *= specular_fresnel(s.bsdf, dot(v, h)) / max(albedo, vec3(1e-30));
    return weight;
}

struct Gathered { vec3 sum; float squares, nearness; int rays, sky; };   // nearness: sum of 1 / distance

// sky: how much of the environment counts; returns what is seen, times the weight.
vec3 follow(vec3 dir, vec3 weight, float sky, Surface s, Pixel p, inout Gathered g) {
    Hit hit;
    vec3 seen = weight * trace_radiance(Ray(ray_origin(s.point, dir), 0.0, dir, INFINITY), footprint(p.hit.t),
                                        frame.orthographic == 1u ? 0.0 : frame.pixel_angle, sky, hit);
    g.nearness += 1.0 / max(hit.t, 1e-30);
    g.rays++;
    if (hit.triangle == ID_NONE) g.sky++;
    return seen;
}

#if USE_SKY_SAMPLES
// A ray to where the sky is bright.
vec3 sky_light(Lobe lobe, Surface s, vec3 v, vec3 albedo, vec2 xi, vec2 within) {
    float density;
    vec3 l = environment_sample(xi, within, density);
    float NoL = dot(lobe.n, l);
    if (density <= 0.0 || NoL <= 0.0 || dot(s.point.n_geo, l) <= 0.0) return vec3(0.0);
    vec3 h = normalize(v + l);
    float of_lobe = ggx_pdf(lobe.n, v, h, lobe.alpha);
    // The lobe over the density is its weight times of_lobe / density, and the heuristic's share density / (density + of_lobe).
    vec3 light = lobe_weight(lobe, s, v, h, NoL, albedo) * environment_radiance(l) * mis(of_lobe, density);
    if (max3(light) <= 0.0) return vec3(0.0);
    return light * any_hit(Ray(ray_origin(s.point, l), 0.0, l, INFINITY));
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    vec4 result = vec4(0.0);
    vec2 noise = vec2(0.0);
    uint reason = REASON_NONE;
    int first = ray_first, end = 0;
    if (covered(p)) {
        Surface s = load_surface(p);
        vec3 v = -p.ray.dir;
        Lobe lobe = GLOSSY_COAT ? coat_lobe(s.bsdf) : base_lobe(s.bsdf);
        vec3 albedo = GLOSSY_COAT ? vec3(s.bsdf.clearcoat) : specular_albedo(s.bsdf, v);
        bool shines = !s.unlit && dot(lobe.n, v) > 0.0 && max3(albedo) > 0.0;
        if (shines && !is_traced(lobe)) {
            reason = REASON_ROUGH;
            if (SPECULAR_SKY) result.rgb = environment_prefiltered(reflect(-v, lobe.n), lobe.roughness);
        } else if (shines) {
            int count = rays_of(lobe);
            end = min(ray_end, count);
            Gathered g = Gathered(vec3(0.0), 0.0, 0.0, 0, 0);
            uvec2 start = sequence_start(px, GLOSSY_SEQUENCE + uint(GLOSSY_COAT), frame.seed);
#if USE_SKY_SAMPLES
            uvec2 sky_start = sequence_start(px, SKY_SEQUENCE + uint(GLOSSY_COAT), frame.seed);
            uvec2 texel_start = sequence_start(px, SKY_SEQUENCE + 2u + uint(GLOSSY_COAT), frame.seed);
#endif
            for (int i = first; i < end; i++) {
                vec3 h = lobe.n, weight = vec3(1.0), seen = vec3(0.0);
                float sky = 1.0;
                uint turn = frame.number * uint(count) + uint(i);
                if (!is_mirror(lobe)) h = ggx_sample_vndf(lobe.n, v, lobe.alpha, sequence_point(start, turn));
                vec3 dir = reflect(-v, h);
                float below = dot(dir, s.point.n_geo);
                if (is_mirror(lobe)) {
                    // One direction for all: bent back rather than lost, as `ray-lerp` does.
                    if (below < 1e-4) { dir = normalize(dir + (1e-3 - below) * s.point.n_geo); reason = REASON_BELOW; }
                } else {
                    weight = lobe_weight(lobe, s, v, h, dot(lobe.n, dir), albedo);
#if USE_SKY_SAMPLES
                    seen = sky_light(lobe, s, v, albedo, sequence_point(sky_start, turn), sequence_point(texel_start, turn));
                    sky = mis(ggx_pdf(lobe.n, v, h, lobe.alpha), environment_pdf(dir));
#endif
                }
                if (is_mirror(lobe) || (dot(lobe.n, dir) > 0.0 && below > 0.0)) seen += follow(dir, weight, sky, s, p, g);
                g.sum += seen;
                g.squares += square(luminance(seen));
            }
            float n = float(end);
            result = vec4(g.sum, g.nearness);
            if (first > 0) {
                vec4 before = imageLoad(out_reflection, px);
                result += vec4(before.rgb * float(first), before.a > 0.0 ? float(first) / before.a : 0.0);
            }
            result.rgb /= max(n, 1.0);
            result.a = max(n, 1.0) / max(result.a, 1e-30);
            if (result.a > 1e29) result.a = INFINITY;
#if USE_DENOISE
            float mean = luminance(result.rgb);
            noise = vec2(g.squares, n);
            if (first > 0) noise.x += imageLoad(out_noise, px).x * square(luminance(imageLoad(out_reflection, px).rgb)) * float(first);
            noise.x = is_mirror(lobe) ? 0.0 : min(noise.x / max(n * square(mean), 1e-30), 6e4);
            if (is_mirror(lobe)) noise.y = 0.0;                            // nothing to filter
#endif
            if (g.rays == 0) reason = REASON_BELOW;
            else if (g.sky == g.rays && reason == REASON_NONE) reason = REASON_ENVIRONMENT;
        }
    }
    if (first > 0 && first >= end) return;
    imageStore(out_reflection, px, result);
#if USE_DENOISE
    imageStore(out_noise, px, vec4(noise, 0.0, 0.0));
#endif
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
