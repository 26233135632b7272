// passes/baked.comp -- visibility of a pixel from the light maps: a layer a light, as passes/shadow.comp.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

#if USE_BLENDED
layout(rgba16f) writeonly uniform image2DArray out_visibility;
#else
layout(r8) writeonly uniform image2DArray out_visibility;
#endif

#if USE_REASON_SHADOWS
layout(r8ui) writeonly uniform uimage2D out_reason_shadows;

// Side of a texel on the triangle or the sphere of a hit, m.
float texel_size(Hit hit, uvec4 tri, Instance inst) {
    ivec4 place = ivec4(texelFetch(lightmap_places, int(texelFetch(lightmap_places, int(hit.instance)).x + tri.w)));
    mat3 world_from_object = mat3(inst.world_from_object[0], inst.world_from_object[1], inst.world_from_object[2]);
    if (SPHERES && tri.x == tri.y) {                                       // 2 w texels a side for 4 pi r^2
        float radius = sphere_radius(tri) * pow(abs(determinant(world_from_object)), 1.0 / 3.0);
        return sqrt(PI) * radius / max(float(place.w), 1.0);
    }
    int row = 2 * (place.w + int(hit.triangle));
    vec4 a = uintBitsToFloat(texelFetch(lightmap_uv, row));
    vec2 c = uintBitsToFloat(texelFetch(lightmap_uv, row + 1).xy), b = a.zw - a.xy;
    c -= a.xy;
    vec3 v0 = vertex_position(tri.x);
    vec3 n = cross(world_from_object * (vertex_position(tri.y) - v0), world_from_object * (vertex_position(tri.z) - v0));
    return sqrt(length(n) / max(abs(b.x * c.y - b.y * c.x), 1e-12));
}
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    if (!covered(p)) {
        for (uint i = 0u; i < frame.light_count; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
#if USE_REASON_SHADOWS
        imageStore(out_reason_shadows, px, uvec4(REASON_NONE));
#endif
        return;
    }
    // The facet decides, as in passes/shadow.comp: where only the shading normal faces away, the BRDF is 0.
    Point q = point_at(p.hit, p.ray);
    bool unlit = material_row(hit_group_of(p.hit.instance, p.hit.geometry).material).unlit == 1u;
    uvec4 tri = texelFetch(triangles, int(p.hit.triangle));
    Instance inst = instance_row(p.hit.instance);
    vec3 at = lightmap_at(p.hit, q, tri, inst);
#if USE_REASON_SHADOWS
    bool coarse = texel_size(p.hit, tri, inst) > footprint(p.hit.t);
    uint reason = REASON_NONE;
#endif
    for (uint i = 0u; i < frame.light_count; i++) {
        LightSample l = light_at(light_row(i), q.position);
        vec3 visibility = vec3(0.0);
        if (arrives(l) && dot(q.n_geo, l.dir) > 0.0 && !unlit) visibility = lightmap_visibility(at, i);
        if (!BLENDED) visibility = in_8_bits(visibility);
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
#if USE_REASON_SHADOWS
        bool border = between_in_8_bits(visibility.x);
        if (coarse && border && light_row(i).size == 0.0) reason = REASON_COARSE;
#endif
    }
#if USE_REASON_SHADOWS
    imageStore(out_reason_shadows, px, uvec4(reason));
#endif
}
