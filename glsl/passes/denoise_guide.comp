// passes/denoise_guide.comp -- the surfaces of a frame, as its filters compare them.
#include "lib/motion.glsl"
#include "lib/denoise.glsl"
#include "lib/tile.glsl"

layout(rgba32ui) writeonly uniform uimage2D out_guide;
#if USE_MOVING
layout(rgba32f) writeonly uniform image2D out_moved;    // how far the point has come since the frame before, m
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    uvec4 result = uvec4(0u, 0u, ID_NONE, 0u);
    vec3 moved = vec3(0.0);
    if (covered(p)) {
        Surface s = load_surface(p);
        float depth = dot(s.point.position - frame.eye_ws, frame.forward_ws);
        result = pack_guide(s.bsdf.n, depth, s.record, s.bsdf.roughness, s.bsdf.clearcoat_roughness);
        moved = s.point.position - previous_position(p.hit, s.point.position);
    }
    imageStore(out_guide, px, result);
#if USE_MOVING
    imageStore(out_moved, px, vec4(moved, 0.0));
#endif
}
