// passes/rebuild_merge.comp -- a level of a tree: each work group merges neighbours on the Morton curve, nearest pairs first,
// until few enough are left for the next level. glhybrid/bvh/merging.py plans it.
//
// Of the first level, triangles: two leaves become one where that is the cheaper, a node and a triangle at 1 each, and slots
// are filled when a leaf is done. Which row a node or a slot gets depends on who asks first, the tree does not.
#include "layout.glsl"

layout(local_size_x = 1024) in;                                        // MERGE_WIDTH

layout(std430) readonly buffer BuildChunks { BuildChunk build_chunks[]; };
layout(std430) readonly buffer BuildItems { BuildItem build_items[]; };
layout(std430) readonly buffer RefitTrees { RefitTree refit_trees[]; };
layout(std430) readonly buffer Triangles { uvec4 triangle_rows[]; };
layout(std430) readonly buffer Vertices { vec4 vertex_rows[]; };       // 2 a vertex
layout(std430) readonly buffer PairsIn { uvec2 pairs_in[]; };          // key, row of build_items
layout(std430) buffer Clusters { uvec4 clusters[]; };                  // box, ref; ID_NONE: nothing
layout(std430) writeonly buffer RefitNodes { uvec2 refit_nodes[]; };
layout(std430) writeonly buffer Nodes { uvec4 node_rows[]; };          // 2 a node: a child each
layout(std430) writeonly buffer Slots { uvec4 slot_rows[]; };          // 3 a slot
uniform int chunk_first;

#include "lib/fit.glsl"

const uint REACH = 8u;                                                 // neighbours looked at, to each side
const uint MAX_LEAF = 4u;

shared uint box_x[MERGE_WIDTH], box_y[MERGE_WIDTH], box_z[MERGE_WIDTH];
shared uint refs[MERGE_WIDTH];                                         // of leaves under way: LEAF | first triangle << 4 | count
shared uint next_triangle[MERGE_WIDTH];                                // of a leaf under way
shared uint partner[MERGE_WIDTH];
shared uint height[MERGE_WIDTH];                                       // nodes made here on the longest way down
shared uint bits[64];                                                  // a bit a thread: who stays; who makes a node
shared uint live, made, slots_taken;
shared bool as_they_come;                                              // pairs from now on

uvec3 box_of(uint i) { return uvec3(box_x[i], box_y[i], box_z[i]); }

void put(uint i, uvec3 box, uint ref, uint nodes_down) {
    box_x[i] = box.x;
    box_y[i] = box.y;
    box_z[i] = box.z;
    refs[i] = ref;
    height[i] = nodes_down;
}

// Bits set before that of thread i, in the half of `bits` that starts at a word.
uint rank(uint word, uint i) {
    int sum = bitCount(bits[word + (i >> 5u)] & ((1u << (i & 31u)) - 1u));
    for (uint k = word; k < word + (i >> 5u); k++) sum += bitCount(bits[k]);
    return uint(sum);
}

// Of the first `count` threads.
uint bits_set(uint word, uint count) {
    int sum = 0;
    for (uint k = word; k < word + ((count + 31u) >> 5u); k++) sum += bitCount(bits[k]);
    return uint(sum);
}

// With whom a cluster makes the smallest box. Of equals the one whose number differs in the lowest bits: an order of pairs
// that both ends agree on, so that each turn merges at least one, and of many equals half.
// highest: what is so high merges no more. Itself if nobody is left.
uint nearest(uint i, uint count, uint highest, vec3 scale) {
    uvec3 box = box_of(i);
    float least = 3e38;
    uint best = i;
    if (height[i] >= highest) return i;
    for (uint j = max(i, REACH) - REACH; j < min(i + REACH + 1u, count); j++) {
        if (j == i || height[j] >= highest) continue;
        float area = half_area(merged(box, box_of(j)), scale);
        if (area < least || (area == least && (i ^ j) < (i ^ best))) {
            least = area;
            best = j;
        }
    }
    return best;
}

// Writes the triangles of a leaf of the first level; returns its ref.
uint filled(uint ref, BuildChunk chunk) {
    uint count = ref & 15u, local = (ref & ~LEAF) >> 4u;
    uint first = chunk.slot_first + atomicAdd(slots_taken, count);
    for (uint slot = first; slot < first + count; slot++) {
        BuildItem item = build_items[pairs_in[chunk.first + local].y];
        uvec3 corner = triangle_rows[item.triangle].xyz;
        slot_rows[3u * slot] = uvec4(floatBitsToUint(vertex_rows[2u * corner.x].xyz), item.triangle);
        slot_rows[3u * slot + 1u] = uvec4(floatBitsToUint(vertex_rows[2u * corner.y].xyz), item.geometry);
        slot_rows[3u * slot + 2u] = uvec4(floatBitsToUint(vertex_rows[2u * corner.z].xyz), KIND_TRIANGLE);
        local = next_triangle[local];
    }
    return LEAF | first << 4u | count;
}

void set_parent(uint ref, RefitTree tree, uint node, uint side) {
    if ((ref & LEAF) == 0u) refit_nodes[ref - tree.node_first + tree.entry_first].x = 2u * node + side;
}

void main() {
    uint i = gl_LocalInvocationID.x;
    BuildChunk chunk = build_chunks[uint(chunk_first) + gl_WorkGroupID.x];
    RefitTree tree = refit_trees[chunk.tree];
    vec3 scale = cell_shape(tree);
    bool leaves = chunk.leaves == 1u;
    uvec4 own = uvec4(ID_NONE);
    if (i < chunk.count) {
        if (leaves) {
            uvec3 corner = triangle_rows[build_items[pairs_in[chunk.first + i].y].triangle].xyz;
            vec3 a = vertex_rows[2u * corner.x].xyz, b = vertex_rows[2u * corner.y].xyz, c = vertex_rows[2u * corner.z].xyz;
            own = uvec4(box_words(min(min(a, b), c), max(max(a, b), c), tree), LEAF | i << 4u | 1u);
        } else {
            own = clusters[chunk.first + i];
        }
    }
    if (i < 64u) bits[i] = 0u;
    if (i == 0u) {
        made = slots_taken = 0u;
        as_they_come = false;
    }
    memoryBarrierShared();
    barrier();
    if (own.w != ID_NONE) atomicOr(bits[i >> 5u], 1u << (i & 31u));
    memoryBarrierShared();
    barrier();
    if (own.w != ID_NONE) put(rank(0u, i), own.xyz, own.w, 0u);
    if (i == 0u) live = bits_set(0u, chunk.count);
    memoryBarrierShared();
    barrier();

    for (uint turn = 0u; turn < chunk.turns; turn++) {
        uint count = live;
        if (count <= chunk.kept) break;
        uint other = i;
        if (i < count) {
            if (!as_they_come) other = nearest(i, count, chunk.highest, scale);
            else if ((i ^ 1u) < count) other = i ^ 1u;
            partner[i] = other;
        }
        if (i < 64u) bits[i] = 0u;
        memoryBarrierShared();
        barrier();
        bool paired = i < count && other != i && partner[other] == i;
        bool makes = paired && i < other, stays = i < count && (makes || !paired);
        bool roots = count == 2u && chunk.root == 1u, joins = false;
        uvec3 a = box_of(i), b = box_of(other), box = merged(a, b);
        uint a_ref = refs[i], b_ref = refs[other], nodes_down = height[i], b_nodes_down = height[other];
        if (makes && leaves && (a_ref & b_ref & LEAF) != 0u && (a_ref & 15u) + (b_ref & 15u) <= MAX_LEAF) {
            float apart = half_area(a, scale) * float(a_ref & 15u) + half_area(b, scale) * float(b_ref & 15u);
            joins = half_area(box, scale) * float((a_ref & 15u) + (b_ref & 15u) - 1u) <= apart;
        }
        if (stays) atomicOr(bits[i >> 5u], 1u << (i & 31u));
        if (makes && !joins && !roots) atomicOr(bits[32u + (i >> 5u)], 1u << (i & 31u));
        memoryBarrierShared();
        barrier();
        if (joins) {                                                   // the triangles of b behind those of a
            uint last = (a_ref & ~LEAF) >> 4u;
            for (uint k = 1u; k < (a_ref & 15u); k++) last = next_triangle[last];
            next_triangle[last] = (b_ref & ~LEAF) >> 4u;
            a_ref += b_ref & 15u;
        } else if (makes) {
            if (leaves && (a_ref & LEAF) != 0u) a_ref = filled(a_ref, chunk);
            if (leaves && (b_ref & LEAF) != 0u) b_ref = filled(b_ref, chunk);
            uint node = tree.node_first + (roots ? 0u : chunk.node_first + made + rank(32u, i));
            node_rows[2u * node] = uvec4(a, a_ref);
            node_rows[2u * node + 1u] = uvec4(b, b_ref);
            set_parent(a_ref, tree, node, 0u);
            set_parent(b_ref, tree, node, 1u);
            a_ref = node;
            nodes_down = max(nodes_down, b_nodes_down) + 1u;
        }
        if (stays) put(rank(0u, i), makes ? box : a, a_ref, nodes_down);
        memoryBarrierShared();
        barrier();
        if (i == 0u) {
            live = bits_set(0u, count);
            made += bits_set(32u, count);
            as_they_come = turn + 1u >= chunk.free_turns || live == count || as_they_come;
        }
        memoryBarrierShared();
        barrier();
    }

    if (i < chunk.kept) {
        own = uvec4(box_of(i), refs[i]);
        if (i >= live) own.w = ID_NONE;
        else if (leaves && (own.w & LEAF) != 0u) own.w = filled(own.w, chunk);
        if (chunk.root == 0u) clusters[chunk.out_first + i] = own;
        else if ((own.w & LEAF) != 0u) {                               // all of the tree is one leaf
            node_rows[2u * tree.node_first] = own;
            node_rows[2u * tree.node_first + 1u] = uvec4(own.xyz, own.w & ~15u);
        }
    }
    for (uint k = made + i; k < chunk.node_count; k += MERGE_WIDTH) {  // not in use: leaves of nothing
        uint node = tree.node_first + chunk.node_first + k;
        node_rows[2u * node] = uvec4(0u, 0u, 0u, LEAF);
        node_rows[2u * node + 1u] = uvec4(0u, 0u, 0u, LEAF);
        refit_nodes[node - tree.node_first + tree.entry_first].x = ID_NONE;
    }
}
