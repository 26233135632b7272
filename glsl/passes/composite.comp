// passes/composite.comp -- direct light times visibility, emission, sky and reflection, then the blended layers in
// front: linear radiance of a pixel.
#define TEST_LAST    // this program alone is faster for it on an H100 too: Sponza 0.27 -> 0.24 ms, atrium 0.31 -> 0.22
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#if USE_GLOSSY
#include "lib/glossy.glsl"
#endif
#if USE_MIRROR_HITS
#include "lib/mirror_shade.glsl"
#endif
#if USE_ENCODES
#include "lib/tone.glsl"
#endif
#include "lib/tile.glsl"

layout(rgba32f) uniform image2D radiance;                  // coverage in a
#if USE_VISIBILITY
uniform sampler2DArray visibility;
#endif
#if USE_OCCLUSION
uniform sampler2D occlusion;
#endif
#if USE_REFLECTIONS && !USE_MIRROR_HITS
uniform sampler2D reflection;
#endif
#if USE_GLOSSY && USE_CLEARCOAT
uniform sampler2D reflection_coat;
#endif

// traced: what comes along the mirror ray, if it is this pass that shades what it met.
vec3 surface_radiance(Pixel p, Surface s, vec3 traced, ivec2 px) {
    if (s.unlit) return s.emissive;
#if USE_OCCLUSION
    s.occlusion *= texelFetch(occlusion, px, 0).r;
#endif
    vec3 v = -p.ray.dir;
    vec3 sum = s.emissive;
    FOR_EACH(uint, i, 0u, frame.light_count) {
        LightSample l = light_at(light_row(i), s.point.position);
        vec3 light = bsdf_eval(s.bsdf, v, l.dir) * l.irradiance;
#if USE_VISIBILITY
        vec4 vis = texelFetch(visibility, ivec3(px, i), 0);
        light *= BLENDED ? vis.rgb : vis.rrr;
#endif
        sum += arrives(l) && faces(s, l.dir) ? light : vec3(0.0);
    } END_FOR(i, frame.light_count)
#if USE_REFLECTIONS && !USE_MIRROR_HITS
    traced = texelFetch(reflection, px, 0).rgb;
#endif
    bool bent;
    vec3 r = mirror_direction(s, v, bent);
#if USE_GLOSSY
    vec3 coat = vec3(0.0);
#if USE_CLEARCOAT
    coat = texelFetch(reflection_coat, px, 0).rgb;
#endif
    return sum + glossy_light(s, v, traced, coat);
#else
    return sum + indirect_light(s, v, r, traced, REFLECTIONS && sends_mirror_ray(s));
#endif
}

#if USE_BLENDED
// Blended surfaces in front, nearest first: the order of the ray, so nothing needs sorting.
vec3 layers_over(Pixel p, vec3 behind) {
    vec3 layers = vec3(0.0), through = vec3(1.0);
    Ray rest = Ray(p.ray.origin, p.ray.t_min, p.ray.dir, p.hit.t);
    for (int i = 0; i < MAX_LAYERS; i++) {
        Hit hit = closest_blended(rest);
        if (hit.triangle == ID_NONE) break;
        Surface s = surface_at(hit, p.ray, footprint(hit.t));
        vec3 v = -p.ray.dir, color = s.emissive;
        if (!s.unlit) {
            bool bent;
            vec3 r = mirror_direction(s, v, bent), traced = vec3(0.0);
            color += direct_light(s, v);
#if USE_MIRROR_RAYS
            bool look = sends_mirror_ray(s);
            if (look) {
                Ray ray = Ray(ray_origin(s.point, r), 0.0, r, INFINITY);
                Hit seen = closest_hit(ray);
                if (seen.triangle == ID_NONE) traced = environment_radiance(r);
                else traced = shade_hit(seen, ray, footprint(hit.t + seen.t));
            }
            color += indirect_light(s, v, r, traced, look);
#else
            color += indirect_light(s, v, r, vec3(0.0), false);
#endif
        }
        layers += through * s.alpha * color;
        through *= layer_transmittance(s, v);
        rest.t_min = uintBitsToFloat(floatBitsToUint(hit.t) + 1u);
    }
    return layers + through * behind;
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    vec3 color = vec3(0.0);
    if (covered(p)) {
        vec3 traced = vec3(0.0);
#if USE_MIRROR_HITS
        traced = mirror_radiance(px, p).rgb;                               // first: less is alive beside its shading
#endif
        color = surface_radiance(p, load_surface(p), traced, px);
    }
    else color = environment_radiance(p.ray.dir);
#if USE_BLENDED
    color = layers_over(p, color);
#endif
    vec4 result = vec4(color, covered(p) ? 1.0 : 0.0);
    if (frame.accumulate > 0.0) {
        vec4 before = imageLoad(radiance, px);
        if (is_finite(before.rgb)) result = mix(result, before, frame.accumulate);
    }
    imageStore(radiance, px, result);
#if USE_ENCODES
    show(px, result.rgb);
#endif
}
