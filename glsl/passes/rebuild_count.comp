// passes/rebuild_count.comp -- a digit of a radix sort: how often each value occurs in each work group's part.
#include "layout.glsl"

layout(local_size_x = 512) in;

layout(std430) readonly buffer PairsIn { uvec2 pairs_in[]; };
layout(std430) writeonly buffer Digits { uint digits[]; };             // by group, then value
uniform int item_total;
uniform int sort_shift;
uniform int sort_rounds;                                               // of 512 pairs a group

shared uint occurs[256];

void main() {
    uint i = gl_LocalInvocationID.x, group = gl_WorkGroupID.x;
    if (i < 256u) occurs[i] = 0u;
    memoryBarrierShared();
    barrier();
    for (uint k = 0u; k < uint(sort_rounds); k++) {
        uint at = (group * uint(sort_rounds) + k) * 512u + i;
        if (at < uint(item_total)) atomicAdd(occurs[pairs_in[at].x >> uint(sort_shift) & 255u], 1u);
    }
    memoryBarrierShared();
    barrier();
    if (i < 256u) digits[256u * group + i] = occurs[i];
}
