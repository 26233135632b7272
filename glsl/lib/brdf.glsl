// lib/brdf.glsl -- glTF 2.0 metallic-roughness, appendix B, with KHR_materials_ior, specular, clearcoat: the one
// implementation that raster lighting, ray hits and the reference share.
// GGX with alpha = roughness^2, separable Smith (B.3.2, as written there; not height-correlated), Schlick, Lambert.
#include "lib/math.glsl"

// Under this roughness a surface is an exact mirror: no highlight from punctual lights. Above, alpha >= 4e-4.
const float MIRROR_ROUGHNESS = 0.02;

struct Bsdf {
    vec3 base_color;
    float metallic;
    float roughness, alpha;
    vec3 f0_dielectric;
    float f90_dielectric;
    float transmission;           // thin: this share of the diffuse light passes straight through
    float clearcoat, clearcoat_roughness;
    vec3 n, n_coat;               // shading normals; those of surface_at face the viewer
};

bool is_mirror(Bsdf b) { return b.roughness < MIRROR_ROUGHNESS; }

// n x h instead of 1 - NoH^2: no cancellation at the peak of a sharp lobe.
float ggx_d(vec3 n, vec3 h, float alpha) {
    vec3 nxh = cross(n, h);
    float NoH = dot(n, h);
    float d = dot(nxh, nxh) + square(NoH * alpha);
    return NoH <= 0.0 ? 0.0 : square(alpha / d) / PI;
}

float smith_g1(float NoX, float alpha) { return 2.0 * NoX / (NoX + sqrt(square(alpha) + (1.0 - square(alpha)) * square(NoX))); }

// G / (4 NoL NoV), separable.
float smith_v(float NoL, float NoV, float alpha) {
    float a2 = square(alpha);
    return 1.0 / ((NoL + sqrt(a2 + (1.0 - a2) * NoL * NoL)) * (NoV + sqrt(a2 + (1.0 - a2) * NoV * NoV)));
}

// Reflectance of the specular interface, both lobes mixed by metallic (B.2).
vec3 specular_fresnel(Bsdf b, float VoH) {
    return mix(fresnel_schlick(b.f0_dielectric, b.f90_dielectric, VoH), fresnel_schlick(b.base_color, 1.0, VoH), b.metallic);
}

// The specular f0 and f90 that split-sum tables take.
vec3 specular_f0(Bsdf b) { return mix(b.f0_dielectric, b.base_color, b.metallic); }
float specular_f90(Bsdf b) { return mix(b.f90_dielectric, 1.0, b.metallic); }

// Share of the light that the clearcoat reflects: the weight of its lobe, and what it takes from all below, emission
// included. By N.V, not V.H, so that the two add up to one (KHR_materials_clearcoat, "Layering").
float coat_fresnel(Bsdf b, vec3 v) { return b.clearcoat * (0.04 + 0.96 * pow5(clamp(1.0 - abs(dot(b.n_coat, v)), 0.0, 1.0))); }

// What passes straight through a thin surface: what neither coat nor interface reflects (KHR_materials_transmission). The
// roughness does not blur it.
vec3 transmitted(Bsdf b, vec3 v) {
    float reflected = max3(fresnel_schlick(b.f0_dielectric, b.f90_dielectric, abs(dot(b.n, v))));
    return b.base_color * (b.transmission * (1.0 - reflected) * (CLEARCOAT ? 1.0 - coat_fresnel(b, v) : 1.0));
}

// BSDF times NoL for light from l (above the surface), v towards the viewer; unit vectors. Mirrors have no lobe here.
vec3 bsdf_eval(Bsdf b, vec3 v, vec3 l) {
    float NoL = dot(b.n, l), NoV = dot(b.n, v);
    vec3 result = vec3(0.0);
    if (NoL > 0.0 && NoV > 0.0) {
        vec3 h = normalize(v + l);
        float VoH = dot(v, h);
        vec3 f_dielectric = fresnel_schlick(b.f0_dielectric, b.f90_dielectric, VoH);
        vec3 diffuse = (1.0 - b.metallic) * (1.0 - max3(f_dielectric)) * (1.0 - b.transmission) * b.base_color / PI;
        result = diffuse * NoL;
        if (!is_mirror(b)) result += specular_fresnel(b, VoH) * (ggx_d(b.n, h, b.alpha) * smith_v(NoL, NoV, b.alpha) * NoL);
    }
    if (CLEARCOAT) {
        float coat_NoL = dot(b.n_coat, l), coat_NoV = dot(b.n_coat, v);
        float coat = coat_fresnel(b, v);
        result *= 1.0 - coat;
        if (coat_NoL > 0.0 && coat_NoV > 0.0 && b.clearcoat_roughness >= MIRROR_ROUGHNESS) {
            vec3 h = normalize(v + l);
            float alpha = max(square(b.clearcoat_roughness), 4e-4);
            result += vec3(coat * ggx_d(b.n_coat, h, alpha) * smith_v(coat_NoL, coat_NoV, alpha) * coat_NoL);
        }
    }
    return result;
}

// A microfacet normal visible from v. Heitz, "Sampling the GGX Distribution of Visible Normals", JCGT 7(4) 2018.
vec3 ggx_sample_vndf(vec3 n, vec3 v, float alpha, vec2 xi) {
    mat3 frame_n = basis(n);
    vec3 ve = transpose(frame_n) * v;
    vec3 vh = normalize(vec3(alpha * ve.xy, ve.z));
    float lensq = dot(vh.xy, vh.xy);
    vec3 t1 = lensq > 0.0 ? vec3(-vh.y, vh.x, 0.0) * inversesqrt(lensq) : vec3(1.0, 0.0, 0.0);
    vec3 t2 = cross(vh, t1);
    float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
    float p1 = r * cos(phi), p2 = r * sin(phi);
    float s = 0.5 * (1.0 + vh.z);
    p2 = (1.0 - s) * sqrt(max(0.0, 1.0 - p1 * p1)) + s * p2;
    vec3 nh = p1 * t1 + p2 * t2 + sqrt(max(0.0, 1.0 - p1 * p1 - p2 * p2)) * vh;
    return frame_n * normalize(vec3(alpha * nh.xy, max(1e-7, nh.z)));
}

// Density over directions of reflecting v about a normal drawn above.
float ggx_pdf(vec3 n, vec3 v, vec3 h, float alpha) {
    float NoV = dot(n, v);
    return NoV <= 0.0 ? 0.0 : smith_g1(NoV, alpha) * ggx_d(n, h, alpha) / (4.0 * NoV);
}
