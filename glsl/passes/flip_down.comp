// passes/flip_down.comp -- FLIP's filters along columns, and what comes of them: colours and edges as they are seen. Those
// of the reference are kept; those of a picture are held against them, and the largest error of all exposures stays.
#include "lib/flip.glsl"
#include "lib/tile.glsl"

uniform sampler2D colour, edges;
uniform int compares;                        // 0: this is the reference
uniform int goes_on;                         // 1: there are errors of other exposures
layout(rgba32f) uniform image2D kept;        // L*, a*, b*, and the strength of edges
layout(r32f) uniform image2D kept_points;    // and of points
layout(r32f) uniform image2D error;

vec4 line[LINE];

vec3 colour_at(const int k) {
    vec4 sum = SENSITIVITY[0] * line[k + REACH];
    for (int i = 1; i <= REACH; i++) {
        vec4 both = line[k + REACH - i] + line[k + REACH + i];
        sum.zw += SENSITIVITY[i].zw * both.zw;
        if (i <= FINE_REACH) sum.xy += SENSITIVITY[i].xy * both.xy;
    }
    return hunt_lab(clamp(rgb_of_opponent(vec3(sum.xy, sum.z + sum.w)), 0.0, 1.0));
}

// Strength of edges and of points.
vec2 edges_at(const int k) {
    vec3 c = line[k + REACH].xyz;
    vec4 sum = vec4(EDGES[0].xx * c.xy, EDGES[0].yz * c.zz);               // across: first, second; down: first, second
    for (int i = 1; i <= EDGE_REACH; i++) {
        vec3 before = line[k + REACH - i].xyz, after = line[k + REACH + i].xyz, both = before + after;
        sum += vec4(EDGES[i].xx * both.xy, EDGES[i].y * (after.z - before.z), EDGES[i].z * both.z);
    }
    return vec2(length(sum.xz), length(sum.yw));
}

void conclude(ivec2 at, ivec2 last, vec3 lab, vec2 strength) {
    if (at.y > last.y) return;
    if (compares == 0) {
        imageStore(kept, at, vec4(lab, strength.x));
        imageStore(kept_points, at, vec4(strength.y));
        return;
    }
    vec4 other = imageLoad(kept, at);
    float feature = max(abs(strength.x - other.w), abs(strength.y - imageLoad(kept_points, at).r));
    float off = colour_difference(lab, other.rgb);
    float found = off > 0.0 ? pow(off, 1.0 - sqrt(feature * 0.70710678)) : 0.0;
    imageStore(error, at, vec4(goes_on == 1 ? max(found, imageLoad(error, at).r) : found));
}

void main() {
    ivec2 first = tile_pixel() * ivec2(1, BLOCK), last = textureSize(colour, 0) - 1;
    if (any(greaterThan(first, last))) return;                             // groups overhang the edge
    vec3 lab[BLOCK];
#define FETCH_COLOUR(i) line[i] = texelFetch(colour, clamp(first + ivec2(0, i - REACH), ivec2(0), last), 0);
    EACH_IN_LINE(FETCH_COLOUR)
#define COLOUR(k) lab[k] = colour_at(k);
    EACH_IN_BLOCK(COLOUR)
#define FETCH_EDGES(i) line[i] = texelFetch(edges, clamp(first + ivec2(0, i - REACH), ivec2(0), last), 0);
    EACH_IN_LINE(FETCH_EDGES)
#define CONCLUDE(k) conclude(first + ivec2(0, k), last, lab[k], edges_at(k));
    EACH_IN_BLOCK(CONCLUDE)
}
