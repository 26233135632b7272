// passes/reflect_shade.comp -- `reflect` in parts, 3: the radiance that comes back along the mirror rays.
#include "lib/mirror_pixel.glsl"
#include "lib/mirror_shade.glsl"

layout(rgba32f) writeonly restrict uniform image2D out_reflection;    // radiance, distance (inf: sky, 0: no ray)

void main() {
    ivec2 px;
    if (!mirror_pixel(px)) return;
    imageStore(out_reflection, px, mirror_radiance(px, load_pixel(px)));
}
