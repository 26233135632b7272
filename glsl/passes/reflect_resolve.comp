// passes/reflect_resolve.comp -- from rays of a part of the pixels to all: a pixel between two pairs that sent one takes their
// mean if it lies midway between them on one surface and all of them see nearly the same. All others go on a list and are
// traced. Surfaces are not looked up here: what a texture changes between pixels shows in what its neighbours see.
#include "lib/gbuffer.glsl"
#include "lib/sparse.glsl"

layout(rgba32f) readonly uniform image2D sparse;             // as passes/reflect_sparse.comp wrote them
layout(rgba32ui) readonly uniform uimage2D guide;
layout(rgba32f) writeonly uniform image2D out_reflection;
#if USE_REASON
layout(r8ui) writeonly uniform uimage2D out_reason;
#endif
layout(std430) writeonly buffer PixelList { uint pixel_list[]; };
layout(std430) buffer PixelCount { uint groups_x, groups_y, groups_z, pixel_count; };
uniform float contrast;    // share of the brighter by which two means may differ; 0: nothing is shared

// A mirror ray that was sent: where it left, which way, and what it saw.
struct Sent { vec3 from, dir; vec4 seen; bool there; };

Sent sent_from(ivec2 px) {
    Sent s = Sent(vec3(0.0), vec3(0.0), vec4(0.0), false);
    if (any(lessThan(px, ivec2(0))) || any(greaterThanEqual(px, frame.size_px))) return s;
    uvec4 g = imageLoad(guide, cell_of(px));
    if (g.y == 0u) return s;
    Ray ray = primary_ray(px);
    return Sent(ray.origin + uintBitsToFloat(g.y) * ray.dir, oct_decode(unpackUnorm2x16(g.x)), imageLoad(sparse, cell_of(px)), true);
}

// Whether a point lies midway between two, both look about the same way, and see about the same.
bool between(Sent a, Sent b, vec3 from) {
    if (!a.there || !b.there || isinf(a.seen.a) != isinf(b.seen.a)) return false;
    if (distance(from, 0.5 * (a.from + b.from)) > 0.25 * distance(a.from, b.from)) return false;
    if (dot(a.dir, b.dir) < 0.98) return false;                            // 11 degrees
    return all(lessThan(abs(a.seen.rgb - b.seen.rgb), vec3(contrast * max3(max(a.seen.rgb, b.seen.rgb)))));
}

// Whether some point of a material may send a mirror ray: as `reflective` in glhybrid/needs.py.
bool may_send(Material m) {
    uint slots_filled = m.texture_slots;
    bool base = m.roughness < frame.mirror_cutoff || (slots_filled >> SLOT_METALLIC_ROUGHNESS & 1u) == 1u;
    bool coat = CLEARCOAT && m.clearcoat > 0.0 &&
                (m.clearcoat_roughness < frame.mirror_cutoff || (slots_filled >> SLOT_CLEARCOAT_ROUGHNESS & 1u) == 1u);
    return m.unlit == 0u && (base || coat);
}

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    vec4 result = vec4(0.0);
    uint reason = REASON_NONE;
    if (has_cell(px)) {
        result = imageLoad(sparse, cell_of(px));
        reason = imageLoad(guide, cell_of(px)).z;
    } else {
        Pixel p = load_pixel(px);
        bool sends = covered(p) && may_send(material_row(hit_group_of(p.hit.instance, p.hit.geometry).material));
        // Two pairs, each on both sides of the pixel: along rows and columns, or the diagonals of a block.
        bool half_grid = uint(USE_REFLECT_GRID) == GRID_HALF;
        ivec2 d = half_grid ? (px & 1) : ivec2(1, 0);
        ivec2 e = half_grid ? (d.x + d.y == 2 ? ivec2(1, -1) : d + 2 * d.yx) : ivec2(0, 1);
        Sent a = sent_from(px - d), b = sent_from(px + d), f = sent_from(px - e), g = sent_from(px + e);
        vec3 from = p.ray.origin + p.hit.t * p.ray.dir, near = a.seen.rgb + b.seen.rgb, far = f.seen.rgb + g.seen.rgb;
        bool agree = all(lessThanEqual(abs(near - far), vec3(contrast * max3(max(near, far)))));
        reason = covered(p) ? REASON_ROUGH : REASON_NONE;
        if (sends && agree && between(a, b, from) && between(f, g, from)) {
            result = 0.5 * (a.seen + b.seen);
            reason = imageLoad(guide, cell_of(px - d)).z;
        } else if (sends) {
            uint i = atomicAdd(pixel_count, 1u);
            pixel_list[i] = uint(px.x) | uint(px.y) << 16u;
            if (i % (GROUPS_ACROSS * 64u) == 0u) atomicAdd(groups_y, 1u);
        }
    }
    imageStore(out_reflection, px, result);
#if USE_REASON
    imageStore(out_reason, px, uvec4(reason));
#endif
}
