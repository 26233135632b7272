// passes/screen_plane.comp -- every pixel as a piece of plane: screen depth at its centre and the change of it a pixel.
// Screen depth is what is affine over the screen along a line and over a plane: 1 / distance along the view axis, or, of
// parallel rays, minus that distance. Larger is nearer.
#include "lib/gbuffer.glsl"
#include "lib/tile.glsl"

layout(rgba32f) writeonly uniform image2D out_plane;    // depth, its change along x and y, 1 = the pixel shows a surface

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    vec4 plane = vec4(frame.orthographic == 1u ? -1e30 : 0.0, 0.0, 0.0, 0.0);
    if (covered(p)) {
        Point q = point_at(p.hit, p.ray);
        vec2 slope = vec2(dot(q.n_geo, frame.right_ws), dot(q.n_geo, frame.up_ws)) * 2.0 / vec2(frame.size_px);
        float z = p.hit.t * dot(p.ray.dir, frame.forward_ws), depth, facing, steepest;
        if (frame.orthographic == 1u) {
            depth = -z;
            facing = dot(q.n_geo, frame.forward_ws);
            steepest = 1e3 * frame.pixel_angle;                            // of a plane seen edge-on
        } else {
            depth = 1.0 / z;
            facing = dot(q.n_geo, p.ray.dir) * p.hit.t;
            steepest = depth;
        }
        slope /= abs(facing) > 0.0 ? facing : -1e-30;
        plane = vec4(depth, slope * min(1.0, steepest / max(abs(slope.x) + abs(slope.y), 1e-30)), 1.0);
    }
    imageStore(out_plane, px, plane);
}
