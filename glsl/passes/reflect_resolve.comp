// passes/reflect_resolve.comp -- from rays of a part of the pixels to all. A pixel between two pairs of its own material that
// sent one takes their mean if it lies midway between them on one surface and they see so much the same that the picture
// hardly tells, or if all that they see is too faint to tell. All others go on a list and are traced. Surfaces are not looked
// up here: what a texture changes between pixels shows in what its neighbours see. An invocation has the pixels of a cell.
#include "lib/gbuffer.glsl"
#include "lib/sparse.glsl"

layout(rgba32ui) readonly restrict uniform uimage2D guide;             // lib/mirror_guide.glsl
layout(rgba32f) restrict uniform image2D out_reflection;    // of some pixels there already
#if USE_REASON
layout(r8ui) restrict uniform uimage2D out_reason;
#endif
layout(std430) writeonly buffer PixelList { uint pixel_list[]; };
layout(std430) buffer PixelCount { uint groups_x, groups_y, groups_z, pixel_count; };
uniform float contrast;    // share of what a pixel shows by which two rays may differ; 0: nothing is shared

// A mirror ray that was sent: where it left, which way, what it saw, and what its pixel shows beside that.
struct Sent { vec3 from, dir; vec4 seen; float beside; uint material; };    // ID_NONE: none

Sent sent_from(ivec2 cell) {
    Sent s = Sent(vec3(0.0), vec3(0.0), vec4(0.0), 0.0, ID_NONE);
    ivec2 px = pixel_of(cell);
    if (any(lessThan(px, ivec2(0))) || any(greaterThanEqual(px, frame.size_px))) return s;
    uvec4 g = imageLoad(guide, cell);
    if (g.y == 0u) return s;
    Ray ray = primary_ray(px);
    vec3 from = ray.origin + uintBitsToFloat(g.y) * ray.dir;
    return Sent(from, oct_decode(unpackUnorm2x16(g.x)), imageLoad(out_reflection, px), uintBitsToFloat(g.z), g.w);
}

bool alike(vec3 a, vec3 b, float beside) { return all(lessThan(abs(a - b), vec3(contrast * (max3(max(a, b)) + beside)))); }

// Whether two look about the same way, 11 degrees, and see about the same.
bool alike(Sent a, Sent b) {
    return isinf(a.seen.a) == isinf(b.seen.a) && dot(a.dir, b.dir) >= 0.98 && alike(a.seen.rgb, b.seen.rgb, min(a.beside, b.beside));
}

bool midway(Sent a, Sent b, vec3 from) { return distance(from, 0.5 * (a.from + b.from)) <= 0.25 * distance(a.from, b.from); }

// Whether some point of a material may send a mirror ray: as `reflective` in glhybrid/needs.py.
bool may_send(Material m) {
    uint slots_filled = m.texture_slots;
    bool base = m.roughness < frame.mirror_cutoff || (slots_filled >> SLOT_METALLIC_ROUGHNESS & 1u) == 1u;
    bool coat = CLEARCOAT && m.clearcoat > 0.0 &&
                (m.clearcoat_roughness < frame.mirror_cutoff || (slots_filled >> SLOT_CLEARCOAT_ROUGHNESS & 1u) == 1u);
    return m.unlit == 0u && (base || coat);
}

// A pixel from two pairs that lie on both sides of it, a and b the nearer; false: it needs a ray of its own.
bool resolve(ivec2 px, Sent a, Sent b, Sent c, Sent d) {
    if (any(greaterThanEqual(px, frame.size_px))) return true;             // groups overhang the edge
    uvec2 id = texelFetch(gbuffer_id, px, 0).xy;
    bool sends = false, surface = id.y != ID_NONE;
    vec4 result = vec4(0.0);
    if (surface) {
        uint material = hit_group_of(id.x, texelFetch(triangles, int(id.y)).w).material;
        sends = may_send(material_row(material));
        if (sends && any(notEqual(uvec4(a.material, b.material, c.material, d.material), uvec4(material)))) return false;
    }
    if (sends) {
        float beside = min(min(a.beside, b.beside), min(c.beside, d.beside));
        bool faint = max3(max(max(a.seen.rgb, b.seen.rgb), max(c.seen.rgb, d.seen.rgb))) < contrast * beside;
        if (!faint) {
            if (!alike(a, b) || !alike(c, d) || !alike(a.seen.rgb + b.seen.rgb, c.seen.rgb + d.seen.rgb, 2.0 * beside)) return false;
            Pixel p = pixel_of(px, id);
            vec3 from = p.ray.origin + p.hit.t * p.ray.dir;
            if (!midway(a, b, from) || !midway(c, d, from)) return false;
        }
        result = 0.5 * (a.seen + b.seen);
    }
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(!surface ? REASON_NONE : !sends ? REASON_ROUGH : imageLoad(out_reason, pixel_of(tile_pixel())).x));
#endif
    return true;
}

// One after another, those of a work group together: rays of neighbours stay together.
shared uint refused[2u * OTHERS], first;    // a bit an invocation, of each pixel of a cell

void main() {
    ivec2 cell = tile_pixel();
    uint lane = gl_LocalInvocationIndex;
    if (lane < 2u * OTHERS) refused[lane] = 0u;
    barrier();
    bool needs_ray[OTHERS];
    ivec2 others[OTHERS];
#if USE_REFLECT_GRID == 1
    // Along rows and columns, and across them; the diagonals of a block.
    Sent here = sent_from(cell), right = sent_from(cell + ivec2(1, 0)), up = sent_from(cell + ivec2(0, 1)), far = sent_from(cell + 1);
    others[0] = 2 * cell + ivec2(1, 0);
    others[1] = 2 * cell + ivec2(0, 1);
    others[2] = 2 * cell + 1;
    needs_ray[0] = !resolve(others[0], here, right, sent_from(cell - ivec2(0, 1)), far);
    needs_ray[1] = !resolve(others[1], here, up, sent_from(cell - ivec2(1, 0)), far);
    needs_ray[2] = !resolve(others[2], here, far, up, right);
#else
    // Left and right, below and above.
    others[0] = ivec2(2 * cell.x + 1 - (cell.y & 1), cell.y);
    ivec2 left = ivec2(cell.x - (cell.y & 1), cell.y);
    needs_ray[0] = !resolve(others[0], sent_from(left), sent_from(left + ivec2(1, 0)), sent_from(cell - ivec2(0, 1)), sent_from(cell + ivec2(0, 1)));
#endif
    for (uint k = 0u; k < OTHERS; k++)
        if (needs_ray[k]) atomicOr(refused[2u * k + (lane >> 5u)], 1u << (lane & 31u));
    barrier();
    uint all_of_group = 0u, before = 0u;
    for (uint k = 0u; k < OTHERS; k++) {
        uint low = refused[2u * k], high = refused[2u * k + 1u];
        all_of_group += uint(bitCount(low) + bitCount(high));
        uint below = (1u << (lane & 31u)) - 1u;
        before += lane < 32u ? uint(bitCount(low & below)) : uint(bitCount(low) + bitCount(high & below));
    }
    if (lane == 0u) {
        first = all_of_group > 0u ? atomicAdd(pixel_count, all_of_group) : 0u;
        if (all_of_group > 0u) atomicMax(groups_y, (first + all_of_group - 1u) / (GROUPS_ACROSS * 64u) + 1u);
    }
    barrier();
    uint i = first + before;
    for (uint k = 0u; k < OTHERS; k++) if (needs_ray[k]) pixel_list[i++] = uint(others[k].x) | uint(others[k].y) << 16u;
}
