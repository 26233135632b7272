// passes/refit_cost.comp -- SAH costs of trees over moved vertices, a node and a triangle at 1 each: by work group the sum of
// areas times weights, and the root's area from the group that has it.
#include "layout.glsl"
#include "lib/fit.glsl"

layout(local_size_x = 256) in;

layout(std430) readonly buffer RefitParts { uvec2 refit_parts[]; };    // row of refit_trees, first node in it
layout(std430) readonly buffer RefitTrees { RefitTree refit_trees[]; };
layout(std430) readonly buffer Nodes { uvec4 node_rows[]; };           // 2 a node: a child each
layout(std430) writeonly buffer Costs { vec2 costs[]; };

const uint NODES_A_THREAD = 16u;

shared float sums[256];

void main() {
    uint i = gl_LocalInvocationID.x;
    uvec2 part = refit_parts[gl_WorkGroupID.x];
    RefitTree tree = refit_trees[part.x];
    vec3 scale = cell_shape(tree);
    float sum = 0.0;
    for (uint k = 0u; k < NODES_A_THREAD; k++) {
        uint node = part.y + 256u * k + i;
        if (node >= tree.node_count) break;
        for (uint side = 0u; side < 2u; side++) {
            uvec4 child = node_rows[2u * (tree.node_first + node) + side];
            sum += half_area(child.xyz, scale) * ((child.w & LEAF) == 0u ? 1.0 : float(child.w & 15u));
        }
    }
    sums[i] = sum;
    for (uint reach = 128u; reach > 0u; reach >>= 1u) {
        memoryBarrierShared();
        barrier();
        if (i < reach) sums[i] += sums[i + reach];
    }
    if (i == 0u) {
        uvec3 root = merged(node_rows[2u * tree.node_first].xyz, node_rows[2u * tree.node_first + 1u].xyz);
        costs[gl_WorkGroupID.x] = vec2(sums[0], part.y == 0u ? half_area(root, scale) : 0.0);
    }
}
