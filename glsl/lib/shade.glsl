// lib/shade.glsl -- the closest-hit program's second half, and the miss program: radiance that leaves a surface towards
// a ray. `ray-lerp` of Kim (section 7): mirror ray and blurred sky, interpolated by roughness.
#include "lib/surface.glsl"
#include "lib/light.glsl"
#include "lib/environment.glsl"
#include "lib/probe.glsl"
#include "lib/shadow_map.glsl"
#include "lib/exact.glsl"
#include "lib/low_discrepancy.glsl"

#if USE_SPECULAR_SKY || USE_REFLECTIONS || USE_PROBES
uniform sampler2D dfg;    // (F0 scale, F90 bias) over (NoV, roughness): Karis, "Real Shading in Unreal Engine 4" (2013)

vec3 specular_albedo(Bsdf b, vec3 v) {
    float NoV = clamp(dot(b.n, v), 0.0, 1.0);
    if (is_mirror(b)) return specular_fresnel(b, NoV);
    // Texel centres carry the ends of both ranges.
    vec2 uv = (vec2(NoV, b.roughness) * float(DFG_SIZE - 1) + 0.5) / float(DFG_SIZE);
    vec2 ab = textureLod(dfg, uv, 0.0).rg;
    return specular_f0(b) * ab.x + specular_f90(b) * ab.y;
}
#endif

// Does the light reach the front of this surface at all, if nothing is in between?
bool faces(Surface s, vec3 l) {
    // Mended terminators (passes/shadow.comp) believe the vertex normals, not the facet.
    return (TERMINATOR || dot(s.point.n_geo, l) > 0.0) && (dot(s.bsdf.n, l) > 0.0 || (CLEARCOAT && dot(s.bsdf.n_coat, l) > 0.0)) && !s.unlit;
}

#if USE_LIGHT_DISCS
uniform int disc_rays;    // to a light with a size, from points that a reflection or a layer shows

// Rays to the light's disc from a point that no pixel stands for: its coordinates turn the sequence.
vec3 disc_visibility(Point p, LightSample l, uint light) {
    uvec3 x = floatBitsToUint(p.position);
    uvec2 start = sequence_start(ivec2(pcg(x.x ^ pcg(x.y)), pcg(x.z)), light, frame.seed);
    vec3 sum = vec3(0.0);
    FOR_SOME(int, i, 0, disc_rays) {
        float cos_axis;
        LightSample to = toward_disc(l, light_row(light), sequence_point(start, frame.number * uint(disc_rays) + uint(i)), cos_axis);
        if (dot(p.n_geo, to.dir) > 0.0) sum += any_hit(Ray(ray_origin(p, to.dir), 0.0, to.dir, to.distance));
    } END_FOR(i, disc_rays)
    return sum / float(disc_rays);
}
#endif

// The share of a light that arrives here: 0 or 1, between through tinted surfaces and in penumbras.
vec3 visibility_of(Point p, LightSample l, uint light) {
#if USE_LIGHT_DISCS
    if (light_row(light).size > 0.0) return disc_visibility(p, l, light);
#endif
    return any_hit(Ray(ray_origin(p, l.dir), 0.0, l.dir, l.distance));
}

// The same where the technique of shadows says how: a ray, or a look into the light's depth map or the light map.
vec3 visibility_from(Surface s, LightSample sample_ws, uint light) {
#if USE_SHADOW_MAPS
    return vec3(map_visibility(s.point, sample_ws.dir, light));
#elif USE_LIGHTMAP
    return lightmap_visibility(s.lightmap, light);
#else
    return visibility_of(s.point, sample_ws, light);
#endif
}

// Direct light of all lamps, each with its own shadow.
vec3 direct_light(Surface s, vec3 v) {
    vec3 sum = vec3(0.0);
    FOR_EACH(uint, i, 0u, frame.light_count) {
        LightSample l = light_at(light_row(i), s.point.position);
        if (arrives(l) && faces(s, l.dir)) {
            vec3 f = bsdf_eval(s.bsdf, v, l.dir) * l.irradiance;
#if USE_SHADOW_RAYS
            f *= visibility_from(s, l, i);
#endif
            sum += f;
        }
    } END_FOR(i, frame.light_count)
    return sum;
}

// The layer whose mirror direction a reflection ray follows: the smoother of base and clearcoat.
bool coat_leads(Bsdf b) { return CLEARCOAT && b.clearcoat > 0.0 && b.clearcoat_roughness < b.roughness; }
float mirror_roughness(Surface s) { return coat_leads(s.bsdf) ? s.bsdf.clearcoat_roughness : s.bsdf.roughness; }

bool sends_mirror_ray(Surface s) { return mirror_roughness(s) < frame.mirror_cutoff && !s.unlit; }

// Mirror direction at a surface; a direction under the geometric plane is bent back onto it.
vec3 mirror_direction(Surface s, vec3 v, out bool bent) {
    vec3 r = reflect(-v, coat_leads(s.bsdf) ? s.bsdf.n_coat : s.bsdf.n);
    float below = dot(r, s.point.n_geo);
    bent = below < 1e-4;
    if (bent) r = normalize(r + (1e-3 - below) * s.point.n_geo);
    return r;
}

// Sky on the diffuse lobe, nothing in the way.
vec3 diffuse_sky(Surface s) {
#if USE_ENVIRONMENT
    return s.bsdf.base_color * (1.0 - s.bsdf.metallic) * (1.0 - s.bsdf.transmission) * environment_irradiance(s.bsdf.n) * s.occlusion;
#else
    return vec3(0.0);
#endif
}

// Sky on the diffuse lobe, and what the specular lobe shows. `traced` is the radiance along the mirror
// direction; give the prefiltered sky there for a surface that spends no ray.
vec3 indirect_light(Surface s, vec3 v, vec3 mirror_dir, vec3 traced, bool has_traced) {
    Bsdf b = s.bsdf;
    vec3 result = diffuse_sky(s);
#if USE_SPECULAR_SKY || USE_REFLECTIONS || USE_PROBES
    vec3 specular = vec3(0.0);
    vec3 sky = SPECULAR_SKY || PROBES ? surroundings(s.point.position, mirror_dir, b.roughness) : vec3(0.0);
    specular = has_traced ? (is_mirror(b) ? traced : mix(traced, sky, b.roughness)) : sky;
    result += specular_albedo(b, v) * specular;
#endif
    if (CLEARCOAT && b.clearcoat > 0.0) {
        float f = coat_fresnel(b, v);
        result *= 1.0 - f;
#if USE_SPECULAR_SKY || USE_REFLECTIONS || USE_PROBES
        vec3 coat_sky = SPECULAR_SKY || PROBES ? surroundings(s.point.position, mirror_dir, b.clearcoat_roughness) : vec3(0.0);
        result += f * (has_traced ? mix(traced, coat_sky, b.clearcoat_roughness) : coat_sky);
#endif
    }
    return result;
}

#if USE_SHADOW_BITS
// Which lights reach the point of a hit: a bit each. These rays go before the surface is looked up, with nothing but the
// point alive.
uint lit_bits(Hit hit, Ray ray) {
    uint lit = 0u;
    Point p = point_at(hit, ray);
    vec3 from = ray_origin(p, p.n_geo);                                    // the same for all lights in front
    FOR_EACH(uint, i, 0u, LIGHTS) {
        LightSample l = light_at(light_row(i), from);
        if (arrives(l) && dot(p.n_geo, l.dir) > 0.0) lit |= any_hit(shadow_ray(from, l)).x > 0.0 ? 1u << i : 0u;
    } END_FOR(i, LIGHTS)
    return lit;
}
#else
uint lit_bits(Hit hit, Ray ray) { return 0u; }                             // direct_light finds out by itself
#endif

// Radiance of a hit seen by a reflection ray: no second reflection, the sky stands in (Kim, section 5). lit: lit_bits.
vec3 shade_hit(Hit hit, Ray ray, float footprint, uint lit) {
    vec3 v = -ray.dir;
    Surface s = surface_at(hit, ray, footprint);
    if (s.unlit) return s.emissive;
    vec3 sum = s.emissive;
#if USE_SHADOW_BITS
    FOR_EACH(uint, i, 0u, frame.light_count) {
        LightSample l = light_at(light_row(i), s.point.position);
        if ((lit >> i & 1u) == 1u && faces(s, l.dir)) sum += bsdf_eval(s.bsdf, v, l.dir) * l.irradiance;
    } END_FOR(i, frame.light_count)
#else
    sum += direct_light(s, v);
#endif
    bool bent;
    vec3 r = mirror_direction(s, v, bent);
    return sum + indirect_light(s, v, r, vec3(0.0), false);
}

vec3 shade_hit(Hit hit, Ray ray, float footprint) { return shade_hit(hit, ray, footprint, lit_bits(hit, ray)); }

// How much of a blended surface is seen, and what is behind it is multiplied by.
vec3 layer_transmittance(Surface s, vec3 v) { return 1.0 - s.alpha * (1.0 - transmitted(s.bsdf, v)); }

const int MAX_LAYERS = 8;    // of blended surfaces along one ray; those behind are not drawn

#if USE_BLENDED
// What the blended surfaces along a ray, up to a distance, add to and leave of the radiance behind them.
vec3 through_layers(Ray ray, float width_0, float spread, float t_end, vec3 radiance) {
    vec3 through = vec3(1.0), layers = vec3(0.0);
    Ray rest = Ray(ray.origin, ray.t_min, ray.dir, t_end);
    for (int i = 0; i < MAX_LAYERS; i++) {
        Hit layer = closest_blended(rest);
        if (layer.triangle == ID_NONE) break;
        Surface s = surface_at(layer, ray, width_0 + spread * layer.t);
        layers += through * s.alpha * shade_hit(layer, ray, width_0 + spread * layer.t);
        through *= layer_transmittance(s, -ray.dir);
        rest.t_min = next_after(layer.t);
    }
    return layers + through * radiance;
}
#endif

// A hit whose distance somebody will read.
Hit measured(Hit hit, Ray ray) {
#if USE_EXACT_DISTANCE
    hit.t = float(exact_t(hit, ray));
#endif
    return hit;
}

// Radiance along a ray whose cone has width_0 at its origin and widens by `spread` a metre: what a reflection shows.
// sky: how much of the environment counts.
vec3 trace_radiance(Ray ray, float width_0, float spread, float sky, out Hit hit) {
    hit = measured(closest_hit(ray), ray);
    vec3 radiance = vec3(0.0);
    if (hit.triangle == ID_NONE) radiance = sky * environment_radiance(ray.dir);
    else radiance = shade_hit(hit, ray, width_0 + spread * hit.t);
#if USE_BLENDED
    radiance = through_layers(ray, width_0, spread, hit.t, radiance);
#endif
    return radiance;
}

vec3 trace_radiance(Ray ray, float width_0, float spread, out Hit hit) { return trace_radiance(ray, width_0, spread, 1.0, hit); }
