// passes/aov.comp -- one AOV of the exact pixel-centre rays, as bits. A program for each kind: what is told of the point, of
// its material, of its motion, or of what rays cost.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/motion.glsl"
#include "lib/tile.glsl"

layout(rgba32ui) writeonly uniform uimage2D out_aov;
uniform uint aov;         // which of its kind

uvec4 bits(vec3 v) { return uvec4(floatBitsToUint(v), 0u); }
uvec4 bits(float v) { return uvec4(floatBitsToUint(v), 0u, 0u, 0u); }

uvec4 of_point(Pixel p) {
    if (!covered(p)) {
        bool id = aov == AOV_INSTANCE_ID || aov == AOV_MATERIAL_ID || aov == AOV_TRIANGLE_ID;
        return id ? uvec4(ID_NONE) : (aov == AOV_DEPTH || aov == AOV_DISTANCE ? bits(INFINITY) : uvec4(0u));
    }
    Point point = point_at(p.hit, p.ray);
    if (aov == AOV_DEPTH) return bits(dot(point.position - frame.eye_ws, frame.forward_ws));
    if (aov == AOV_DISTANCE) return bits(p.hit.t);
    if (aov == AOV_POSITION) return bits(point.position);
    if (aov == AOV_NORMAL_GEOMETRIC) return bits(point.n_geo);
    if (aov == AOV_TRIANGLE_ID) return uvec4(p.hit.triangle);
    Record record = record_of(p.hit.instance, texelFetch(triangles, int(p.hit.triangle)).w);
    if (aov == AOV_MATERIAL_ID) return uvec4(hit_groups[record.hit_group].material);
    return uvec4(record.instance_id != ID_NONE ? record.instance_id : instance_row(p.hit.instance).id);
}

uvec4 of_material(Pixel p) {
    if (!covered(p)) return uvec4(0u);
    Surface s = load_surface(p);
    if (aov == AOV_NORMAL) return bits(s.bsdf.n);
    if (aov == AOV_ALBEDO) return bits(s.bsdf.base_color);
    if (aov == AOV_ROUGHNESS) return bits(s.bsdf.roughness);
    if (aov == AOV_METALLIC) return bits(s.bsdf.metallic);
    return bits(s.unlit ? vec3(0.0) : s.emissive);
}

// To where the point was a frame ago, pixels, y down. What stands still is 0, however drivers round.
uvec4 of_motion(Pixel p) {
    if (!covered(p)) return uvec4(0u);
    vec3 position = point_at(p.hit, p.ray).position, from = previous_position(p.hit, position);
    if (from == position && frame.previous_clip_from_world == frame.clip_from_world) return uvec4(0u);
    vec4 now = frame.clip_from_world * vec4(position, 1.0), before = frame.previous_clip_from_world * vec4(from, 1.0);
    vec2 moved = (before.xy / before.w - now.xy / now.w) * 0.5 * vec2(frame.size_px);
    return bits(vec3(moved.x, -moved.y, 0.0));
}

// Nodes visited and triangles tested by the shadow and reflection rays of this pixel.
#if USE_STEP_COUNTER
uvec4 of_rays(Pixel p) {
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

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
#if USE_AOV == 0       // AOVS_POINT ...
    imageStore(out_aov, px, of_point(p));
#elif USE_AOV == 1
    imageStore(out_aov, px, of_material(p));
#elif USE_AOV == 2
    imageStore(out_aov, px, of_motion(p));
#else
    imageStore(out_aov, px, of_rays(p));
#endif
}
