// lib/frame.glsl -- what changes by frame, and the primary ray of a pixel.
#include "layout.glsl"

layout(std430) readonly buffer Frame { FrameConstants frame; };

struct Ray { vec3 origin; float t_min; vec3 dir; float t_max; };

const float INFINITY = uintBitsToFloat(0x7F800000u);

// The ray through a pixel's centre, plus an offset in pixels. dir is unit; world space, origin-relative.
Ray primary_ray(ivec2 px, vec2 offset_px) {
    vec2 ndc = (vec2(px) + 0.5 + offset_px) / vec2(frame.size_px) * 2.0 - 1.0;   // row 0 at the bottom: GL's
    Ray ray = Ray(frame.eye_ws, 0.0, frame.forward_ws, INFINITY);
    // The raster clips at the near plane; so does the ray.
    if (frame.orthographic == 1u) ray.origin += ndc.x * frame.right_ws + ndc.y * frame.up_ws;
    else ray.dir = normalize(frame.forward_ws + ndc.x * frame.right_ws + ndc.y * frame.up_ws);
    ray.t_min = frame.near / dot(ray.dir, frame.forward_ws);
    return ray;
}

Ray primary_ray(ivec2 px) { return primary_ray(px, frame.jitter_px); }
