// lib/intersect.glsl -- a ray in the space of one tree, and its tests against boxes and triangles.
//
// Triangle test: Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1) 2013. `precise` is what makes
// it watertight: an fma contracted on one side of a shared edge only opens a crack.
// Boxes: Ize, "Robust BVH Ray Traversal", JCGT 2(2) 2013, with the bound taken in grid cells per axis instead of in ulps of t.

// A box's near and far planes are told apart by the direction's sign: a CPU shifts their words, a GPU multiplies them, whose
// units for products have room where those for shifts, minima and conversions have none. To the minimum and maximum of both
// planes an H100 gains 4 to 9 % in bare rays, in mirror rays of frames 11 to 28 %, where the six registers more that it takes are there: hence
// one origin for all shadow rays of a point, no loop over one light, and no second ray beside the local one.
#define BY_SHIFTS USE_BRANCHLESS

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
