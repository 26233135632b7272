// passes/shadow.comp -- one any-hit ray per pixel and light, only where a surface faces the light.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/terminator.glsl"
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
    Surface s = load_surface(p);
    Point from = shadow_point(p, s);
    for (uint i = frame.light_first; i < frame.light_end; i++) {
        LightSample l = light_at(lights[i], s.point.position);
        vec3 visibility = vec3(0.0);
        if (arrives(l) && faces(s, l.dir)) visibility = any_hit(Ray(shadow_origin(from, l.dir), 0.0, l.dir, l.distance));
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
    }
}
