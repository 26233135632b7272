// probes/surface.comp -- what lib/surface.glsl makes of the nearest hit of each ray.
#include "lib/surface.glsl"

layout(local_size_x = 64) in;
layout(std430) readonly buffer Rays { vec4 rays[]; };             // origin, footprint at the hit; direction, t_max
layout(std430) writeonly buffer Surfaces { vec4 surfaces[]; };    // rows as in test_surface.py
uniform uint ray_count;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= ray_count) return;
    Ray ray = Ray(rays[2u * i].xyz, 0.0, rays[2u * i + 1u].xyz, rays[2u * i + 1u].w);
    Hit hit = closest_hit(ray);
    for (uint k = 0u; k < 8u; k++) surfaces[8u * i + k] = vec4(0.0);
    if (hit.triangle == ID_NONE) return;
    Surface s = surface_at(hit, ray, rays[2u * i].w);
    surfaces[8u * i] = vec4(s.point.position, s.point.offset);
    surfaces[8u * i + 1u] = vec4(s.point.n_geo, s.alpha);
    surfaces[8u * i + 2u] = vec4(s.bsdf.n, s.bsdf.roughness);
    surfaces[8u * i + 3u] = vec4(s.bsdf.n_coat, s.bsdf.metallic);
    surfaces[8u * i + 4u] = vec4(s.bsdf.base_color, s.occlusion);
    surfaces[8u * i + 5u] = vec4(s.emissive, s.unlit ? 1.0 : 0.0);
    surfaces[8u * i + 6u] = vec4(hit.bary, uintBitsToFloat(hit.triangle), 1.0);
    surfaces[8u * i + 7u] = vec4(s.bsdf.clearcoat, s.bsdf.clearcoat_roughness, s.bsdf.transmission, hit.t);
}
