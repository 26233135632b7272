// passes/gbuffer.frag -- the ids of what covers a pixel. Cut-outs and spheres look at the exact ray, as the tracer does.
#if USE_ALPHA_TEST || USE_SPHERE_PROXY
#include "lib/texture.glsl"
#else
#include "lib/frame.glsl"
#endif

flat in uint instance;
flat in uint first_triangle;
layout(location = 0) out uvec2 out_id;

void main() {
    uint triangle = first_triangle + uint(gl_PrimitiveID);
#if USE_SPHERE_PROXY
    triangle = first_triangle;
#endif
#if USE_ALPHA_TEST || USE_SPHERE_PROXY
    Ray ray = primary_ray(ivec2(gl_FragCoord.xy));
    bool met, front;
    Hit hit = hit_uncut(ray, instance, triangle, met, front);
#endif
#if USE_SPHERE_PROXY
    if (!met || (SINGLE_SIDED && !front && hit_group_of(instance, hit.geometry).single_sided == 1u)) discard;
    Point p = sphere_point(texelFetch(triangles, int(triangle)), ray, hit.t, instance_row(instance));
    vec4 clip = frame.clip_from_world * vec4(p.position, 1.0);
    gl_FragDepth = CLIP_CONTROL ? clip.z / clip.w : clip.z / clip.w * 0.5 + 0.5;
#endif
#if USE_ALPHA_TEST
    HitGroup group = hit_group_of(instance, hit.geometry);
    Material m = material_row(group.material);
    if (group.any_hit == ANY_HIT_MASK && base_color_at(group.material, hit).a < m.alpha_cutoff) discard;
#endif
    out_id = uvec2(instance, triangle);
}
