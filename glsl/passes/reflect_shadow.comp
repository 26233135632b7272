// passes/reflect_shadow.comp -- `reflect` in parts, 2: which lights reach what the mirror rays met.
#include "lib/mirror.glsl"
#include "lib/mirror_pixel.glsl"
#include "lib/shade.glsl"

layout(r32ui) writeonly restrict uniform uimage2D mirror_lit;    // a bit a light

void main() {
    ivec2 px;
    if (!mirror_pixel(px)) return;
    Pixel p = load_pixel(px);
    if (!covered(p)) return;
    Ray ray;
    Hit hit = load_mirror(px, p, ray);
    if (hit.triangle != ID_NONE) imageStore(mirror_lit, px, uvec4(lit_bits(hit, ray)));
}
