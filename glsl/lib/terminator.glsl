// lib/terminator.glsl -- where the shadow rays of a pixel leave from.
#include "lib/gbuffer.glsl"

// Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II (2021), ch. 4: leave from the surface that the vertex
// normals promise, not from the flat triangle under it.
Point smooth_point(Pixel p, Surface s) {
    Point q = s.point;
    uvec4 tri = texelFetch(triangles, int(p.hit.triangle));
    Instance inst = instance_row(p.hit.instance);
    mat3 to_world = mat3(inst.world_from_object[0], inst.world_from_object[1], inst.world_from_object[2]);
    mat3 normal_from_object = transpose(mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]));
    vec3 w = vec3(1.0 - p.hit.bary.x - p.hit.bary.y, p.hit.bary);
    vec3 lift = vec3(0.0);
    for (int i = 0; i < 3; i++) {
        vec3 n = normalize(normal_from_object * uintBitsToFloat(texelFetch(vertices, int(tri[i]) * 2 + 1).xyz));
        if (dot(n, s.point.n_geo) < 0.0) n = -n;
        vec3 from_vertex = q.position - (to_world * vertex_position(tri[i]) + inst.world_from_object[3]);
        lift -= w[i] * min(0.0, dot(from_vertex, n)) * n;
    }
    q.position += lift;
    return q;
}

// The side that the viewer sees is the one that lights shine on, even where a mended point's light lies behind the facet.
vec3 shadow_origin(Pixel p, Surface s) {
    Point from = s.point;
    if (TERMINATOR && !(SPHERES && hit_group_of(p.hit.instance, p.hit.geometry).kind == KIND_SPHERE)) from = smooth_point(p, s);
    return ray_origin(from, from.n_geo);
}
