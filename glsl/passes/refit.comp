// passes/refit.comp -- new boxes for trees over moved vertices: a node a thread, then up to its parents, each of which waits
// for the last of what is under it. Leaves take their triangles' vertices along into the slots.
// Karras, "Maximizing Parallelism in the Construction of BVHs, Octrees, and k-d Trees" (HPG 2012), section 4: who comes
// first at a node leaves, so no thread waits for another.
#include "layout.glsl"
#include "lib/fit.glsl"

layout(local_size_x = 64) in;

layout(std430) readonly buffer RefitNodes { uvec2 refit_nodes[]; };    // 2 * parent + side, or ID_NONE: not in use; tree
layout(std430) readonly buffer RefitTrees { RefitTree refit_trees[]; };
layout(std430) readonly buffer Triangles { uvec4 triangle_rows[]; };
layout(std430) readonly buffer Vertices { vec4 vertex_rows[]; };       // 2 a vertex
layout(std430) coherent buffer Nodes { uvec4 node_rows[]; };           // 2 a node: a child each
layout(std430) buffer Slots { uvec4 slot_rows[]; };                    // 3 a slot
layout(std430) coherent buffer Arrived { uint arrived[]; };            // at each node; 0 between dispatches
uniform int refit_total;

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
    return box_words(low, high, tree);
}

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
