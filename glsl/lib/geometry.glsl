// lib/geometry.glsl -- the scene's tables, and from a hit to an exact point.
// Large arrays are read through buffer textures, small ones through storage blocks.
#include "lib/frame.glsl"
#include "lib/buffers.glsl"
#include "lib/math.glsl"

layout(std430) readonly buffer Instances { Instance instances[]; };
layout(std430) readonly buffer Records { Record records[]; };
layout(std430) readonly buffer HitGroups { HitGroup hit_groups[]; };
layout(std430) readonly buffer Materials { Material materials[]; };

struct Hit {
    float t;         // INFINITY: a miss
    vec2 bary;       // weights of the second and third vertex; a sphere: its uv, where an alpha test has asked for it
    uint instance;   // row of instances
    uint triangle;   // row of triangles; ID_NONE: a miss
    uint geometry;   // of the triangle, in its mesh
};

const Hit MISS = Hit(INFINITY, vec2(0.0), ID_NONE, ID_NONE, 0u);

Record record_of(uint instance, uint geometry) { return records[instance_row(instance).first_record + geometry]; }
HitGroup hit_group_of(uint instance, uint geometry) { return hit_groups[record_of(instance, geometry).hit_group]; }

float sphere_radius(uvec4 tri) { return uintBitsToFloat(texelFetch(vertices, int(tri.x) * 2 + 1).x); }
float next_after(float t) { return uintBitsToFloat(floatBitsToUint(t) + 1u); }    // of a t that is not negative
vec3 vertex_position(uint i) { return uintBitsToFloat(texelFetch(vertices, int(i) * 2).xyz); }

// A point on a surface, in world space, and how far off its plane rounding may have put it.
struct Point {
    vec3 position;
    vec3 n_geo;      // unit, of the front side: glTF turns the winding over in mirrored instances, as does this transform
    float offset;    // m along n_geo that is sure to clear the surface
    vec3 back;       // m towards where the ray that found it came from: stand_back
    vec2 uv;
};

// Error bounds of a point rebuilt from barycentrics, so that a ray leaving it along +-n_geo cannot find it again:
// NVIDIA, "Solving Self-Intersection Artifacts in DirectX Raytracing" (2023): 2^-24 per rounding, summed over the
// reconstruction, the transform to the world and the transform back that the next ray goes through.
float spawn_offset(vec3 object_err, vec3 position_os, vec3 position_ws, vec3 n_os, vec3 n_ws, float n_scale, Instance inst) {
    mat3 m = mat3(abs(inst.world_from_object[0]), abs(inst.world_from_object[1]), abs(inst.world_from_object[2]));
    mat3 w = mat3(abs(inst.object_from_world[0]), abs(inst.object_from_world[1]), abs(inst.object_from_world[2]));
    vec3 world_err = 1.7881394e-7 * (m * abs(position_os)) + 1.1920931e-7 * abs(inst.world_from_object[3]);
    object_err += 1.1920931e-7 * (w * abs(position_ws) + abs(inst.object_from_world[3]));
    // The offset itself is added in float: one more rounding of the position.
    world_err += 5.9604645e-8 * abs(position_ws);
    return dot(world_err, abs(n_ws)) + n_scale * dot(object_err, abs(n_os));
}

// These two sum in a fixed order, without fma: a point that has not moved is the same float wherever it is rebuilt.
vec3 interpolate(vec3 v0, vec3 e1, vec3 e2, vec2 bary) {
    precise vec3 p = v0 + (bary.x * e1 + bary.y * e2);                           // the base vertex last: least error
    return p;
}

vec3 transform_point(mat4x3 m, vec3 p) {
    precise vec3 q = m[3] + (m[0] * p.x + m[1] * p.y + m[2] * p.z);              // the translation last
    return q;
}

Point triangle_point(uvec4 tri, vec2 bary, Instance inst) {
    vec3 v0 = vertex_position(tri.x);
    vec3 e1 = vertex_position(tri.y) - v0;
    vec3 e2 = vertex_position(tri.z) - v0;
    vec3 p_os = interpolate(v0, e1, e2, bary);
    vec3 p_ws = transform_point(inst.world_from_object, p_os);
    // Scaled by the longest edge first: the cross product of tiny edges would underflow, of huge ones overflow.
    float extent = max3(abs(e1) + abs(e2) + abs(abs(e1) - abs(e2)));
    vec3 n_os = normalize(cross(e1 / extent, e2 / extent));
    vec3 n_ws = vec3(dot(inst.object_from_world[0], n_os), dot(inst.object_from_world[1], n_os),
                     dot(inst.object_from_world[2], n_os));                      // inverse transpose
    float n_scale = inversesqrt(dot(n_ws, n_ws));
    n_ws *= n_scale;
    vec3 object_err = 5.9604645e-8 * abs(v0) + 1.7881394e-7 * extent;
    return Point(p_ws, n_ws, spawn_offset(object_err, p_os, p_ws, n_os, n_ws, n_scale, inst), vec3(0.0), vec2(0.0));
}

vec2 sphere_uv(vec3 n_os) { return vec2(angle_of(n_os.x, n_os.z) / (2.0 * PI) + 0.5, angle_of(length(n_os.xz), n_os.y) / PI); }

// The point of a sphere in direction n_os (unit, object space) from its centre.
Point sphere_point_at(uvec4 tri, vec3 n_os, Instance inst) {
    vec3 centre = vertex_position(tri.x);
    float radius = sphere_radius(tri);
    vec3 p_os = centre + radius * n_os;
    vec3 p_ws = inst.world_from_object[3] + mat3(inst.world_from_object[0], inst.world_from_object[1],
                                                 inst.world_from_object[2]) * p_os;
    vec3 n_ws = vec3(dot(inst.object_from_world[0], n_os), dot(inst.object_from_world[1], n_os),
                     dot(inst.object_from_world[2], n_os));
    float n_scale = inversesqrt(dot(n_ws, n_ws));
    n_ws *= n_scale;
    // The quadratic's rounding grows with the radius, not with an edge: 2^-20 of it.
    vec3 object_err = 5.9604645e-8 * abs(centre) + 9.5367432e-7 * radius;
    return Point(p_ws, n_ws, spawn_offset(object_err, p_os, p_ws, n_os, n_ws, n_scale, inst), vec3(0.0), sphere_uv(n_os));
}

// The point of a sphere under a ray; bary is not used: the point is put back on the sphere along its radius.
Point sphere_point(uvec4 tri, Ray ray, float t, Instance inst) {
    mat3 object_from_world = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
    vec3 origin_os = object_from_world * ray.origin + inst.object_from_world[3];
    return sphere_point_at(tri, normalize(origin_os + t * (object_from_world * ray.dir) - vertex_position(tri.x)), inst);
}

// In a corner of two surfaces the point of one lies in the other's plane, and rounding may put it behind that: rays into the
// open would end where they start. What the ray that found the point came through is open, so they leave from a little way
// back along it. Four offsets clear surfaces that it passed at 1 : 200 and steeper (two: 1 : 20), and edges of shadows stay as
// exact as they are without. Half the way at most: a ray between two walls may be shorter than that.
void stand_back(inout Point p, Hit hit, Ray ray) { p.back = -min(4.0 * p.offset, 0.5 * hit.t) * ray.dir; }

// Where a ray leaves: on the side of the surface that `dir` points to.
vec3 ray_origin(Point p, vec3 dir) {
    // Through the surface: back is mirrored in its plane.
    float along = dot(dir, p.n_geo) >= 0.0 ? p.offset : -p.offset - 2.0 * dot(p.back, p.n_geo);
    return p.position + (p.back + along * p.n_geo);
}

// Barycentrics of a primary ray on the triangle that the raster says covers the pixel, clamped to it: the raster snaps
// vertices to 1/256 px, so at an edge the exact ray may pass just outside, and a grazing plane is then far away.
vec2 clamp_bary(vec2 b) {
    if (!(b.x == b.x && b.y == b.y)) return vec2(1.0 / 3.0);                     // an edge-on triangle: its middle
    b = max(b, vec2(0.0));
    float sum = b.x + b.y;
    return sum > 1.0 ? b / sum : b;
}

// The intersection function of KIND_SPHERE: the nearer root within [t_min, t_max]; front: the ray comes from outside.
// f: the ray's origin from the centre. A miss still sets t: to where the ray passes closest, or to the root it may not use.
// Haines et al., "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems (2019), ch. 7. `precise`: a ray
// that goes on from t must not find that root again, wherever this is inlined.
bool intersect_sphere(vec3 f, vec3 dir, float radius, float t_min, float t_max, out float t, out bool front) {
    precise float a = dot(dir, dir), b = -dot(f, dir);
    precise vec3 away = f + (b / a) * dir;
    precise float under = radius * radius - dot(away, away);
    precise float q = b + (b >= 0.0 ? 1.0 : -1.0) * sqrt(a * max(under, 0.0));
    precise float t0 = (dot(f, f) - radius * radius) / q, t1 = q / a;
    float near = min(t0, t1), far = max(t0, t1);
    front = near >= t_min;
    t = under < 0.0 ? b / a : (front ? near : far);
    return under >= 0.0 && t >= t_min && t <= t_max;
}

// The hit of a ray with the plane of one known triangle (or its sphere). met: a sphere may be missed; triangles are not.
Hit hit_known(Ray ray, uint instance, uint triangle, out bool met, out bool front) {
    Instance inst = instance_row(instance);
    uvec4 tri = texelFetch(triangles, int(triangle));
    mat3 object_from_world = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
    vec3 o = object_from_world * ray.origin + inst.object_from_world[3];
    vec3 d = object_from_world * ray.dir;
    vec3 v0 = vertex_position(tri.x);
    Hit hit = Hit(0.0, vec2(0.0), instance, triangle, tri.w);
    met = front = true;
    if (SPHERES && hit_group_of(instance, tri.w).kind == KIND_SPHERE) {
        met = intersect_sphere(o - v0, d, sphere_radius(tri), ray.t_min, ray.t_max, hit.t, front);
        if (ALPHA_TEST) hit.bary = sphere_uv(normalize(o + hit.t * d - v0));
        return hit;
    }
    vec3 e1 = vertex_position(tri.y) - v0, e2 = vertex_position(tri.z) - v0;
    vec3 s = o - v0;
    vec3 p = cross(d, e2), q = cross(s, e1);
    float inv_det = 1.0 / dot(e1, p);
    hit.bary = clamp_bary(vec2(dot(s, p), dot(d, q)) * inv_det);
    // t of the clamped point, so that distance and position tell one story.
    hit.t = dot(v0 + hit.bary.x * e1 + hit.bary.y * e2 - o, d) / dot(d, d);
    return hit;
}
