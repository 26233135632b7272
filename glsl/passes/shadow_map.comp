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

#if USE_REASON_SHADOWS
layout(r8ui) writeonly uniform uimage2D out_reason_shadows;

// Why the share of a light that arrives is no more than a guess. pixel: its width there, m.
uint map_reason(Point p, vec3 dir, uint light, float lit, float pixel) {
    ShadowLight maps = shadow_lights[light];
    uint k = maps.first_map, last = maps.cube == 1u ? k : k + maps.map_count - 1u;
    if (maps.cube == 1u) k = last = k + cube_face(p.position - light_row(light).position);
    for (; k < last; k++) {                                                // the finest that has it
        ShadowMap map = shadow_maps[k];
        vec2 centred = abs(receiver_on(map, p, dir).at / float(map.size) * 2.0 - 1.0);
        if (max(centred.x, centred.y) < 1.0 - 2.0 * map_margin / float(map.size)) break;
    }
    ShadowMap map = shadow_maps[k];
    Receiver r = receiver_on(map, p, dir);
    float unit = from_point(map) ? r.depth : 1.0, texel = max(map.texel.x, map.texel.y), size = light_row(light).size;
    bool border = between_in_8_bits(lit);
    if (MAP_FILTER == int(FILTER_PCSS) && size > 0.0) {
        float widest = cone_width(map, light_row(light), r.depth, from_point(map) ? size : 0.0);
        return border && widest > map_search * texel ? REASON_SEARCH : REASON_NONE;
    }
    if (MAP_FILTER == int(FILTER_TAP)) {
        int about = 0;                                                     // texels that see the receiver's plane
        for (int i = 0; i < 4; i++) {
            ivec2 texel = ivec2(floor(r.at - 0.5)) + ivec2(i & 1, i >> 1);
            float rise = dot(r.slope, vec2(texel) + 0.5 - r.at);
            float plane = from_point(map) ? r.depth / max(1.0 + rise, 0.05) : r.depth - rise;
            about += int(caster_depth(map, texel) >= plane - r.bias);
        }
        border = about > 0 && about < 4;
    }
    return border && texel * unit > pixel ? REASON_COARSE : REASON_NONE;
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    if (!covered(p)) {
        for (uint i = frame.light_first; i < frame.light_end; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
#if USE_REASON_SHADOWS
        imageStore(out_reason_shadows, px, uvec4(REASON_NONE));
#endif
        return;
    }
    // Interleaved gradient noise (Jimenez, "Next Generation Post Processing in Call of Duty", 2014), another in each of the
    // frames that are averaged.
    map_turn = fract(52.9829189 * fract(dot(vec2(px), vec2(0.06711056, 0.00583715))) + dot(frame.jitter_px, vec2(0.7548777, 0.5698403)));
    Surface s = load_surface(p);
    uint reason = REASON_NONE;
    for (uint i = frame.light_first; i < frame.light_end; i++) {
        LightSample l = light_at(light_row(i), s.point.position);
        vec3 visibility = vec3(0.0);
        if (arrives(l) && faces(s, l.dir)) visibility = in_8_bits(vec3(map_visibility(s.point, l.dir, i)));
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
#if USE_REASON_SHADOWS
        uint why = REASON_NONE;
        if (arrives(l) && faces(s, l.dir)) why = map_reason(s.point, l.dir, i, visibility.x, footprint(p.hit.t));
        if (why != REASON_NONE) reason = why;
#endif
    }
#if USE_REASON_SHADOWS
    if (frame.light_first == 0u || reason != REASON_NONE) imageStore(out_reason_shadows, px, uvec4(reason));
#endif
}
