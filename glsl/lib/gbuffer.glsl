// lib/gbuffer.glsl -- from a pixel of the G-buffer to its surface.
// The G-buffer is as thin as it can be: ids only. Points come from triangle id and barycentrics, never from depth, and
// materials from the same tables as ray hits: one code path, and no rounding that a render target would add.
#include "lib/surface.glsl"

uniform usampler2D gbuffer_id;    // instance, triangle

struct Pixel { Ray ray; Hit hit; };

bool covered(Pixel p) { return p.hit.triangle != ID_NONE; }

// id: instance, triangle.
Pixel pixel_of(ivec2 px, uvec2 id) {
    Pixel p = Pixel(primary_ray(px), MISS);
    bool met, front;
    if (id.y != ID_NONE) p.hit = hit_uncut(p.ray, id.x, id.y, met, front);
    return p;
}

Pixel load_pixel(ivec2 px) { return pixel_of(px, texelFetch(gbuffer_id, px, 0).xy); }

// Diameter of a pixel's footprint at a distance along its ray.
float footprint(float t) { return frame.orthographic == 1u ? frame.pixel_angle : frame.pixel_angle * t; }

Surface load_surface(Pixel p) { return surface_at(p.hit, p.ray, footprint(p.hit.t)); }
