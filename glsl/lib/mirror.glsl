// lib/mirror.glsl -- what the programs of a split `reflect` hand on: the mirror ray and its hit.
#include "lib/gbuffer.glsl"

layout(rgba32ui) restrict uniform uimage2D mirror_hit;    // t (inf: sky, 0: no ray), bary, triangle (ID_NONE: neither hit)
layout(rgba32ui) restrict uniform uimage2D mirror_ray;    // direction, instance

void store_mirror(ivec2 px, vec3 dir, Hit hit) {
    imageStore(mirror_hit, px, uvec4(floatBitsToUint(hit.t), floatBitsToUint(hit.bary), hit.triangle));
    imageStore(mirror_ray, px, uvec4(floatBitsToUint(dir), hit.instance));
}

// p: the pixel that the ray left.
Hit load_mirror(ivec2 px, Pixel p, out Ray ray) {
    uvec4 a = imageLoad(mirror_hit, px), b = imageLoad(mirror_ray, px);
    Hit hit = Hit(uintBitsToFloat(a.x), uintBitsToFloat(a.yz), b.w, a.w, 0u);
    ray = Ray(vec3(0.0), 0.0, uintBitsToFloat(b.xyz), INFINITY);
    if (hit.triangle != ID_NONE) {
        hit.geometry = texelFetch(triangles, int(hit.triangle)).w;
        if (SPHERES) ray.origin = ray_origin(point_at(p.hit, p.ray), ray.dir);   // only their points are found along the ray
    }
    return hit;
}
