// lib/sampling.glsl -- directions drawn from the BSDF: coat, specular interface, diffuse.
#include "lib/brdf.glsl"

struct Lobes { float coat, specular, diffuse; };   // probabilities, sum 1

Lobes lobes_of(Bsdf b, vec3 v) {
    float NoV = max(dot(b.n, v), 0.0);
    float f = luminance(specular_fresnel(b, NoV));
    float d = luminance(b.base_color) * (1.0 - b.metallic) * (1.0 - b.transmission);
    float coat = CLEARCOAT ? coat_fresnel(b, v) : 0.0;
    float specular = b.metallic >= 1.0 || d <= 0.0 ? 1.0 : clamp(f / max(f + d, 1e-6), 0.1, 0.9);
    coat = coat > 0.0 ? clamp(coat, 0.1, 0.9) : 0.0;
    return Lobes(coat, (1.0 - coat) * specular, (1.0 - coat) * (1.0 - specular));
}

// Density of the directions that bsdf_sample draws from its rough lobes.
float bsdf_pdf(Bsdf b, Lobes p, vec3 v, vec3 l) {
    vec3 h = normalize(v + l);
    float pdf = p.diffuse * max(dot(b.n, l), 0.0) / PI;
    if (!is_mirror(b)) pdf += p.specular * ggx_pdf(b.n, v, h, b.alpha);
    if (CLEARCOAT && p.coat > 0.0 && b.clearcoat_roughness >= MIRROR_ROUGHNESS)
        pdf += p.coat * ggx_pdf(b.n_coat, v, h, max(square(b.clearcoat_roughness), 4e-4));
    return pdf;
}

// Draws l, by numbers in [0, 1): choice for the lobe, xi for the direction in it. weight = BSDF * NoL / pdf.
// pdf 0: a mirror was followed.
vec3 bsdf_sample(Bsdf b, vec3 v, float choice, vec2 xi, out vec3 weight, out float pdf) {
    Lobes p = lobes_of(b, v);
    vec3 l;
    pdf = 0.0;
    weight = vec3(0.0);
    float under_coat = CLEARCOAT ? 1.0 - coat_fresnel(b, v) : 1.0;
    if (choice < p.coat) {
        if (b.clearcoat_roughness < MIRROR_ROUGHNESS) {
            weight = vec3(coat_fresnel(b, v) / p.coat);
            return reflect(-v, b.n_coat);
        }
        l = reflect(-v, ggx_sample_vndf(b.n_coat, v, max(square(b.clearcoat_roughness), 4e-4), xi));
    } else if (choice < p.coat + p.specular) {
        if (is_mirror(b)) {
            weight = specular_fresnel(b, dot(b.n, v)) * under_coat / p.specular;
            return reflect(-v, b.n);
        }
        l = reflect(-v, ggx_sample_vndf(b.n, v, b.alpha, xi));
    } else {
        float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
        l = basis(b.n) * vec3(r * cos(phi), r * sin(phi), sqrt(max(0.0, 1.0 - xi.x)));
    }
    pdf = bsdf_pdf(b, p, v, l);
    if (pdf > 0.0) weight = bsdf_eval(b, v, l) / pdf;
    return l;
}
