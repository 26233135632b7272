// passes/sky_dfg.comp -- the split-sum table: albedo of the specular lobe as F0 * scale + F90 * bias, over (NoV, roughness).
// Karis, "Real Shading in Unreal Engine 4" (2013), with visible-normal sampling and the separable Smith term.
#include "lib/brdf.glsl"
#include "layout.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
layout(rgba16f) writeonly uniform image2D out_dfg;

const uint SAMPLES = 256u;

void main() {
    ivec2 px = ivec2(gl_GlobalInvocationID.xy);
    vec2 at = vec2(px) / float(DFG_SIZE - 1);
    float NoV = max(at.x, 1e-3), alpha = max(square(at.y), 4e-4);
    vec3 v = vec3(sqrt(1.0 - NoV * NoV), 0.0, NoV), n = vec3(0.0, 0.0, 1.0);
    vec2 sum = vec2(0.0);
    for (uint i = 0u; i < SAMPLES; i++) {
        vec2 xi = vec2((float(i) + 0.5) / float(SAMPLES), float(bitfieldReverse(i)) * (1.0 / 4294967296.0));
        vec3 h = ggx_sample_vndf(n, v, alpha, xi);
        vec3 l = reflect(-v, h);
        if (l.z <= 0.0) continue;
        float weight = smith_g1(l.z, alpha), f = pow5(clamp(1.0 - dot(v, h), 0.0, 1.0));   // f * NoL / pdf = F * G1(l)
        sum += weight * vec2(1.0 - f, f);
    }
    imageStore(out_dfg, px, vec4(sum / float(SAMPLES), 0.0, 0.0));
}
