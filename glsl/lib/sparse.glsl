// lib/sparse.glsl -- which pixels always send a mirror ray: one a cell, a block of four or two in a row.
#include "lib/tile.glsl"

const uint GROUPS_ACROSS = 64u;    // of an indirect dispatch over a list: x stays, y grows with it
const uint OTHERS = uint(USE_REFLECT_GRID) == GRID_HALF ? 3u : 1u;    // pixels of a cell beside that one

ivec2 pixel_of(ivec2 cell) {
    if (uint(USE_REFLECT_GRID) == GRID_HALF) return cell * 2;
    return ivec2(cell.x * 2 + (cell.y & 1), cell.y);
}

ivec2 cell_of(ivec2 px) {
    if (uint(USE_REFLECT_GRID) == GRID_HALF) return px / 2;
    return ivec2(px.x / 2, px.y);
}
