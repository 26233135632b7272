// lib/reuse.glsl -- rays of neighbours, each weighted by how likely this pixel's lobe sends one to what it met, over how
// likely any of them does: a lobe is estimated from some fifty rays instead of one, and is not blurred by it.
//
// The ratio estimator of Stachowiak, "Stochastic Screen-Space Reflections" (SIGGRAPH 2015 courses), with two differences.
// Rays are compared where they cross the distance of the nearest things about, whose outlines are what a blur would show;
// beyond it everything is far. Rejected: comparing them where they end, which lets the sky shine around the foot of
// things. And the density is that of the neighbourhood, not of the one lobe that drew the ray (balance heuristic, Veach
// 1997): half the variance. It is GGX over slopes, averaged over the middle and six places around it.
#include "lib/brdf.glsl"

uniform usampler2DArray rays;              // of this frame, a layer each: direction; distance; radiance over albedo

const float REUSE_TAPS = 48.0;            // pixels looked at, about, if each has one ray
const float REUSE_SHARE = 1.6;             // deviation of these over the length over which the lobe's image changes
const float REUSE_PIXELS = 5.0;            // most: as many as there are taps for
const float REUSE_LEAST = 0.5;             // least, pixels
const float REUSE_CUT = 2.3;               // deviations, to the farthest
const float REUSE_RING = 1.6;              // deviations, to the six places: their second moments are those of what is cut
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

    float around[6], all = 6.0;            // how much of the neighbourhood is there, to six sides
    for (int j = 0; j < 6; j++) {
        around[j] = 0.0;
        ivec2 q = px + ivec2(round(screen * (HEXAGON[j] * size) * 2.0));
        if (steps != ivec2(0) && inside(q)) {
            uvec4 bits = texelFetch(guide, q, 0);
            if (is_surface(bits) && texelFetch(noise, q, 0).y > 0.0) around[j] = alike(g, unpack_guide(bits, vec2(q)));
        }
        all += around[j];
    }

    vec3 sum = vec3(0.0), own_sum = vec3(0.0);
    float weight = 0.0, weights2 = 0.0;
    for (int y = -steps.y; y <= steps.y; y++)
        for (int x = -steps.x; x <= steps.x; x++) {
            vec2 o = x == 0 && y == 0 ? vec2(0.0) : round(spacing * (vec2(x, y) + shift));
            vec2 at = transpose(screen) * o / size;
            ivec2 q = px + ivec2(o);
            if (dot(at, at) > square(REUSE_CUT) || !inside(q)) continue;
            uvec4 bits = texelFetch(guide, q, 0);
            if (!is_surface(bits)) continue;
            int count = int(texelFetch(noise, q, 0).y);
            Guide there = unpack_guide(bits, vec2(q));
            float near = exp(-0.5 * dot(at, at)) * alike(g, there);
            if (near < 0.01) continue;
            vec3 d = there.position - g.position;
            for (int i = 0; i < count; i++) {
                uvec4 ray = texelFetch(rays, ivec3(q, i), 0);
                float distance = max(min(uintBitsToFloat(ray.y), nearest), 1e-6 * nearest);
                vec3 dir = oct_decode(unpackUnorm2x16(ray.x));
                vec3 h = normalize(v + (distance < 1e15 ? normalize(d + dir * distance) : dir));
                vec2 slope = vec2(dot(h, axes.across), dot(h, axes.up)) / max(dot(h, g.n), 1e-3);
                // The same point, seen from a deviation away: so much the slope of the half vector changes.
                float turned = REUSE_RING * 0.5 * deviation * width * (1.0 / distance + (frame.orthographic == 1u ? 0.0 : 1.0 / g.depth));
                float likely = 1.0 / square(a2 + dot(slope, slope)), mixed = 6.0 * likely;
                for (int j = 0; j < 6; j++) {
                    vec2 other = slope - turned * HEXAGON[j];
                    mixed += around[j] / square(a2 + dot(other, other));
                }
                float w = near * likely * all / mixed;
                vec3 seen = vec3(unpackHalf2x16(ray.z), unpackHalf2x16(ray.w).x);
                sum += w * seen;
                if (q == px) own_sum += seen / float(count);
                weight += w;
                weights2 += w * w;
            }
        }
    return Reused(sum / weight, own_sum, square(weight) / weights2);
}
