// lib/emitters.glsl -- shining triangles and spheres as lights: points on them drawn in proportion to area times luminance
// (glhybrid/emitters.py), and how densely.
#include "lib/surface.glsl"

layout(std430) readonly buffer Emitters { Emitter emitters[]; };

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

// Draws a point that shines, as seen from another: the direction to it, its surface, and the density of that direction over
// solid angle, 0 where it cannot be seen from there.
vec3 emitter_sample(vec3 from, float pick, vec2 xi, out Surface there, out float pdf) {
    int lo = 0, hi = emitters.length() - 1;
    while (lo < hi) { int mid = (lo + hi) / 2; if (emitters[mid].cdf > pick) hi = mid; else lo = mid + 1; }
    Emitter e = emitters[lo];
    Hit hit;
    Ray ray = toward_emitter(e, from, xi, hit);
    pdf = 0.0;
    if (hit.t > 0.0) {
        there = surface_at(hit, ray, 0.0);
        HitGroup group = hit_group_of(hit.instance, hit.geometry);
        bool back = false;                         // a sphere is met from outside
        if (group.kind == KIND_TRIANGLE) {
            uvec4 tri = texelFetch(triangles, int(e.triangle));
            back = dot(triangle_point(tri, hit.bary, instance_row(e.instance)).n_geo, ray.dir) > 0.0;
        }
        if (!(back && group.single_sided == 1u)) pdf = emitter_pdf(hit, ray, there);
    }
    return ray.dir;
}
