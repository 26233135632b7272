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
        for (uint i = frame.light_first; i < frame.light_end; i++) imageStore(out_visibility, ivec3(px, i), vec4(0.0));
        return;
    }
#if USE_TERMINATOR
    Surface s = load_surface(p);
    Point from = shadow_point(p, s);
#else
    // The facet decides, without a look at textures: where only the shading normal faces away, the BRDF is 0.
    Point from = point_at(p.hit, p.ray);
    bool unlit = material_row(hit_group_of(p.hit.instance, p.hit.geometry).material).unlit == 1u;
#endif
    FOR_SOME(uint, i, frame.light_first, frame.light_end) {                // else this pass does not run
        LightSample l = light_at(light_row(i), from.position);
        vec3 visibility = vec3(0.0);
#if USE_TERMINATOR
        if (arrives(l) && faces(s, l.dir)) visibility = any_hit(Ray(shadow_origin(from, l.dir), 0.0, l.dir, l.distance));
#else
        if (arrives(l) && dot(from.n_geo, l.dir) > 0.0 && !unlit) visibility = any_hit(Ray(ray_origin(from, l.dir), 0.0, l.dir, l.distance));
#endif
        imageStore(out_visibility, ivec3(px, i), vec4(visibility, 1.0));
    } END_FOR(i, frame.light_end)
}
