// probes/depth_shadow.comp -- the control of test_self_shadow.py: shadow rays from a point rebuilt from depth, as a
// renderer with a depth buffer does, lifted by the same offset as ours.
#include "lib/gbuffer.glsl"
#include "lib/light.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
layout(r32f) writeonly uniform image2D out_visibility;     // 1, 0; -1 = no surface, or it faces away
uniform float depth_far;       // m
uniform float depth_levels;    // 2^24: a 24-bit buffer; 0: 32-bit float

void main() {
    ivec2 px = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(px, frame.size_px))) return;
    Pixel p = load_pixel(px);
    float result = -1.0;
    if (covered(p)) {
        Surface s = load_surface(p);
        LightSample l = light_at(lights[0], s.point.position);
        if (dot(s.point.n_geo, l.dir) > 0.0) {
            // The usual mapping of z in [near, far] to [0, 1] and back.
            float z = dot(s.point.position - frame.eye_ws, frame.forward_ws);
            float d = depth_far * (z - frame.near) / (z * (depth_far - frame.near));
            if (depth_levels > 0.0) d = round(d * depth_levels) / depth_levels;
            float z_again = frame.near * depth_far / (depth_far - d * (depth_far - frame.near));
            s.point.position = frame.eye_ws + p.ray.dir * (z_again / dot(p.ray.dir, frame.forward_ws));
            result = max3(any_hit(Ray(ray_origin(s.point, l.dir), 0.0, l.dir, l.distance)));
        }
    }
    imageStore(out_visibility, px, vec4(result));
}
