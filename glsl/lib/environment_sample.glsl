// lib/environment_sample.glsl -- directions to the environment, drawn by texel in proportion to luminance times solid angle
// (glhybrid/environment_cdf.py), and how densely.
#include "lib/environment.glsl"

// Balance heuristic (Veach 1997).
float mis(float pdf, float other) { return pdf / (pdf + other); }

#if USE_ENVIRONMENT_MAP
uniform sampler2D environment_cdf;    // r32f; row y < H: along that row; row H: over rows (in its first H texels)

int search_cdf(int row, int count, float x) {      // first entry > x
    int lo = 0, hi = count - 1;
    while (lo < hi) {
        int mid = (lo + hi) / 2;
        if (texelFetch(environment_cdf, ivec2(mid, row), 0).r > x) hi = mid; else lo = mid + 1;
    }
    return lo;
}

float cdf_step(int i, int row) {
    return texelFetch(environment_cdf, ivec2(i, row), 0).r - (i > 0 ? texelFetch(environment_cdf, ivec2(i - 1, row), 0).r : 0.0);
}

float environment_pdf(vec3 d_ws) {
    vec3 d = environment_from_world(d_ws);
    ivec2 size = textureSize(environment_map, 0);
    ivec2 p = clamp(ivec2(equirect(d) * vec2(size)), ivec2(0), size - 1);
    float sin_theta = max(length(d.xz), 1e-6);
    return cdf_step(p.x, p.y) * cdf_step(p.y, size.y) * float(size.x * size.y) / (2.0 * PI * PI * sin_theta);
}

vec3 environment_sample(vec2 xi, vec2 within, out float pdf) {
    ivec2 size = textureSize(environment_map, 0);
    int y = search_cdf(size.y, size.y, xi.y);
    int x = search_cdf(y, size.x, xi.x);
    vec2 uv = (vec2(x, y) + within) / vec2(size);
    float phi = (uv.x - 0.5) * 2.0 * PI, theta = uv.y * PI;
    vec3 d = vec3(sin(theta) * sin(phi), cos(theta), -sin(theta) * cos(phi));
    // environment_from_world is a rotation about +Y: its inverse is its transpose.
    d = vec3(frame.environment_x.x * d.x + frame.environment_z.x * d.z, d.y, frame.environment_x.z * d.x + frame.environment_z.z * d.z);
    pdf = environment_pdf(d);
    return d;
}
#elif USE_ENVIRONMENT
float environment_pdf(vec3 d) { return 1.0 / (4.0 * PI); }
vec3 environment_sample(vec2 xi, vec2 within, out float pdf) {
    float z = 1.0 - 2.0 * xi.x, r = sqrt(max(0.0, 1.0 - z * z)), phi = 2.0 * PI * xi.y;
    pdf = 1.0 / (4.0 * PI);
    return vec3(r * cos(phi), r * sin(phi), z);
}
#endif
