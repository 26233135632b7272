// lib/bake.glsl -- the surface point that a texel of a light map stands for.
#include "lib/light.glsl"
#include "lib/bvh.glsl"
#include "lib/low_discrepancy.glsl"

layout(local_size_x = 64) in;
layout(std430) readonly buffer BakeTexels { uvec4 bake_texels[]; };    // instance, triangle, bits of bary
layout(std430) buffer BakePoints { vec4 bake_points[]; };              // position, BAKE_*
uniform uint bake_count;

const float BAKE_HERE = 0.0;       // the point as it is
const float BAKE_PUSHED = 1.0;     // moved to where its surface leaves a solid
const float BAKE_INSIDE = 2.0;     // within one, no way out near

uint bake_row() { return gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * gl_NumWorkGroups.x * 64u; }

// The exact point; n_geo is that of the front.
Point bake_point(uvec4 texel) {
    Instance inst = instance_row(texel.x);
    uvec4 tri = texelFetch(triangles, int(texel.y));
    vec2 bary = uintBitsToFloat(texel.zw);
    if (SPHERES && tri.x == tri.y) return sphere_point_at(tri, oct_decode(bary), inst);
    return triangle_point(tri, bary, inst);
}

// Whether nothing looks at this texel's back: where it faces away from a light no ray need be sent.
bool bake_front_only(uvec4 texel) {
    return SINGLE_SIDED && hit_group_of(texel.x, texelFetch(triangles, int(texel.y)).w).single_sided == 1u;
}
