// passes/exposure.comp -- log-average luminance of the picture to middle grey (Reinhard et al. 2002, eq. 1), in EV.
#include "lib/frame.glsl"
#include "lib/math.glsl"

layout(local_size_x = 1024) in;    // one group, as large as any device takes: 64 took a GPU 0.5 ms
layout(rgba32f) readonly uniform image2D radiance;
layout(std430) buffer Exposure { float exposure_ev; };
shared vec2 partial[1024];

const int SAMPLES_ACROSS = 256;    // of the picture, at most: the average needs no more

void main() {
    uint i = gl_LocalInvocationIndex;
    ivec2 steps = min(frame.size_px, ivec2(SAMPLES_ACROSS));
    vec2 sum = vec2(0.0);
    for (int n = int(i); n < steps.x * steps.y; n += 1024) {
        ivec2 px = ivec2((vec2(n % steps.x, n / steps.x) + 0.5) / vec2(steps) * vec2(frame.size_px));
        float l = luminance(imageLoad(radiance, px).rgb);
        if (l > 0.0 && l < INFINITY) sum += vec2(log2(clamp(l, 1e-6, 1e6)), 1.0);   // black pixels say nothing
    }
    partial[i] = sum;
    for (uint half_count = 512u; half_count > 0u; half_count >>= 1u) {
        memoryBarrierShared();
        barrier();
        if (i < half_count) partial[i] += partial[i + half_count];
    }
    if (i == 0u) exposure_ev = partial[0].y > 0.0 ? log2(0.18) - partial[0].x / partial[0].y : 0.0;
}
