// passes/tuning.comp -- the rays of a frame without its shading, to choose among variants of the tracer by: one from the
// camera, one that leaves what it meets in a random direction, and one from there to the first light.
#include "lib/surface.glsl"
#include "lib/light.glsl"
#include "lib/random.glsl"
#include "lib/tile.glsl"

layout(rg32ui) writeonly uniform uimage2D out_id;

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Ray ray = primary_ray(px, vec2(0.0));
    Hit hit = closest_hit(ray);
    uint triangle = hit.triangle;
    float arrives = 0.0;
    if (hit.triangle != ID_NONE) {
        Point p = point_at(hit, ray);
        random_seed(uvec2(px), 0u, 1u);
        vec2 xi = random_vec2();
        float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
        vec3 dir = basis(p.n_geo) * vec3(r * cos(phi), r * sin(phi), sqrt(1.0 - xi.x));
        hit = closest_hit(Ray(ray_origin(p, dir), 0.0, dir, INFINITY));
        LightSample l = light_at(light_row(0), p.position);
        arrives = any_hit(Ray(ray_origin(p, l.dir), 0.0, l.dir, l.distance)).x;
    }
    imageStore(out_id, px, uvec4(triangle ^ hit.triangle, floatBitsToUint(arrives), 0u, 0u));
}
