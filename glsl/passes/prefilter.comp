// passes/prefilter.comp -- the environment convolved once: GGX lobes of growing roughness, and the cosine.
// Karis (2013) with n = v = r; each sample reads the mip that covers its solid angle (Colbert & Krivanek, GPU Gems 3, ch. 20).
#include "layout.glsl"
#include "lib/brdf.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
uniform sampler2D environment_mips;    // equirect, all levels, linear
uniform int lobe;                      // level of PREFILTER_SIZES; -1: the cosine
uniform int column;                    // where the map lies in the atlas
layout(rgba16f) writeonly uniform image2D out_atlas;

const uint SAMPLES = 256u;

vec3 texels(vec3 d, float level) {
    return textureLod(environment_mips, equirect(d), level).rgb;
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
    mat3 to_world = basis(n);
    ivec2 map_size = textureSize(environment_mips, 0);
    float texel_angle = 4.0 * PI / float(map_size.x * map_size.y) * 1.5;   // mean solid angle; lat-long texels shrink to the poles
    float alpha = square(float(lobe + 1) / float(PREFILTER_LEVELS));
    vec4 sum = vec4(0.0);
    for (uint i = 0u; i < SAMPLES; i++) {
        vec2 xi = vec2((float(i) + 0.5) / float(SAMPLES), float(bitfieldReverse(i)) * (1.0 / 4294967296.0));
        vec3 l;
        float pdf, weight;
        if (lobe < 0) {
            float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
            l = to_world * vec3(r * cos(phi), r * sin(phi), sqrt(1.0 - xi.x));
            pdf = sqrt(1.0 - xi.x) / PI;
            weight = 1.0;
        } else {
            vec3 h = ggx_sample_vndf(n, n, alpha, xi);
            l = reflect(-n, h);
            weight = dot(n, l);
            pdf = ggx_pdf(n, n, h, alpha);
        }
        if (weight <= 0.0) continue;
        float level = max(0.0, 0.5 * log2(1.0 / (float(SAMPLES) * pdf * texel_angle)) + 1.0);
        sum += weight * vec4(texels(l, level), 1.0);
    }
    imageStore(out_atlas, px + ivec2(column, 0), vec4(min(sum.rgb / sum.w, 65504.0), 1.0));   // what a half float holds
}
