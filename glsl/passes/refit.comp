// passes/refit.comp -- new boxes for one level of the trees over moved vertices, the deepest level first: a node a thread.
// A dispatch a level, so that no work group waits for another. Leaves take their triangles' vertices along into the slots.
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

#include "lib/fit_leaf.glsl"

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
