// passes/refit_climb.comp -- new boxes for trees over moved vertices, in one dispatch: a node a thread, then on to its parents,
// each by the last thread that comes there. For trees that the GPU built, whose levels nobody knows.
// Karras, "Maximizing Parallelism in the Construction of BVHs, Octrees, and k-d Trees" (HPG 2012), section 4: who comes
// first at a node leaves, so no thread waits for another.
#include "layout.glsl"

layout(local_size_x = 64) in;

layout(std430) readonly buffer RefitNodes { uvec2 refit_nodes[]; };    // 2 * parent + side, or ID_NONE: not in use; tree
layout(std430) readonly buffer RefitTrees { RefitTree refit_trees[]; };
layout(std430) readonly buffer Triangles { uvec4 triangle_rows[]; };
layout(std430) readonly buffer Vertices { vec4 vertex_rows[]; };       // 2 a vertex
layout(std430) coherent buffer Nodes { uvec4 node_rows[]; };           // 2 a node: a child each
layout(std430) buffer Slots { uvec4 slot_rows[]; };                    // 3 a slot
layout(std430) coherent buffer Arrived { uint arrived[]; };            // at each node; 0 between dispatches
uniform int refit_total;

#include "lib/fit_leaf.glsl"

void main() {
    uint entry = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u;
    if (entry >= uint(refit_total)) return;
    uvec2 way = refit_nodes[entry];
    if (way.x == ID_NONE) return;
    RefitTree tree = refit_trees[way.y];
    uint node = entry - tree.entry_first + tree.node_first;
    uint left = node_rows[2u * node].w, right = node_rows[2u * node + 1u].w;
    if ((left & LEAF) != 0u) {
        uvec3 box = leaf_box(left, tree);
        node_rows[2u * node].xyz = box;
        // The empty child of a tree that is one leaf has its sibling's box.
        if ((right & 15u) == 0u && (right & LEAF) != 0u) node_rows[2u * node + 1u].xyz = box;
    }
    if ((right & LEAF) != 0u && (right & 15u) != 0u) node_rows[2u * node + 1u].xyz = leaf_box(right, tree);
    for (;;) {
        memoryBarrierBuffer();
        uint others = 2u - (left >> 31u) - (right >> 31u);             // nodes below, that come here too
        if (atomicAdd(arrived[entry], 1u) < others) return;
        arrived[entry] = 0u;
        if (way.x == REFIT_ROOT) return;
        memoryBarrierBuffer();
        uvec3 box = merged(node_rows[2u * node].xyz, node_rows[2u * node + 1u].xyz);
        node_rows[way.x].xyz = box;
        node = way.x >> 1u;
        entry = node - tree.node_first + tree.entry_first;
        way = refit_nodes[entry];
        left = node_rows[2u * node].w;
        right = node_rows[2u * node + 1u].w;
    }
}
