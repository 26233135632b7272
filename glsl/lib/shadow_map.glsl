// lib/shadow_map.glsl -- the share of a light that depth maps say arrives at a point.
// Every map is a tile of one atlas, 32-bit float, reversed. Depth is compared in metres along the map's axis. A point is
// biased by what a texel can hide: its size times the slope of the surface, whose plane is known exactly, so that each tap
// can be compared with the depth of that plane there (Isidoro, "Shadow Mapping: GPU-based Tips and Techniques", GDC 2006,
// with the true normal in place of screen derivatives). Point moved along the normal: Holbein (2011).
#include "lib/geometry.glsl"
#include "lib/light.glsl"

#if USE_SHADOW_MAPS
uniform sampler2D shadow_atlas;
layout(std430) readonly buffer ShadowMaps { ShadowMap shadow_maps[]; };
layout(std430) readonly buffer ShadowLights { ShadowLight shadow_lights[]; };
uniform float map_bias;             // m
uniform float map_slope_bias;       // texels, times the slope
uniform float map_normal_bias;      // texels, times the sine
uniform float map_receiver_plane;   // 1 = taps are compared with the receiver's plane, 0 = with the receiver
uniform float map_radius;           // half width of the filter, texels
uniform float map_search;           // largest half width (pcss)
uniform float map_blend;            // share of a cascade over which the next takes over
uniform float map_margin;           // texels around a cascade that only filters reach into
uniform int map_taps;
uniform int map_blockers;

float map_turn = 0.0;               // of the tap pattern, revolutions: set by a pass to vary it from pixel to pixel

// A point on a map.
struct Receiver {
    vec2 at;         // texels from the corner of the tile
    float depth;     // m along the map's axis
    vec2 slope;      // change of depth a texel: m, or from a point a share of the depth
    float bias;      // m
};

bool from_point(ShadowMap map) { return map.near > 0.0; }

const float STEEPEST = 100.0;        // a slope of 89.4 degrees; beyond it light grazes the surface and adds nothing

Receiver receiver_on(ShadowMap map, Point p, vec3 dir) {
    Receiver r;
    vec3 n = dot(p.n_geo, dir) < 0.0 ? -p.n_geo : p.n_geo;
    float sine = sqrt(max(0.0, 1.0 - square(dot(n, dir))));
    float coarse = max(map.texel.x, map.texel.y);
    if (from_point(map)) coarse *= dot(p.position - map.origin, map.axis);
    vec3 f = p.position + (map_normal_bias * coarse * sine) * n - map.origin;
    vec2 side = vec2(dot(f, map.right), dot(f, map.up));
    r.depth = dot(f, map.axis) - map.start;
    if (from_point(map)) side /= r.depth;
    r.at = side / map.texel - map.first_texel;
    // The plane in coordinates of the map: parallel rays meet it at depth - dot(g, moved), those of a point at
    // depth / (1 + dot(g, moved)).
    vec3 ray = from_point(map) ? map.axis + side.x * map.right + side.y * map.up : map.axis;
    vec2 g = vec2(dot(n, map.right), dot(n, map.up)) / min(dot(n, ray), -1e-6);
    g *= min(1.0, STEEPEST * inversesqrt(max(dot(g, g), 1e-12)));
    r.slope = g * map.texel;
    // Rounding: of the stored depth, of the point, and of vertices that the raster puts on a grid of 1/256 texel.
    float rounding = 1e-6 * (from_point(map) ? r.depth : map.range) + p.offset * STEEPEST * 0.1;
    float texel_depth = (abs(r.slope.x) + abs(r.slope.y)) * (from_point(map) ? r.depth : 1.0);
    r.bias = map_bias + (map_slope_bias + 1.0 / 128.0) * texel_depth + rounding;
    return r;
}

// Depth of the receiver's plane at a place of the map.
float plane_depth(ShadowMap map, Receiver r, vec2 at) {
    float step = map_receiver_plane * dot(r.slope, at - r.at);
    return from_point(map) ? r.depth / max(1.0 + step, 0.05) : r.depth - step;
}

// Depth of the nearest caster in a texel, m; INFINITY: none, as outside the map, where nothing can hide anything.
float caster_depth(ShadowMap map, ivec2 texel) {
    if (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, ivec2(map.size)))) return INFINITY;
    float z = texelFetch(shadow_atlas, map.corner + texel, 0).r;
    if (z <= 0.0) return INFINITY;
    return from_point(map) ? map.near / z : (1.0 - z) * map.range;
}

float texel_lit(ShadowMap map, Receiver r, ivec2 texel) {
    return caster_depth(map, texel) >= plane_depth(map, r, vec2(texel) + 0.5) - r.bias ? 1.0 : 0.0;
}

// Share of a box about `at` that is lit, each texel weighted by what the box covers of it; half a texel: bilinear.
float box_lit(ShadowMap map, Receiver r, vec2 at, float radius) {
    vec2 low = at - radius, high = at + radius;
    ivec2 first = ivec2(floor(low)), last = ivec2(ceil(high)) - 1;
    float sum = 0.0;
    for (int y = first.y; y <= last.y; y++)
        for (int x = first.x; x <= last.x; x++) {
            vec2 w = min(high, vec2(x, y) + 1.0) - max(low, vec2(x, y));
            sum += w.x * w.y * texel_lit(map, r, ivec2(x, y));
        }
    return sum / square(2.0 * radius);
}

// Vogel's spiral: even over the unit disc for any count.
vec2 disc_tap(int i, int count) {
    float angle = (float(i) * 0.381966011 + map_turn) * 2.0 * PI;
    return sqrt((float(i) + 0.5) / float(count)) * vec2(cos(angle), sin(angle));
}

float disc_lit(ShadowMap map, Receiver r, vec2 radius) {
    float sum = 0.0;
    for (int i = 0; i < map_taps; i++) sum += box_lit(map, r, r.at + radius * disc_tap(i, map_taps), 0.5);
    return sum / float(map_taps);
}

// Half width, in the map's units, of the cone from a receiver to the light at the depth of a caster.
float cone_width(ShadowMap map, Light light, float depth, float caster) {
    return from_point(map) ? light.size * (1.0 / max(caster, map.near) - 1.0 / depth) : light.size * (depth - caster);
}

// Fernando, "Percentage-Closer Soft Shadows" (2005). Only casters inside the cone to the light count, others in the
// searched disc hide nothing of it; taps lie closer to its middle, where the cones of near casters are.
float pcss_lit(ShadowMap map, Receiver r, Light light) {
    vec2 limit = map_search * map.texel;
    vec2 search = min(vec2(cone_width(map, light, r.depth, from_point(map) ? light.size : 0.0)), limit) / map.texel;
    float width = 0.0, found = 0.0;
    for (int i = 0; i < map_blockers && light.size > 0.0; i++) {
        vec2 tap = disc_tap(i, map_blockers);
        vec2 away = max(search, vec2(0.5)) * length(tap) * tap;
        ivec2 texel = ivec2(floor(r.at + away));
        float caster = caster_depth(map, texel);
        if (caster < plane_depth(map, r, vec2(texel) + 0.5) - r.bias) {
            float w = cone_width(map, light, r.depth, caster);
            if (length(away * map.texel) <= w + max(map.texel.x, map.texel.y)) { width += w; found += 1.0; }
        }
    }
    vec2 radius = found > 0.0 ? min(vec2(width / found), limit) / map.texel : vec2(0.0);
    radius = max(radius, vec2(map_radius));
    // A filter of a texel or so is a box, without noise.
    return max(radius.x, radius.y) <= 1.0 ? box_lit(map, r, r.at, max(map_radius, 0.5)) : disc_lit(map, r, radius);
}

float filtered(ShadowMap map, Receiver r, Light light) {
    if (MAP_FILTER == int(FILTER_TAP)) return texel_lit(map, r, ivec2(floor(r.at)));
    if (MAP_FILTER == int(FILTER_BOX)) return box_lit(map, r, r.at, map_radius);
    if (MAP_FILTER == int(FILTER_DISC)) return disc_lit(map, r, vec2(map_radius));
    return pcss_lit(map, r, light);
}

uint cube_face(vec3 d) {
    vec3 a = abs(d);
    uint axis = a.x >= a.y && a.x >= a.z ? 0u : (a.y >= a.z ? 1u : 2u);
    return 2u * axis + (d[axis] < 0.0 ? 1u : 0u);
}

// dir: unit, towards the light. The share of its light that arrives, 0 to 1.
float map_visibility(Point p, vec3 dir, uint light) {
    ShadowLight maps = shadow_lights[light];
    uint first = maps.first_map, count = maps.map_count;
    if (maps.cube == 1u) { first += cube_face(p.position - light_row(light).position); count = 1u; }
    float lit = 0.0, rest = 1.0;
    for (uint k = 0u; k < count && rest > 0.0; k++) {
        ShadowMap map = shadow_maps[first + k];
        Receiver r = receiver_on(map, p, dir);
        float take = 1.0;                                                  // of what finer maps have left
        if (k + 1u < count) {
            vec2 centred = abs(r.at / float(map.size) * 2.0 - 1.0);
            float inside = 1.0 - 2.0 * map_margin / float(map.size) - max(centred.x, centred.y);
            take = map_blend > 0.0 ? clamp(inside / map_blend, 0.0, 1.0) : float(inside > 0.0);
        }
        if (take > 0.0) {
            lit += rest * take * filtered(map, r, light_row(light));
            rest *= 1.0 - take;
        }
    }
    return lit;
}
#endif
