// lib/denoise.glsl -- what the filter of a noisy image knows of a pixel's surface. Signals are the same for suns and lobes:
// a mean of samples, how many, how unlike they were, and over which length of the surface the truth may change.
#include "lib/frame.glsl"
#include "lib/math.glsl"

uniform usampler2D guide;    // octahedral normal; depth along the view axis; row of records; roughness of base and coat

const int SIGNAL_COAT = 2, SIGNAL_VISIBILITY = 3, SIGNAL_OCCLUSION = 4;
const bool IS_VISIBILITY = USE_DENOISE_SIGNAL >= SIGNAL_VISIBILITY;    // of a light's disc, or of the sky

#if USE_DENOISE_SIGNAL == 3
#define SIGNAL_SAMPLER sampler2DArray
#define SIGNAL_IMAGE image2DArray
#define SIGNAL_FORMAT rgba32f
#define AT(px) ivec3(px, layer)
uniform int layer;           // of the light
#else
#define SIGNAL_SAMPLER sampler2D
#define SIGNAL_IMAGE image2D
#define SIGNAL_FORMAT rgba32f
#define AT(px) (px)
#endif

#define DRIFTS (USE_MOVING && USE_DENOISE_SIGNAL <= 3)
#if DRIFTS
#define COUNTS_FORMAT rgba16f
#else
#define COUNTS_FORMAT rg16f
#endif

struct Guide { vec3 position, n; float depth, roughness; uint record; };

// The world's point at a depth along the view axis, under the middle of a pixel.
vec3 point_under(vec2 px, float depth) {
    vec2 ndc = (px + 0.5 + frame.jitter_px) / vec2(frame.size_px) * 2.0 - 1.0;
    vec3 across = ndc.x * frame.right_ws + ndc.y * frame.up_ws;
    return frame.eye_ws + (frame.orthographic == 1u ? across + depth * frame.forward_ws : depth * (frame.forward_ws + across));
}

uvec4 pack_guide(vec3 n, float depth, uint record, float base, float coat) {
    return uvec4(packUnorm2x16(oct_encode(n)), floatBitsToUint(depth), record, packUnorm2x16(vec2(base, coat)));
}

bool is_surface(uvec4 g) { return g.z != ID_NONE; }
vec3 guide_normal(uvec4 g) { return oct_decode(unpackUnorm2x16(g.x)); }

float guide_roughness(uvec4 g) {
    vec2 r = unpackUnorm2x16(g.w);
    return USE_DENOISE_SIGNAL == SIGNAL_COAT ? r.y : r.x;
}

Guide unpack_guide(uvec4 g, vec2 px) {
    float depth = uintBitsToFloat(g.y);
    return Guide(point_under(px, depth), guide_normal(g), depth, guide_roughness(g), g.z);
}

bool inside(ivec2 px) { return all(greaterThanEqual(px, ivec2(0))) && all(lessThan(px, frame.size_px)); }

// Diameter of a pixel, m.
float pixel_width(float depth) { return frame.orthographic == 1u ? frame.pixel_angle : frame.pixel_angle * depth; }

// Across and along the plane of incidence, both across the view; and the latter on the surface. What a lobe shows slides
// over the surface as if across the view, since a mirrored view is as slanted as the view; and the lobe is narrower across
// than along, by N.V.
struct LobeAxes { vec3 across, along, up; float NoV; };

LobeAxes lobe_axes(vec3 n, vec3 v) {
    vec3 across = cross(n, v);
    float slant = length(across);
    across = slant > 1e-4 ? across / slant : basis(v)[0];
    return LobeAxes(across, cross(v, across), cross(n, across), clamp(dot(n, v), 0.05, 1.0));
}

vec3 toward_eye(Guide g) { return frame.orthographic == 1u ? -frame.forward_ws : normalize(frame.eye_ws - g.position); }

// 0 where another surface continues this one: on its plane, turned like it, as rough. In squared deviations.
float unlike(Guide a, Guide b) {
    vec3 d = b.position - a.position;
    float slope2 = square(dot(a.n, d)) / max(dot(d, d), 1e-30);
    // Normals may be as far apart as the half vectors of one lobe.
    float turn = IS_VISIBILITY ? 0.3 : max(square(a.roughness), 0.01);
    float turned = 2.0 * max(1.0 - dot(a.n, b.n), 0.0) / square(turn);
    float rougher = IS_VISIBILITY ? 0.0 : square((b.roughness - a.roughness) / (0.1 * a.roughness + 0.005));
    return slope2 / square(0.1) + turned + rougher;
}

float alike(Guide a, Guide b) { return exp(-unlike(a, b)); }

// Of the pixels whose mean stands for how bright it is about one.
const int LEVEL_REACH = 2;
float level_weight(int x, int y) { return exp(-float(x * x + y * y) / 8.0); }
