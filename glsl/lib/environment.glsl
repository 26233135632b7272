// lib/environment.glsl -- light from far away: the map itself, and its convolutions for rough and diffuse surfaces.
#include "lib/frame.glsl"
#include "lib/math.glsl"

#if USE_ENVIRONMENT_MAP
uniform sampler2D environment_map;      // equirect, rgba32f, row 0 is +Y
uniform sampler2D environment_rough;    // octahedral maps of PREFILTER_SIZES side by side, with a border texel, rgba16f
uniform sampler2D environment_diffuse;  // octahedral irradiance / pi, with a border texel
#elif USE_ENVIRONMENT
uniform vec3 environment_constant;
#endif

vec3 environment_from_world(vec3 d) {
    return vec3(dot(frame.environment_x, d), d.y, dot(frame.environment_z, d));
}

#if USE_ENVIRONMENT_MAP
// Bilinear by hand: exact weights, columns wrap, rows clamp; texel centres at 0.5.
vec3 environment_texels(vec3 d) {
    ivec2 size = textureSize(environment_map, 0);
    vec2 p = equirect(d) * vec2(size) - 0.5;
    ivec2 i = ivec2(floor(p));
    vec2 f = p - floor(p);
    int x0 = (i.x + size.x) % size.x, x1 = (i.x + 1) % size.x;
    int y0 = clamp(i.y, 0, size.y - 1), y1 = clamp(i.y + 1, 0, size.y - 1);
    return mix(mix(texelFetch(environment_map, ivec2(x0, y0), 0).rgb, texelFetch(environment_map, ivec2(x1, y0), 0).rgb, f.x),
               mix(texelFetch(environment_map, ivec2(x0, y1), 0).rgb, texelFetch(environment_map, ivec2(x1, y1), 0).rgb, f.x), f.y);
}

// One octahedral map of `size` texels at column x of an atlas; its border texel repeats what lies across the edge.
vec3 oct_texture(sampler2D atlas, int x, int size, vec3 d) {
    vec2 p = vec2(float(x) + 1.0, 1.0) + oct_encode(d) * float(size);
    return textureLod(atlas, p / vec2(textureSize(atlas, 0)), 0.0).rgb;
}
#endif

// Radiance from direction d (world, unit).
vec3 environment_radiance(vec3 d) {
#if USE_ENVIRONMENT_MAP
    return environment_texels(environment_from_world(d)) * frame.environment_intensity;
#elif USE_ENVIRONMENT
    return environment_constant * frame.environment_intensity;
#else
    return vec3(0.0);
#endif
}

// The environment blurred by the GGX lobe of this roughness about the mirror direction d (n = v = d).
vec3 environment_prefiltered(vec3 d, float roughness) {
#if USE_ENVIRONMENT_MAP
    vec3 e = environment_from_world(d);
    float level = clamp(roughness, 0.0, 1.0) * float(PREFILTER_LEVELS) - 1.0;   // level i holds roughness (i + 1) / levels
    int i = int(floor(level));
    int x = 0;
    for (int k = 0; k < i; k++) x += PREFILTER_SIZES[k] + 2;
    vec3 low, high;
    if (i < 0) { low = environment_texels(e); high = oct_texture(environment_rough, 0, PREFILTER_SIZES[0], e); }
    else {
        low = oct_texture(environment_rough, x, PREFILTER_SIZES[i], e);
        int j = min(i + 1, PREFILTER_LEVELS - 1);
        high = oct_texture(environment_rough, i < j ? x + PREFILTER_SIZES[i] + 2 : x, PREFILTER_SIZES[j], e);
    }
    return mix(low, high, level - floor(level)) * frame.environment_intensity;
#else
    return environment_radiance(d);
#endif
}

// Irradiance over pi on a surface with normal n, nothing in the way: times albedo it is radiance.
vec3 environment_irradiance(vec3 n) {
#if USE_ENVIRONMENT_MAP
    return oct_texture(environment_diffuse, 0, IRRADIANCE_SIZE, environment_from_world(n)) * frame.environment_intensity;
#else
    return environment_radiance(n);
#endif
}
