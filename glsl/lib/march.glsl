// lib/march.glsl -- a reflection ray looked for in the G-buffer: which pixel shows what it meets, or why none does.
//
// On the screen a ray is a straight line in (x, y, screen depth), and every pixel a piece of plane in the same space, so
// crossings are solved, not stepped over: perspective-correct and as fine as the geometry. Empty space is skipped by a
// pyramid of nearest depths: Uludag, "Hi-Z Screen-Space Cone-Traced Reflections", GPU Pro 5 (2014); AMD FidelityFX SSSR.
// What went behind a surface is skipped by the farthest depths alike.
#include "lib/gbuffer.glsl"
#include "lib/screen.glsl"

uniform sampler2D screen_depth;      // nearest, farthest
uniform int screen_levels;           // of it
uniform int march_steps;             // cells looked at, at most
uniform float march_thickness;       // of what is seen: share of its distance
uniform float march_thickness_m;     // and m

struct Found {
    Hit hit;          // MISS: none
    ivec2 px;         // that shows it
    uint reason;      // why there is none; REASON_THICKNESS: it was guessed
    float gap;        // share of the thickness that the ray is behind what is seen there
};

// How far behind the screen something that thick still is, as screen depth.
float depth_behind(float depth) {
    float z = frame.orthographic == 1u ? -depth : 1.0 / max(depth, 1e-30);
    z += march_thickness_m + march_thickness * z;
    return frame.orthographic == 1u ? -z : 1.0 / z;
}

// Does the ray meet this very triangle, seen in the pixel, as the tracer would find it?
bool meets(Ray ray, ivec2 px, out Hit hit) {
    uvec2 id = texelFetch(gbuffer_id, px, 0).xy;
    hit = MISS;
    if (id.y == ID_NONE) return false;
    Instance inst = instance_row(id.x);
    uvec4 tri = texelFetch(triangles, int(id.y));
    HitGroup group = hit_group_of(id.x, tri.w);
    mat3 m = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
    vec3 origin = m * ray.origin + inst.object_from_world[3], dir = m * ray.dir, v0 = vertex_position(tri.x);
    hit = Hit(0.0, vec2(0.0), id.x, id.y, tri.w);
    bool met, front;
    if (SPHERES && group.kind == KIND_SPHERE) {
        met = intersect_sphere(origin - v0, dir, sphere_radius(tri), ray.t_min, ray.t_max, hit.t, front);
        if (ALPHA_TEST) hit.bary = sphere_uv(normalize(origin + hit.t * dir - v0));
    } else {
        LocalRay local = local_ray(origin, dir, vec3(0.0), vec3(1.0));
        met = intersect_triangle(local, v0, vertex_position(tri.y), vertex_position(tri.z), ray.t_min, ray.t_max, hit.t, hit.bary, front);
    }
    if (SINGLE_SIDED && group.single_sided == 1u && !front) met = false;
    if (ALPHA_TEST && met && group.any_hit == ANY_HIT_MASK)
        met = base_color_at(group.material, hit).a >= material_row(group.material).alpha_cutoff;
    return met;
}

// ray: from a surface that the pixel `from` shows. With MIRROR_RAYS only what is certain counts, and the search ends at the
// first thing that is not; without, it goes on behind surfaces, and those count as so and so thick. The loop only looks for
// the pixel: what it shows is asked for afterwards, since a CPU runs all that stands in a loop for every turn.
Found march(Ray ray, ivec2 from) {
    vec2 size = vec2(frame.size_px);
    // The ray in (ndc, distance along the view axis), then on the screen: at + u * along.
    vec2 unit = 1.0 / vec2(dot(frame.right_ws, frame.right_ws), dot(frame.up_ws, frame.up_ws));
    vec3 rel = ray.origin - frame.eye_ws;
    vec3 p = vec3(unit * vec2(dot(rel, frame.right_ws), dot(rel, frame.up_ws)), dot(rel, frame.forward_ws));
    vec3 r = vec3(unit * vec2(dot(ray.dir, frame.right_ws), dot(ray.dir, frame.up_ws)), dot(ray.dir, frame.forward_ws));
    bool parallel = frame.orthographic == 1u;
    vec3 at = parallel ? vec3(p.xy, -p.z) : vec3(p.xy, 1.0) / p.z;
    vec3 along = parallel ? vec3(r.xy, -r.z) : vec3(r.xy - at.xy * r.z, -r.z * at.z);
    at.xy = (at.xy * 0.5 + 0.5) * size - frame.jitter_px;
    along.xy *= 0.5 * size;
    // u where the ray ends: at the near plane, at infinity, or at the border of the screen. t = u * p.z / (1 - u * r.z).
    float t_near = (p.z - frame.near) / -r.z;
    float end = r.z < 0.0 ? (parallel ? t_near : t_near / frame.near) : (parallel || r.z == 0.0 ? INFINITY : 1.0 / r.z);
    vec2 moves = mix(along.xy, vec2(1e-20), lessThan(abs(along.xy), vec2(1e-20)));
    vec2 per_px = 1.0 / moves;
    ivec2 ahead = ivec2(greaterThan(moves, vec2(0.0)));
    vec2 border = (vec2(ahead) * size - at.xy) * per_px;
    float leaves = min(border.x, border.y), last = min(end, leaves);

    ivec2 px = from, previous = from;
    vec2 edge = (vec2(px + ahead) - at.xy) * per_px;                      // out of the own pixel
    float u = max(min(edge.x, edge.y), 0.0);
    if (edge.x < edge.y) px.x += 2 * ahead.x - 1;
    else px.y += 2 * ahead.y - 1;
    int level = 0;
    bool before = true, met = false;                                       // before: nothing seen is in front of the ray
    float met_u = 0.0, gap = 0.0;
    uint reason = REASON_NONE;
    int left = march_steps;
    for (; left > 0 && u < last && !met; left--) {
        ivec2 cell = px >> level;
        edge = (vec2((cell + ahead) << level) - at.xy) * per_px;
        float u1 = clamp(min(edge.x, edge.y), u, last);
        vec2 depth = at.z + along.z * vec2(u, u1);
        bool skip = true;
        if (level > 0) {
            vec2 span = texelFetch(screen_depth, pyramid_texel(cell, level), 0).xy;
            skip = min(depth.x, depth.y) > span.x;
            before = before || skip;
            if (!MIRROR_RAYS) skip = skip || (!before && max(depth.x, depth.y) < depth_behind(span.y));
        } else {
            vec4 plane = texelFetch(screen_plane, px, 0);
            vec2 c = vec2(px) + 0.5, first = at.xy + u * along.xy - c, second = at.xy + u1 * along.xy - c;
            vec2 over = depth - plane.x - vec2(dot(plane.yz, first), dot(plane.yz, second));
            float rounding = 4e-6 * abs(plane.x) + 2e-4 * (abs(plane.y) + abs(plane.z));
            bool was_over = over.x >= -rounding, is_over = over.y >= -rounding;
            if (plane.w == 0.0 || (was_over && is_over)) before = true;
            else {
                // Through this plane, or before the last one and behind this; else behind it for some time, or from behind.
                bool enters = over.y < over.x && (before || was_over);
                float z = parallel ? -depth.x : 1.0 / depth.x;
                float z_seen = parallel ? over.x - depth.x : 1.0 / max(depth.x - over.x, 1e-30);
                gap = was_over ? 0.0 : (z - z_seen) / max(march_thickness_m + march_thickness * z_seen, 1e-30);
                met = enters && (MIRROR_RAYS || gap <= 1.0);
                met_u = was_over ? mix(u, u1, clamp(over.x / (over.x - over.y), 0.0, 1.0)) : u;
                before = !enters && is_over;
                if (reason == REASON_NONE && !met) reason = over.y > over.x ? REASON_BACK_FACE : REASON_HIDDEN;
                if (MIRROR_RAYS && !met) break;
            }
        }
        if (met) break;
        // Down a level, or to the next cell: exactly over the border that comes first, else within this one's rows or columns.
        if (!skip) level--;
        else {
            previous = px;
            ivec2 low = cell << level, high = low + (1 << level) - 1;
            px = clamp(ivec2(floor(at.xy + u1 * along.xy)), low, high);
            if (edge.x < edge.y) px.x = ahead.x == 1 ? high.x + 1 : low.x - 1;
            else px.y = ahead.y == 1 ? high.y + 1 : low.y - 1;
            u = any(lessThan(px, ivec2(0))) || any(greaterThanEqual(px, frame.size_px)) ? last : u1;
            if (any(notEqual(px >> (level + 1), cell >> 1))) level = min(level + 1, screen_levels);
        }
    }

    Found found = Found(MISS, px, reason, 0.0);
    if (met) {
        // On the triangles of these two pixels; or on others in between, or nowhere.
        float pixel_u = min(abs(per_px.x), abs(per_px.y));
        vec3 range = met_u + pixel_u * vec3(-1.5, 0.0, 1.5);
        if (!parallel) range *= p.z / max(1.0 - range * r.z, 1e-30);
        Ray here = Ray(ray.origin, max(range.x, 0.0), ray.dir, range.z > 0.0 ? range.z : INFINITY);
        bool sure = false;
        for (int k = 0; k < 2 && !sure; k++) {
            found.px = k == 0 ? px : previous;
            sure = meets(here, found.px, found.hit);
        }
        if (!sure && MIRROR_RAYS) {
            found = Found(MISS, px, REASON_HIDDEN, 0.0);
        } else if (sure) {
            found.reason = REASON_NONE;
        } else {
            found.px = px;
            found.hit = load_pixel(px).hit;
            found.hit.t = range.y;
            found.gap = gap;
            found.reason = REASON_THICKNESS;
        }
    } else if (reason == REASON_NONE) {
        if (u < last) found.reason = REASON_STEPS;
        else found.reason = end > leaves ? REASON_OFF_SCREEN : (r.z < 0.0 ? REASON_FACING : REASON_ENVIRONMENT);
    }
    return found;
}
