// lib/bvh.glsl -- traversal of the two-level structure: closest_hit and any_hit.
//
// Node: two children in two texels, 16-bit box planes on a grid and a ref each. Bounded inner loop ("at most
// BVH_INNER_STEPS inner nodes, then at most one leaf") keeps the lanes of a GPU together; on a CPU there is none.
// USE_BRANCHLESS is that CPU's form of it. llvmpipe reads and writes a stack in memory lane by lane, and writes behind a branch
// for each, taken if the lane is at work: a third of the instructions of a turn. So the upper end of the stack is in registers,
// which a push or pop moves by one, all lanes at once, and memory is seen only between turns: up to an eighth faster than stores
// above the top that count or not, those a seventh faster than "if (both)", the near and far planes by the direction's sign
// another twentieth, loops with their conditions at the end another tenth.
// Triangle test: Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1) 2013. `precise` is what makes
// it watertight: an fma contracted on one side of a shared edge only opens a crack.
// Boxes: Ize, "Robust BVH Ray Traversal", JCGT 2(2) 2013, with the bound taken in grid cells per axis instead of in ulps of t.
#include "lib/geometry.glsl"
#include "lib/loop.glsl"
#include "lib/texture.glsl"

const uint LEAF = 0x80000000u;
const uint REF_END = 0xFFFFFFFFu;      // bottom of the stack
const uint REF_RETURN = 0xFFFFFFFEu;   // the instance is done: back to the world's ray
const uint REF_BELOW = 0xFFFFFFFDu;    // the registers are empty: the next is in memory
const bool UNBOUNDED = BVH_INNER_STEPS >= 0x100000;

// What a ray sees.
const uint SEE_SURFACES = 0u;      // camera and reflection rays: single-sided back faces and blended surfaces are invisible
const uint SEE_BLOCKERS = 1u;      // shadow rays: everything, blended surfaces tint; stops at the first full blocker
const uint SEE_BLENDED = 2u;       // only blended surfaces

// A box's near and far planes are told apart by the direction's sign: a CPU shifts their words, a GPU multiplies them, whose
// units for products have room where those for shifts, minima and conversions have none. To the minimum and maximum of both
// planes an H100 gains 4 to 9 % in bare rays, in mirror rays of frames 11 to 28 %, where the six registers more that it takes are there: hence
// one origin for all shadow rays of a point, no loop over one light, and no second ray beside the local one.
#define BY_SHIFTS USE_BRANCHLESS

// How far a ray looks for a nearer hit is that hit's distance, kept once: a register less. With five inner steps in place of four
// and fewer stores of mirror rays an H100 takes 1 to 3 % less for frames in one level; in two levels this was not read.
#if USE_BRANCHLESS || USE_TWO_LEVEL
#define ONE_REACH 0
#else
#define ONE_REACH 1
#endif

const bool ASKS = ALPHA_TEST || BLENDED || SINGLE_SIDED;    // a hit may have to ask an any-hit function

// One stack for every traversal in the shader: each copy would cost its bytes in local memory, used or not.
uint stack[BVH_STACK];
#if USE_BRANCHLESS
// Its upper end, the top first, REF_BELOW where there is none. The last waits for its way into memory, and its lane with it:
// fewer registers wait too often, more cost every turn. The fastest are 7 in hall, spheres and city with their 24 entries, by
// 1 % to 9, and 10 to 12 in Sponza with its 36, by 10 % to 7.
const int TOP = clamp(BVH_STACK / 4 + 1, 4, 12);
uint top[TOP];
#endif
#if USE_STEP_COUNTER
uint step_count = 0u;
#endif

// A ray in the space of one tree, with what the box and triangle tests need of it.
struct LocalRay {
    vec3 origin, dir;
    vec3 inv_dir, near_offset, far_offset;   // t = plane * inv_dir - offset, in 2^-16 grid cells
#if BY_SHIFTS
    uvec3 near_shift;                     // 16 where the low plane is the near one, else 0
#else
    uvec3 near_scale, far_scale;          // 65536 and 1 there, else 1 and 65536
#endif
    vec3 shear;                           // x, y, z of the watertight test
    int axis;                             // of the largest direction component
};

vec3 permute(vec3 v, int axis) { return axis == 2 ? v : (axis == 0 ? v.yzx : v.zxy); }

LocalRay local_ray(vec3 origin, vec3 dir, vec3 grid_min, vec3 grid_step) {
    LocalRay r;
    r.origin = origin;
    r.dir = dir;
    vec3 d = dir / grid_step;
    // A zero component would make 0 * inf = NaN on a slab plane; 1e-20 keeps every product finite.
    d = mix(d, mix(vec3(-1e-20), vec3(1e-20), greaterThanEqual(d, vec3(0.0))), lessThan(abs(d), vec3(1e-20)));
    r.inv_dir = 1.0 / d;
    vec3 o = (origin - grid_min) / grid_step;
    // Rounding of plane and origin, in cells: under 10 * 2^-24 of the larger of both; the boxes are widened by that.
    vec3 pad = (abs(o) + 65536.0) * 6e-7;
    bvec3 down = lessThan(r.inv_dir, vec3(0.0));
    vec3 low = (o + pad) * r.inv_dir, high = (o - pad) * r.inv_dir;
    r.near_offset = mix(low, high, down);
    r.far_offset = mix(high, low, down);
    r.inv_dir *= 1.0 / 65536.0;
#if BY_SHIFTS
    r.near_shift = 16u - 16u * uvec3(down);
#else
    r.near_scale = 65536u - 65535u * uvec3(down);
    r.far_scale = 1u + 65535u * uvec3(down);
#endif
    vec3 a = abs(dir);
    r.axis = a.x > a.y ? (a.x > a.z ? 0 : 2) : (a.y > a.z ? 1 : 2);
    vec3 p = permute(dir, r.axis);
    r.shear = vec3(p.x / p.z, p.y / p.z, 1.0 / p.z);
    return r;
}

#if USE_TWO_LEVEL
// The ray in the space of an instance, whose tree is next; ID_NONE: in the world's.
LocalRay local_to(uint instance, Ray ray, inout uint next) {
    vec3 origin = ray.origin, dir = ray.dir, grid_min = frame.top_grid_min, grid_step = frame.top_grid_step;
    if (instance != ID_NONE) {
        Instance inst = instance_row(instance);
        mat3 m = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
        origin = m * origin + inst.object_from_world[3];
        dir = m * dir;
        grid_min = inst.grid_min;
        grid_step = inst.grid_step;
        next = inst.root;
    }
    return local_ray(origin, dir, grid_min, grid_step);
}
#endif

// Where a ray enters a child's box and where it leaves it, not before t_min and not after t_max: missed if x > y. As bits:
// floats that are not negative have the order of their bits, a negative one only makes its slab start before t_min or end
// before it, whichever it is, and t_min is not negative. An integer minimum knows no NaN to look out for: llvmpipe gains a
// fifth.
ivec2 box_span(uvec3 planes, LocalRay r, float t_min, float t_max) {
    // A plane in the upper half of its word; the high one keeps the low one as its fraction: less than a cell outward.
#if BY_SHIFTS
    uvec3 near = planes << r.near_shift, far = planes << (16u - r.near_shift);
#else
    uvec3 near = planes * r.near_scale, far = planes * r.far_scale;
#endif
    ivec3 enter = floatBitsToInt(vec3(near) * r.inv_dir - r.near_offset);
    ivec3 leave = floatBitsToInt(vec3(far) * r.inv_dir - r.far_offset);
    return ivec2(max(max(enter.x, enter.y), max(enter.z, floatBitsToInt(t_min))),
                 min(min(leave.x, leave.y), min(leave.z, floatBitsToInt(t_max))));
}

// Whether none is negative or none is positive; both zeros are neither.
bool one_sign(vec3 w) {
#if USE_BRANCHLESS
    ivec3 a = floatBitsToInt(w), b = floatBitsToInt(-w);                         // bits of what is not positive are <= 0
    return min(max(max(a.x, a.y), a.z), max(max(b.x, b.y), b.z)) <= 0;
#else
    return min3(w) >= 0.0 || max3(w) <= 0.0;
#endif
}

// min and max as GLSL defines them. llvmpipe's do more, with a NaN, and take three instructions instead of one.
#if USE_BRANCHLESS
float lesser(float a, float b) { precise float found = b < a ? b : a; return found; }
float greater(float a, float b) { precise float found = a < b ? b : a; return found; }
#else
float lesser(float a, float b) { return min(a, b); }
float greater(float a, float b) { return max(a, b); }
#endif

// Woop's test. Returns det (0 = outside) and the scaled weights of v0, v1, v2, and the depths along the ray's main axis.
float triangle_weights(LocalRay r, vec3 v0, vec3 v1, vec3 v2, out vec3 weights, out vec3 depths) {
    vec3 a = permute(v0 - r.origin, r.axis), b = permute(v1 - r.origin, r.axis), c = permute(v2 - r.origin, r.axis);
    precise float ax = a.x - r.shear.x * a.z, ay = a.y - r.shear.y * a.z;
    precise float bx = b.x - r.shear.x * b.z, by = b.y - r.shear.y * b.z;
    precise float cx = c.x - r.shear.x * c.z, cy = c.y - r.shear.y * c.z;
    precise float u0 = cx * by, u1 = cy * bx, u = u0 - u1;
    precise float v_0 = ax * cy, v_1 = ay * cx, v = v_0 - v_1;
    precise float w0 = bx * ay, w1 = by * ax, w = w0 - w1;
    weights = vec3(u, v, w);
    depths = vec3(a.z, b.z, c.z) * r.shear.z;
    return one_sign(weights) ? u + v + w : 0.0;
}

// Moeller-Trumbore, the control of the leak tests: it must fail where the test above holds.
float triangle_weights_mt(LocalRay r, vec3 v0, vec3 v1, vec3 v2, out vec3 weights, out vec3 depths) {
    vec3 e1 = v1 - v0, e2 = v2 - v0, s = r.origin - v0;
    vec3 p = cross(r.dir, e2), q = cross(s, e1);
    float det = dot(e1, p);
    float v = dot(s, p) / det, w = dot(r.dir, q) / det;
    weights = vec3(1.0 - v - w, v, w);
    depths = vec3(dot(e2, q) / det);
    return v >= 0.0 && w >= 0.0 && v + w <= 1.0 ? 1.0 : 0.0;
}

// The intersection function of KIND_TRIANGLE. True if the ray meets it within [t_min, t_max]; front: it meets the wound side.
bool intersect_triangle(LocalRay r, vec3 v0, vec3 v1, vec3 v2, float t_min, float t_max,
                        out float t, out vec2 bary, out bool front) {
    vec3 weights, depths;
#if USE_MOELLER_TRUMBORE
    float det = triangle_weights_mt(r, v0, v1, v2, weights, depths);
#else
    float det = triangle_weights(r, v0, v1, v2, weights, depths);
#endif
    if (!BRANCHLESS && det == 0.0) return false;                                 // a GPU skips the rest, a CPU's lanes cannot
    bary = weights.yz / det;
    // t from the plane: more exact than the weighted depths; clamped to them, where a sliver's normal is noise.
    vec3 n = cross(v1 - v0, v2 - v0);
    float facing = dot(r.dir, n);
    t = greater(dot(v0 - r.origin, n) / facing, lesser(lesser(depths.x, depths.y), depths.z));
    t = lesser(t, greater(greater(depths.x, depths.y), depths.z));
    if (facing == 0.0) t = dot(weights, depths) / det;
    front = facing < 0.0;
    return det != 0.0 && t >= t_min && t <= t_max;                               // a NaN t fails
}

// The any-hit function: what is at this point of the surface for this kind of ray?  1 = nothing, 0 = a full blocker or a
// surface to stop at, between = a tint on the way (SEE_BLOCKERS only).
vec3 transmittance_at(HitGroup group, Hit hit, Ray ray, bool front, uint see) {
    if (see != SEE_BLOCKERS) {
        bool blended = group.any_hit == ANY_HIT_TINT;
        if (SINGLE_SIDED && group.single_sided == 1u && !front) return vec3(1.0);
        if (BLENDED && blended != (see == SEE_BLENDED)) return vec3(1.0);
    }
    vec3 result = vec3(0.0);
#if USE_ALPHA_TEST || USE_BLENDED
    if (group.any_hit == ANY_HIT_MASK || (see == SEE_BLOCKERS && group.any_hit == ANY_HIT_TINT)) {
        bool sphere = SPHERES && group.kind == KIND_SPHERE;
        if (sphere) hit.bary = sphere_point(texelFetch(triangles, int(hit.triangle)), ray, hit.t, instance_row(hit.instance)).uv;
        vec4 color = base_color_at(group.material, hit);
        if (group.any_hit == ANY_HIT_MASK) result = vec3(color.a < material_row(group.material).alpha_cutoff ? 1.0 : 0.0);
#if USE_BLENDED
        else {
            Instance inst = instance_row(hit.instance);
            uvec4 tri = texelFetch(triangles, int(hit.triangle));
            Point p = sphere ? sphere_point(tri, ray, hit.t, inst) : triangle_point(tri, hit.bary, inst);
            result = tint_at(material_row(group.material), color, hit, abs(dot(p.n_geo, normalize(ray.dir))));
        }
#endif
    }
#endif
    return result;
}

#if USE_BRANCHLESS
void push(uint ref, bool wanted) {
    for (int k = TOP - 1; k > 0; k--) top[k] = wanted ? top[k - 1] : top[k];
    top[0] = wanted ? ref : top[0];
}

void pop(bool wanted) {
    for (int k = 0; k < TOP - 1; k++) top[k] = wanted ? top[k + 1] : top[k];
    top[TOP - 1] = wanted ? REF_BELOW : top[TOP - 1];
}

uint popped() {
    uint ref = top[0];
    pop(true);
    return ref;
}

// Between turns: the last register into memory, or what is next out of it. sp: entries in memory. One place is read and
// written for both, so that the addresses of its lanes are made once.
void settle(inout uint cur, inout int sp) {
    bool full = top[TOP - 1] != REF_BELOW, empty = cur == REF_BELOW;
    int at = sp + int(full);                                                     // from 1 on
    uint there = stack[at];
    stack[at] = full ? top[TOP - 1] : there;
    top[TOP - 1] = REF_BELOW;
    cur = empty ? there : cur;
    sp = at - int(empty);
}

// Whether a lane is at an inner node and has room for what a turn pushes.
bool can_turn(uint cur) { return (cur & LEAF) == 0u && top[TOP - 1] == REF_BELOW; }

// A node's turn as in `traverse`, of a lane that can. Which can is asked once, before the loop, instead of in every turn of
// it: reflections take 3 to 5 % less.
void turn(inout uint cur, LocalRay local, float t_min, float t_max, const bool closest) {
    uvec4 a = texelFetch(nodes, int(cur) * 2), b = texelFetch(nodes, int(cur) * 2 + 1);
    ivec2 in_a = box_span(a.xyz, local, t_min, t_max), in_b = box_span(b.xyz, local, t_min, t_max);
    bool meets_a = in_a.x <= in_a.y, meets_b = in_b.x <= in_b.y;
    bool b_first = closest ? in_b.x < in_a.x : in_b.x > in_a.x;                  // if both are met
    uint next = b_first ? b.w : a.w;
    next = meets_b ? next : a.w;
    next = meets_a ? next : b.w;
    cur = meets_a || meets_b ? next : top[0];
    pop(!meets_a && !meets_b);                                                   // from below, then push from above: each
    push(b_first ? a.w : b.w, meets_a && meets_b);                               // register is written once
#if USE_STEP_COUNTER
    step_count++;
#endif
}
#endif

// Follows one ray through the structure. SEE_BLOCKERS: tint is what is left of the light; others: hit is the nearest.
// A surface whose any-hit function must be asked interrupts the loop: asking reads textures, and that code must not stand
// where every triangle passes (a CPU would run it masked for each of them, a GPU keep its registers).
void traverse(Ray ray, const uint see, inout Hit hit, inout vec3 tint) {
    const bool closest = see != SEE_BLOCKERS;
#if ONE_REACH
    if (closest) hit.t = ray.t_max;
#define t_max (closest ? hit.t : ray.t_max)
#else
    float t_max = ray.t_max;
#endif
    LocalRay local;
#if USE_TWO_LEVEL
    uint instance = ID_NONE, cur = frame.top_root;
    local = local_to(instance, ray, cur);
#if USE_BRANCHLESS
    LocalRay world = local;
#endif
#else
    const uint instance = 0u;                      // whose transform is a translation
    uint cur = instance_row(0).root;
    local = local_ray(ray.origin + instance_row(0).object_from_world[3], ray.dir, instance_row(0).grid_min, instance_row(0).grid_step);
#endif
    uint slot = 0u, slot_end = 0u;                 // what is left of the current leaf, in texels
    Hit candidate;
    bool front, pending = false;
    int sp = 0;
#if USE_BRANCHLESS
    for (int k = 0; k < TOP; k++) top[k] = REF_BELOW;
    top[0] = REF_END;
#else
    stack[0] = REF_END;
#endif
    for (;;) {
        WHILE (cur != REF_END) {
#if USE_TWO_LEVEL && USE_BRANCHLESS
            // To the next instance and right through it: lanes wait for each other, but what enters runs once for each, and
            // not masked with every leaf. Frames of two levels take a tenth less.
            if (instance == ID_NONE) {
                do {
                    if (can_turn(cur)) {
                        do turn(cur, world, ray.t_min, t_max, closest);
                        while (can_turn(cur));
                    }
                    settle(cur, sp);
                } while ((cur & LEAF) == 0u);
            }
            if (instance == ID_NONE && cur < REF_BELOW) {
                instance = (cur & ~LEAF) >> 4u;
                local = local_to(instance, ray, cur);
                push(REF_RETURN, true);
            }
            do {
#endif
            // One child on the stack, the other next; none: the stack's top. The near one is next for the closest hit. For any
            // hit the far one: what is near is the neighbourhood that the ray leaves, and seldom blocks it; up to a third fewer
            // steps.
#if USE_BRANCHLESS
            int turns = 0;
            if (can_turn(cur)) {
                do turn(cur, local, ray.t_min, t_max, closest);
                while ((UNBOUNDED || ++turns < BVH_INNER_STEPS) && can_turn(cur));
            }
            settle(cur, sp);
#else
            for (int i = 0; (UNBOUNDED || i < BVH_INNER_STEPS) && (cur & LEAF) == 0u; i++) {
                uvec4 a = texelFetch(nodes, int(cur) * 2), b = texelFetch(nodes, int(cur) * 2 + 1);
                ivec2 in_a = box_span(a.xyz, local, ray.t_min, t_max), in_b = box_span(b.xyz, local, ray.t_min, t_max);
                bool meets_a = in_a.x <= in_a.y, meets_b = in_b.x <= in_b.y;
                bool b_next = meets_b && (!meets_a || (closest ? in_b.x < in_a.x : in_b.x > in_a.x));
                if (meets_a && meets_b) stack[++sp] = b_next ? a.w : b.w;
                if (meets_a || meets_b) cur = b_next ? b.w : a.w;
                else cur = stack[sp--];
#if USE_STEP_COUNTER
                step_count++;
#endif
            }
#endif
            if ((cur & LEAF) == 0u || cur >= (BRANCHLESS ? REF_BELOW : REF_END)) continue;
#if USE_TWO_LEVEL && !USE_BRANCHLESS
            // Into an instance, or back. The world's ray is made again then: kept, it takes the registers that the boxes want.
            if (cur == REF_RETURN || instance == ID_NONE) {
                instance = cur == REF_RETURN ? ID_NONE : (cur & ~LEAF) >> 4u;
                if (instance == ID_NONE) cur = stack[sp--];
                else stack[++sp] = REF_RETURN;
                local = local_to(instance, ray, cur);
                continue;
            }
#endif
            if (!ASKS || slot >= slot_end) {
                slot = ((cur & ~LEAF) >> 4u) * 3u;
                slot_end = slot + (cur & 15u) * 3u;
            }
            WHILE (slot < slot_end && !pending) {
                uvec4 s0 = texelFetch(slots, int(slot)), s1 = texelFetch(slots, int(slot) + 1), s2 = texelFetch(slots, int(slot) + 2);
                float t;
                vec2 bary = vec2(0.0);
                bool met, faces_ray;
                if (SPHERES && s2.w == KIND_SPHERE)
                    met = intersect_sphere(local.origin - uintBitsToFloat(s0.xyz), local.dir, uintBitsToFloat(s1.x), ray.t_min, t_max, t, faces_ray);
                else
                    met = intersect_triangle(local, uintBitsToFloat(s0.xyz), uintBitsToFloat(s1.xyz), uintBitsToFloat(s2.xyz),
                                             ray.t_min, t_max, t, bary, faces_ray);
#if USE_STEP_COUNTER
                step_count++;
#endif
                if (TESTS_LAST) met = met && slot < slot_end;                    // the empty child of a tree that is one leaf
                // Of surfaces at one distance the lowest id wins, whatever the order of the tree: the raster's rule too.
                if (closest) met = met && (t < hit.t || s0.w < hit.triangle);
                if (closest && SINGLE_SIDED) met = met && (faces_ray || (s1.w & SLOT_SINGLE_SIDED) == 0u);
                bool ask = (s1.w & SLOT_ASK) != 0u;
                if (BLENDED && see == SEE_BLENDED) met = met && ask;
                if (ASKS && met && ask) {
                    candidate = Hit(t, bary, instance, s0.w, s1.w & SLOT_GEOMETRY);
                    front = faces_ray;
                    pending = true;
                } else if (met) {
                    hit = Hit(t, bary, instance, s0.w, s1.w & SLOT_GEOMETRY);
#if !ONE_REACH
                    t_max = t;
#endif
                    if (!closest) {
                        tint = vec3(0.0);
#if USE_BRANCHLESS
                        top[0] = REF_END;                                        // leaving from the midst costs a CPU masks
#else
                        return;
#endif
                        slot_end = slot + 3u;
                    }
                }
                slot += 3u;
            }
            END_WHILE (slot < slot_end && !pending)
#if USE_BRANCHLESS
            if (!ASKS || slot >= slot_end) cur = popped();
#else
            if (!ASKS || slot >= slot_end) cur = stack[sp--];
#endif
            if (pending) break;
#if USE_TWO_LEVEL && USE_BRANCHLESS
            } while (cur < REF_RETURN);
            if (pending) break;
            if (cur == REF_RETURN) {
                instance = ID_NONE;
                cur = popped();
            }
#endif
        }
        END_WHILE (cur != REF_END)
        if (!pending) return;
        pending = false;
        HitGroup group = hit_group_of(candidate.instance, candidate.geometry);
#if USE_SPHERES
        bool again;
        do {                                                                     // a loop only here: H100s pay a third for one
            again = false;
#endif
            vec3 through = transmittance_at(group, candidate, ray, front, see);
            tint *= through;
            if (!closest && max3(through) < 1.0) hit = candidate;
            if (max3(closest ? through : tint) <= 0.0) {
                hit = candidate;
#if !ONE_REACH
                t_max = candidate.t;
#endif
                if (!closest) return;
            }
#if USE_SPHERES
            else if (group.kind == KIND_SPHERE && front) {                       // let through: its far side is next
                uvec4 tri = texelFetch(triangles, int(candidate.triangle));
                again = intersect_sphere(local.origin - vertex_position(tri.x), local.dir, sphere_radius(tri), next_after(candidate.t),
                                         t_max, candidate.t, front);
            }
        } while (again);
#endif
    }
#undef t_max
}

// The nearest surface that a camera or reflection ray sees.
Hit closest_hit(Ray ray) {
    Hit hit = MISS;
    vec3 tint = vec3(1.0);
    traverse(ray, SEE_SURFACES, hit, tint);
    if (ONE_REACH == 1 && hit.triangle == ID_NONE) hit.t = INFINITY;
    return hit;
}

// The share of light that arrives along a shadow ray: 0 or 1, between only through tinted surfaces.
vec3 any_hit(Ray ray) {
    Hit hit = MISS;
    vec3 tint = vec3(1.0);
    traverse(ray, SEE_BLOCKERS, hit, tint);
    return tint;
}

// The same, and how far away something blocks or tints, if not the nearest; INFINITY: nothing does.
vec3 any_hit(Ray ray, out float distance) {
    Hit hit = MISS;
    vec3 tint = vec3(1.0);
    traverse(ray, SEE_BLOCKERS, hit, tint);
    distance = hit.t;
    return tint;
}

#if USE_BLENDED
// The nearest blended surface beyond t_min.
Hit closest_blended(Ray ray) {
    Hit hit = MISS;
    vec3 tint = vec3(1.0);
    traverse(ray, SEE_BLENDED, hit, tint);
    if (ONE_REACH == 1 && hit.triangle == ID_NONE) hit.t = INFINITY;
    return hit;
}
#endif
