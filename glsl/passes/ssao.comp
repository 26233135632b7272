// passes/ssao.comp -- ambient occlusion from what the G-buffer shows: in slices through the view direction, the horizons
// to either side, and between them the cosine-weighted share in closed form.
// Jimenez, Wu, Pesce, Jarabo, "Practical Real-Time Strategies for Accurate Indirect Occlusion" (GTAO, 2016), with the
// distribution of steps and the handling of the radius of Intel's XeGTAO (2021). One bounce: no multi-bounce colour.
#include "lib/gbuffer.glsl"
#include "lib/low_discrepancy.glsl"
#include "lib/screen.glsl"
#include "lib/tile.glsl"

layout(r32f) writeonly uniform image2D out_occlusion;    // 1 = open
#if USE_REASON_AO
layout(r8ui) writeonly uniform uimage2D out_reason_ao;
#endif
uniform int slices, steps;
uniform float ao_radius;                                 // m

const uint SSAO_SEQUENCE = 0x55A0u;
const float FALLOFF = 0.2;                               // last share of the radius, over which occluders fade

// The point that a pixel shows `off` pixels from its centre, on its plane.
vec3 screen_point(ivec2 px, vec2 off, vec4 plane) {
    Ray ray = primary_ray(px, frame.jitter_px + off);
    float depth = plane.x + dot(plane.yz, off);
    float z = frame.orthographic == 1u ? -depth : 1.0 / depth;
    return ray.origin + ray.dir * (z / dot(ray.dir, frame.forward_ws));
}

// acos within 7e-5, as fast as a square root: Abramowitz & Stegun 4.4.45.
float fast_acos(float x) {
    float a = abs(x);
    float r = (((-0.0187293 * a + 0.0742610) * a - 0.2121144) * a + 1.5707288) * sqrt(max(1.0 - a, 0.0));
    return x < 0.0 ? PI - r : r;
}

// Share of the half slice from the view direction to the horizon h, for a normal at angle n: GTAO, equation 7.
float arc(float h, float n, float cos_n, float sin_n) { return 0.25 * (cos_n + 2.0 * h * sin_n - cos(2.0 * h - n)); }

float open_share(Pixel p, Surface s, ivec2 px, out uint reason) {
    reason = REASON_NONE;
    vec3 v = -p.ray.dir, n_ws = s.bsdf.n;
    vec3 right = normalize(frame.right_ws), up = normalize(frame.up_ws);
    float radius_px = ao_radius / footprint(p.hit.t);
    if (radius_px < 1.0) { reason = REASON_SMALL; return 1.0; }
    uvec2 start = sequence_start(px, SSAO_SEQUENCE, frame.seed);
    float sum = 0.0, open = 0.0, facing = dot(v, frame.forward_ws) < 0.0 ? -1.0 : 1.0;
    mat3 frame_v = basis(v);
    for (int i = 0; i < slices; i++) {
        vec2 xi = sequence_point(start, frame.number * uint(slices) + uint(i));
        float phi = (float(i) + xi.x) * (PI / float(slices));
        // Even about the view direction, not on the screen: off the middle of the picture that is not the same.
        vec3 along = frame_v * vec3(cos(phi), sin(phi), 0.0);
        vec2 along_px = normalize(vec2(dot(along, right), dot(along, up)) * dot(v, frame.forward_ws)
                                  - vec2(dot(v, right), dot(v, up)) * dot(along, frame.forward_ws)) * facing;
        vec3 axis = cross(along, v);
        vec3 n_slice = n_ws - axis * dot(n_ws, axis);
        float weight = length(n_slice);
        if (weight < 1e-6) continue;
        float cos_n = clamp(dot(n_slice, v) / weight, -1.0, 1.0);
        float n = (dot(along, n_slice) >= 0.0 ? 1.0 : -1.0) * fast_acos(cos_n), sin_n = sin(n);
        float share = 0.0;
        for (int side = -1; side <= 1; side += 2) {
            float lowest = cos(n + float(side) * 0.5 * PI), horizon = lowest;
            for (int k = 0; k < steps; k++) {
                float t = (float(k) + fract(xi.y + float(k) * 0.61803399)) / float(steps);
                vec2 offset = float(side) * along_px * max(t * t * radius_px, 1.0 + float(k));
                vec2 at = vec2(px) + 0.5 + offset;                         // not at a pixel's centre: that is off the slice
                ivec2 q = ivec2(floor(at));
                if (any(lessThan(q, ivec2(0))) || any(greaterThanEqual(q, frame.size_px))) { reason = REASON_OFF_SCREEN; break; }
                vec4 plane = texelFetch(screen_plane, q, 0);
                if (plane.w == 0.0) continue;
                vec3 to = screen_point(q, at - 0.5 - vec2(q), plane) - s.point.position;
                float away = length(to);
                float near = clamp((ao_radius - away) / (FALLOFF * ao_radius), 0.0, 1.0);
                horizon = max(horizon, mix(lowest, dot(to, v) / max(away, 1e-20), near));
            }
            float h = float(side) * fast_acos(clamp(horizon, -1.0, 1.0));
            h = n + clamp(h - n, -0.5 * PI, 0.5 * PI);                     // the hemisphere ends there
            share += arc(h, n, cos_n, sin_n);
        }
        sum += weight * share;
        open += weight * (cos_n + n * sin_n);                              // all slices together: 1. A few: nearly
    }
    return open > 0.0 ? min(sum / open, 1.0) : 1.0;
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    float result = 1.0;
    uint reason = REASON_NONE;
    if (covered(p)) {
        Surface s = load_surface(p);
        if (!s.unlit) result = open_share(p, s, px, reason);
    }
    imageStore(out_occlusion, px, vec4(result));
#if USE_REASON_AO
    imageStore(out_reason_ao, px, uvec4(reason));
#endif
}
