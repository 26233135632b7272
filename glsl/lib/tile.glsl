// lib/tile.glsl -- which pixel an invocation works on: groups of 64 cover 8x8 tiles in Morton order, so that any 8
// neighbouring lanes (llvmpipe) are a 4x2 block and any 32 (a GPU's subgroup) an 8x4 one, whose rays stay together.
layout(local_size_x = 64) in;

// Of all rows of tiles, the first of this dispatch, and how many are left out after each: 0, 0 is all of them.
uniform uvec2 tile_rows;

uvec2 tile() { return uvec2(gl_WorkGroupID.x, gl_WorkGroupID.y * (tile_rows.y + 1u) + tile_rows.x); }

ivec2 tile_pixel() {
    uint i = gl_LocalInvocationIndex;
    uvec2 p = uvec2((i & 1u) | (i >> 1u & 2u) | (i >> 2u & 4u), (i >> 1u & 1u) | (i >> 2u & 2u) | (i >> 3u & 4u));
    return ivec2(tile() * 8u + p);
}
