// lib/bvh.glsl -- traversal of the two-level structure: closest_hit and any_hit.
//
// Node: two children in two texels, 16-bit box planes on a grid and a ref each. Bounded inner loop ("at most
// BVH_INNER_STEPS inner nodes, then at most one leaf") keeps the lanes of a GPU together; on a CPU there is none.
// USE_BRANCHLESS is that CPU's form of it. llvmpipe reads and writes a stack in memory lane by lane, and writes behind a branch
// for each, taken if the lane is at work: a third of the instructions of a turn. So the upper end of the stack is in registers,
// which a push or pop moves by one, all lanes at once, and memory is seen only between turns: up to an eighth faster than stores
// above the top that count or not, those a seventh faster than "if (both)", the near and far planes by the direction's sign
// another twentieth, loops with their conditions at the end another tenth.
// What a ray meets of boxes and triangles: lib/intersect.glsl.
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
const uint SEE_NEAREST_BLOCKER = 3u;   // as SEE_BLOCKERS, but goes on to the nearest of them
bool is_shadow_ray(uint see) { return see == SEE_BLOCKERS || see == SEE_NEAREST_BLOCKER; }

// REACH: how far a ray looks for a nearer hit. With ONE_REACH it is that hit's distance, kept once: a register less. With five
// inner steps in place of four and fewer stores of mirror rays an H100 takes 1 to 3 % less for frames in one level; in two
// levels (`plaza`) 7 % more.
#if USE_BRANCHLESS || USE_TWO_LEVEL
#define ONE_REACH 0
#define REACH t_max
#define SHORTEN(t) t_max = t;
#else
#define ONE_REACH 1
#define REACH (closest ? hit.t : ray.t_max)
#define SHORTEN(t)
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
#include "lib/intersect.glsl"

// The any-hit function: what is at this point of the surface for this kind of ray?  1 = nothing, 0 = a full blocker or a
// surface to stop at, between = a tint on the way (shadow rays only).
vec3 transmittance_at(HitGroup group, Hit hit, Ray ray, bool front, uint see) {
    if (!is_shadow_ray(see)) {
        bool blended = group.any_hit == ANY_HIT_TINT;
        if (SINGLE_SIDED && group.single_sided == 1u && !front) return vec3(1.0);
        if (BLENDED && blended != (see == SEE_BLENDED)) return vec3(1.0);
    }
    vec3 result = vec3(0.0);
#if USE_ALPHA_TEST || USE_BLENDED
    if (group.any_hit == ANY_HIT_MASK || (is_shadow_ray(see) && group.any_hit == ANY_HIT_TINT)) {
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
                        do turn(cur, world, ray.t_min, REACH, closest);
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
                do turn(cur, local, ray.t_min, REACH, closest);
                while ((UNBOUNDED || ++turns < BVH_INNER_STEPS) && can_turn(cur));
            }
            settle(cur, sp);
#else
            for (int i = 0; (UNBOUNDED || i < BVH_INNER_STEPS) && (cur & LEAF) == 0u; i++) {
                uvec4 a = texelFetch(nodes, int(cur) * 2), b = texelFetch(nodes, int(cur) * 2 + 1);
                ivec2 in_a = box_span(a.xyz, local, ray.t_min, REACH), in_b = box_span(b.xyz, local, ray.t_min, REACH);
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
                    met = intersect_sphere(local.origin - uintBitsToFloat(s0.xyz), local.dir, uintBitsToFloat(s1.x), ray.t_min, REACH, t, faces_ray);
                else
                    met = intersect_triangle(local, uintBitsToFloat(s0.xyz), uintBitsToFloat(s1.xyz), uintBitsToFloat(s2.xyz),
                                             ray.t_min, REACH, t, bary, faces_ray);
#if USE_STEP_COUNTER
                step_count++;
#endif
                if (TESTS_LAST) met = met && slot < slot_end;                    // the empty child of a tree that is one leaf
                // Of surfaces at one distance the lowest id wins, whatever the order of the tree: the raster's rule too.
                if (closest) met = met && (t < hit.t || s0.w < hit.triangle);
                if (!is_shadow_ray(see) && SINGLE_SIDED) met = met && (faces_ray || (s1.w & SLOT_SINGLE_SIDED) == 0u);
                bool ask = (s1.w & SLOT_ASK) != 0u;
                if (BLENDED && see == SEE_BLENDED) met = met && ask;
                if (ASKS && met && ask) {
                    candidate = Hit(t, bary, instance, s0.w, s1.w & SLOT_GEOMETRY);
                    front = faces_ray;
                    pending = true;
                } else if (met) {
                    hit = Hit(t, bary, instance, s0.w, s1.w & SLOT_GEOMETRY);
                    SHORTEN(t)
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
                SHORTEN(candidate.t)
                if (!closest) return;
            }
#if USE_SPHERES
            else if (group.kind == KIND_SPHERE && front) {                       // let through: its far side is next
                uvec4 tri = texelFetch(triangles, int(candidate.triangle));
                again = intersect_sphere(local.origin - vertex_position(tri.x), local.dir, sphere_radius(tri), next_after(candidate.t),
                                         REACH, candidate.t, front);
            }
        } while (again);
#endif
    }
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

// The same, and what blocks or tints, if not the nearest; MISS: nothing does.
vec3 any_hit(Ray ray, out Hit hit) {
    hit = MISS;
    vec3 tint = vec3(1.0);
    traverse(ray, SEE_BLOCKERS, hit, tint);
    return tint;
}

// The same, and the nearest that blocks, whatever the order of the tree; MISS: nothing does.
vec3 nearest_blocker(Ray ray, out Hit hit) {
    hit = MISS;
    vec3 tint = vec3(1.0);
    traverse(ray, SEE_NEAREST_BLOCKER, hit, tint);
    if (hit.triangle == ID_NONE) hit.t = INFINITY;
    else tint = vec3(0.0);
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
