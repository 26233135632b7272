// passes/denoise_temporal.comp -- adds a frame's samples to those of the frames before, where these still show the same.
//
// Schied et al., "Spatiotemporal Variance-Guided Filtering", HPG 2017, with exact counts of samples in place of a blend
// factor, reprojection of what a reflection shows instead of where it is seen (Zhdan, "ReBLUR", Ray Tracing Gems II (2021),
// ch. 49), and history held to the interval that this frame's samples about the pixel allow: what is gone does not linger.
#include "lib/denoise.glsl"
#include "lib/tile.glsl"

uniform SIGNAL_SAMPLER signal;           // mean of this frame's samples; a: distance or half width, see below
#if USE_DENOISE_SIGNAL != 3
uniform sampler2D noise;                 // mean square over squared mean, samples
#endif
uniform SIGNAL_SAMPLER history;          // mean; a: length over which the truth changes, m
uniform SIGNAL_SAMPLER moments;          // samples, mean square over squared mean
uniform usampler2D guide_before;
#if USE_MOVING
uniform sampler2D moved;
#endif
layout(SIGNAL_FORMAT) writeonly uniform SIGNAL_IMAGE out_history;
layout(rg16f) writeonly uniform SIGNAL_IMAGE out_moments;
layout(rgba32f) writeonly uniform image2D out_filtered;    // mean; a: variance of its luminance, < 0: not to be touched
uniform float history_frames, samples;

const int REACH = 2;                     // pixels about this one that are asked what is likely

// This frame's samples about the pixel. All of luminance; variance: of one sample, within pixels if these hold several.
struct Near { float mean, spread, variance, extent, distance, weight; };

bool has_signal(vec4 s) { return IS_VISIBILITY ? s.a >= 0.0 : s.a > 0.0; }

vec2 noise_of(ivec2 px, vec4 s) {
#if USE_DENOISE_SIGNAL == 3
    float m = luminance(s.rgb);
    return vec2(m > 0.0 ? 1.0 / m : 0.0, samples);                         // of zeros and ones the mean square is the mean
#else
    return texelFetch(noise, px, 0).xy;
#endif
}

// Over which length of this surface the mean of a lobe or of a disc of light changes, standard deviation in m.
float length_of(vec4 s, Guide g) {
    if (IS_VISIBILITY) return 0.5 * s.a;                                   // of an even disc half its radius
    float tan_lobe = 1.4 * square(g.roughness);                            // GGX: half of the half vectors, twice as far
    float t = frame.orthographic == 1u ? INFINITY : g.depth;
    float far = min(s.a, 1e15);
    return tan_lobe * (t < INFINITY ? far * t / (far + t) : far);
}

Near look_around(ivec2 px, Guide g) {
    float sum = 0.0, square_of_means = 0.0, squares = 0.0, within = 0.0, nearness = 0.0, weight = 0.0, known = 0.0, counts = 0.0, inverse = 0.0;
    for (int y = -REACH; y <= REACH; y++)
        for (int x = -REACH; x <= REACH; x++) {
            ivec2 q = px + ivec2(x, y);
            if (!inside(q)) continue;
            uvec4 bits = texelFetch(guide, q, 0);
            vec4 s = texelFetch(signal, AT(q), 0);
            if (!is_surface(bits) || !has_signal(s)) continue;
            float w = x == 0 && y == 0 ? 1.0 : alike(g, unpack_guide(bits, vec2(q)));
            if (w < 0.01) continue;
            vec2 n = noise_of(q, s);
            float m = luminance(s.rgb);
            sum += w * m;
            square_of_means += w * m * m;
            squares += w * n.x * m * m;
            if (n.y > 1.0) { within += w * max(n.x - 1.0, 0.0) * m * m * n.y / (n.y - 1.0); counts += w; }
            weight += w;
            inverse += w / max(s.a, 1e-30);
            float len = length_of(s, g);
            if (len > 0.0) { nearness += w / len; known += w; }
        }
    Near near;
    near.weight = weight;
    near.mean = sum / weight;
    near.spread = max(square_of_means / weight - square(near.mean), 0.0);
    near.variance = max(squares / weight - square(near.mean), 0.0);
    if (counts > 0.5 * weight && !IS_VISIBILITY) near.variance = within / counts;
    near.extent = nearness > 0.0 ? known / nearness : 0.0;
    near.distance = min(weight / max(inverse, 1e-30), 1e15);
    return near;
}

// Where on the screen of the frame before this is, in pixels.
vec2 pixel_before(vec3 position_ws) {
    vec4 clip = frame.previous_clip_from_world * vec4(position_ws, 1.0);
    return clip.w > 0.0 ? (clip.xy / clip.w * 0.5 + 0.5) * vec2(frame.size_px) - 0.5 : vec2(-1e6);
}

// How much of a lobe's image moves with what is reflected, not with the surface. NVIDIA's NRD, `GetSpecularDominantFactor`.
float mirror_share(float roughness, float NoV) {
    float a = 0.298475 * log(39.4115 - 39.0029 * roughness);
    return clamp(pow(1.0 - NoV, 10.8649) * (1.0 - a) + a, 0.0, 1.0);
}

struct Past { vec4 mean; float squares, samples, frames; };    // frames: how many may count

Past look_back(ivec2 px, Guide g, Near near) {
    Past past = Past(vec4(0.0), 0.0, 0.0, history_frames - 1.0);
    if (frame.history == HISTORY_NONE) return past;
    if (frame.history == HISTORY_SAME_VIEW) {
        uvec4 bits = texelFetch(guide_before, px, 0);
        if (bits.z == g.record) {
            vec2 m = texelFetch(moments, AT(px), 0).xy;
            past.mean = texelFetch(history, AT(px), 0);
            past.samples = m.x;
            past.squares = m.y * square(luminance(past.mean.rgb));
        }
        return past;
    }
    vec3 was = g.position;
#if USE_MOVING
    was -= texelFetch(moved, px, 0).xyz;
#endif
    float depth = dot(frame.previous_depth, vec4(was, 1.0));
    vec2 at = pixel_before(was);
#if USE_DENOISE_SIGNAL != 3
    vec3 v = frame.orthographic == 1u ? -frame.forward_ws : normalize(frame.eye_ws - g.position);
    // The point that a mirror would show, behind the surface; the sky's is so far that it stands still.
    float share = mirror_share(g.roughness, clamp(dot(g.n, v), 0.0, 1.0));
    at = pixel_before(was - v * (min(near.distance, 1e4 * max(length(frame.eye_ws - g.position), g.depth)) * share));
#endif
    // Only one of the distances that a lobe sees moves like this. Others drift, by up to as much as the image moves on its
    // surface, and must not drift further than a share of what the lobe blurs.
    past.frames = min(past.frames, 1.0 + 0.3 * near.extent / (pixel_width(g.depth) * max(distance(at, pixel_before(was)), 1e-3)));
    ivec2 corner = ivec2(floor(at));
    vec2 f = at - floor(at);
    float weight = 0.0;
    for (int i = 0; i < 4; i++) {
        ivec2 q = corner + ivec2(i & 1, i >> 1);
        float w = ((i & 1) == 1 ? f.x : 1.0 - f.x) * ((i >> 1) == 1 ? f.y : 1.0 - f.y);
        if (!inside(q) || w <= 0.0) continue;
        uvec4 bits = texelFetch(guide_before, q, 0);
        if (bits.z != g.record || dot(guide_normal(bits), g.n) < 0.9) continue;
        // A visibility stays with its point; a reflection is only held to its surface, whose depth there is another.
        if (IS_VISIBILITY && abs(uintBitsToFloat(bits.y) - depth) > 0.02 * abs(depth) + 4.0 * pixel_width(depth)) continue;
        vec2 m = texelFetch(moments, AT(q), 0).xy;
        if (m.x <= 0.0) continue;
        vec4 h = texelFetch(history, AT(q), 0);
        past.mean += w * h;
        past.samples += w * m.x;
        past.squares += w * m.y * square(luminance(h.rgb));
        weight += w;
    }
    if (weight < 0.01) return Past(vec4(0.0), 0.0, 0.0, 0.0);
    past.mean /= weight;
    past.samples /= weight;
    past.squares /= weight;
    return past;
}

// History that this frame's samples contradict is moved to what they allow, and counts for less.
void hold(inout Past past, Near near, float frame_samples) {
    float m = luminance(past.mean.rgb);
    float of_sample = max(near.variance, max(past.squares - m * m, 0.0));
    // How far the mean about the pixel may be from the truth in it: by chance, and because the truth is not even.
    float chance = of_sample / max(frame_samples * near.weight, 1.0);
    float uneven = max(near.spread - of_sample / max(frame_samples, 1.0), 0.0);
    float allowed = 3.0 * sqrt(chance + uneven) + 1e-3 * near.mean;
    float off = abs(m - near.mean);
    if (off <= allowed) return;
    float keep = allowed / off;
    float target = near.mean + (m - near.mean) * keep;
    past.mean.rgb *= m > 1e-9 ? target / m : 0.0;
    past.squares *= m > 1e-9 ? square(target / m) : 0.0;
    past.samples *= square(square(keep));
    if (m <= 1e-9) past.samples = 0.0;
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    uvec4 bits = texelFetch(guide, px, 0);
    vec4 s = texelFetch(signal, AT(px), 0);
    vec4 mean = vec4(s.rgb, 0.0), filtered = vec4(s.rgb, -1.0);
    vec2 state = vec2(0.0);
    vec2 n = is_surface(bits) && has_signal(s) ? noise_of(px, s) : vec2(0.0);
    if (n.y > 0.0) {
        Guide g = unpack_guide(bits, vec2(px));
        Near near = look_around(px, g);
        Past past = look_back(px, g, near);
        if (past.samples > 0.0) hold(past, near, n.y);
        past.samples = min(past.samples, past.frames * n.y);
        float count = past.samples + n.y, now = n.y / count;
        mean.rgb = mix(past.mean.rgb, s.rgb, now);
        mean.a = past.samples > 0.0 && past.mean.a > 0.0 && near.extent > 0.0 ? mix(past.mean.a, near.extent, now) : max(near.extent, past.mean.a);
        float m = luminance(mean.rgb);
        float squares = mix(past.squares, n.x * square(luminance(s.rgb)), now);
        float of_sample = max(squares - m * m, 0.0) * count / max(count - 1.0, 1.0);
        // A few samples do not know their own spread; those about them do.
        of_sample = mix(near.variance, of_sample, clamp((count - 4.0) / 28.0, 0.0, 1.0));
        filtered = vec4(mean.rgb, of_sample / count);
        state = vec2(count, min(squares / max(m * m, 1e-30), 6e4));
    }
    imageStore(out_history, AT(px), mean);
    imageStore(out_moments, AT(px), vec4(state, 0.0, 0.0));
    imageStore(out_filtered, px, filtered);
}
