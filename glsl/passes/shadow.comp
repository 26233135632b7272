// passes/shadow.comp -- one any-hit ray per pixel and light, only where a surface faces the light.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

#if USE_BLENDED
layout(rgba16f) writeonly uniform image2DArray out_visibility;
#else
layout(r8) writeonly uniform image2DArray out_visibility;
#endif

// Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II (2021), ch. 4: leave from the surface that the vertex
// normals promise, not from the flat triangle under it.
Point smooth_point(Pixel p, Surface s) {
    Point q = s.point;
    uvec4 tri = texelFetch(triangles, int(p.hit.triangle));
    Instance inst = instances[p.hit.instance];
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

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    if (!covered(p)) {
        for (uint i = frame.light_first; i < frame.light_end; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
        return;
    }
    Surface s = load_surface(p);
    Point from = s.point;
    if (TERMINATOR && !(SPHERES && hit_group_of(p.hit.instance, p.hit.geometry).kind == KIND_SPHERE)) from = smooth_point(p, s);
    for (uint i = frame.light_first; i < frame.light_end; i++) {
        LightSample l = light_at(lights[i], s.point.position);
        vec3 visibility = vec3(0.0);
        // A mended point leaves on the viewer's side, even where the light lies behind the facet.
        vec3 origin = TERMINATOR ? from.position + from.offset * from.n_geo : ray_origin(from, l.dir);
        if (arrives(l) && faces(s, l.dir)) visibility = any_hit(Ray(origin, 0.0, l.dir, l.distance));
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
    }
}
