// passes/reference_mean.comp -- `reference` in parts, 4: the wave's paths become part of the running mean.
#include "lib/path.glsl"

layout(rgba32f) restrict uniform image2D radiance;                         // of all samples so far

void main() {
    uint slot = gl_GlobalInvocationID.x;
    ivec2 px = slot_pixel(slot);
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // tiles overhang the edge
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < wave.z; i++) {
        uint path = slot + i * wave.y * 64u;
        sum += uintBitsToFloat(load_part(path, PATH_SUM).xyz);
        for (uint kind = 0u; kind < LIGHT_KINDS; kind++)
            sum += uintBitsToFloat(load_part(path, PATH_LIGHT + PATH_LIGHT_PARTS * kind + 3u).xyz);
    }
    vec4 mean = vec4(sum / float(wave.z), 1.0);
    float before = float(frame.sample_first), now = float(wave.z);
    if (before > 0.0) mean = mix(mean, imageLoad(radiance, px), before / (before + now));
    imageStore(radiance, px, mean);
}
