// passes/denoise_level.comp -- about how bright a noisy image is here: what the filter compares pixels by, since one pixel's
// own few samples are as likely an exception as an edge.
#include "lib/denoise.glsl"
#include "lib/tile.glsl"

uniform sampler2D filtered;                        // mean; a: variance of its luminance, < 0: not to be touched
layout(rg32f) writeonly uniform SIGNAL_IMAGE out_level; // luminance; its variance

void main() {
    ivec2 px = tile_pixel();
    if (any(greaterThanEqual(px, frame.size_px))) return;                  // groups overhang the edge
    vec4 center = texelFetch(filtered, px, 0);
    vec2 level = vec2(luminance(center.rgb), center.a);
    if (center.a > 0.0) {
        Guide g = unpack_guide(texelFetch(guide, px, 0), vec2(px));
        float weight = 1.0;
        for (int y = -LEVEL_REACH; y <= LEVEL_REACH; y++)
            for (int x = -LEVEL_REACH; x <= LEVEL_REACH; x++) {
                ivec2 q = px + ivec2(x, y);
                if ((x == 0 && y == 0) || !inside(q)) continue;
                vec4 c = texelFetch(filtered, q, 0);
                if (c.a < 0.0) continue;
                float w = level_weight(x, y) * alike(g, unpack_guide(texelFetch(guide, q, 0), vec2(q)));
                level += vec2(w, w * w) * vec2(luminance(c.rgb), c.a);
                weight += w;
            }
        level /= vec2(weight, weight * weight);
    }
    imageStore(out_level, AT(px), vec4(level, 0.0, 0.0));
}
