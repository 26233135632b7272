// passes/rebuild_scan.comp -- sums of all counts before each one, in place: where each value of each group goes. One group.
#include "layout.glsl"

layout(local_size_x = 1024) in;

layout(std430) buffer Digits { uint digits[]; };
uniform int digit_total;

shared uint sums[1024];

void main() {
    uint i = gl_LocalInvocationID.x;
    uint share = (uint(digit_total) + 1023u) / 1024u;
    uint first = min(i * share, uint(digit_total)), last = min(first + share, uint(digit_total));
    uint own = 0u;
    for (uint k = first; k < last; k++) own += digits[k];
    sums[i] = own;
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
    uint sum = sums[i] - own;
    for (uint k = first; k < last; k++) {
        uint count = digits[k];
        digits[k] = sum;
        sum += count;
    }
}
