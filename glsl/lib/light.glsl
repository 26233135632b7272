// lib/light.glsl -- KHR_lights_punctual: where a light is from a point, and how much of it would arrive unblocked.
#include "lib/frame.glsl"
#include "lib/math.glsl"

layout(std430) readonly buffer Lights { Light lights[]; };

// The lights of a dispatch are LIGHT_FIRST to before LIGHT_END, all of them are LIGHTS. Where there is one, the loop has one
// turn and nothing has to live through the rays that it sends.
#if USE_ONE_LIGHT
const uint LIGHT_FIRST = 0u, LIGHT_END = 1u, LIGHTS = 1u;
#else
#define LIGHT_FIRST frame.light_first
#define LIGHT_END frame.light_end
#define LIGHTS frame.light_count
#endif

struct LightSample {
    vec3 irradiance;    // on a surface facing the light: lux at the point
    vec3 dir;           // unit, towards the light
    float distance;     // m; INFINITY: directional
};

LightSample light_at(Light light, vec3 position_ws) {
    if (light.kind == LIGHT_DIRECTIONAL) return LightSample(light.color, -light.direction, INFINITY);
    vec3 to_light = light.position - position_ws;
    float distance2 = dot(to_light, to_light);
    float distance = sqrt(distance2);
    LightSample s = LightSample(light.color / distance2, to_light / distance, distance);
    if (light.range > 0.0) s.irradiance *= clamp(1.0 - square(distance2 / square(light.range)), 0.0, 1.0);
    if (light.kind == LIGHT_SPOT) s.irradiance *= square(clamp(dot(-s.dir, light.direction) * light.cone_scale + light.cone_offset, 0.0, 1.0));
    return s;
}

#if USE_LIGHT_DISCS
// A ray to the disc that a light with a size shows: a sphere of even radiance, or a sun. Drawn evenly over the projected
// solid angle as seen from a surface that faces it, whose irradiance stays what it was: with f for BSDF times N.L, f / cos_axis
// times irradiance has the mean that the whole disc gives.
LightSample toward_disc(LightSample s, Light light, vec2 xi, out float cos_axis) {
    bool sun = light.kind == LIGHT_DIRECTIONAL;
    float sin_disc = sun ? light.size * inversesqrt(1.0 + square(light.size)) : min(light.size / s.distance, 0.9999);
    float sin_axis = sin_disc * sqrt(xi.x), phi = 2.0 * PI * xi.y;
    cos_axis = sqrt(1.0 - square(sin_axis));
    LightSample to = s;
    to.dir = normalize(basis(s.dir) * vec3(sin_axis * cos(phi), sin_axis * sin(phi), cos_axis));
    if (!sun)                                                              // up to the sphere
        to.distance = max(s.distance * cos_axis - sqrt(max(square(light.size) - square(s.distance * sin_axis), 0.0)), 0.0);
    return to;
}
#endif

// To a light as seen from where its shadow ray leaves, which may be nearer than the surface's point by a rounding or two: what
// touches the lamp is in the way, from everywhere.
Ray shadow_ray(vec3 from, LightSample s) { return Ray(from, 0.0, s.dir, s.distance * 1.000001); }

bool arrives(LightSample s) { return max3(s.irradiance) > 0.0; }
