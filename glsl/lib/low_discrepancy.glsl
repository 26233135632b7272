// lib/low_discrepancy.glsl -- points of [0, 1)^2 that are even over the samples of a pixel and over its neighbours.
//
// Over a pixel's samples: Roberts' R2 sequence, "The Unreasonable Effectiveness of Quasirandom Sequences" (2018), turned
// by an offset of its own (Cranley & Patterson 1976). Over pixels: the offsets are Sobol's first two dimensions along the
// Morton order of pixels, so that each aligned block of 2^k x 2^k of them holds a (0, 2k, 2)-net (Ahmed & Wonka,
// "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error", 2020), Owen-scrambled by hashing (Burley,
// "Practical Hash-based Owen Scrambling", JCGT 9(4) 2020), which leaves every point uniform: nothing is biased. The order
// is scrambled the same way, from the largest blocks down: blocks differ, and no lattice of pixels shows.
#include "lib/random.glsl"

// Owen scrambling of bit-reversed digits, by Laine & Karras.
uint owen_reversed(uint x, uint seed) {
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    return x ^ (x * 0x53a22864u);
}

// Pascal's triangle modulo 2 as a matrix over the bits: Sobol's second dimension, bit-reversed.
uint pascal(uint v) {
    v ^= v >> 16u;
    v ^= (v & 0xFF00FF00u) >> 8u;
    v ^= (v & 0xF0F0F0F0u) >> 4u;
    v ^= (v & 0xCCCCCCCCu) >> 2u;
    return v ^ ((v & 0xAAAAAAAAu) >> 1u);
}

uint morton(uvec2 p) {
    p &= 0xFFFFu;
    p = (p | p << 8u) & 0x00FF00FFu;
    p = (p | p << 4u) & 0x0F0F0F0Fu;
    p = (p | p << 2u) & 0x33333333u;
    p = (p | p << 1u) & 0x55555555u;
    return p.x | p.y << 1u;
}

// Where the points of a pixel start, for one use of them.
uvec2 sequence_start(ivec2 px, uint use, uint seed) {
    uint key = pcg(use ^ pcg(seed));
    uint index = bitfieldReverse(owen_reversed(bitfieldReverse(morton(uvec2(px))), pcg(key + 1u)));
    return bitfieldReverse(uvec2(owen_reversed(index, key), owen_reversed(pascal(index), pcg(key))));
}

// The same where neighbours share what they find: pixels are a lattice too. What a filter over pixels leaves is the waves
// of the integrand that are slow across the screen. These steps were searched for (400 strongest waves of half planes over a
// disc of half vectors, Gaussian windows of 1 to 4 pixels, 1 to 4 samples): 1.5 times less error than offsets from a net.
// For one use at a pixel: two of these would go side by side.
uvec2 lattice_start(ivec2 px, uint use, uint seed) {
    uint key = pcg(use ^ pcg(seed));
    return uvec2(key, pcg(key)) + uint(px.x) * uvec2(3570735308u, 3205278688u) + uint(px.y) * uvec2(3521082050u, 1901605360u);
}

// Point i from there.
vec2 sequence_point(uvec2 start, uint i) {
    uvec2 x = start + i * uvec2(3242174889u, 2447445414u);                 // 2^32 over the plastic number, and over its square
    return vec2(x >> 8u) * (1.0 / 16777216.0);
}
