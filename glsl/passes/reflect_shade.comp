// passes/reflect_shade.comp -- `reflect` in parts, 3: the radiance that comes back along the mirror rays.
#include "lib/mirror_pixel.glsl"
#include "lib/mirror_shade.glsl"

layout(rgba32f) writeonly restrict uniform image2D out_reflection;    // radiance, distance (inf: sky, 0: no ray)

void main() {
    ivec2 px;
    if (!mirror_pixel(px)) return;
    Pixel p = load_pixel(px);
    vec4 seen = vec4(0.0);
    if (covered(p)) seen = mirror_radiance(px, p);
    imageStore(out_reflection, px, seen);
}
