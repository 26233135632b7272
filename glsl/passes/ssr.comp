// passes/ssr.comp -- the mirror direction looked up in the G-buffer. What is found is shaded from its ids, as seen along the
// reflected ray and with the light that the shadow pass says arrives there: as ray-lerp does, but for the search. Where the
// march gives up stand the blurred sky (ssr) or an exact ray (ssr-ray).
#include "lib/march.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

layout(rgba32f) writeonly uniform image2D out_reflection;    // radiance, distance (inf: sky, 0: nothing was looked for)
#if USE_VISIBILITY
uniform sampler2DArray visibility;
#endif
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif
uniform float march_fade;            // share of the screen's width and height over which hits fade towards its border

vec3 shade_seen(Found found, Ray ray, float width) {
    vec3 v = -ray.dir;
    Surface s = surface_at(found.hit, ray, width);
    if (s.unlit) return s.emissive;
    vec3 sum = s.emissive;
    for (uint i = 0u; i < frame.light_count; i++) {
        LightSample l = light_at(lights[i], s.point.position);
        if (!arrives(l) || !faces(s, l.dir)) continue;
        vec3 light = bsdf_eval(s.bsdf, v, l.dir) * l.irradiance;
#if USE_VISIBILITY
        vec4 vis = texelFetch(visibility, ivec3(found.px, i), 0);
        light *= BLENDED ? vis.rgb : vis.rrr;
#endif
        sum += light;
    }
    bool bent;
    return sum + indirect_light(s, v, mirror_direction(s, v, bent), vec3(0.0), false);
}

// 1 in the middle of the screen, 0 at its border.
float inside_screen(ivec2 px) {
    vec2 away = 0.5 - abs((vec2(px) + 0.5) / vec2(frame.size_px) - 0.5);
    return march_fade > 0.0 ? clamp(min(away.x, away.y) / march_fade, 0.0, 1.0) : 1.0;
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    vec4 result = vec4(0.0);
    uint reason = REASON_NONE;
    if (covered(p)) {
        Surface s = load_surface(p);
        bool bent;
        vec3 r = mirror_direction(s, -p.ray.dir, bent);
        reason = REASON_ROUGH;
        if (sends_mirror_ray(s)) {
            Ray ray = Ray(ray_origin(s.point, r), 0.0, r, INFINITY);
            float width = footprint(p.hit.t), spread = frame.orthographic == 1u ? 0.0 : frame.pixel_angle;
            Found found = march(ray, px);
            reason = found.reason;
            result.a = found.hit.t;
            bool sure = found.hit.triangle != ID_NONE || reason == REASON_ENVIRONMENT;
#if USE_MIRROR_RAYS
            if (sure) {
                if (found.hit.triangle == ID_NONE) result.rgb = environment_radiance(r);
                else result.rgb = shade_seen(found, ray, width + spread * found.hit.t);
#if USE_BLENDED
                result.rgb = through_layers(ray, width, spread, found.hit.t, result.rgb);
#endif
            } else {
                Hit hit;
                result.rgb = trace_radiance(ray, width, spread, hit);
                result.a = hit.t;
            }
#else
            if (reason == REASON_ENVIRONMENT) result.rgb = environment_radiance(r);
            else result.rgb = environment_prefiltered(r, mirror_roughness(s));
            if (found.hit.triangle != ID_NONE) {
                float weight = inside_screen(found.px) * square(1.0 - smoothstep(0.0, 1.0, found.gap));
                result.rgb = mix(result.rgb, shade_seen(found, ray, width + spread * found.hit.t), weight);
            }
#endif
            if (reason == REASON_NONE && bent) reason = REASON_BELOW;
        }
    }
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
