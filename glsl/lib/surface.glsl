// lib/surface.glsl -- everything shading needs to know about a hit: the closest-hit program's first half.
#include "lib/bvh.glsl"
#include "lib/brdf.glsl"
#include "lib/lightmap.glsl"

struct Surface {
    Point point;         // exact position, n_geo turned to the viewer
    Bsdf bsdf;
    vec3 emissive;       // radiance
    float alpha;         // coverage: 1 unless the material blends or cuts out
    float occlusion;     // of the baked map, 1 = open
    bool unlit;
    uint material;
    uint record;
#if USE_LIGHTMAP
    vec3 lightmap;       // where its light map has it: lightmap_at
#endif
};

#if USE_NORMAL_MAP
// Tangent-space normal, as texels, to world. The tangent need not be orthogonal (MikkTSpace does not restore it a pixel).
vec3 mapped_normal(vec3 texel, float scale, vec3 n, vec4 tangent) {
    vec3 m = texel * 2.0 - 1.0;                                            // 127.5 is flat: glTF 3.9.3
    m.xy *= scale;
    vec3 t = tangent.xyz, b = cross(n, t) * tangent.w;
    vec3 mapped = m.x * t + m.y * b + m.z * n;
    float len = length(mapped);
    return len > 0.0 ? mapped / len : n;
}
#endif

// The exact point of a hit, n_geo turned to where the ray came from.
Point point_at(Hit hit, Ray ray) {
    Instance inst = instance_row(hit.instance);
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    Point p = triangle_point(tri, hit.bary, inst);
    if (SPHERES && hit_group_of(hit.instance, tri.w).kind == KIND_SPHERE) p = sphere_point(tri, ray, hit.t, inst);
    if (dot(p.n_geo, ray.dir) > 0.0) p.n_geo = -p.n_geo;
    stand_back(p, hit, ray);
    return p;
}

// An interpolated or mapped normal may face away from who sees the surface, along outlines above all. No such microsurface is
// seen, and the BRDF would be black: the normal is turned towards the viewer v as far as the edge of what can be seen,
// continuously. A facet nearly edge-on sets the limit, so that plain surfaces keep their own normal however flat the view
// (the threshold of Cycles' ensure_valid_specular_reflection).
const float LEAST_NOV = 1e-3;

vec3 toward_viewer(vec3 n, vec3 v, vec3 n_geo) {
    float below = clamp(0.9 * dot(n_geo, v), 1e-6, LEAST_NOV) - dot(n, v);
    return below > 0.0 ? normalize(n + below * v) : n;
}

// ray: the one that found the hit. footprint: diameter in m of what it stands for, at the hit (0 = finest texture level).
Surface surface_at(Hit hit, Ray ray, float footprint) {
    Surface s;
    Instance inst = instance_row(hit.instance);
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    Record record = records[inst.first_record + tri.w];
    s.record = inst.first_record + tri.w;
    HitGroup group = hit_groups[record.hit_group];
    Material m = material_row(group.material);
    s.material = group.material;
    bool sphere = SPHERES && group.kind == KIND_SPHERE;

    s.point = triangle_point(tri, hit.bary, inst);
    if (sphere) s.point = sphere_point(tri, ray, hit.t, inst);
#if USE_LIGHTMAP
    s.lightmap = lightmap_at(hit, s.point, tri, inst);
#endif
    vec3 to_viewer = -ray.dir;
    float side = dot(s.point.n_geo, to_viewer) < 0.0 ? -1.0 : 1.0;
    s.point.n_geo *= side;
    stand_back(s.point, hit, ray);

    vec3 w = vec3(1.0 - hit.bary.x - hit.bary.y, hit.bary);
    mat3 to_world = mat3(inst.world_from_object[0], inst.world_from_object[1], inst.world_from_object[2]);
    mat3 normal_from_object = transpose(mat3(inst.object_from_world[0], inst.object_from_world[1], inst.object_from_world[2]));
    vec3 n_shade = s.point.n_geo;
    if (!sphere) {
        vec3 n_os = vec3(0.0);
        for (int i = 0; i < 3; i++) n_os += w[i] * uintBitsToFloat(texelFetch(vertices, int(tri[i]) * 2 + 1).xyz);
        vec3 n = normal_from_object * n_os;
        float len = length(n);
        // Normals are stored for the wound side; the viewer may be on the other, and a mirrored instance flips the winding.
        if (len > 0.0) n_shade = n * (side / len);
    }
    s.bsdf.n = n_shade;
    s.bsdf.n_coat = n_shade;

    Attributes a = attributes_at(hit);
#if USE_TEXTURES
    float log2_area = FINEST_LEVEL;
    if (sphere) { a.uv0 = s.point.uv; a.uv1 = s.point.uv; }
    if (footprint > 0.0 && !sphere) {
        // Ray cones (Akenine-Moeller et al., Ray Tracing Gems (2019), ch. 20): area of the footprint on the surface over the
        // triangle's area, in its uv; the true, slanted footprint has area 1 / cos.
        vec3 v0 = vertex_position(tri.x), e1 = vertex_position(tri.y) - v0, e2 = vertex_position(tri.z) - v0;
        float world_area = length(cross(to_world * e1, to_world * e2));
        vec2 t[3];
        for (int i = 0; i < 3; i++)
            t[i] = vec2(uintBitsToFloat(texelFetch(vertices, int(tri[i]) * 2).w), uintBitsToFloat(texelFetch(vertices, int(tri[i]) * 2 + 1).w));
        float uv_area = abs((t[1].x - t[0].x) * (t[2].y - t[0].y) - (t[2].x - t[0].x) * (t[1].y - t[0].y));
        float slant = max(abs(dot(s.point.n_geo, ray.dir)), 0.05);
        log2_area = log2(max(square(footprint) * uv_area / (world_area * slant), 1e-30));
    }
#endif
    vec4 color = m.base_color * a.color;
    float metallic = m.metallic, roughness = m.roughness;
    s.emissive = m.emissive;
    s.occlusion = 1.0;
    float specular = m.specular;
    vec3 specular_color = m.specular_color;
    s.bsdf.transmission = m.transmission;
    s.bsdf.clearcoat = m.clearcoat;
    s.bsdf.clearcoat_roughness = m.clearcoat_roughness;
#if USE_TEXTURES
    vec3 normal_xyz = vec3(0.5, 0.5, 1.0), coat_normal_xyz = normal_xyz;
    // One call for all slots that this material fills: its code is large, and inlined wherever it is called.
    uint rest = m.texture_slots & uint(TEXTURE_SLOTS);
    if (rest != 0u) WHILE (rest != 0u) {
        uint k = uint(findLSB(rest));
        bool srgb = k == SLOT_BASE_COLOR || k == SLOT_EMISSIVE || k == SLOT_SPECULAR_COLOR;
        vec4 c = sample_texture(material_row(group.material).texture[k], a.uv0, a.uv1, log2_area, srgb);
        if (HAS_SLOT(SLOT_BASE_COLOR) && k == SLOT_BASE_COLOR) color *= c;
        if (HAS_SLOT(SLOT_METALLIC_ROUGHNESS) && k == SLOT_METALLIC_ROUGHNESS) { metallic *= c.b; roughness *= c.g; }
        if (HAS_SLOT(SLOT_NORMAL) && k == SLOT_NORMAL) normal_xyz = c.xyz;
        if (HAS_SLOT(SLOT_OCCLUSION) && k == SLOT_OCCLUSION) s.occlusion = 1.0 + m.occlusion_strength * (c.r - 1.0);
        if (HAS_SLOT(SLOT_EMISSIVE) && k == SLOT_EMISSIVE) s.emissive *= c.rgb;
        if (HAS_SLOT(SLOT_SPECULAR) && k == SLOT_SPECULAR) specular *= c.a;
        if (HAS_SLOT(SLOT_SPECULAR_COLOR) && k == SLOT_SPECULAR_COLOR) specular_color *= c.rgb;
        if (HAS_SLOT(SLOT_CLEARCOAT) && k == SLOT_CLEARCOAT) s.bsdf.clearcoat *= c.r;
        if (HAS_SLOT(SLOT_CLEARCOAT_ROUGHNESS) && k == SLOT_CLEARCOAT_ROUGHNESS) s.bsdf.clearcoat_roughness *= c.g;
        if (HAS_SLOT(SLOT_CLEARCOAT_NORMAL) && k == SLOT_CLEARCOAT_NORMAL) coat_normal_xyz = c.xyz;
        if (HAS_SLOT(SLOT_TRANSMISSION) && k == SLOT_TRANSMISSION) s.bsdf.transmission *= c.r;
        rest &= rest - 1u;
    } END_WHILE (rest != 0u)
#if USE_NORMAL_MAP
    const uint normal_slots = 1u << SLOT_NORMAL | 1u << SLOT_CLEARCOAT_NORMAL;
    if (!sphere && (m.texture_slots & normal_slots) != 0u) {
        vec4 tangent = vec4(0.0);
        for (int i = 0; i < 3; i++) tangent += w[i] * uintBitsToFloat(texelFetch(tangents, int(tri[i])));
        tangent.xyz = to_world * tangent.xyz;
        float len = length(tangent.xyz);
        tangent = len > 0.0 ? vec4(tangent.xyz / len, tangent.w < 0.0 ? -1.0 : 1.0) : vec4(basis(n_shade)[0], 1.0);
        if (inst.flipped == 1u) tangent.w = -tangent.w;                    // a mirrored instance mirrors the bitangent
        // The map was made for the front of the surface; seen from behind, the whole frame turns over (glTF 3.9.4).
        vec3 n_front = n_shade * side;
        if ((m.texture_slots >> SLOT_NORMAL & 1u) == 1u) s.bsdf.n = side * mapped_normal(normal_xyz, m.normal_scale, n_front, tangent);
        if ((m.texture_slots >> SLOT_CLEARCOAT_NORMAL & 1u) == 1u)
            s.bsdf.n_coat = side * mapped_normal(coat_normal_xyz, m.clearcoat_normal_scale, n_front, tangent);
    }
#endif
#endif
    s.bsdf.n = toward_viewer(s.bsdf.n, to_viewer, s.point.n_geo);
    s.bsdf.n_coat = toward_viewer(s.bsdf.n_coat, to_viewer, s.point.n_geo);
    s.bsdf.base_color = color.rgb;
    s.alpha = coverage(m, color.a);
    s.bsdf.metallic = metallic;
    s.bsdf.roughness = roughness;
    s.bsdf.alpha = max(square(roughness), 4e-4);
    s.bsdf.f0_dielectric = SPECULAR ? min(m.dielectric_f0 * specular_color, vec3(1.0)) * specular : vec3(0.04);
    s.bsdf.f90_dielectric = SPECULAR ? specular : 1.0;
    s.unlit = m.unlit == 1u;
    if (s.unlit) s.emissive = color.rgb;
    else if (CLEARCOAT) s.emissive *= 1.0 - coat_fresnel(s.bsdf, to_viewer);   // the coat lies over the emission
    s.bsdf.transmission *= 1.0 - metallic;                                 // metals absorb what they do not reflect
    return s;
}
