// passes/rebuild_keys.comp -- where each triangle lies on the Morton curve of its tree: key and triangle, to be sorted.
// A bit halves the longest side of the cell that is left: cells stay near to cubes in meshes of any proportion (Vinkler,
// Bittner, Havran, "Extended Morton Codes for High Performance Bounding Volume Hierarchy Construction", HPG 2017).
// The top bits are the tree's number, so that all trees are sorted at once.
#include "layout.glsl"

layout(local_size_x = 64) in;

layout(std430) readonly buffer BuildItems { BuildItem build_items[]; };
layout(std430) readonly buffer RefitTrees { RefitTree refit_trees[]; };
layout(std430) readonly buffer Triangles { uvec4 triangle_rows[]; };
layout(std430) readonly buffer Vertices { vec4 vertex_rows[]; };       // 2 a vertex
layout(std430) writeonly buffer PairsOut { uvec2 pairs_out[]; };       // key, row of build_items
uniform int item_total;

#include "lib/fit.glsl"

void main() {
    uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u;
    if (i >= uint(item_total)) return;
    BuildItem item = build_items[i];
    RefitTree tree = refit_trees[item.tree];
    uvec3 corner = triangle_rows[item.triangle].xyz;
    vec3 a = vertex_rows[2u * corner.x].xyz, b = vertex_rows[2u * corner.y].xyz, c = vertex_rows[2u * corner.z].xyz;
    uvec3 words = box_words(min(min(a, b), c), max(max(a, b), c), tree);
    uvec3 left = ((words & 0xFFFFu) + (words >> 16u)) << 15u;          // the centre; its next bit is the topmost
    uint key = item.tree;
    for (uint k = 0u; k < tree.key_bits; k++) {
        uint axis = (k < 16u ? tree.axes.x >> 2u * k : tree.axes.y >> 2u * (k - 16u)) & 3u;
        uvec3 now = uvec3(equal(uvec3(axis), uvec3(0u, 1u, 2u)));
        uvec3 bit = left >> 31u & now;
        key = key << 1u | (bit.x | bit.y | bit.z);
        left <<= now;
    }
    pairs_out[i] = uvec2(key, i);
}
