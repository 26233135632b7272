// passes/denoise_atrous.comp -- one step of an edge-avoiding wavelet filter (Dammertz et al., HPG 2010). Pixels count by how
// far their levels (passes/denoise_level.comp) are apart, in standard deviations (Schied et al. 2017): what is known well is
// left alone. Its reach in space is a share of the length over which the truth changes, so that contacts stay sharp.
//
// Of a penumbra that length is known, from how far away what blocks is, across the way to the light: the filter reaches no
// farther, and where a penumbra is narrower than pixels it reaches none of them (Liu et al., "Cinematic Rendering in UE4",
// Ray Tracing Gems (2019), ch. 19).
#include "lib/denoise.glsl"
#include "lib/tile.glsl"
#if USE_DENOISE_SIGNAL == 3
#include "lib/light.glsl"
#endif

uniform sampler2D filtered;              // mean; a: variance of its luminance, < 0: not to be touched
uniform SIGNAL_SAMPLER level;            // luminance about each pixel, its variance
uniform SIGNAL_SAMPLER history;          // a: length over which the truth changes, m
#if USE_DENOISE_SIGNAL == 3
uniform SIGNAL_SAMPLER counts;           // samples in it
#endif
uniform int stride;
#if USE_DENOISE_LAST
layout(SIGNAL_FORMAT) uniform SIGNAL_IMAGE out_signal;
#else
layout(rgba32f) writeonly uniform image2D out_filtered;
#endif

#if USE_REUSE
const int REACH = 1;                     // most of it is done, and what is left is less than it seems
const float LEVEL_DEVIATIONS = 4.0;
const float KERNEL[2] = float[](0.5, 0.25);
#else
const int REACH = 2;
const float LEVEL_DEVIATIONS = USE_DENOISE_SIGNAL == SIGNAL_VISIBILITY ? 4.0 : 2.0;
const float KERNEL[3] = float[](0.375, 0.25, 0.0625);    // cubic B-spline
#endif

const float PENUMBRA_SHARE = 2.45;       // of its deviation, for one ray
const float LEAST_NOL = 0.2;
const float LENGTH_SHARE = IS_VISIBILITY ? 1.0 : 2.0;
const float LEAST_PIXELS = 2.0;
const float LEAST_SHARE = 0.125;         // of what a lobe covers of a surface far behind
const float LEAST_WEIGHT = 0.1;          // of one in a penumbra, taken from all: much of little would light what is dark
const float DEVIATIONS = 6.0;            // of one pixel's own mean: only what no chance explains

#if USE_DENOISE_SIGNAL == 3
const float TAIL = 0.02;

// A blur reaches beyond the ends of a penumbra, and a hundredth of a light is seen where there is no other. What none of a
// pixel's own rays has met, of light or of shadow, counts as none up to TAIL, and whole from twice that on.
vec3 without_tails(vec3 share, vec3 own, float rays) {
    vec3 less = min(share, max(2.0 * (share - TAIL), vec3(0.0))), dark = 1.0 - share;
    vec3 more = 1.0 - min(dark, max(2.0 * (dark - TAIL), vec3(0.0)));
    share = mix(share, less, lessThan(own * rays, vec3(0.5)));
    return mix(share, more, lessThan((1.0 - own) * rays, vec3(0.5)));
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    vec4 center = texelFetch(filtered, px, 0);
    vec4 result = center;
    if (center.a > 0.0) {
        Guide g = unpack_guide(texelFetch(guide, px, 0), vec2(px));
        float width = pixel_width(g.depth);
#if USE_DENOISE_SIGNAL == 3
        vec3 l = light_at(lights[layer], g.position).dir;
        // A blur by s is off by s^2, and leaves noise by 1 / s; that of a ray is by n^-3/4 of n: s goes by n^-1/4.
        float len = PENUMBRA_SHARE * texelFetch(history, AT(px), 0).a * inversesqrt(sqrt(texelFetch(counts, AT(px), 0).x));
        float farthest = len / max(dot(g.n, l), LEAST_NOL);
#else
        // A lobe as narrow as a pixel has no noise to speak of: what differs between pixels is what it shows.
        float least = LEAST_PIXELS * width;
        if (!IS_VISIBILITY && frame.orthographic == 0u) least = min(least, LEAST_SHARE * lobe_tangent(g.roughness) * g.depth);
        float len = max(LENGTH_SHARE * texelFetch(history, AT(px), 0).a, least), farthest = len;
        LobeAxes axes = lobe_axes(g.n, toward_eye(g));
        float len_across = max(len * axes.NoV, least);
#endif
        float m = luminance(center.rgb);
        vec2 about = texelFetch(level, AT(px), 0).xy;
        float tiny = square(1e-5 * about.x) + 1e-30;
        if (farthest > 0.3 * float(stride) * width) {
            float weight = square(KERNEL[0]);
            result = center * vec4(vec3(weight), square(weight));
            for (int y = -REACH; y <= REACH; y++)
                for (int x = -REACH; x <= REACH; x++) {
                    ivec2 q = px + stride * ivec2(x, y);
                    if ((x == 0 && y == 0) || !inside(q)) continue;
                    vec4 c = texelFetch(filtered, q, 0);
                    if (c.a < 0.0) continue;
                    Guide there = unpack_guide(texelFetch(guide, q, 0), vec2(q));
                    vec3 d = there.position - g.position;
                    vec2 other = texelFetch(level, AT(q), 0).xy;
                    float apart = square(other.x - about.x) / (square(LEVEL_DEVIATIONS) * (other.y + about.y) + tiny)
                                + square(luminance(c.rgb) - m) / (square(DEVIATIONS) * (c.a + center.a) + tiny);
                    float w = KERNEL[abs(x)] * KERNEL[abs(y)];
#if USE_DENOISE_SIGNAL == 3
                    float near = 1.0 - (dot(d, d) - square(dot(d, l))) / square(len);
                    if (near <= 0.0) continue;
                    w *= near * max(alike(g, there) * exp(-apart) - LEAST_WEIGHT, 0.0);
#else
                    float d2 = IS_VISIBILITY ? dot(d, d) / square(len) : square(dot(d, axes.across) / len_across) + square(dot(d, axes.along) / len);
                    w *= alike(g, there) * exp(-apart - 0.5 * d2);
#endif
                    result += c * vec4(vec3(w), square(w));
                    weight += w;
                }
            result /= vec4(vec3(weight), square(weight));
        }
    }
#if USE_DENOISE_LAST
    vec4 raw = imageLoad(out_signal, AT(px));
#if USE_DENOISE_SIGNAL == 3
    result.rgb = without_tails(result.rgb, texelFetch(history, AT(px), 0).rgb, texelFetch(counts, AT(px), 0).x);
#endif
    if (center.a >= 0.0) imageStore(out_signal, AT(px), vec4(result.rgb, raw.a));
#else
    imageStore(out_filtered, px, result);
#endif
}
