// passes/aov.comp -- one AOV of the exact pixel-centre rays, as bits. Which one is a feature: nothing else is computed.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

layout(rgba32ui) writeonly uniform uimage2D out_aov;

uvec4 bits(vec3 v) { return uvec4(floatBitsToUint(v), 0u); }
uvec4 bits(float v) { return uvec4(floatBitsToUint(v), 0u, 0u, 0u); }

// Nodes visited and triangles tested by the shadow and reflection rays of this pixel.
#if USE_STEP_COUNTER
uvec4 steps_of(Pixel p) {
    if (!covered(p)) return uvec4(0u);
    Surface s = load_surface(p);
    step_count = 0u;
    vec3 unused = direct_light(s, -p.ray.dir);
#if USE_MIRROR_RAYS
    bool bent;
    vec3 r = mirror_direction(s, -p.ray.dir, bent);
    Hit hit;
    if (sends_mirror_ray(s)) unused += trace_radiance(Ray(ray_origin(s.point, r), 0.0, r, INFINITY), 0.0, 0.0, hit);
#endif
    return uvec4(step_count, floatBitsToUint(unused.x), 0u, 0u);    // the light is kept, or its rays would be optimised away
}
#endif

#if USE_AOV == 13
#include "lib/motion.glsl"
#endif

uvec4 value_of(Pixel p) {
#if USE_AOV == 14
    return steps_of(p);
#else
    if (!covered(p)) {
        const bool id = USE_AOV == AOV_INSTANCE_ID || USE_AOV == AOV_MATERIAL_ID || USE_AOV == AOV_TRIANGLE_ID;
        return id ? uvec4(ID_NONE) : (USE_AOV == AOV_DEPTH || USE_AOV == AOV_DISTANCE ? bits(INFINITY) : uvec4(0u));
    }
    Surface s = load_surface(p);
    Record record = records[s.record];
    if (USE_AOV == AOV_DEPTH) return bits(dot(s.point.position - frame.eye_ws, frame.forward_ws));
    if (USE_AOV == AOV_DISTANCE) return bits(p.hit.t);
    if (USE_AOV == AOV_POSITION) return bits(s.point.position);
    if (USE_AOV == AOV_NORMAL) return bits(s.bsdf.n);
    if (USE_AOV == AOV_NORMAL_GEOMETRIC) return bits(s.point.n_geo);
    if (USE_AOV == AOV_ALBEDO) return bits(s.bsdf.base_color);
    if (USE_AOV == AOV_ROUGHNESS) return bits(s.bsdf.roughness);
    if (USE_AOV == AOV_METALLIC) return bits(s.bsdf.metallic);
    if (USE_AOV == AOV_EMISSIVE) return bits(s.unlit ? vec3(0.0) : s.emissive);
    if (USE_AOV == AOV_INSTANCE_ID) return uvec4(record.instance_id != ID_NONE ? record.instance_id : instance_row(p.hit.instance).id);
    if (USE_AOV == AOV_MATERIAL_ID) return uvec4(s.material);
    if (USE_AOV == AOV_TRIANGLE_ID) return uvec4(p.hit.triangle);
#if USE_AOV == 13
    // AOV_MOTION: to where the point was a frame ago, pixels, y down. What stands still is 0, however drivers round.
    vec3 from = previous_position(p, s);
    if (from == s.point.position && frame.previous_clip_from_world == frame.clip_from_world) return uvec4(0u);
    vec4 now = frame.clip_from_world * vec4(s.point.position, 1.0), before = frame.previous_clip_from_world * vec4(from, 1.0);
    vec2 moved = (before.xy / before.w - now.xy / now.w) * 0.5 * vec2(frame.size_px);
    return bits(vec3(moved.x, -moved.y, 0.0));
#endif
    return uvec4(0u);
#endif
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    imageStore(out_aov, px, value_of(load_pixel(px)));
}
