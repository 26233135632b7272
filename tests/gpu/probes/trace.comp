// probes/trace.comp -- rays from a buffer through lib/bvh.glsl, hits to a buffer.
#include "lib/bvh.glsl"
#include "lib/exact.glsl"

layout(local_size_x = 64) in;
layout(std430) readonly buffer Rays { vec4 rays[]; };      // origin, t_min; direction, t_max
layout(std430) writeonly buffer Hits { uvec4 hits[]; };    // t, bary, triangle; instance, geometry, light that arrives, 0
uniform uint ray_count;

void main() {
    uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u;
    if (i >= ray_count) return;
    Ray ray = Ray(rays[2u * i].xyz, rays[2u * i].w, rays[2u * i + 1u].xyz, rays[2u * i + 1u].w);
    Hit hit = closest_hit(ray);
#if USE_EXACT_DISTANCE
    hit.t = float(exact_t(hit, ray));
#endif
    hits[2u * i] = uvec4(floatBitsToUint(hit.t), floatBitsToUint(hit.bary), hit.triangle);
    hits[2u * i + 1u] = uvec4(hit.instance, hit.geometry, floatBitsToUint(max3(any_hit(ray))), 0u);
}
