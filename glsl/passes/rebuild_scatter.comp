// passes/rebuild_scatter.comp -- a digit of a radix sort: every pair to its place, those of one value in the order they had.
#include "layout.glsl"

layout(local_size_x = 512) in;

layout(std430) readonly buffer PairsIn { uvec2 pairs_in[]; };
layout(std430) readonly buffer Places { uint places[]; };              // by group, then value
layout(std430) writeonly buffer PairsOut { uvec2 pairs_out[]; };
uniform int item_total;
uniform int sort_shift;
uniform int sort_rounds;

shared uint place[256];                                                // of the next pair, by value
shared uint has[256 * 16];                                             // by value, a bit a thread

void main() {
    uint i = gl_LocalInvocationID.x, group = gl_WorkGroupID.x;
    if (i < 256u) place[i] = places[256u * group + i];
    for (uint k = 0u; k < uint(sort_rounds); k++) {
        for (uint w = i; w < 4096u; w += 512u) has[w] = 0u;
        memoryBarrierShared();
        barrier();
        uint at = (group * uint(sort_rounds) + k) * 512u + i;
        bool here = at < uint(item_total);
        uvec2 pair = here ? pairs_in[at] : uvec2(0u);
        uint value = pair.x >> uint(sort_shift) & 255u, row = value * 16u, word = i >> 5u;
        if (here) atomicOr(has[row + word], 1u << (i & 31u));
        memoryBarrierShared();
        barrier();
        if (here) {
            int rank = bitCount(has[row + word] & ((1u << (i & 31u)) - 1u));
            for (uint w = 0u; w < word; w++) rank += bitCount(has[row + w]);
            pairs_out[place[value] + uint(rank)] = pair;
        }
        memoryBarrierShared();
        barrier();
        if (i < 256u) {
            int count = 0;
            for (uint w = 0u; w < 16u; w++) count += bitCount(has[i * 16u + w]);
            place[i] += uint(count);
        }
        memoryBarrierShared();
        barrier();
    }
}
