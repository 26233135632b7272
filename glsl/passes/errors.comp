// passes/errors.comp -- how far a picture is from another: sums over tiles of 8x8 pixels, which the host adds up.
#include "lib/tile.glsl"

layout(rgba8) readonly uniform image2D ours, theirs;                       // as displayed
layout(rgba32f) readonly uniform image2D ours_radiance, theirs_radiance;
// By tile: squared differences in levels of 255 over all channels; pixels whose relative error is finite; these errors'
// sum, as bits of a float; nothing.
layout(std430) writeonly buffer Errors { uvec4 errors[]; };

shared uvec2 counts[64];
shared float relatives[64];

void main() {
    uint i = gl_LocalInvocationIndex;
    ivec2 px = tile_pixel(), size = imageSize(ours);
    counts[i] = uvec2(0u);
    relatives[i] = 0.0;
    if (all(lessThan(px, size))) {                                         // groups overhang the edge
        ivec3 d = ivec3(round(imageLoad(ours, px).rgb * 255.0)) - ivec3(round(imageLoad(theirs, px).rgb * 255.0));
        vec3 truth = imageLoad(theirs_radiance, px).rgb, off = imageLoad(ours_radiance, px).rgb - truth;
        float relative = dot(off, off) / (dot(truth, truth) + 0.01);
        bool finite = relative < 3.4e38;                                   // false for NaN
        counts[i] = uvec2(uint(d.x * d.x + d.y * d.y + d.z * d.z), finite ? 1u : 0u);
        relatives[i] = finite ? relative : 0.0;
    }
    for (uint half_count = 32u; half_count > 0u; half_count >>= 1u) {
        memoryBarrierShared();
        barrier();
        if (i < half_count) {
            counts[i] += counts[i + half_count];
            relatives[i] += relatives[i + half_count];
        }
    }
    uint across = uint(size.x + 7) / 8u;
    if (i == 0u) errors[tile().y * across + tile().x] = uvec4(counts[0], floatBitsToUint(relatives[0]), 0u);
}
