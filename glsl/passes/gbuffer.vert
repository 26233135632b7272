// passes/gbuffer.vert -- every instance of every draw: position to clip space, ids to the fragment.
#include "lib/frame.glsl"

layout(std430) readonly buffer Instances { Instance instances[]; };

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
#if USE_SPHERE_PROXY
    // The back faces of a cube around the sphere: drawn also when the eye is inside.
    uint corner = uint[](0u,1u,2u, 2u,1u,3u, 4u,6u,5u, 5u,6u,7u, 0u,2u,4u, 4u,2u,6u, 1u,5u,3u, 3u,5u,7u, 0u,4u,1u, 1u,4u,5u, 2u,3u,6u, 6u,3u,7u)[gl_VertexID];
    vec3 position = in_sphere.xyz + in_sphere.w * 1.0001 * (vec3(corner & 1u, (corner >> 1u) & 1u, corner >> 2u) * 2.0 - 1.0);
#else
    vec3 position = in_position;
#endif
    precise vec3 p = inst.world_from_object[3] + mat3(inst.world_from_object[0], inst.world_from_object[1], inst.world_from_object[2]) * position;
    gl_Position = frame.clip_from_world * vec4(p, 1.0);
    gl_Position.xy -= 2.0 * frame.jitter_px / vec2(frame.size_px) * gl_Position.w;   // samples where primary_ray looks
}
