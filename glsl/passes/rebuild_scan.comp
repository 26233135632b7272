// passes/rebuild_scan.comp -- where each value of each work group goes: sums of all counts before it. One group; four threads
// a value, which read neighbouring words together.
#include "layout.glsl"

layout(local_size_x = 1024) in;

layout(std430) readonly restrict buffer Digits { uint digits[]; };     // by group, then value
layout(std430) writeonly restrict buffer Places { uint places[]; };
uniform int sort_groups;

shared uint sums[1024];                                                // by value, then quarter of the groups

void main() {
    uint i = gl_LocalInvocationID.x, value = i & 255u, quarter = i >> 8u, row = 4u * value + quarter;
    uint share = (uint(sort_groups) + 3u) / 4u;
    uint first = min(quarter * share, uint(sort_groups)), last = min(first + share, uint(sort_groups));
    uint own = 0u;
    for (uint group = first; group < last; group++) own += digits[256u * group + value];
    sums[row] = own;
    memoryBarrierShared();
    barrier();
    for (uint reach = 1u; reach < 1024u; reach *= 2u) {
        uint before = i >= reach ? sums[i - reach] : 0u;
        memoryBarrierShared();
        barrier();
        sums[i] += before;
        memoryBarrierShared();
        barrier();
    }
    uint sum = sums[row] - own;
    for (uint group = first; group < last; group++) {
        places[256u * group + value] = sum;
        sum += digits[256u * group + value];
    }
}
