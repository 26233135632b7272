// passes/reference_shade.comp -- `reference` in parts, 2: at each path's surface, its own light, rays to look for more, and
// the direction to go on in. Unbiased: next-event estimation with multiple importance sampling (Veach 1997, balance
// heuristic), no clamp; Russian roulette.
#include "lib/path.glsl"
#include "lib/surface.glsl"
#include "lib/light.glsl"
#include "lib/environment_sample.glsl"
#include "lib/sampling.glsl"

#if USE_EMITTERS
layout(std430) readonly buffer Emitters { Emitter emitters[]; };
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
#if USE_SPHERES
// The cone that a sphere fills, seen from the origin of a ray, in object space: its axis, and 1 - cos of its half angle,
// which is 0 from within.
vec3 sphere_cone(uvec4 tri, Instance inst, vec3 origin, out float one_minus_cos) {
    mat3 object_from_world = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
    vec3 axis = vertex_position(tri.x) - (object_from_world * origin + inst.object_from_world[3]);
    float sin2 = square(sphere_radius(tri)) / dot(axis, axis);
    one_minus_cos = sin2 < 1.0 ? sin2 / (1.0 + sqrt(1.0 - sin2)) : 0.0;
    return normalize(axis);
}

// Density over solid angle of sending a ray to a shining sphere: even over the cone in object space. The far side, seen
// through a hole in the near one, is not sent to.
float sphere_pdf(Hit hit, Ray ray, float light) {
    Instance inst = instance_row(hit.instance);
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    mat3 object_from_world = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
    float one_minus_cos;
    vec3 axis = sphere_cone(tri, inst, ray.origin, one_minus_cos), dir = object_from_world * ray.dir;
    vec3 met = object_from_world * (ray.origin + hit.t * ray.dir) + inst.object_from_world[3] - vertex_position(tri.x);
    if (one_minus_cos <= 0.0 || dot(met, dir) > 1e-3 * sphere_radius(tri) * length(dir)) return 0.0;
    float shrink = abs(determinant(object_from_world)), k = length(dir);     // solid angles grow by k^3 over the determinant
    float share = light * 4.0 * PI * square(sphere_radius(tri)) * pow(shrink, -2.0 / 3.0) / frame.emissive_weight;
    return share * shrink / (2.0 * PI * one_minus_cos * k * k * k);
}
#endif

// Density over solid angle of picking the point of a shining surface that a ray met.
float emitter_pdf(Hit hit, Ray ray, Surface s) {
    HitGroup group = hit_group_of(hit.instance, hit.geometry);
    float light = luminance(material_row(group.material).emissive);
#if USE_SPHERES
    if (group.kind == KIND_SPHERE) return sphere_pdf(hit, ray, light);
#endif
    float cos_theta = abs(dot(s.point.n_geo, ray.dir));
    return light / frame.emissive_weight * square(hit.t) / max(cos_theta, 1e-9);
}

// A ray to a point of an emitter, and the hit that it has there.
Ray toward_emitter(Emitter e, vec3 from, vec2 xi, out Hit hit) {
    uvec4 tri = texelFetch(triangles, int(e.triangle));
    Instance inst = instance_row(e.instance);
    Ray ray = Ray(from, 0.0, vec3(0.0), INFINITY);
#if USE_SPHERES
    if (tri.x == tri.y) {
        hit = Hit(0.0, vec2(0.0), e.instance, e.triangle, tri.w);
        float one_minus_cos;
        vec3 axis = sphere_cone(tri, inst, from, one_minus_cos);
        if (one_minus_cos <= 0.0) return ray;
        float z = 1.0 - xi.x * one_minus_cos, r = sqrt(max(0.0, 1.0 - z * z)), phi = 2.0 * PI * xi.y;
        ray.dir = normalize(mat3(inst.world_from_object[0], inst.world_from_object[1], inst.world_from_object[2])
                            * (basis(axis) * vec3(r * cos(phi), r * sin(phi), z)));
        bool met, front;
        hit = hit_known(ray, e.instance, e.triangle, met, front);              // a miss by rounding: where it passes closest
        return ray;
    }
#endif
    float r = sqrt(xi.x);
    hit = Hit(0.0, vec2(r * (1.0 - xi.y), r * xi.y), e.instance, e.triangle, tri.w);
    vec3 d = triangle_point(tri, hit.bary, inst).position - from;
    hit.t = length(d);
    if (hit.t > 0.0) ray.dir = d / hit.t;
    return ray;
}

Connection shining(Surface s, vec3 v, float pick, vec2 xi) {
    Connection c = DARK;
    int lo = 0, hi = emitters.length() - 1;
    while (lo < hi) { int mid = (lo + hi) / 2; if (emitters[mid].cdf > pick) hi = mid; else lo = mid + 1; }
    Emitter e = emitters[lo];
    Hit hit;
    Ray ray = toward_emitter(e, s.point.position, xi, hit);
    if (hit.t > 0.0 && above(s, ray.dir)) {
        Surface there = surface_at(hit, ray, 0.0);
        float pdf = emitter_pdf(hit, ray, there);
        HitGroup group = hit_group_of(hit.instance, hit.geometry);
        bool back = false;                         // a sphere is met from outside
        if (group.kind == KIND_TRIANGLE) {
            uvec4 tri = texelFetch(triangles, int(e.triangle));
            back = dot(triangle_point(tri, hit.bary, instance_row(e.instance)).n_geo, ray.dir) > 0.0;
        }
        if (pdf > 0.0 && !(back && group.single_sided == 1u)) {
            vec3 from = ray_origin(s.point, ray.dir), target = ray_origin(there.point, -ray.dir);
            c.ray = Ray(from, 0.0, target - from, 1.0);
            float other = bsdf_pdf(s.bsdf, lobes_of(s.bsdf, v), v, ray.dir);
            c.light = bsdf_eval(s.bsdf, v, ray.dir) * there.emissive * there.alpha * mis(pdf, other) / pdf;
        }
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
