// lib/shadow_rays.glsl -- one any-hit ray to each light of a dispatch, only where a surface faces it.
#include "lib/gbuffer.glsl"
#include "lib/shade.glsl"
#include "lib/terminator.glsl"

#if USE_BLENDED
layout(rgba16f) writeonly uniform image2DArray out_visibility;
#else
layout(r8) writeonly uniform image2DArray out_visibility;
#endif

void send_shadow_rays(ivec2 px, Pixel p) {
    if (!covered(p)) {
        for (uint i = LIGHT_FIRST; i < LIGHT_END; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
        return;
    }
#if USE_TERMINATOR
    Surface s = load_surface(p);
    vec3 from = shadow_origin(p, s);
#else
    // The facet decides, without a look at textures: where only the shading normal faces away, the BRDF is 0.
    Point point = point_at(p.hit, p.ray);
    vec3 from = ray_origin(point, point.n_geo);
    bool unlit = material_row(hit_group_of(p.hit.instance, p.hit.geometry).material).unlit == 1u;
#endif
    FOR_SOME(uint, i, LIGHT_FIRST, LIGHT_END) {                            // else this pass does not run
        LightSample l = light_at(light_row(i), from);
        vec3 visibility = vec3(0.0);
#if USE_TERMINATOR
        if (arrives(l) && faces(s, l.dir)) visibility = any_hit(shadow_ray(from, l));
#else
        if (arrives(l) && dot(point.n_geo, l.dir) > 0.0 && !unlit) visibility = any_hit(shadow_ray(from, l));
#endif
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
    } END_FOR(i, LIGHT_END)
}
