// passes/sky_prefilter.comp -- the environment convolved once: GGX lobes of growing roughness, and the cosine.
// Karis (2013) with n = v = r, but summed, not sampled: the sky is a quadtree (glhybrid/sky_tree.py), and a node is taken
// whole, at its centre of light, where the lobe hardly changes across it, as Barnes & Hut (1986) sum gravity.
#include "layout.glsl"
#include "lib/brdf.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
layout(std430) readonly buffer SkyNodes { vec4 sky_nodes[]; };   // three each: glhybrid/sky_tree.py
uniform int levels;                    // of the tree
uniform float mean_radiance;           // of the sky
uniform int lobe;                      // level of PREFILTER_SIZES; -1: the cosine
uniform int column;                    // where the map lies in the atlas
layout(rgba16f) writeonly uniform image2D out_atlas;

const float FLATNESS = 0.3;            // radius of a node over the angle in which the lobe changes

// What light from a direction counts for, by its cosine to n. Half vectors lie at half the angle: 1 - N.H^2 = (1 - c) / 2.
float lobe_at(float c, float a2) {
    if (lobe < 0) return max(c, 0.0);
    return c > 0.0 ? c * square(a2 / (a2 + (1.0 - a2) * 0.5 * (1.0 - c))) : 0.0;
}

void main() {
    int size = lobe < 0 ? IRRADIANCE_SIZE : PREFILTER_SIZES[lobe];
    ivec2 px = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(px, ivec2(size + 2)))) return;
    // The border repeats what lies across the octahedron's edge: the same edge, mirrored about its middle.
    ivec2 p = px - 1;
    if (p.x < 0 || p.x >= size) p = ivec2(clamp(p.x, 0, size - 1), size - 1 - p.y);
    if (p.y < 0 || p.y >= size) p = ivec2(size - 1 - p.x, clamp(p.y, 0, size - 1));
    vec3 n = oct_decode((vec2(p) + 0.5) / float(size));
    float a2 = lobe < 0 ? 1.0 : square(square(float(lobe + 1) / float(PREFILTER_LEVELS)));
    vec3 sum = vec3(0.0);
    float whole = 0.0;
    for (int root = 0; root < 32; root++) {
        int level = 0, first = 0;                                          // first node of the level
        ivec2 at = ivec2(root & 7, root >> 3);
        while (true) {
            int i = 3 * (first + (at.y << (level + 3)) + at.x);
            vec4 light = sky_nodes[i], centre = sky_nodes[i + 1];
            float c = dot(n, centre.xyz);
            // That angle: the lobe's width near its middle, the distance from it far away, at most 0.4 where the horizon is
            // within the lobe. Brighter nodes are taken smaller.
            float reach = min(sqrt(4.0 * a2 + 2.0 - 2.0 * c), a2 < 0.02 ? 1.5 : 0.4);
            float limit = FLATNESS * clamp(inversesqrt(max3(light.rgb) / mean_radiance), 0.3, 1.0) * reach;
            if (level < levels - 1 && centre.w > limit) {
                first += 32 << (2 * level);
                level++;
                at *= 2;
                continue;
            }
            sum += lobe_at(c, a2) * light.w * light.rgb;
            whole += lobe_at(dot(n, sky_nodes[i + 2].xyz), a2) * light.w;
            while (level > 0 && (at.x & at.y & 1) == 1) {                  // the last of four: up
                level--;
                first -= 32 << (2 * level);
                at >>= 1;
            }
            if (level == 0) break;
            at += (at.x & 1) == 0 ? ivec2(1, 0) : ivec2(-1, 1);
        }
    }
    imageStore(out_atlas, px + ivec2(column, 0), vec4(min(sum / whole, 65504.0), 1.0));   // what a half float holds
}
