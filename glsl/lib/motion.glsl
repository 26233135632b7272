// lib/motion.glsl -- where a point of a surface was a frame ago, in this frame's world: the same sums as for where it is.
#include "lib/gbuffer.glsl"

#if USE_MOVING
layout(std430) readonly buffer PreviousInstances { Placement previous_instances[]; };
#if USE_DEFORMING
uniform usamplerBuffer previous_vertices;
#else
#define previous_vertices vertices
#endif

vec3 previous_vertex(uint i) { return uintBitsToFloat(texelFetch(previous_vertices, int(i) * 2).xyz); }

vec3 previous_position(Hit hit, vec3 position_ws) {
    mat4x3 m = previous_instances[hit.instance].world_from_object;
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    vec3 v0 = previous_vertex(tri.x);
    vec3 e1 = previous_vertex(tri.y) - v0, e2 = previous_vertex(tri.z) - v0;
    // What has not moved is the same point: not rebuilt, since drivers may round the same sums apart.
    vec3 now_0 = vertex_position(tri.x);
    if (m == instance_row(hit.instance).world_from_object && v0 == now_0 && e1 == vertex_position(tri.y) - now_0 &&
        e2 == vertex_position(tri.z) - now_0) return position_ws;
    vec3 p_os = interpolate(v0, e1, e2, hit.bary);
    if (SPHERES && hit_group_of(hit.instance, tri.w).kind == KIND_SPHERE) {
        Instance inst = instance_row(hit.instance);
        p_os = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]) * position_ws
             + inst.object_from_world[3];
    }
    return transform_point(m, p_os);
}

// How far what was hit at a point has come since then, m: as filters want it, to float32 of where it is, and 0 if it stands.
vec3 came(Hit hit, vec3 position_ws) {
#if USE_DEFORMING
    return position_ws - previous_position(hit, position_ws);
#else
    mat4x3 m = previous_instances[hit.instance].world_from_object;
    Instance inst = instance_row(hit.instance);
    if (m == inst.world_from_object) return vec3(0.0);
    vec3 p_os = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]) * position_ws;
    return position_ws - transform_point(m, p_os + inst.object_from_world[3]);
#endif
}

// By how much a surface has turned since then, as the distance of two unit normals.
float turned(Hit hit, vec3 n_ws) {
    mat4x3 m = previous_instances[hit.instance].world_from_object;
    Instance inst = instance_row(hit.instance);
    vec3 n_os = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]) * n_ws;
#if USE_DEFORMING
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    if (!SPHERES || hit_group_of(hit.instance, tri.w).kind != KIND_SPHERE) {
        vec3 v0 = vertex_position(tri.x), u0 = previous_vertex(tri.x);
        vec3 now = cross(vertex_position(tri.y) - v0, vertex_position(tri.z) - v0);
        vec3 before = cross(previous_vertex(tri.y) - u0, previous_vertex(tri.z) - u0);
        if (now != before) n_os += length(n_os) * sign(dot(n_os, now)) * (normalize(before) - normalize(now));
    }
#else
    if (m == inst.world_from_object) return 0.0;
#endif
    return distance(n_ws, normalize(mat3(m[0], m[1], m[2]) * n_os));
}

// What a ray shows slides with what it met and with the surface that it left, whose normal has turned as well: how far in a
// frame, over the length it changes over. by, over: m.
float drift_of(vec3 by, float over) { return min(length(by) / max(over, 1e-30), 1e3); }
#else
vec3 previous_position(Hit hit, vec3 position_ws) { return position_ws; }
#endif
