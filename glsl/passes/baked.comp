// passes/baked.comp -- visibility of a pixel from the light maps: a layer a light, as passes/shadow.comp.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/tile.glsl"

#if USE_BLENDED
layout(rgba16f) writeonly uniform image2DArray out_visibility;
#else
layout(r8) writeonly uniform image2DArray out_visibility;
#endif

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    Pixel p = load_pixel(px);
    if (!covered(p)) {
        for (uint i = 0u; i < frame.light_count; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
        return;
    }
    // The facet decides, as in passes/shadow.comp: where only the shading normal faces away, the BRDF is 0.
    Point q = point_at(p.hit, p.ray);
    bool unlit = material_row(hit_group_of(p.hit.instance, p.hit.geometry).material).unlit == 1u;
    vec3 at = lightmap_at(p.hit, q, texelFetch(triangles, int(p.hit.triangle)), instance_row(p.hit.instance));
    for (uint i = 0u; i < frame.light_count; i++) {
        LightSample l = light_at(light_row(i), q.position);
        vec3 visibility = vec3(0.0);
        if (arrives(l) && dot(q.n_geo, l.dir) > 0.0 && !unlit) visibility = lightmap_visibility(at, i);
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
    }
}
