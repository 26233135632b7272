// passes/reference.comp -- the picture as it should be: an unbiased path tracer on the same trees and the same BSDF.
// Next-event estimation with multiple importance sampling (Veach 1997, balance heuristic), no clamp, progressive.
#include "lib/surface.glsl"
#include "lib/light.glsl"
#include "lib/environment_sample.glsl"
#include "lib/sampling.glsl"
#include "lib/tile.glsl"

layout(rgba32f) uniform image2D radiance;          // running mean of all samples so far

#if USE_EMITTERS
layout(std430) readonly buffer Emitters { Emitter emitters[]; };
#endif

// ---- one vertex: light that comes straight from lamps, sky and shining triangles

bool above(Surface s, vec3 l) { return dot(s.point.n_geo, l) > 0.0; }

vec3 lamps(Surface s, vec3 v) {
    vec3 sum = vec3(0.0);
    if (frame.light_count > 0u) {
        uint i = min(uint(random_float() * float(frame.light_count)), frame.light_count - 1u);
        LightSample l = light_at(light_row(i), s.point.position);
        float cos_axis = 1.0;
#if USE_LIGHT_DISCS
        if (light_row(i).size > 0.0) l = toward_disc(l, light_row(i), random_vec2(), cos_axis);
#endif
        if (arrives(l) && above(s, l.dir))
            sum = bsdf_eval(s.bsdf, v, l.dir) * l.irradiance * (float(frame.light_count) / cos_axis)
                * any_hit(Ray(ray_origin(s.point, l.dir), 0.0, l.dir, l.distance));
    }
    return sum;
}

vec3 sky(Surface s, vec3 v) {
    vec3 sum = vec3(0.0);
#if USE_ENVIRONMENT
    float pdf;
    vec3 l = environment_sample(random_vec2(), random_vec2(), pdf);
    if (pdf > 0.0 && above(s, l)) {
        vec3 f = bsdf_eval(s.bsdf, v, l);
        float other = bsdf_pdf(s.bsdf, lobes_of(s.bsdf, v), v, l);
        sum = f * environment_radiance(l) * mis(pdf, other) / pdf * any_hit(Ray(ray_origin(s.point, l), 0.0, l, INFINITY));
    }
#endif
    return sum;
}

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

vec3 shining(Surface s, vec3 v) {
    float x = random_float();
    int lo = 0, hi = emitters.length() - 1;
    while (lo < hi) { int mid = (lo + hi) / 2; if (emitters[mid].cdf > x) hi = mid; else lo = mid + 1; }
    Emitter e = emitters[lo];
    Hit hit;
    Ray ray = toward_emitter(e, s.point.position, random_vec2(), hit);
    vec3 sum = vec3(0.0);
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
            vec3 f = bsdf_eval(s.bsdf, v, ray.dir);
            float other = bsdf_pdf(s.bsdf, lobes_of(s.bsdf, v), v, ray.dir);
            sum = f * there.emissive * there.alpha * mis(pdf, other) / pdf * any_hit(Ray(from, 0.0, target - from, 1.0));
        }
    }
    return sum;
}
#endif

// ---- blended surfaces on the way: passed, or met, in proportion to alpha

Hit next_hit(Ray ray, inout vec3 throughput, out bool passed_through) {
    Hit hit = closest_hit(ray);
    passed_through = false;
#if USE_BLENDED
    Ray rest = Ray(ray.origin, ray.t_min, ray.dir, hit.t);
    for (int i = 0; i < 32; i++) {
        Hit layer = closest_blended(rest);
        if (layer.triangle == ID_NONE) break;
        Surface s = surface_at(layer, ray, 0.0);
        rest.t_min = next_after(layer.t);
        if (random_float() >= s.alpha) continue;
        vec3 passes = transmitted(s.bsdf, -ray.dir);
        float through = min(max3(passes), 0.95);
        if (random_float() < through) { throughput *= passes / through; continue; }
        throughput /= 1.0 - through;
        hit = layer;
        break;
    }
#endif
    return hit;
}

vec3 path(Ray ray) {
    vec3 sum = vec3(0.0), throughput = vec3(1.0);
    float pdf = 0.0;                               // of the direction followed; 0: camera or mirror
    Surface from;
    for (uint depth = 0u; depth <= frame.bounces + 1u; depth++) {
        bool passed;
        Hit hit = next_hit(ray, throughput, passed);
        if (hit.triangle == ID_NONE) {
#if USE_ENVIRONMENT
            float w = pdf > 0.0 ? mis(pdf, environment_pdf(ray.dir)) : 1.0;
            sum += throughput * environment_radiance(ray.dir) * w;
#endif
            break;
        }
        float footprint = frame.orthographic == 1u ? frame.pixel_angle : frame.pixel_angle * hit.t;
        Surface s = surface_at(hit, ray, depth == 0u ? footprint : 0.0);
        float w = 1.0;
#if USE_EMITTERS
        // An unlit surface shines in its base colour and is not in the table of emitters.
        if (pdf > 0.0 && !s.unlit && max3(s.emissive) > 0.0) w = mis(pdf, emitter_pdf(hit, ray, s));
#endif
        sum += throughput * s.emissive * w;
        if (s.unlit || depth > frame.bounces) break;
        vec3 v = -ray.dir;
        sum += throughput * (lamps(s, v) + sky(s, v));
#if USE_EMITTERS
        sum += throughput * shining(s, v);
#endif
        vec3 weight;
        vec3 l = bsdf_sample(s.bsdf, v, weight, pdf);
        throughput *= weight;
        if (!above(s, l) || max3(throughput) <= 0.0) break;
        if (depth >= 4u) {                         // Russian roulette
            float survive = min(max3(throughput), 0.95);
            if (random_float() >= survive) break;
            throughput /= survive;
        }
        ray = Ray(ray_origin(s.point, l), 0.0, l, INFINITY);
    }
    return sum;
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < frame.sample_count; i++) {
        random_seed(uvec2(px), frame.sample_first + i, frame.seed);
        // jitter_px is the width of the box that samples spread over: 0 = pixel centres.
        vec2 offset = (random_vec2() - 0.5) * frame.jitter_px;
        sum += path(primary_ray(px, offset));
    }
    vec4 mean = vec4(sum / float(frame.sample_count), 1.0);
    float before = float(frame.sample_first), now = float(frame.sample_count);
    if (before > 0.0) mean = mix(mean, imageLoad(radiance, px), before / (before + now));
    imageStore(radiance, px, mean);
}
