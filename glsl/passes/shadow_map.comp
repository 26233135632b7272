// passes/shadow_map.comp -- depth maps looked up per pixel and light, only where a surface faces the light. The same
// points and the same output as shadow.comp.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

#if USE_BLENDED
layout(rgba16f) writeonly uniform image2DArray out_visibility;
#else
layout(r8) writeonly uniform image2DArray out_visibility;
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    if (!covered(p)) {
        for (uint i = frame.light_first; i < frame.light_end; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
        return;
    }
    // Interleaved gradient noise (Jimenez, "Next Generation Post Processing in Call of Duty", 2014), another in each of the
    // frames that are averaged.
    map_turn = fract(52.9829189 * fract(dot(vec2(px), vec2(0.06711056, 0.00583715))) + dot(frame.jitter_px, vec2(0.7548777, 0.5698403)));
    Surface s = load_surface(p);
    for (uint i = frame.light_first; i < frame.light_end; i++) {
        LightSample l = light_at(light_row(i), s.point.position);
        vec3 visibility = vec3(0.0);
        if (arrives(l) && faces(s, l.dir)) visibility = vec3(map_visibility(s.point, l.dir, i));
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
    }
}
