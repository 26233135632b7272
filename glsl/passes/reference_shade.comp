// passes/reference_shade.comp -- `reference` in parts, 2: at each path's surface, its own light, rays to look for more, and
// the direction to go on in. Unbiased: next-event estimation with multiple importance sampling (Veach 1997, balance
// heuristic), no clamp; Russian roulette.
#include "lib/path.glsl"
#include "lib/surface.glsl"
#include "lib/light.glsl"
#include "lib/environment_sample.glsl"
#include "lib/sampling.glsl"

#if USE_EMITTERS
#include "lib/emitters.glsl"
#endif

// Light that may come straight from lamps, sky or shining triangles, and the ray that tells whether it does.
struct Connection { Ray ray; vec3 light; };

const Connection DARK = Connection(Ray(vec3(0.0), 0.0, vec3(0.0), 0.0), vec3(0.0));

bool above(Surface s, vec3 l) { return dot(s.point.n_geo, l) > 0.0; }

Connection lamps(Surface s, vec3 v, float pick, vec2 xi) {
    Connection c = DARK;
    uint i = min(uint(pick * float(frame.light_count)), frame.light_count - 1u);
    LightSample l = light_at(light_row(i), s.point.position);
    float cos_axis = 1.0;
#if USE_LIGHT_DISCS
    if (light_row(i).size > 0.0) l = toward_disc(l, light_row(i), xi, cos_axis);
#endif
    if (arrives(l) && above(s, l.dir)) {
        c.ray = Ray(ray_origin(s.point, l.dir), 0.0, l.dir, l.distance);
        c.light = bsdf_eval(s.bsdf, v, l.dir) * l.irradiance * (float(frame.light_count) / cos_axis);
    }
    return c;
}

#if USE_ENVIRONMENT
Connection sky(Surface s, vec3 v, vec2 xi, vec2 within) {
    Connection c = DARK;
    float pdf;
    vec3 l = environment_sample(xi, within, pdf);
    if (pdf > 0.0 && above(s, l)) {
        c.ray = Ray(ray_origin(s.point, l), 0.0, l, INFINITY);
        float other = bsdf_pdf(s.bsdf, lobes_of(s.bsdf, v), v, l);
        c.light = bsdf_eval(s.bsdf, v, l) * environment_radiance(l) * mis(pdf, other) / pdf;
    }
    return c;
}
#endif

#if USE_EMITTERS
Connection shining(Surface s, vec3 v, float pick, vec2 xi) {
    Connection c = DARK;
    float pdf;
    Surface there;
    vec3 dir = emitter_sample(s.point.position, pick, xi, there, pdf);
    if (pdf > 0.0 && above(s, dir)) {
        vec3 from = ray_origin(s.point, dir), target = ray_origin(there.point, -dir);
        c.ray = Ray(from, 0.0, target - from, 1.0);
        float other = bsdf_pdf(s.bsdf, lobes_of(s.bsdf, v), v, dir);
        c.light = bsdf_eval(s.bsdf, v, dir) * there.emissive * there.alpha * mis(pdf, other) / pdf;
    }
    return c;
}
#endif

// Notes a connection for the program that follows its ray; a list's bit if there is anything to follow.
uint look_for(Connection c, vec3 throughput, uint slot, uint list) {
    vec3 light = throughput * c.light;
    if (!(max3(light) > 0.0)) return 0u;
    uint part = PATH_LIGHT + PATH_LIGHT_PARTS * (list - TO_LAMPS);
    store_part(slot, part, c.ray.origin, floatBitsToUint(c.ray.t_max));
    store_part(slot, part + 1u, c.ray.dir, 0u);
    store_part(slot, part + 2u, light, 0u);
    return 1u << list;
}

// What the path has met, and the lists that it is on from here.
uint shade(uint slot) {
    uvec4 a = load_part(slot, PATH_ORIGIN), b = load_part(slot, PATH_DIRECTION), c = load_part(slot, PATH_THROUGHPUT);
    uvec4 d = load_part(slot, PATH_SUM), e = load_part(slot, PATH_HIT);
    if (c.w == ID_NONE) return 0u;
    Ray ray = Ray(uintBitsToFloat(a.xyz), 0.0, uintBitsToFloat(b.xyz), INFINITY);
    float pdf = uintBitsToFloat(a.w);              // of the direction followed; 0: camera or mirror
    vec3 throughput = uintBitsToFloat(c.xyz), sum = uintBitsToFloat(d.xyz);
    if (e.w == ID_NONE) {
#if USE_ENVIRONMENT
        float w = pdf > 0.0 ? mis(pdf, environment_pdf(ray.dir)) : 1.0;
        store_part(slot, PATH_SUM, sum + throughput * environment_radiance(ray.dir) * w, d.w);
#endif
        return 0u;
    }
    Hit hit = Hit(uintBitsToFloat(e.x), uintBitsToFloat(e.yz), b.w, e.w, texelFetch(triangles, int(e.w)).w);
    float footprint = frame.orthographic == 1u ? frame.pixel_angle : frame.pixel_angle * hit.t;
    Surface s = surface_at(hit, ray, depth == 0u ? footprint : 0.0);
    if (max3(s.emissive) > 0.0) {
        float w = 1.0;
#if USE_EMITTERS
        // An unlit surface shines in its base colour and is not in the table of emitters.
        if (pdf > 0.0 && !s.unlit) w = mis(pdf, emitter_pdf(hit, ray, s));
#endif
        store_part(slot, PATH_SUM, sum + throughput * s.emissive * w, d.w);
    }
    if (s.unlit || depth > frame.bounces) return 0u;
    uvec2 px = uvec2(c.w & 0xFFFFu, c.w >> 16u);
    uint number = d.w, lists = 0u;
    vec3 v = -ray.dir;
    vec2 pick = draw_point(px, number, DRAW_LIGHT);
    if (frame.light_count > 0u) lists |= look_for(lamps(s, v, pick.x, draw_point(px, number, DRAW_DISC)), throughput, slot, TO_LAMPS);
#if USE_ENVIRONMENT
    lists |= look_for(sky(s, v, draw_point(px, number, DRAW_SKY), draw_point(px, number, DRAW_WITHIN)), throughput, slot, TO_SKY);
#endif
#if USE_EMITTERS
    lists |= look_for(shining(s, v, pick.y, draw_point(px, number, DRAW_EMITTER)), throughput, slot, TO_EMITTERS);
#endif
    vec3 weight;
    vec2 choice = draw_point(px, number, DRAW_LOBE);
    vec3 l = bsdf_sample(s.bsdf, v, choice.x, draw_point(px, number, DRAW_DIRECTION), weight, pdf);
    throughput *= weight;
    if (!above(s, l) || max3(throughput) <= 0.0) return lists;
    if (depth >= 4u) {                             // Russian roulette
        float survive = min(max3(throughput), 0.95);
        if (choice.y >= survive) return lists;
        throughput /= survive;
    }
    store_part(slot, PATH_ORIGIN, ray_origin(s.point, l), floatBitsToUint(pdf));
    store_part(slot, PATH_DIRECTION, l, 0u);
    store_part(slot, PATH_THROUGHPUT, throughput, c.w);
    return lists | 1u << GOES_ON;
}

void main() {
    uint slot, lists = 0u;
    if (listed(GOES_ON, slot)) lists = shade(slot);
    join_lists(lists, slot);
}
