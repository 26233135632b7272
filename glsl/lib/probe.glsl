// lib/probe.glsl -- surroundings captured at a few points, seen from others through a box that stands for the walls.
// Box projection: Behc, "Box Projected Cubemap Environment Mapping" (2010); Lagarde & Zanuttini, "Local Image-based
// Lighting With Parallax-corrected Cubemap", SIGGRAPH 2012.
#include "lib/brdf.glsl"
#include "lib/environment.glsl"

#if USE_PROBES
uniform sampler2DArray probe_faces;    // +X -X +Y -Y +Z -Z of every probe, with a border texel
#if USE_PROBES_BLURRED
uniform sampler2DArray probe_rough;    // a layer a probe: octahedral maps of PREFILTER_SIZES, as the sky's
#endif
layout(std430) readonly buffer Probes { Probe probes[]; };    // the smallest reach first
uniform int probe_count;

vec3 probe_face(int probe, vec3 d) {
    vec3 a = abs(d);
    int axis = a.x >= a.y && a.x >= a.z ? 0 : (a.y >= a.z ? 1 : 2);
    float s = d[axis] < 0.0 ? -1.0 : 1.0;
    vec2 uv = axis == 0 ? vec2(s * d.z, d.y) : (axis == 1 ? vec2(s * d.x, d.z) : vec2(-s * d.x, d.y));
    vec2 size = vec2(textureSize(probe_faces, 0).xy);
    vec2 at = ((uv / a[axis] * 0.5 + 0.5) * (size - 2.0) + 1.0) / size;
    return textureLod(probe_faces, vec3(at, float(6 * probe + 2 * axis + (s < 0.0 ? 1 : 0))), 0.0).rgb;
}

#if USE_PROBES_BLURRED
vec3 probe_map(int probe, int x, int size, vec3 d) {
    vec2 p = vec2(float(x) + 1.0, 1.0) + oct_encode(d) * float(size);
    return textureLod(probe_rough, vec3(p / vec2(textureSize(probe_rough, 0).xy), float(probe)), 0.0).rgb;
}

#endif

// What a probe saw in direction d, blurred by the GGX lobe of this roughness: environment_prefiltered of the sky.
vec3 probe_prefiltered(int probe, vec3 d, float roughness) {
#if !USE_PROBES_BLURRED
    return probe_face(probe, d);                                           // mirrors alone
#else
    if (roughness < MIRROR_ROUGHNESS) return probe_face(probe, d);
    float level = clamp(roughness, 0.0, 1.0) * float(PREFILTER_LEVELS) - 1.0;
    int i = int(floor(level));
    int x = 0;
    for (int k = 0; k < i; k++) x += PREFILTER_SIZES[k] + 2;
    int j = clamp(i + 1, 0, PREFILTER_LEVELS - 1);
    vec3 d_unit = normalize(d), low;
    if (i < 0) low = probe_face(probe, d);
    else low = probe_map(probe, x, PREFILTER_SIZES[i], d_unit);
    return mix(low, probe_map(probe, i >= 0 && i < j ? x + PREFILTER_SIZES[i] + 2 : x, PREFILTER_SIZES[j], d_unit), level - floor(level));
#endif
}

// How much a probe has to say at a point: 1 in its reach.
float probe_weight(Probe probe, vec3 position) {
    vec3 outside = max(probe.reach_min - position, position - probe.reach_max);
    float away = max3(outside);
    return away <= 0.0 ? 1.0 : (probe.fade > 0.0 ? max(1.0 - away / probe.fade, 0.0) : 0.0);
}

// Distance from a point along dir to the wall of a probe's box.
float probe_wall(Probe probe, vec3 position, vec3 dir) {
    position = clamp(position, probe.box_min, probe.box_max);
    vec3 wall = mix(probe.box_min, probe.box_max, greaterThan(dir, vec3(0.0)));
    vec3 d = mix(dir, vec3(1e-20), lessThan(abs(dir), vec3(1e-20)));
    return max(min3(abs((wall - position) / d)), 0.0);
}

// What lies along the mirror direction: the probes in whose reach the point is, and the sky for the rest of it. wall: m to
// the box, INFINITY where no probe says anything.
vec3 probes_prefiltered(vec3 position, vec3 dir, float roughness, out float wall) {
    vec3 sum = vec3(0.0);
    float rest = 1.0;
    wall = INFINITY;
    for (int k = 0; k < probe_count && rest > 0.0; k++) {
        Probe probe = probes[k];
        float weight = rest * probe_weight(probe, position);
        if (weight > 0.0) {
            float t = probe_wall(probe, position, dir);
            if (wall == INFINITY) wall = t;
            vec3 seen = clamp(position, probe.box_min, probe.box_max) + t * dir;
            sum += weight * probe_prefiltered(k, seen - probe.position, roughness);
            rest -= weight;
        }
    }
    return rest > 0.0 ? sum + rest * environment_prefiltered(dir, roughness) : sum;
}
#endif

// What a specular lobe of this roughness shows where nothing is looked for: the surroundings as they were captured.
vec3 surroundings(vec3 position, vec3 dir, float roughness) {
#if USE_PROBES
    float wall;
    if (roughness < frame.mirror_cutoff) return probes_prefiltered(position, dir, roughness, wall);
#endif
    return environment_prefiltered(dir, roughness);
}
