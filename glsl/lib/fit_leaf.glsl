// lib/fit_leaf.glsl -- the box of a leaf over moved vertices. Wants triangle_rows, vertex_rows and slot_rows.
#include "lib/fit.glsl"

// Its triangles' vertices go along into the slots.
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
