// lib/fit.glsl -- boxes of moved triangles, in cells of their tree's grid: words low | high << 16 for x, y and z.
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

// In units of the square of what scale says a cell is.
float half_area(uvec3 box, vec3 scale) {
    vec3 side = vec3((box >> 16u) - (box & 0xFFFFu)) * scale;
    return side.x * side.y + side.y * side.z + side.z * side.x;
}

// Of a tree's cell, its longest side at 1: areas of small and huge meshes neither vanish nor overflow.
vec3 cell_shape(RefitTree tree) { return tree.grid_step / max(tree.grid_step.x, max(tree.grid_step.y, tree.grid_step.z)); }
