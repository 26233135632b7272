// probes/bsdf.comp -- lib/brdf.glsl and lib/sampling.glsl on materials and directions from a buffer: value and density at
// a given direction, and one drawn direction with its weight and density.
#include "lib/sampling.glsl"
#include "lib/random.glsl"

layout(local_size_x = 64) in;
// Six a case: base colour, metallic; f0, f90; roughness, transmission, clearcoat, its roughness; v; l; coat normal. n is +Z.
layout(std430) readonly buffer Cases { vec4 cases[]; };
layout(std430) writeonly buffer Results { vec4 results[]; };   // value, density; drawn direction, density; weight, 0
uniform uint count;
uniform uint repeats;    // draws a case
uniform uint seed;

void main() {
    uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u;
    if (i >= count * repeats) return;
    uint k = 6u * (i / repeats);
    Bsdf b;
    b.base_color = cases[k].xyz;
    b.metallic = cases[k].w;
    b.f0_dielectric = cases[k + 1u].xyz;
    b.f90_dielectric = cases[k + 1u].w;
    b.roughness = cases[k + 2u].x;
    b.alpha = max(square(b.roughness), 4e-4);
    b.transmission = cases[k + 2u].y;
    b.clearcoat = cases[k + 2u].z;
    b.clearcoat_roughness = cases[k + 2u].w;
    b.n = vec3(0.0, 0.0, 1.0);
    b.n_coat = cases[k + 5u].xyz;
    vec3 v = cases[k + 3u].xyz, l = cases[k + 4u].xyz;
    random_seed(uvec2(i & 0xFFFFu, i >> 16u), 0u, seed);
    vec3 weight;
    float pdf;
    float choice = random_float();
    vec3 drawn = bsdf_sample(b, v, choice, random_vec2(), weight, pdf);
    results[3u * i] = vec4(bsdf_eval(b, v, l), bsdf_pdf(b, lobes_of(b, v), v, l));
    results[3u * i + 1u] = vec4(drawn, pdf);
    results[3u * i + 2u] = vec4(weight, 0.0);
}
