// lib/sparse.glsl -- which pixels send a ray of their own, and where its result is kept: cells of a smaller image.
#include "lib/tile.glsl"

const uint GROUPS_ACROSS = 64u;    // of an indirect dispatch over a list: x stays, y grows with it

ivec2 pixel_of(ivec2 cell) {
    if (uint(USE_REFLECT_GRID) == GRID_HALF) return cell * 2;
    return ivec2(cell.x * 2 + (cell.y & 1), cell.y);
}

bool has_cell(ivec2 px) {
    if (uint(USE_REFLECT_GRID) == GRID_HALF) return ((px.x | px.y) & 1) == 0;
    return ((px.x + px.y) & 1) == 0;
}

ivec2 cell_of(ivec2 px) {
    if (uint(USE_REFLECT_GRID) == GRID_HALF) return px / 2;
    return ivec2(px.x / 2, px.y);
}
