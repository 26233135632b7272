// bench/closest.comp -- the nearest hit of given rays: 8 bytes a ray, as a tracer that shades later would keep.
#include "lib/bvh.glsl"
#include "bench/ray_buffer.glsl"

layout(std430) writeonly buffer Found { uvec2 found[]; };   // t, triangle

void main() {
    uint i = ray_index();
    if (i >= ray_count) return;
    Hit hit = closest_hit(ray_at(i));
    found[i] = uvec2(floatBitsToUint(hit.t), hit.triangle);
#if USE_STEP_COUNTER
    steps[i] = step_count;
#endif
}
