// passes/refit.comp -- new boxes for one level of the trees over moved vertices, the deepest level first: a node a thread.
// A dispatch a level, so that no work group waits for another. Leaves take their triangles' vertices along into the slots.
//
// Rounding: glhybrid/bvh/blas.py asks for boxes with 5e-7 of the largest coordinate and a twentieth of a cell to spare;
// `pad` and the tenth of a cell here hold that and what float32 loses on the way.
#include "layout.glsl"

layout(local_size_x = 64) in;

layout(std430) readonly buffer RefitOrder { uvec2 refit_order[]; };    // row of nodes, row of refit_trees
layout(std430) readonly buffer RefitTrees { RefitTree refit_trees[]; };
layout(std430) readonly buffer Triangles { uvec4 triangle_rows[]; };
layout(std430) readonly buffer Vertices { vec4 vertex_rows[]; };       // 2 a vertex
layout(std430) buffer Nodes { uvec4 node_rows[]; };                    // 2 a node: a child each
layout(std430) buffer Slots { uvec4 slot_rows[]; };                    // 3 a slot
uniform int refit_first;
uniform int refit_count;

const uint LEAF = 0x80000000u;

uvec3 merged(uvec3 a, uvec3 b) { return min(a & 0xFFFFu, b & 0xFFFFu) | max(a >> 16u, b >> 16u) << 16u; }

uvec3 leaf_box(uint ref, RefitTree tree) {
    vec3 low = vec3(3e38), high = vec3(-3e38);
    uint first = (ref & ~LEAF) >> 4u;
    for (uint slot = first; slot < first + (ref & 15u); slot++) {
        uvec3 corner = triangle_rows[slot_rows[3u * slot].w].xyz;
        for (uint k = 0u; k < 3u; k++) {
            vec3 p = vertex_rows[2u * corner[k]].xyz;
            slot_rows[3u * slot + k].xyz = floatBitsToUint(p);
            low = min(low, p);
            high = max(high, p);
        }
    }
    vec3 a = floor((low - tree.pad - tree.grid_min) / tree.grid_step - 0.1);
    vec3 b = ceil((high + tree.pad - tree.grid_min) / tree.grid_step + 0.1);
    return uvec3(clamp(a, 0.0, 65535.0)) | uvec3(clamp(b, 0.0, 65535.0)) << 16u;
}

uvec3 child_box(uint ref, RefitTree tree) {
    if ((ref & LEAF) == 0u) return merged(node_rows[2u * ref].xyz, node_rows[2u * ref + 1u].xyz);
    return leaf_box(ref, tree);
}

void main() {
    uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u;
    if (i >= uint(refit_count)) return;
    uvec2 order = refit_order[uint(refit_first) + i];
    RefitTree tree = refit_trees[order.y];
    uint left = node_rows[2u * order.x].w, right = node_rows[2u * order.x + 1u].w;
    uvec3 left_box = child_box(left, tree);
    node_rows[2u * order.x].xyz = left_box;
    // The empty child of a tree that is one leaf has its sibling's box.
    node_rows[2u * order.x + 1u].xyz = (right & 15u) == 0u && (right & LEAF) != 0u ? left_box : child_box(right, tree);
}
