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

// Radiance of a hit. seen: the pixel px shows it, and the shadow pass has been there; else rays ask, or depth maps. One piece
// of code for both: a CPU runs what stands in either branch.
vec3 shade_found(Hit hit, Ray ray, float width, bool seen, ivec2 px) {
#if USE_SHADOW_BITS
    uint lit = 0u;
    Point p = point_at(hit, ray);
    for (uint i = 0u; i < frame.light_count; i++) {
        LightSample l = light_at(light_row(i), p.position);
        float arriving = 0.0;
        if (seen) arriving = texelFetch(visibility, ivec3(px, i), 0).r;
        else if (MIRROR_RAYS && arrives(l) && dot(p.n_geo, l.dir) > 0.0) arriving = visibility_of(p, l, i).x;
        lit |= arriving > 0.5 ? 1u << i : 0u;
    }
    return shade_hit(hit, ray, width, lit);
#else
    vec3 v = -ray.dir;
    Surface s = surface_at(hit, ray, width);
    if (s.unlit) return s.emissive;
    vec3 sum = s.emissive;
    for (uint i = 0u; i < frame.light_count; i++) {
        LightSample l = light_at(light_row(i), s.point.position);
        if (!arrives(l) || !faces(s, l.dir)) continue;
        vec3 light = bsdf_eval(s.bsdf, v, l.dir) * l.irradiance;
#if USE_VISIBILITY
        vec4 vis = texelFetch(visibility, ivec3(px, i), 0);
        if (seen) light *= BLENDED ? vis.rgb : vis.rrr;
        else if (MIRROR_RAYS) light *= visibility_from(s, l, i);
#endif
        sum += light;
    }
    bool bent;
    return sum + indirect_light(s, v, mirror_direction(s, v, bent), vec3(0.0), false);
#endif
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
            Hit hit = found.hit;
            bool seen = hit.triangle != ID_NONE;
            if (MIRROR_RAYS && !seen && reason != REASON_ENVIRONMENT) hit = closest_hit(ray);
            result.a = hit.t;
            if (MIRROR_RAYS || reason == REASON_ENVIRONMENT) result.rgb = environment_radiance(r);
            else result.rgb = environment_prefiltered(r, mirror_roughness(s));
            if (hit.triangle != ID_NONE) {
                float weight = MIRROR_RAYS ? 1.0 : inside_screen(found.px) * square(1.0 - smoothstep(0.0, 1.0, found.gap));
                result.rgb = mix(result.rgb, shade_found(hit, ray, width + spread * hit.t, seen, found.px), weight);
            }
#if USE_MIRROR_RAYS && USE_BLENDED
            result.rgb = through_layers(ray, width, spread, hit.t, result.rgb);
#endif
            if (reason == REASON_NONE && bent) reason = REASON_BELOW;
        }
    }
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
