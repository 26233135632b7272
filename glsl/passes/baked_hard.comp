// passes/baked_hard.comp -- an any-hit ray from each texel of the light maps to each of several lights without a size: a
// bit each, whether it arrives, and whether the texel's front faces away. As passes/shadow.comp.
#include "lib/bake.glsl"

layout(std430) readonly buffer BakeLights { uint bake_lights[]; };
layout(std430) buffer BakeBits { uvec2 bake_bits[]; };
uniform uint bake_first;      // of bake_lights: bit bake_first of this dispatch
uniform uint bake_end;

void main() {
    uint row = bake_row();
    if (row >= bake_count) return;
    uvec2 bits = bake_first > 0u ? bake_bits[row] : uvec2(0u);
    Point p = bake_point(bake_texels[row]);
    float place = bake_points[row].w;
    if (place == BAKE_PUSHED) p.position = bake_points[row].xyz;
    bool front_only = bake_front_only(bake_texels[row]);
    for (uint i = bake_first; i < bake_end; i++) {
        Light light = light_row(bake_lights[i]);
        bool sun = light.kind == LIGHT_DIRECTIONAL;
        vec3 to_light = sun ? -light.direction : light.position - p.position;
        float away = sun ? INFINITY : length(to_light);
        vec3 dir = sun ? to_light : to_light / away;
        bool facing = dot(dir, p.n_geo) > 0.0;
        uint bit = 1u << i;
        if (!facing) bits.y |= bit;
        if (place != BAKE_INSIDE && (facing || !front_only) && any_hit(Ray(ray_origin(p, dir), 0.0, dir, away)).x > 0.0) bits.x |= bit;
    }
    bake_bits[row] = bits;
}
