// lib/exact.glsl -- the distance of a hit in double precision, for results that people measure with. Traversal's float t
// is off by up to 2 ulp of the coordinates, which at grazing rays and near the origin of a ray is more than 1e-5 of it.
#include "lib/geometry.glsl"

#if USE_EXACT_DISTANCE
double exact_t(Hit hit, Ray ray) {
    if (hit.triangle == ID_NONE) return double(hit.t);
    Instance inst = instance_row(hit.instance);
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    dvec3 d = dvec3(ray.dir), o = dvec3(ray.origin);
#if USE_SPHERES
    if (hit_group_of(hit.instance, hit.geometry).kind == KIND_SPHERE) {
        dmat3 to_object = dmat3(dvec3(inst.object_from_world[0]), dvec3(inst.object_from_world[1]), dvec3(inst.object_from_world[2]));
        dvec3 f = to_object * o + dvec3(inst.object_from_world[3]) - dvec3(vertex_position(tri.x)), e = to_object * d;
        double a = dot(e, e), b = -dot(f, e), radius = double(sphere_radius(tri));
        double under = b * b - a * (dot(f, f) - radius * radius), root = sqrt(max(under, 0.0LF));
        double near = (b - root) / a, far = (b + root) / a;
        return abs(near - double(hit.t)) <= abs(far - double(hit.t)) ? near : far;
    }
#endif
    dmat3 to_world = dmat3(dvec3(inst.world_from_object[0]), dvec3(inst.world_from_object[1]), dvec3(inst.world_from_object[2]));
    dvec3 v0 = dvec3(vertex_position(tri.x));
    dvec3 e1 = to_world * (dvec3(vertex_position(tri.y)) - v0), e2 = to_world * (dvec3(vertex_position(tri.z)) - v0);
    dvec3 n = cross(e1, e2);
    double facing = dot(d, n);
    if (facing == 0.0LF) return double(hit.t);                             // edge-on
    return dot(to_world * v0 + dvec3(inst.world_from_object[3]) - o, n) / facing;
}
#endif
