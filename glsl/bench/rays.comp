// bench/rays.comp -- the rays of one class, by tile: camera rays, or what leaves their hits.
#include "lib/surface.glsl"
#include "lib/light.glsl"
#include "lib/random.glsl"
#include "lib/tile.glsl"

const uint CAMERA = 0u, SHADOW = 1u, MIRROR = 2u, DIFFUSE = 3u;   // as CLASSES in glhybrid/bench/rays.py

layout(std430) writeonly buffer Rays { vec4 rays[]; };   // origin, t_max (negative: no ray); direction, 0
uniform uint ray_class;
uniform float lift;    // m

void main() {
    ivec2 px = tile_pixel();
    uint i = (gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * 64u + gl_LocalInvocationIndex;
    rays[2u * i] = vec4(0.0, 0.0, 0.0, -1.0);
    rays[2u * i + 1u] = vec4(0.0);
    if (any(greaterThanEqual(px, frame.size_px))) return;
    Ray ray = primary_ray(px, vec2(0.0));
    ray.t_min = 0.0;
    Ray next = ray;
    if (ray_class != CAMERA) {
        Hit hit = closest_hit(ray);
        if (hit.triangle == ID_NONE) return;
        Point p = point_at(hit, ray);
        LightSample light = light_at(light_row(0), p.position);
        random_seed(uvec2(px), 0u, 1u);
        vec2 xi = random_vec2();
        float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
        next.dir = basis(p.n_geo) * vec3(r * cos(phi), r * sin(phi), sqrt(1.0 - xi.x));
        if (ray_class == SHADOW) next.dir = light.dir;
        if (ray_class == MIRROR) next.dir = reflect(ray.dir, p.n_geo);
        if (dot(next.dir, p.n_geo) <= 0.0) return;
        // Further than a frame's rays: they must clear this surface also where its vertices are rounded otherwise.
        next.origin = ray_origin(p, next.dir) + lift * p.n_geo;
        next.t_max = ray_class == SHADOW ? light.distance : INFINITY;
    }
    rays[2u * i] = vec4(next.origin, next.t_max);
    rays[2u * i + 1u] = vec4(next.dir, 0.0);
}
