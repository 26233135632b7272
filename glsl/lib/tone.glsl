// lib/tone.glsl -- exposure, tone map, sRGB encoding: linear radiance to what a screen shows.
#include "lib/frame.glsl"
#include "lib/math.glsl"

layout(rgba8) writeonly uniform image2D out_display;
layout(std430) readonly buffer Exposure { float exposure_ev; };

// Stephen Hill's fit of the ACES reference transforms (BakingLab, 2016).
vec3 tone_aces(vec3 c) {
    c = mat3(0.59719, 0.07600, 0.02840, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777) * c;
    c = (c * (c + 0.0245786) - 0.000090537) / (c * (0.983729 * c + 0.4329510) + 0.238081);
    c = mat3(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602) * c;
    return clamp(c, 0.0, 1.0);
}

// Troy Sobotka's AgX, Benjamin Wrensch's polynomial (2023); the result is linear again.
vec3 tone_agx(vec3 c) {
    c = mat3(0.842479062253094, 0.0423282422610123, 0.0423756549057051, 0.0784335999999992, 0.878468636469772,
             0.0784336, 0.0792237451477643, 0.0791661274605434, 0.879142973793104) * c;
    c = clamp((log2(max(c, 1e-10)) + 12.47393) / (4.026069 + 12.47393), 0.0, 1.0);
    vec3 c2 = c * c, c4 = c2 * c2;
    c = 15.5 * c4 * c2 - 40.14 * c4 * c + 31.96 * c4 - 6.868 * c2 * c + 0.4298 * c2 + 0.1191 * c - 0.00232;
    c = mat3(1.19687900512017, -0.0528968517574562, -0.0529716355144438, -0.0980208811401368, 1.15190312990417,
             -0.0980434501171241, -0.0990297440797205, -0.0989611768448433, 1.15107367264116) * c;
    return clamp(pow(max(c, 0.0), vec3(2.2)), 0.0, 1.0);
}

// Khronos PBR Neutral tone mapper (2024).
vec3 tone_pbr_neutral(vec3 c) {
    const float start = 0.8 - 0.04, desaturation = 0.15;
    float x = min3(c);
    c -= x < 0.08 ? x - 6.25 * x * x : 0.04;
    float peak = max3(c);
    if (peak < start) return c;
    float d = 1.0 - start, new_peak = 1.0 - d * d / (peak + d - start);
    c *= new_peak / peak;
    return mix(c, vec3(new_peak), 1.0 - 1.0 / (desaturation * (peak - new_peak) + 1.0));
}

vec3 srgb_encode(vec3 c) {
    return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}

void show(ivec2 px, vec3 radiance) {
    // Up to what every curve can square without overflow.
    vec3 c = clamp(radiance * exp2(exposure_ev), 0.0, 1e9);
    if (frame.tone_map == TONE_ACES) c = tone_aces(c);
    if (frame.tone_map == TONE_AGX) c = tone_agx(c);
    if (frame.tone_map == TONE_PBR_NEUTRAL) c = tone_pbr_neutral(c);
    imageStore(out_display, px, vec4(in_8_bits(srgb_encode(clamp(c, 0.0, 1.0))), 1.0));
}
