// bench/any.comp -- whether anything blocks given rays: 4 bytes a ray.
#include "lib/bvh.glsl"
#include "bench/ray_buffer.glsl"

layout(std430) writeonly buffer Found { uint found[]; };    // 1 = blocked

void main() {
    uint i = ray_index();
    if (i >= ray_count) return;
    found[i] = max3(any_hit(ray_at(i))) <= 0.0 ? 1u : 0u;
#if USE_STEP_COUNTER
    steps[i] = step_count;
#endif
}
