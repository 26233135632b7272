// passes/shadow_map.vert -- every caster as one light sees it: position into its tile of the atlas.
#include "lib/frame.glsl"

layout(std430) readonly buffer Instances { Instance instances[]; };
layout(std430) readonly buffer ShadowMaps { ShadowMap shadow_maps[]; };
uniform uint map_index;

#if USE_SPHERE_PROXY
in vec4 in_sphere;                 // centre, radius: object space
#else
in vec3 in_position;
#endif
in uvec2 in_draw;                  // per instance of a draw: row of instances, row of its first triangle
flat out uint instance;
flat out uint first_triangle;

void main() {
    instance = in_draw.x;
    first_triangle = in_draw.y;
    Instance inst = instances[in_draw.x];
    ShadowMap map = shadow_maps[map_index];
#if USE_SPHERE_PROXY
    // A cube around the sphere, as in gbuffer.vert.
    uint corner = uint[](0u,1u,2u, 2u,1u,3u, 4u,6u,5u, 5u,6u,7u, 0u,2u,4u, 4u,2u,6u, 1u,5u,3u, 3u,5u,7u, 0u,4u,1u, 1u,4u,5u, 2u,3u,6u, 6u,3u,7u)[gl_VertexID];
    vec3 position = in_sphere.xyz + in_sphere.w * 1.0001 * (vec3(corner & 1u, (corner >> 1u) & 1u, corner >> 2u) * 2.0 - 1.0);
#else
    vec3 position = in_position;
#endif
    precise vec3 p = inst.world_from_object[3] + mat3(inst.world_from_object[0], inst.world_from_object[1], inst.world_from_object[2]) * position;
    vec3 f = p - map.origin;
    float depth = dot(f, map.axis) - map.start;
    bool parallel = map.near == 0.0;
    float w = parallel ? 1.0 : depth;
    vec2 at = vec2(dot(f, map.right), dot(f, map.up)) / map.texel - map.first_texel * w;   // times w
    float z = parallel ? 1.0 - depth / map.range : map.near;                                // reversed
    gl_Position = vec4(at * (2.0 / float(map.size)) - w, CLIP_CONTROL ? z : 2.0 * z - w, w);
}
