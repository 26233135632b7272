// lib/mirror.glsl -- what the programs of a split `reflect` hand on: the mirror ray and its hit.
#include "lib/gbuffer.glsl"

layout(rgba32ui) restrict uniform uimage2D mirror_hit;    // t (inf: sky, 0: no ray), bary, triangle (ID_NONE: neither hit)
layout(rg32ui) restrict uniform uimage2D mirror_ray;      // octahedral direction
#if USE_TWO_LEVEL
layout(r32ui) restrict uniform uimage2D mirror_instance;
#endif

void store_mirror(ivec2 px, vec3 dir, Hit hit) {
    imageStore(mirror_hit, px, uvec4(floatBitsToUint(hit.t), floatBitsToUint(hit.bary), hit.triangle));
    imageStore(mirror_ray, px, uvec4(floatBitsToUint(oct_encode(dir)), 0u, 0u));
#if USE_TWO_LEVEL
    imageStore(mirror_instance, px, uvec4(hit.instance));
#endif
}

// p: the pixel that the ray left.
Hit load_mirror(ivec2 px, Pixel p, out Ray ray) {
    uvec4 a = imageLoad(mirror_hit, px);
    Hit hit = Hit(uintBitsToFloat(a.x), uintBitsToFloat(a.yz), 0u, a.w, 0u);
#if USE_TWO_LEVEL
    hit.instance = imageLoad(mirror_instance, px).x;
#endif
    ray = Ray(vec3(0.0), 0.0, oct_decode(uintBitsToFloat(imageLoad(mirror_ray, px).xy)), INFINITY);
    if (hit.triangle != ID_NONE) {
        hit.geometry = texelFetch(triangles, int(hit.triangle)).w;
        if (SPHERES) ray.origin = ray_origin(point_at(p.hit, p.ray), ray.dir);   // only their points are found along the ray
    }
    return hit;
}
