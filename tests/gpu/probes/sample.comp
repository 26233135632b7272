// probes/sample.comp -- lib/texture.glsl's sampler at given coordinates.
#include "lib/texture.glsl"

layout(local_size_x = 64) in;
layout(std430) readonly buffer Samples { vec4 samples[]; };       // u, v, log2_area, 0
layout(std430) writeonly buffer Colors { vec4 colors[]; };
uniform uint sample_total;
uniform int texture_row;
uniform uint is_srgb;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= sample_total) return;
    vec4 s = samples[i];
    colors[i] = sample_texture(texture_row, s.xy, s.xy, s.z, is_srgb == 1u);
}
