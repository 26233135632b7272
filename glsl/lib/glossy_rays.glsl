// lib/glossy_rays.glsl -- what the programs of `ray-glossy` share: which rays a pixel sends, and how what they bring adds up.
#include "lib/gbuffer.glsl"
#include "lib/motion.glsl"
#include "lib/glossy.glsl"

layout(rgba32f) uniform image2D out_reflection;    // radiance; distance, the harmonic mean (inf: sky, 0: no ray)
#if USE_DENOISE
layout(rg16f) uniform image2D out_noise;           // mean square of the luminance over the square of its mean; rays
#endif
#define DRIFTS (USE_MOVING && USE_DENOISE)
#if DRIFTS
layout(r16f) uniform image2D out_drift;            // how far what is seen slides in a frame, over the length it changes over
#endif
#if USE_REUSE
layout(rgba32ui) writeonly uniform uimage2DArray out_rays;    // direction; distance; radiance; how many
#endif
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif
uniform int rays, ray_first, ray_end;              // a pixel at most; those of this dispatch

const uint GLOSSY_SEQUENCE = 0x6105u, SKY_SEQUENCE = 0x5C1Eu;

// A pixel's lobe. count: rays that it sends; reason: why there are none.
// came, turned: how far its point has come since the frame before, m, and its normal.
struct Shine { Surface s; Lobe lobe; vec3 v, albedo, came; float turned; int count; uint reason; };

// The noise of a ray grows with the lobe, up to a roughness of a quarter, where a few of them are worth their time.
int rays_of(Lobe lobe) {
    if (is_mirror(lobe)) return 1;
    return max(int(ceil(float(rays) * min(square(lobe.roughness / 0.25), 1.0))), 1);
}

Shine shine_of(Pixel p) {
    Shine a;
    a.count = 0;
    a.reason = REASON_NONE;
    if (!covered(p)) return a;
    a.s = load_surface(p);
    a.v = -p.ray.dir;
    a.lobe = GLOSSY_COAT ? coat_lobe(a.s.bsdf) : base_lobe(a.s.bsdf);
    a.albedo = GLOSSY_COAT ? vec3(a.s.bsdf.clearcoat) : specular_albedo(a.s.bsdf, a.v);
    if (a.s.unlit || max3(a.albedo) <= 0.0) return a;
#if DRIFTS
    a.came = came(p.hit, a.s.point.position);
    a.turned = turned(p.hit, a.lobe.n);
#endif
    if (is_traced(a.lobe)) a.count = rays_of(a.lobe);
    else a.reason = REASON_ROUGH;
    return a;
}

// What a direction that the lobe was or might have been sent along counts for, over the lobe's albedo.
vec3 lobe_weight(Shine a, vec3 h, float NoL) {
    vec3 weight = vec3(smith_g1(NoL, a.lobe.alpha));
    if (!GLOSSY_COAT) weight *= specular_fresnel(a.s.bsdf, dot(a.v, h)) / max(a.albedo, vec3(1e-30));
    return weight;
}

// One of the rays. sent: it leaves the surface on its outside.
struct Drawn { vec3 dir, h, weight; bool sent, bent; };

Drawn draw_ray(Shine a, ivec2 px, int i) {
    Drawn d;
    d.h = a.lobe.n;
    d.weight = vec3(1.0);
    d.sent = true;
    d.bent = false;
    if (!is_mirror(a.lobe)) {
        uint use = GLOSSY_SEQUENCE + uint(GLOSSY_COAT);
        uvec2 start = bool(USE_REUSE) ? lattice_start(px, use, frame.seed) : sequence_start(px, use, frame.seed);
        d.h = ggx_sample_vndf(a.lobe.n, a.v, a.lobe.alpha, sequence_point(start, frame.number * uint(a.count) + uint(i)));
    }
    d.dir = reflect(-a.v, d.h);
    float below = dot(d.dir, a.s.point.n_geo);
    if (!is_mirror(a.lobe)) {
        d.weight = lobe_weight(a, d.h, dot(a.lobe.n, d.dir));
        d.sent = dot(a.lobe.n, d.dir) > 0.0 && below > 0.0;
    } else if (below < 1e-4) {
        // One direction for all: bent back rather than lost, as `ray-lerp` does.
        d.dir = normalize(d.dir + (1e-3 - below) * a.s.point.n_geo);
        d.bent = true;
    }
    return d;
}

// nearness: sum of 1 / distance; drifts: of squares.
struct Gathered { vec3 sum; float squares, nearness, drifts; int rays; };
const Gathered NOTHING = Gathered(vec3(0.0), 0.0, 0.0, 0.0, 0);

// Adds what ray i sees, times its weight; beside: what came by other ways at its turn.
void gather(inout Gathered g, Shine a, ivec2 px, int i, Drawn d, Hit hit, vec3 seen, vec3 beside) {
    if (!is_finite(seen)) seen = vec3(0.0);                                // min() of it would be the brightest of all
    if (!is_finite(beside)) beside = vec3(0.0);
    if (d.sent) {
        g.nearness += 1.0 / max(hit.t, 1e-30);
        g.rays++;
#if DRIFTS
        float tangent = lobe_tangent(a.lobe.roughness), drift = 2.0 * a.turned / tangent;
        if (hit.triangle != ID_NONE) {
            vec3 slid = came(hit, a.s.point.position + hit.t * d.dir) - a.came;
            drift += drift_of(slid - dot(slid, d.dir) * d.dir, tangent * hit.t);
        }
        g.drifts += square(min(drift, 100.0));
#endif
    }
    g.sum += seen + beside;
    g.squares += square(luminance(seen + beside));
#if USE_REUSE
    imageStore(out_rays, ivec3(px, i), uvec4(packUnorm2x16(oct_encode(d.dir)), floatBitsToUint(d.sent ? hit.t : INFINITY),
                                             packHalf2x16(min(seen.xy, vec2(6e4))), packHalf2x16(vec2(min(seen.z, 6e4), is_mirror(a.lobe) ? 0.0 : float(a.count)))));
#endif
}

// Rays first to end of a pixel, into its means.
void store_rays(ivec2 px, Shine a, Gathered g, bool bent, int first, int end) {
    vec4 result = vec4(0.0);
    vec2 noise = vec2(0.0);
    uint reason = a.reason;
#if USE_REUSE
    if (a.count == 0 && first == 0) imageStore(out_rays, ivec3(px, 0), uvec4(0u));
#endif
    if (reason == REASON_ROUGH && SPECULAR_SKY) result.rgb = environment_prefiltered(reflect(-a.v, a.lobe.n), a.lobe.roughness);
    if (a.count > 0) {
        float n = float(end);
        result = vec4(g.sum, g.nearness);
        vec4 before = vec4(0.0);
        if (first > 0) {
            before = imageLoad(out_reflection, px);
            result += vec4(before.rgb * float(first), before.a > 0.0 ? float(first) / before.a : 0.0);
        }
        result.rgb /= n;
        result.a = n / max(result.a, 1e-30);
        if (result.a > 1e29) result.a = INFINITY;
#if USE_DENOISE
        noise = vec2(g.squares, n);
        if (first > 0) noise.x += imageLoad(out_noise, px).x * square(luminance(before.rgb)) * float(first);
        noise.x = min(noise.x / max(n * square(luminance(result.rgb)), 1e-30), 6e4);
        if (is_mirror(a.lobe)) noise = vec2(0.0);                          // nothing to filter
#endif
        if ((g.rays == 0 && first == 0) || bent) reason = REASON_BELOW;
        else if (isinf(result.a)) reason = REASON_ENVIRONMENT;
    }
    imageStore(out_reflection, px, result);
#if DRIFTS
    float drift = a.count > 0 ? g.drifts : 0.0;
    if (first > 0) drift += square(imageLoad(out_drift, px).x) * float(first);
    imageStore(out_drift, px, vec4(sqrt(drift / float(max(end, 1)))));
#endif
#if USE_DENOISE
    imageStore(out_noise, px, vec4(noise, 0.0, 0.0));
#endif
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
