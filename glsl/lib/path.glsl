// lib/path.glsl -- paths on their way between the programs of `reference`: what each carries, and lists of those that the
// next program is for. A wave of paths lies in one image: texel `part` of all paths together, so that neighbouring lanes
// read neighbouring texels.
#include "lib/bvh.glsl"
#include "lib/low_discrepancy.glsl"

layout(local_size_x = 64) in;

layout(rgba32ui) restrict uniform uimage2D paths;
layout(std430) restrict buffer PathLists { uint path_lists[]; };
layout(std430) restrict buffer PathCounts { uvec4 path_counts[]; };       // by depth and list: work groups, 1, 1, entries
uniform uvec4 wave;       // first row of tiles and, << 16, every which one; tiles; samples of each pixel; rows of a part
uniform uint depth;       // surfaces that the path has met

// Parts of a path, and of the rays that look whether light arrives at it, for each kind of light.
const uint PATH_ORIGIN = 0u;        // and the density of the direction; 0: camera or mirror
const uint PATH_DIRECTION = 1u;     // and the instance that was met
const uint PATH_THROUGHPUT = 2u;    // and the pixel, x + 65536 y; ID_NONE: beside the picture
const uint PATH_SUM = 3u;           // of what it has met that shines; and the sample
const uint PATH_HIT = 4u;           // t, bary, triangle
const uint PATH_LIGHT = PATH_PARTS; // origin, length; direction; radiance on its way; what arrived so far
// Lists: paths that go on, and those that a light may shine on.
const uint GOES_ON = 0u;
const uint TO_LAMPS = 1u;
const uint TO_SKY = 2u;
const uint TO_EMITTERS = 2u + uint(ENVIRONMENT);
const uint LIGHT_KINDS = 1u + uint(ENVIRONMENT) + uint(USE_EMITTERS);

ivec2 part_of(uint slot, uint part) { return ivec2(slot & (PATH_WIDTH - 1u), part * wave.w + slot / PATH_WIDTH); }
uvec4 load_part(uint slot, uint part) { return imageLoad(paths, part_of(slot, part)); }
void store_part(uint slot, uint part, vec3 v, uint w) { imageStore(paths, part_of(slot, part), uvec4(floatBitsToUint(v), w)); }

uint list_row(uint list) { return (list == GOES_ON ? depth + 1u : depth) * PATH_LISTS + list; }
uint list_start(uint list) { return (list == GOES_ON ? (depth + 1u) % 2u : list + 1u) * wave.w * PATH_WIDTH; }

// The path that this invocation of a program over a list works on. All of the wave go to the first surface.
bool listed(uint list, out uint slot) {
    uint i = gl_GlobalInvocationID.x;
    slot = i;
    if (list == GOES_ON && depth == 0u) return i < wave.y * 64u * wave.z;
    uint row = depth * PATH_LISTS + list, start = (list == GOES_ON ? depth % 2u : list + 1u) * wave.w * PATH_WIDTH;
    if (i >= path_counts[row].w) return false;
    slot = path_lists[start + i];
    return true;
}

// Puts a path on lists, a bit each. All invocations of a group must call it.
#if USE_BRANCHLESS                                                         // a CPU's lanes take turns anyway
void join_lists(uint lists, uint slot) {
    for (uint list = 0u; list < PATH_LISTS; list++) {
        if ((lists >> list & 1u) == 1u) {
            uint row = list_row(list), at = atomicAdd(path_counts[row].w, 1u);
            if (at % 64u == 0u) atomicAdd(path_counts[row].x, 1u);
            path_lists[list_start(list) + at] = slot;
        }
    }
}
#else                                                                      // a place in the list is asked for once a group
shared uint joining[PATH_LISTS], joined_at[PATH_LISTS];

void join_lists(uint lists, uint slot) {
    uint at[PATH_LISTS];
    if (gl_LocalInvocationIndex < PATH_LISTS) joining[gl_LocalInvocationIndex] = 0u;
    barrier();
    for (uint list = 0u; list < PATH_LISTS; list++)
        if ((lists >> list & 1u) == 1u) at[list] = atomicAdd(joining[list], 1u);
    barrier();
    if (gl_LocalInvocationIndex < PATH_LISTS) {
        uint list = gl_LocalInvocationIndex, row = list_row(list), count = joining[list];
        uint first = count > 0u ? atomicAdd(path_counts[row].w, count) : 0u;
        if (count > 0u) atomicMax(path_counts[row].x, (first + count + 63u) / 64u);
        joined_at[list] = first;
    }
    barrier();
    for (uint list = 0u; list < PATH_LISTS; list++)
        if ((lists >> list & 1u) == 1u) path_lists[list_start(list) + joined_at[list] + at[list]] = slot;
}
#endif

// The pixel of a slot: tiles of 8x8 in Morton order, as lib/tile.glsl.
ivec2 slot_pixel(uint slot) {
    uint i = slot % 64u, tile = slot / 64u % wave.y, across = uint(frame.size_px.x + 7) / 8u;
    uvec2 p = uvec2((i & 1u) | (i >> 1u & 2u) | (i >> 2u & 4u), (i >> 1u & 1u) | (i >> 2u & 2u) | (i >> 3u & 4u));
    return ivec2(uvec2(tile % across, (wave.x & 0xFFFFu) + tile / across * (wave.x >> 16u)) * 8u + p);
}

uint slot_sample(uint slot) { return frame.sample_first + slot / (64u * wave.y); }

// ---- points that a path draws by: even over a pixel's samples, two dimensions at a time (Burley, "Practical Hash-based
// Owen Scrambling", JCGT 9(4) 2020), pairs of dimensions in an order of their own; other pixels and seeds are independent.

const uint DRAWS = 8u;              // pairs a surface
const uint DRAW_LOBE = 0u;          // which lobe; whether the path goes on
const uint DRAW_DIRECTION = 1u;
const uint DRAW_SKY = 2u;           // texel
const uint DRAW_WITHIN = 3u;        // and the point of it
const uint DRAW_LIGHT = 4u;         // which lamp, which emitter
const uint DRAW_DISC = 5u;
const uint DRAW_EMITTER = 6u;
const uint DRAW_PIXEL = 7u;         // where in the pixel the path starts

uint draw_key(uvec2 px, uint draw) { return pcg(depth * DRAWS + draw + pcg(px.x ^ pcg(px.y ^ pcg(frame.seed)))); }

vec2 draw_point(uvec2 px, uint number, uint draw) {
    uint key = draw_key(px, draw), other = pcg(key), index = bitfieldReverse(owen_reversed(bitfieldReverse(number), pcg(other)));
    uvec2 x = bitfieldReverse(uvec2(owen_reversed(index, key), owen_reversed(pascal(index), other)));
    return vec2(x >> 8u) * (1.0 / 16777216.0);
}
