// passes/denoise_temporal.comp -- adds a frame's samples to those of the frames before, where these still show the same.
//
// Schied et al., "Spatiotemporal Variance-Guided Filtering", HPG 2017, with exact counts of samples in place of a blend
// factor, reprojection of what a reflection shows instead of where it is seen (Zhdan, "ReBLUR", Ray Tracing Gems II (2021),
// ch. 49), and history held to the interval that this frame's samples about the pixel allow: what is gone does not linger.
#include "lib/denoise.glsl"
#include "lib/tile.glsl"
#if USE_DENOISE_SIGNAL == 3
#include "lib/light.glsl"
#endif

uniform SIGNAL_SAMPLER signal;           // mean of this frame's samples; a: distance or half width, see below
#if USE_DENOISE_SIGNAL < 3
uniform sampler2D noise;                 // mean square over squared mean, samples
#endif
uniform SIGNAL_SAMPLER history;          // mean; a: length over which the truth changes, m
uniform SIGNAL_SAMPLER counts;           // samples in it; root of the luminance about each pixel in the last frames
uniform SIGNAL_SAMPLER level_before;     // luminance about each pixel, its variance
uniform usampler2D guide_before;
#if USE_MOVING
uniform sampler2D moved;
#endif
#if DRIFTS
uniform SIGNAL_SAMPLER drift;            // of what this frame's rays met, over the length over which the signal changes
#endif
#if USE_DENOISE_SIGNAL == 3
uniform vec4 light_moved;                // position, m, or direction; size
#endif
uniform float history_frames, samples;
uniform float tolerance;                 // standard deviations by which the level may differ from its past
#if USE_REUSE
#include "lib/reuse.glsl"
#endif
layout(SIGNAL_FORMAT) writeonly uniform SIGNAL_IMAGE out_history;
layout(COUNTS_FORMAT) writeonly uniform SIGNAL_IMAGE out_counts;
layout(rgba32f) writeonly uniform image2D out_filtered;    // mean; a: variance of its luminance, < 0: not to be touched

// This frame's samples about the pixel. All of luminance; variance: of one sample, within pixels if these hold several;
// worth: how many equal pixels would be as good. drift: of what moves.
struct Near { float mean, variance, extent, distance, nearest, worth, drift; };

bool has_signal(vec4 s) { return (IS_VISIBILITY ? s.a >= 0.0 : s.a > 0.0) && is_finite(s.rgb); }

// How many random samples would be as good: those over a disc are so even that their error goes by n^-3/4.
float as_random(float n) { return USE_DENOISE_SIGNAL == SIGNAL_VISIBILITY ? n * sqrt(n) : n; }

vec2 noise_of(ivec2 px, vec4 s) {
#if USE_DENOISE_SIGNAL >= 3
    float m = luminance(s.rgb);
    return vec2(m > 0.0 ? 1.0 / m : 0.0, samples);                         // of zeros and ones the mean square is the mean
#else
    return texelFetch(noise, px, 0).xy;
#endif
}

// Over which length of this surface the mean of a lobe or of a disc of light changes, standard deviation in m.
float length_of(vec4 s, Guide g) {
    if (IS_VISIBILITY) return 0.5 * s.a;                                   // of an even disc half its radius
    float t = frame.orthographic == 1u ? INFINITY : g.depth;
    float far = min(s.a, 1e15);
    return lobe_tangent(g.roughness) * (t < INFINITY ? far * t / (far + t) : far);
}

Near look_around(ivec2 px, Guide g) {
    Near near;
    near.drift = 0.0;
    float sum = 0.0, squares = 0.0, within = 0.0, nearness = 0.0, weight = 0.0, weights2 = 0.0, known = 0.0, several = 0.0, inverse = 0.0, inverse2 = 0.0;
    for (int y = -LEVEL_REACH; y <= LEVEL_REACH; y++)
        for (int x = -LEVEL_REACH; x <= LEVEL_REACH; x++) {
            ivec2 q = px + ivec2(x, y);
            if (!inside(q)) continue;
            uvec4 bits = texelFetch(guide, q, 0);
            vec4 s = texelFetch(signal, AT(q), 0);
            if (!is_surface(bits) || !has_signal(s)) continue;
            float w = x == 0 && y == 0 ? 1.0 : level_weight(x, y) * alike(g, unpack_guide(bits, vec2(q)));
            if (w < 0.01) continue;
            vec2 n = noise_of(q, s);
            float m = luminance(s.rgb);
            sum += w * m;
            squares += w * n.x * m * m;
            if (n.y > 1.0) { within += w * max(n.x - 1.0, 0.0) * m * m * n.y / (n.y - 1.0); several += w; }
            weight += w;
            weights2 += w * w;
            inverse += w / max(s.a, 1e-15);
            inverse2 += w / square(max(s.a, 1e-15));
            float len = length_of(s, g);
            if (len > 0.0) { nearness += w / len; known += w; }
#if DRIFTS
            if (((x | y) & 1) == 0) near.drift = max(near.drift, texelFetch(drift, AT(q), 0).x);    // every other: enough
#endif
        }
    near.worth = square(weight) / weights2;
    near.mean = sum / weight;
    near.variance = max(squares / weight - square(near.mean), 0.0);
    if (several > 0.5 * weight && !IS_VISIBILITY) near.variance = within / several;
    // Where all rays got through, the next one might not: Jeffreys' half of a ray to either side.
    if (USE_DENOISE_SIGNAL == SIGNAL_OCCLUSION) {
        float asked = samples * near.worth, open = (near.mean * asked + 0.5) / (asked + 1.0);
        near.variance = max(near.variance, open * (1.0 - open));
    }
    near.extent = nearness > 0.0 ? known / nearness : 0.0;
    near.distance = min(weight / max(inverse, 1e-30), 1e15);
    near.nearest = inverse2 > 1e-28 ? min(inverse / inverse2, 1e15) : 1e15;
    return near;
}

// Where on the screen of the frame before this is, in pixels.
vec2 pixel_before(vec3 position_ws) {
    vec4 clip = frame.previous_clip_from_world * vec4(position_ws, 1.0);
    return clip.w > 0.0 ? (clip.xy / clip.w * 0.5 + 0.5) * vec2(frame.size_px) - 0.5 : vec2(-1e6);
}

// How many frames count, this one with. Only one of the distances that a lobe sees moves as the image is thought to. The
// rest drifts: by `drift` of the length over which it changes, a frame. F frames are F drifts off, and their noise is that of
// F times as many rays: the sum of both squares is least at the cube root.
float frames_of(float drift, float worth) { return min(pow(1.0 / max(2.0 * worth * square(drift), 1e-12), 1.0 / 3.0), history_frames); }

// How much of a lobe's image moves with what is reflected, not with the surface. NVIDIA's NRD, `GetSpecularDominantFactor`.
float mirror_share(float roughness, float NoV) {
    float a = 0.298475 * log(39.4115 - 39.0029 * roughness);
    return clamp(pow(1.0 - NoV, 10.8649) * (1.0 - a) + a, 0.0, 1.0);
}

// level: luminance about the point, of all frames; lately: of the last ones; variance: of one sample there; drift: of a frame.
struct Past { vec4 mean; float level, lately, variance, samples, drift; };
const Past NO_PAST = Past(vec4(0.0), 0.0, 0.0, 0.0, 0.0, 0.0);

bool is_finite(Past p) { return is_finite(p.mean.rgb) && is_finite(vec3(p.mean.a, p.level, p.lately)) && is_finite(vec3(p.variance, p.samples, p.drift)); }

const float DRIFT = 1.0;
const float MOST_HALF = 6e4;             // more would be infinite in a half float

const float LEANING = 0.25;              // normals of what is looked at, off by half a lobe: flakes and bumps show other things
const float RESAMPLED = USE_DENOISE_SIGNAL == SIGNAL_VISIBILITY ? 2.0 : 0.25;

// Each look between pixels of the frame before blurs what is kept a little more. How much: squares of steps of a pixel to the
// right and up over that of the length over which it changes. Of a penumbra they are on the surface, across the way to the
// light; of a lobe across the view.
#if USE_DENOISE_SIGNAL == 3
float resampled(vec2 f, Guide g, float extent) {
    vec3 v = toward_eye(g), l = light_at(lights[layer], g.position).dir;
    float sum = 0.0;
    for (int i = 0; i < 2; i++) {
        vec3 d = normalize(i == 0 ? frame.right_ws : frame.up_ws);
        d -= v * (dot(g.n, d) / max(dot(g.n, v), 0.05));
        sum += f[i] * (1.0 - f[i]) * (dot(d, d) - square(dot(d, l)));
    }
    return extent > 0.0 ? RESAMPLED * sum * square(pixel_width(g.depth) / extent) : 0.0;
}
#elif USE_DENOISE_SIGNAL < 3
float resampled(vec2 f, Guide g, float extent) {
    LobeAxes axes = lobe_axes(g.n, toward_eye(g));
    float sum = 0.0;
    for (int i = 0; i < 2; i++) {
        vec3 d = normalize(i == 0 ? frame.right_ws : frame.up_ws);
        sum += f[i] * (1.0 - f[i]) * (square(dot(d, axes.across) / axes.NoV) + square(dot(d, axes.along)));
    }
    return extent > 0.0 ? min(RESAMPLED * sum * square(pixel_width(g.depth) / extent), 1e3) : 0.0;
}
#endif

#if USE_DENOISE_SIGNAL == 3
// Shadows of what stands still slide as far as the light turns, seen from here, and change over as much as it is wide.
float light_drift(Guide g) {
    if (light_moved == vec4(0.0)) return 0.0;
    Light now = lights[layer], was = now;
    was.position -= light_moved.xyz;
    was.direction -= light_moved.xyz;
    was.size -= light_moved.w;
    LightSample a = light_at(now, g.position), b = light_at(was, g.position);
    bool sun = now.kind == LIGHT_DIRECTIONAL;
    float size = sun ? now.size : now.size / a.distance, before = sun ? was.size : was.size / b.distance;
    return 2.0 * (distance(a.dir, b.dir) + abs(size - before)) / max(size, 1e-6);
}
#endif

Past look_back(ivec2 px, Guide g, Near near) {
    Past past = NO_PAST;
    if (frame.history == HISTORY_NONE) return past;
    if (frame.history == HISTORY_SAME_VIEW) {
        uvec4 bits = texelFetch(guide_before, px, 0);
        if (bits.z == g.record) {
            vec2 about = texelFetch(level_before, AT(px), 0).xy;
            past.mean = texelFetch(history, AT(px), 0);
            vec2 count = texelFetch(counts, AT(px), 0).xy;
            past.samples = count.x;
            past.lately = square(count.y);
            past.level = about.x;
            past.variance = about.y * near.worth * as_random(past.samples);
        }
        return past;
    }
    vec3 was = g.position;
#if USE_MOVING
    was -= texelFetch(moved, px, 0).xyz;
#endif
    float depth = dot(frame.previous_depth, vec4(was, 1.0));
    vec2 at = pixel_before(was);
#if USE_DENOISE_SIGNAL < 3
    vec3 v = toward_eye(g);
    // The point that a mirror would show, behind the surface; the sky's is so far that it stands still.
    float share = mirror_share(g.roughness, clamp(dot(g.n, v), 0.0, 1.0));
    at = pixel_before(was - v * (min(near.distance, 1e4 * max(length(frame.eye_ws - g.position), g.depth)) * share));
#endif
    past.drift = DRIFT * pixel_width(g.depth) * distance(at, pixel_before(was)) / max(near.extent, 1e-30);
    ivec2 corner = ivec2(floor(at));
    vec2 f = at - floor(at);
    float weight = 0.0, gone = 0.0, leaning = 0.0;
    for (int i = 0; i < 4; i++) {
        ivec2 q = corner + ivec2(i & 1, i >> 1);
        float w = ((i & 1) == 1 ? f.x : 1.0 - f.x) * ((i >> 1) == 1 ? f.y : 1.0 - f.y);
        if (!inside(q) || w <= 0.0) continue;
        uvec4 bits = texelFetch(guide_before, q, 0);
        vec3 n = guide_normal(bits);
        if (bits.z != g.record || dot(n, g.n) < 0.9) continue;
        // A visibility stays with its point; a reflection is only held to its surface, whose depth there is another.
        if (IS_VISIBILITY && abs(uintBitsToFloat(bits.y) - depth) > 0.02 * abs(depth) + 4.0 * pixel_width(depth)) continue;
        vec3 count = texelFetch(counts, AT(q), 0).xyz;
        if (count.x <= 0.0) continue;
#if DRIFTS
        gone = max(gone, count.z);
#endif
        vec2 about = texelFetch(level_before, AT(q), 0).xy;
        past.mean += w * texelFetch(history, AT(q), 0);
        past.samples += w * count.x;
        past.lately += w * square(count.y);
        past.level += w * about.x;
        past.variance += w * about.y * near.worth * as_random(count.x);
        leaning += w * dot(n - g.n, n - g.n);
        weight += w;
    }
    if (weight < 0.01) return NO_PAST;
    past.mean /= weight;
    past.level /= weight;
    past.lately /= weight;
    past.samples /= weight;
    past.variance /= weight;
#if USE_DENOISE_SIGNAL < 3
    past.drift += resampled(f, g, near.extent) + LEANING * leaning / (weight * square(lobe_tangent(g.roughness)));
#endif
#if USE_DENOISE_SIGNAL == 3
    past.drift = resampled(f, g, near.extent > 0.0 ? near.extent : past.mean.a) + light_drift(g);
#endif
    // Where it was a frame ago it may not be now.
    past.drift = max(past.drift, max(near.drift, gone));
    return past;
}

const float LEAST_CHANGE = 2e-3;         // roundings of half floats, twice

// History that what was seen since contradicts is moved to what that allows, and counts for less. What is compared are means
// about the pixel: its own past is as noisy as it is young. chance: variance of their difference.
void hold(inout Past past, float seen, float chance) {
    float allowed = tolerance * sqrt(chance) + LEAST_CHANGE * seen;
    float off = abs(past.level - seen);
    if (off <= allowed) return;
    float keep = allowed / off, now = max(seen + (past.level - seen) * keep, 0.0), scale = now / max(past.level, 1e-9);
    past.mean.rgb *= scale;
    past.variance *= square(scale);
    past.samples *= past.level > 1e-9 ? square(square(keep)) : 0.0;
    past.level = now;
}

const float LATELY = 0.25;               // share of this frame in the mean of the last ones
const float LATELY_FRAMES = 7.0;         // frames whose plain mean is as noisy: (2 - LATELY) / LATELY
const float LATELY_LEAST = 0.2;          // of the variance that was, where less is seen now

// What goes at once shows in one frame, what goes by less than one frame's noise in several ("fast history": Zhdan 2021).
// Only what is gone: what comes may be one bright ray of many, which stays in the mean of the last frames, but not in the
// variance of this one.
void forget(inout Past past, Near near, float frame_samples) {
    float variance = max(near.variance, past.variance) / near.worth, before = 1.0 / as_random(past.samples);
    float allowed = 3.0 * sqrt(variance / as_random(frame_samples)) + LEAST_CHANGE * near.mean;
    past.lately = mix(clamp(past.lately, near.mean - allowed, near.mean + allowed), near.mean, LATELY);
    hold(past, near.mean, variance * (1.0 / as_random(frame_samples) + before));
    if (past.samples <= 0.0 || past.lately >= past.level) return;
    variance = max(sqrt(near.variance) * sqrt(past.variance), LATELY_LEAST * past.variance) / near.worth;
    hold(past, past.lately, variance * (1.0 / as_random(LATELY_FRAMES * frame_samples) + before));
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    uvec4 bits = texelFetch(guide, px, 0);
    vec4 s = texelFetch(signal, AT(px), 0);
    vec4 mean = vec4(s.rgb, 0.0), filtered = vec4(s.rgb, -1.0);
    if (!is_finite(s.rgb)) mean = filtered = vec4(0.0);                    // what is not light: black, for one frame
    float count = 0.0, lately = 0.0, drifts = 0.0;
    vec2 n = is_surface(bits) && has_signal(s) ? noise_of(px, s) : vec2(0.0);
    if (n.y > 0.0) {
        Guide g = unpack_guide(bits, vec2(px));
        Near near = look_around(px, g);
        Past past = look_back(px, g, near);
        if (!is_finite(past)) past = NO_PAST;
        if (past.samples > 0.0) forget(past, near, n.y);
        else past.lately = near.mean;
        lately = past.lately;
        drifts = near.drift;
#if USE_REUSE
        float trusted = min(past.samples, 8.0 * (frames_of(past.drift, n.y) - 1.0) * n.y);
        Reused reused = reuse_rays(px, g, toward_eye(g), length_of(vec4(near.nearest), g), near.nearest, trusted);
#if USE_SKY_SAMPLES || USE_EMITTERS
        // What rays to lamps brought is this pixel's alone, and so is its share of the noise.
        vec3 beside = max(s.rgb - reused.own, vec3(0.0));
        float share = min(luminance(beside) / max(luminance(reused.mean + beside), 1e-30), 1.0);
        reused.mean += beside;
        reused.worth = 1.0 / mix(1.0 / reused.worth, 1.0 / n.y, share);
#endif
        s.rgb = reused.mean;
        n.y = reused.worth;
#endif
        past.samples = min(past.samples, max(frames_of(past.drift, as_random(n.y)) - 1.0, 0.0) * n.y);
        count = past.samples + n.y;
        float now = min(n.y / count, 1.0);                                 // x / x may be more: drivers divide to 2.5 ulp
        mean.rgb = mix(past.mean.rgb, s.rgb, now);
        mean.a = near.extent <= 0.0 ? past.mean.a : past.samples > 0.0 && past.mean.a > 0.0 ? mix(past.mean.a, near.extent, now) : near.extent;
        filtered = vec4(mean.rgb, max(mix(past.variance, near.variance, now), 0.0) / as_random(count));
    }
    imageStore(out_history, AT(px), mean);
    imageStore(out_counts, AT(px), vec4(min(vec3(count, sqrt(lately), drifts), MOST_HALF), 0.0));
    imageStore(out_filtered, px, filtered);
}
