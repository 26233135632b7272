// passes/shadow_soft.comp -- any-hit rays to the disc that each light shows, where a surface faces it; one to a light
// without a size, as passes/shadow.comp.
// The share that arrives is a ratio of sums weighted by N.L over the disc: where nothing blocks it is 1 without noise
// (Heitz et al., "Combining Analytic Direct Illumination and Stochastic Shadows", I3D 2018).
#include "lib/shade.glsl"
#include "lib/motion.glsl"
#include "lib/terminator.glsl"
#include "lib/tile.glsl"

layout(rgba32f) uniform image2DArray out_visibility;    // tint, half width of the penumbra
#define DRIFTS (USE_MOVING && USE_DENOISE_SHADOWS)
#if DRIFTS
layout(r16f) uniform image2DArray out_drift;            // how far the shadow slides in a frame, over the length it changes over
#endif
uniform int rays, ray_first, ray_end;                   // a light; those of this dispatch

const uint SHADOW_SEQUENCE = 0x5AD0u;

// moved: how far the surface's point has come since the frame before, m; drift: of the shadow of one that blocks.
vec4 disc_rays_from(vec3 from, Surface s, LightSample l, uint light, ivec2 px, uint first, uint end, vec3 moved, out float drift) {
    drift = 0.0;
    uvec2 start = sequence_start(px, SHADOW_SEQUENCE + light, frame.seed);
    float size = light_row(light).kind == LIGHT_DIRECTIONAL ? light_row(light).size : light_row(light).size / l.distance;
    vec3 sum = vec3(0.0), at = from;
    Hit blocker = MISS;
    float weights = 0.0, width = 0.0, blocked = 0.0;
    FOR_SOME(uint, i, first, end) {
        float cos_axis;
        Hit hit = MISS;
        LightSample to = toward_disc(l, light_row(light), sequence_point(start, frame.number * uint(rays) + i), cos_axis);
        // Lobes of base and coat share one visibility; where the light is behind one normal the other weighs.
        float NoL = max(dot(s.bsdf.n, to.dir), CLEARCOAT ? dot(s.bsdf.n_coat, to.dir) : 0.0) / cos_axis;
        if (NoL <= 0.0) continue;
        weights += NoL;
        if (TERMINATOR || dot(s.point.n_geo, to.dir) > 0.0)
            sum += NoL * any_hit(Ray(from, 0.0, to.dir, to.distance), hit);
        if (hit.t < INFINITY) {
            width += hit.t * size;
            blocked += 1.0;
#if DRIFTS
            blocker = hit;
            at = from + hit.t * to.dir;
#endif
        }
    } END_FOR(i, end)
#if DRIFTS
    // One of those that block is as likely as the others to move, and pixels about look at other ones.
    if (blocker.triangle != ID_NONE) {
        vec3 slid = came(blocker, at) - moved;
        drift = drift_of(slid - dot(slid, l.dir) * l.dir, 0.5 * blocker.t * size);
    }
#endif
    return vec4(weights > 0.0 ? sum / weights : vec3(0.0), blocked > 0.0 ? min(width / blocked, 1e15) : 0.0);
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    Surface s;
    vec3 from, moved = vec3(0.0);
    if (covered(p)) {
        s = load_surface(p);
        from = shadow_origin(p, s);
#if DRIFTS
        moved = came(p.hit, s.point.position);
#endif
    }
    FOR_SOME(uint, i, LIGHT_FIRST, LIGHT_END) {
        bool disc = light_row(i).size > 0.0;
        uint first = uint(ray_first), end = disc ? uint(ray_end) : 1u;
        if (first >= end) continue;
        vec4 result = vec4(0.0, 0.0, 0.0, -1.0);                           // -1: no ray, nothing to filter
        float drift = 0.0;
        if (covered(p)) {
            LightSample l = light_at(light_row(i), s.point.position);
            if (arrives(l) && faces(s, l.dir)) {
                if (disc) result = disc_rays_from(from, s, l, i, px, first, end, moved, drift);
                else result = vec4(any_hit(Ray(from, 0.0, l.dir, l.distance)), 0.0);
            }
        }
        if (first > 0u) {
            vec4 before = imageLoad(out_visibility, ivec3(px, i));
            result.rgb = mix(before.rgb, result.rgb, float(end - first) / float(end));
            if (min(before.a, result.a) > 0.0) result.a = 0.5 * (before.a + result.a);
            else result.a = max(before.a, result.a);
        }
        imageStore(out_visibility, ivec3(px, i), result);
#if DRIFTS
        if (first > 0u) drift = max(drift, imageLoad(out_drift, ivec3(px, i)).x);
        imageStore(out_drift, ivec3(px, i), vec4(drift));
#endif
    } END_FOR(i, LIGHT_END)
}
