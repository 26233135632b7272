// passes/shadow_map.frag -- depth alone. Cut-outs and spheres look along the exact ray of the light, as the tracer does.
#if USE_ALPHA_TEST || USE_SPHERE_PROXY
#include "lib/texture.glsl"

layout(std430) readonly buffer ShadowMaps { ShadowMap shadow_maps[]; };
uniform uint map_index;

flat in uint instance;
flat in uint first_triangle;

// The light's ray through the middle of a texel.
Ray texel_ray(ShadowMap map) {
    vec2 side = (gl_FragCoord.xy - vec2(map.corner) + map.first_texel) * map.texel;
    vec3 across = side.x * map.right + side.y * map.up;
    if (map.near > 0.0) return Ray(map.origin, 0.0, normalize(map.axis + across), INFINITY);
    return Ray(map.origin + across + map.start * map.axis, 0.0, map.axis, INFINITY);
}

void main() {
    ShadowMap map = shadow_maps[map_index];
    uint triangle = first_triangle + uint(gl_PrimitiveID);
#if USE_SPHERE_PROXY
    triangle = first_triangle;
#endif
    Ray ray = texel_ray(map);
    bool met, front;
    Hit hit = hit_uncut(ray, instance, triangle, met, front);
#if USE_SPHERE_PROXY
    if (!met) discard;
    Point p = sphere_point(texelFetch(triangles, int(triangle)), ray, hit.t, instance_row(instance));
    float depth = dot(p.position - map.origin, map.axis) - map.start;
    gl_FragDepth = map.near > 0.0 ? map.near / depth : 1.0 - depth / map.range;
#endif
#if USE_ALPHA_TEST
    HitGroup group = hit_group_of(instance, hit.geometry);
    Material m = material_row(group.material);
    if (group.any_hit == ANY_HIT_MASK && base_color_at(group.material, hit).a < m.alpha_cutoff) discard;
#endif
}
#else
void main() {}
#endif
