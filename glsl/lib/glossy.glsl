// lib/glossy.glsl -- specular lobes as `ray-glossy` sees them: each is an image of its own, divided by the lobe's albedo,
// so that noise is filtered apart from what is exactly known.
#include "lib/shade.glsl"

struct Lobe { vec3 n; float roughness, alpha; };

Lobe base_lobe(Bsdf b) { return Lobe(b.n, b.roughness, b.alpha); }
Lobe coat_lobe(Bsdf b) { return Lobe(b.n_coat, b.clearcoat_roughness, max(square(b.clearcoat_roughness), 4e-4)); }

bool is_mirror(Lobe lobe) { return lobe.roughness < MIRROR_ROUGHNESS; }
bool is_traced(Lobe lobe) { return lobe.roughness < frame.mirror_cutoff; }

// Sky on the diffuse lobe, and both specular lobes: what reaches the viewer by way of other surfaces and the sky.
vec3 glossy_light(Surface s, vec3 v, vec3 base, vec3 coat) {
    Bsdf b = s.bsdf;
    vec3 result = diffuse_sky(s) + specular_albedo(b, v) * base;
    if (CLEARCOAT && b.clearcoat > 0.0) {
        float f = coat_fresnel(b, v);
        result *= 1.0 - f;
        result += f * coat;
    }
    return result;
}
