// lib/fit.glsl -- boxes of moved triangles, in cells of their tree's grid: words low | high << 16 for x, y and z.
// Wants triangle_rows and vertex_rows.
//
// Rounding: glhybrid/bvh/blas.py asks for boxes with 5e-7 of the largest coordinate and a twentieth of a cell to spare;
// `pad` and the tenth of a cell here hold that and what float32 loses on the way.

const uint LEAF = 0x80000000u;

uvec3 merged(uvec3 a, uvec3 b) { return min(a & 0xFFFFu, b & 0xFFFFu) | max(a >> 16u, b >> 16u) << 16u; }

uvec3 box_words(vec3 low, vec3 high, RefitTree tree) {
    vec3 a = floor((low - tree.pad - tree.grid_min) / tree.grid_step - 0.1);
    vec3 b = ceil((high + tree.pad - tree.grid_min) / tree.grid_step + 0.1);
    return uvec3(clamp(a, 0.0, 65535.0)) | uvec3(clamp(b, 0.0, 65535.0)) << 16u;
}

uvec3 triangle_box(uint triangle, RefitTree tree) {
    uvec3 corner = triangle_rows[triangle].xyz;
    vec3 a = vertex_rows[2u * corner.x].xyz, b = vertex_rows[2u * corner.y].xyz, c = vertex_rows[2u * corner.z].xyz;
    return box_words(min(min(a, b), c), max(max(a, b), c), tree);
}
