// lib/lightmap.glsl -- how much of each light arrives, looked up in the light maps of glhybrid/lightmap.py.
#include "lib/geometry.glsl"

#if USE_LIGHTMAP
uniform sampler2DArray lightmap;           // visibility; layers: light * lightmap_pages + page
uniform usamplerBuffer lightmap_uv;        // 2 texels a triangle: three corners, in texels of its place
uniform usamplerBuffer lightmap_places;    // bits of ints; row of an instance: its first place; of a place: corner x, y, page, row of uv
uniform int lightmap_pages;

// Where a point's texels are: x, y and page. tri, inst: those of the hit.
vec3 lightmap_at(Hit hit, Point p, uvec4 tri, Instance inst) {
    ivec4 place = ivec4(texelFetch(lightmap_places, int(texelFetch(lightmap_places, int(hit.instance)).x + tri.w)));
    vec2 uv;
    if (SPHERES && tri.x == tri.y) {                                       // one row of vertices stands for a sphere
        mat3 object_from_world = mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]);
        vec3 n_os = normalize(object_from_world * p.position + inst.object_from_world[3] - vertex_position(tri.x));
        uv = 1.0 + oct_encode(n_os) * float(place.w);
    } else {
        int row = 2 * (place.w + int(hit.triangle));
        vec4 a = uintBitsToFloat(texelFetch(lightmap_uv, row));
        vec2 c = uintBitsToFloat(texelFetch(lightmap_uv, row + 1).xy);
        uv = a.xy + hit.bary.x * (a.zw - a.xy) + hit.bary.y * (c - a.xy);
    }
    return vec3(uv + vec2(place.xy), float(place.z));
}

// Bilinear by hand, with exact weights. 0 or 1, between in penumbrae, over texels that differ, and through tints.
vec3 lightmap_visibility(vec3 at, uint light) {
    int layer = int(light) * lightmap_pages + int(at.z);
    vec2 p = at.xy - 0.5, f = fract(p);
    ivec2 i = ivec2(floor(p));
    vec4 sum = mix(mix(texelFetch(lightmap, ivec3(i, layer), 0), texelFetch(lightmap, ivec3(i + ivec2(1, 0), layer), 0), f.x),
                   mix(texelFetch(lightmap, ivec3(i + ivec2(0, 1), layer), 0), texelFetch(lightmap, ivec3(i + 1, layer), 0), f.x), f.y);
    return BLENDED ? sum.rgb : sum.rrr;
}
#endif
