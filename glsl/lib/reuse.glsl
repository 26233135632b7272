// lib/reuse.glsl -- rays of neighbours, each weighted by how likely this pixel's lobe sends one to what it met, over how
// likely any of them does: a lobe is estimated from some fifty rays instead of one, and is not blurred by it.
//
// The ratio estimator of Stachowiak, "Stochastic Screen-Space Reflections" (SIGGRAPH 2015 courses), with two differences.
// Rays are compared where they cross the distance of the nearest things about, whose outlines are what a blur would show;
// beyond it everything is far. Rejected: comparing them where they end, which lets the sky shine around the foot of
// things. And the density is that of the neighbourhood, not of the one lobe that drew the ray (balance heuristic, Veach
// 1997): half the variance. It is GGX over slopes, of the middle and of a ring around it, whose mean is closed.
#include "lib/brdf.glsl"

uniform usampler2DArray rays;              // of this frame, a layer each: direction; distance; radiance over albedo; count

int ray_count(uvec4 first) { return int(unpackHalf2x16(first.w).y); }

const float REUSE_TAPS = 48.0;            // pixels looked at, about, if each has one ray
const float REUSE_SHARE = 1.6;             // deviation of these over the length over which the lobe's image changes
const float REUSE_PIXELS = 5.0;            // most: as many as there are taps for
const float REUSE_LEAST = 0.5;             // least, pixels
const float REUSE_CUT = 2.3;               // deviations, to the farthest
const float REUSE_RING = 1.6;              // deviations, to the ring: its second moments are those of what is cut
const float REUSE_FAR = 1.2;               // of the distance of the nearest things: theirs differ
const float REUSE_ENOUGH = 64.0;           // rays
const vec2 HEXAGON[6] = vec2[](vec2(1.0, 0.0), vec2(0.5, 0.8660254), vec2(-0.5, 0.8660254), vec2(-1.0, 0.0),
                               vec2(-0.5, -0.8660254), vec2(0.5, -0.8660254));

struct Reused { vec3 mean, own; float worth; };    // own: of this pixel's rays alone; worth: of these, that would be as good

// extent, m: length over which the lobe's image changes; nearest, m: distance of what is nearest along it; before: rays
// in history.
Reused reuse_rays(ivec2 px, Guide g, vec3 v, float extent, float nearest, float before) {
    float width = pixel_width(g.depth), a2 = square(max(square(g.roughness), 4e-4));
    LobeAxes axes = lobe_axes(g.n, v);
    // On the screen; seen at a slant a lobe is narrower across than along.
    mat2 screen = mat2(dot(axes.across, normalize(frame.right_ws)), dot(axes.across, normalize(frame.up_ws)),
                       dot(axes.along, normalize(frame.right_ws)), dot(axes.along, normalize(frame.up_ws)));
    // Where history knows enough, fewer of them are asked, from nearer.
    float asked = min(REUSE_ENOUGH / max(before, 1e-3), 1.0);
    float deviation = min(REUSE_SHARE * extent / width, REUSE_PIXELS) * sqrt(asked);
    vec2 size = max(vec2(axes.NoV, 1.0) * deviation, REUSE_LEAST);
    vec2 reach = REUSE_CUT * sqrt(square2(screen[0] * size.x) + square2(screen[1] * size.y));
    float spacing = max(1.0, sqrt(4.0 * reach.x * reach.y / (REUSE_TAPS * inversesqrt(samples) * asked)));
    vec2 shift = spacing > 1.0 ? fract(vec2(0.7548777, 0.5698403) * (float(px.x) + 17.0 * float(px.y))) - 0.5 : vec2(0.0);
    ivec2 steps = ivec2(reach / spacing);

    // How much of the neighbourhood is there: over the ring, and on which side more.
    float there_is = 0.0;
    vec2 side = vec2(0.0);
    if (steps != ivec2(0))
        for (int j = 0; j < 6; j++) {
            ivec2 q = px + ivec2(round(screen * (HEXAGON[j] * size) * 2.0));
            if (!inside(q)) continue;
            uvec4 bits = texelFetch(guide, q, 0);
            if (!is_surface(bits) || ray_count(texelFetch(rays, ivec3(q, 0), 0)) == 0) continue;
            float w = alike(g, unpack_guide(bits, vec2(q)));
            there_is += w / 6.0;
            side += w / 3.0 * HEXAGON[j];
        }
    side *= min(there_is / max(length(side), 1e-9), 1.0);

    // Slopes of half vectors, of v and a direction, are ratios: neither needs to be of length one.
    float v_up = dot(v, axes.up), v_n = dot(v, g.n), turn = REUSE_RING * 0.5 * deviation * width;
    float inverse_depth = frame.orthographic == 1u ? 0.0 : 1.0 / g.depth, far = REUSE_FAR * nearest;
    vec3 sum = vec3(0.0), own_sum = vec3(0.0);
    float weight = 0.0, weights2 = 0.0;
    // One loop over rows: lanes of a group differ in how many and how long these are, hardly in how many taps.
    ivec2 tap = -steps;
    for (int left = (2 * steps.x + 1) * (2 * steps.y + 1); left > 0; left--) {
        vec2 o = tap == ivec2(0) ? vec2(0.0) : round(spacing * (vec2(tap) + shift));
        tap = tap.x < steps.x ? tap + ivec2(1, 0) : ivec2(-steps.x, tap.y + 1);
        vec2 at = o * screen / size;
        ivec2 q = px + ivec2(o);
        if (dot(at, at) > square(REUSE_CUT) || !inside(q)) continue;
        uvec4 bits = texelFetch(guide, q, 0), ray = texelFetch(rays, ivec3(q, 0), 0);
        int count = ray_count(ray);
        if (!is_surface(bits) || count == 0) continue;
        Guide there = unpack_guide(bits, vec2(q));
        float near = exp(-0.5 * dot(at, at) - unlike(g, there));
        if (near < 0.01) continue;
        vec3 d = there.position - g.position;
        for (int i = 0; i < count; i++) {
            if (i > 0) ray = texelFetch(rays, ivec3(q, i), 0);
            float distance = max(min(uintBitsToFloat(ray.y), far), 1e-6 * nearest);
            vec3 dir = normalize(d + oct_decode(unpackUnorm2x16(ray.x)) * distance);
            vec2 slope = vec2(dot(dir, axes.across), dot(dir, axes.up) + v_up) / max(dot(dir, g.n) + v_n, 1e-3);
            // The same point, seen from a deviation away: so much the slope of the half vector changes.
            float turned = min(turn * (1.0 / distance + inverse_depth), 1e4), s2 = dot(slope, slope);
            // Of GGX, 1 / (a^2 + |slope - turned|^2)^2, the mean over all sides, closed.
            float about = a2 + s2 + square(turned);
            float inverse = inversesqrt(max(square(about) - 4.0 * s2 * square(turned), square(a2)));
            float ring = (there_is * about + 2.0 * turned * dot(side, slope)) * inverse * square(inverse * (a2 + s2));
            float w = near * (1.0 + there_is) / (1.0 + ring);
            vec3 seen = vec3(unpackHalf2x16(ray.z), unpackHalf2x16(ray.w).x);
            sum += w * seen;
#if USE_SKY_SAMPLES || USE_EMITTERS
            if (q == px) own_sum += seen / float(count);
#endif
            weight += w;
            weights2 += w * w;
        }
    }
    return Reused(sum / weight, own_sum, square(weight) / weights2);
}
