// passes/flip_across.comp -- FLIP's filters along rows, of a picture as it is seen at one exposure.
#include "lib/flip.glsl"
#include "lib/tile.glsl"

uniform sampler2D picture;                   // linear light, or sRGB
uniform float scale, most;                   // of all light; of what comes of that
uniform float exposure;                      // a factor; 0: what a screen is given, in sRGB
layout(rgba32f) writeonly uniform image2D out_colour;      // Y, Cx, both parts of Cz
layout(rgba32f) writeonly uniform image2D out_edges;       // of Y: first and second derivative, mean

vec3 line[LINE];

// The curve of ACES by Narkowicz (2015), exposed as FLIP's authors have it.
vec3 tone_mapped(vec3 c) {
    return c * (0.9036 * c + 0.018) / (c * (0.8748 * c + 0.354) + 0.14);
}

vec3 decoded(vec3 c) {
    return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, lessThanEqual(c, vec3(0.04045)));
}

vec3 seen(ivec2 at, ivec2 last) {
    vec3 c = texelFetch(picture, clamp(at, ivec2(0), last), 0).rgb * scale;
    c = vec3(c.x > 0.0 ? min(c.x, most) : 0.0, c.y > 0.0 ? min(c.y, most) : 0.0, c.z > 0.0 ? min(c.z, most) : 0.0);    // NaN: 0
    c = exposure > 0.0 ? tone_mapped(c * exposure) : decoded(c);
    return opponent_of_rgb(clamp(c, 0.0, 1.0));
}

void filtered(const int k, ivec2 at, ivec2 last) {
    if (at.x > last.x) return;
    vec3 c = line[k + REACH];
    vec4 colour = SENSITIVITY[0] * c.xyzz;
    vec3 edges = EDGES[0] * c.x;
    for (int i = 1; i <= REACH; i++) {
        vec3 before = line[k + REACH - i], after = line[k + REACH + i], both = before + after;
        colour.zw += SENSITIVITY[i].zw * both.z;
        if (i <= FINE_REACH) colour.xy += SENSITIVITY[i].xy * both.xy;
        if (i <= EDGE_REACH) edges += EDGES[i] * vec3(both.x, after.x - before.x, both.x);
    }
    imageStore(out_colour, at, colour);
    imageStore(out_edges, at, vec4(edges.yz, edges.x, 0.0));
}

void main() {
    ivec2 first = tile_pixel() * ivec2(BLOCK, 1), last = textureSize(picture, 0) - 1;
    if (any(greaterThan(first, last))) return;                             // groups overhang the edge
#define FETCH(i) line[i] = seen(first + ivec2(i - REACH, 0), last);
    EACH_IN_LINE(FETCH)
#define STORE(k) filtered(k, first + ivec2(k, 0), last);
    EACH_IN_BLOCK(STORE)
}
