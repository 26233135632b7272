// passes/reflect_guide.comp -- `reflect` in parts: what pixels between must know of the mirror rays of the grid. Not beside
// their traversal (an H100 then took 1.24 ms for half the rays of Sponza, without it 1.04 for all), but while they are on
// their way; none of their programs touches the list that it empties.
#include "lib/mirror_guide.glsl"

void main() {
    ivec2 px;
    if (!mirror_pixel(px)) return;
    begin_list(px);
    Pixel p = load_pixel(px);
    uvec4 guide = uvec4(0u);
    if (covered(p)) {
        Surface s = load_surface(p);
        bool bent;
        vec3 r = mirror_direction(s, -p.ray.dir, bent);
        if (sends_mirror_ray(s)) guide = guide_of(p, s, r);
    }
    store_guide(px, guide);
}
