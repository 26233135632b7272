// lib/buffers.glsl -- the large tables, read through buffer textures (the fast path on Mesa's llvmpipe, never slower on
// NVIDIA). Floats travel as bits in RGBA32UI texels, so that ids and coordinates share one fetch.
#if USE_BUFFER_ARRAY
// One array, so that buffers have the same slots in every program. Mesa keys a program by the sampler state in all slots
// that it declares; a buffer has none, and finds there what another program's texture left: after the first frame nearly
// every program was compiled again. The last element is one that every program with textures beside buffers reads, for an
// array ends at the last element in use. (Programs without buffers read images, not textures, for the same reason.)
uniform usamplerBuffer buffers[11];
#if USE_EXTRA_ATTRIBUTES
#define attributes buffers[0]
#endif
#if USE_TANGENTS
#define tangents buffers[1]
#endif
#define nodes buffers[7]
#define slots buffers[8]
#define triangles buffers[9]
#define vertices buffers[10]
// The scene's small tables too: llvmpipe reads a storage block in a loop over the lanes for every field, a texel of four
// fields for all lanes at once. A tenth of a frame.
#include "tables.glsl"
#if USE_TEXTURES
#define texture_row(i) read_Texture(buffers[2], uint(i))
#define texture_level_row(i) texelFetch(buffers[3], int(i))
#endif
#define light_row(i) read_Light(buffers[4], uint(i))
#define material_row(i) read_Material(buffers[5], uint(i))
#define instance_row(i) read_Instance(buffers[6], uint(i))
#else
uniform usamplerBuffer nodes;        // 2 texels each: two children's boxes and references
uniform usamplerBuffer slots;        // 3 texels each: v0, triangle; v1, geometry; v2, kind
uniform usamplerBuffer vertices;     // 2 texels each: position, u; normal, v (a sphere: centre, 0; radius, 0, 0, 0)
uniform usamplerBuffer triangles;    // 1 texel each: three rows of vertices, geometry index in its mesh
#if USE_TANGENTS
uniform usamplerBuffer tangents;     // 1 texel a vertex: direction, handedness
#endif
#if USE_EXTRA_ATTRIBUTES
uniform usamplerBuffer attributes;   // 1 texel a vertex: second uv set, colour as 4 x half
#endif
#define texture_row(i) textures[i]
#define texture_level_row(i) texture_levels[i]
#define light_row(i) lights[i]
#define material_row(i) materials[i]
#define instance_row(i) instances[i]
#endif
