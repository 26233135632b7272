// lib/tile.glsl -- which pixel an invocation works on: groups of 64 cover 8x8 tiles in Morton order, so that any 8
// neighbouring lanes (llvmpipe) are a 4x2 block and any 32 (a GPU's subgroup) an 8x4 one, whose rays stay together.
layout(local_size_x = 64) in;

uniform uint tile_row;                                     // of all rows of tiles, the first of this dispatch

uvec2 tile() { return uvec2(gl_WorkGroupID.x, gl_WorkGroupID.y + tile_row); }

ivec2 tile_pixel() {
    uint i = gl_LocalInvocationIndex;
    uvec2 p = uvec2((i & 1u) | (i >> 1u & 2u) | (i >> 2u & 4u), (i >> 1u & 1u) | (i >> 2u & 2u) | (i >> 3u & 4u));
    return ivec2(tile() * 8u + p);
}
