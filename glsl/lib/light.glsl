// lib/light.glsl -- KHR_lights_punctual: where a light is from a point, and how much of it would arrive unblocked.
#include "lib/frame.glsl"
#include "lib/math.glsl"

layout(std430) readonly buffer Lights { Light lights[]; };

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

bool arrives(LightSample s) { return max3(s.irradiance) > 0.0; }
