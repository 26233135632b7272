// passes/reference_extend.comp -- `reference` in parts, 1: what each path meets next.
#include "lib/path.glsl"
#include "lib/surface.glsl"

#if USE_BLENDED
// Blended surfaces on the way: passed, or met, in proportion to alpha.
Hit among_layers(Ray ray, Hit hit, inout vec3 throughput) {
    Ray rest = Ray(ray.origin, ray.t_min, ray.dir, hit.t);
    for (int i = 0; i < 32; i++) {
        Hit layer = closest_blended(rest);
        if (layer.triangle == ID_NONE) break;
        Surface s = surface_at(layer, ray, 0.0);
        rest.t_min = next_after(layer.t);
        if (random_float() >= s.alpha) continue;
        vec3 passes = transmitted(s.bsdf, -ray.dir);
        float through = min(max3(passes), 0.95);
        if (random_float() < through) { throughput *= passes / through; continue; }
        throughput /= 1.0 - through;
        return layer;
    }
    return hit;
}
#endif

void main() {
    uint slot;
    if (!listed(GOES_ON, slot)) return;
    Ray ray;
    vec3 throughput = vec3(1.0);
    uint pixel = ID_NONE, number = 0u;
    if (depth == 0u) {
        ivec2 px = slot_pixel(slot);
        bool inside = all(lessThan(px, frame.size_px));                    // tiles overhang the edge
        number = slot_sample(slot);
        if (inside) pixel = uint(px.x) | uint(px.y) << 16u;
        store_part(slot, PATH_THROUGHPUT, throughput, pixel);
        store_part(slot, PATH_SUM, vec3(0.0), number);
        for (uint kind = 0u; kind < LIGHT_KINDS; kind++) store_part(slot, PATH_LIGHT + PATH_LIGHT_PARTS * kind + 3u, vec3(0.0), 0u);
        if (!inside) return;
        // jitter_px is the width of the box that samples spread over: 0 = pixel centres.
        ray = primary_ray(px, (draw_point(uvec2(px), number, DRAW_PIXEL) - 0.5) * frame.jitter_px);
        store_part(slot, PATH_ORIGIN, ray.origin, 0u);
    } else {
        ray = Ray(uintBitsToFloat(load_part(slot, PATH_ORIGIN).xyz), 0.0, uintBitsToFloat(load_part(slot, PATH_DIRECTION).xyz), INFINITY);
    }
    Hit hit = closest_hit(ray);
#if USE_BLENDED
    if (depth > 0u) {
        uvec4 carried = load_part(slot, PATH_THROUGHPUT);
        throughput = uintBitsToFloat(carried.xyz);
        pixel = carried.w;
        number = load_part(slot, PATH_SUM).w;
    }
    random_seed(uvec2(pixel & 0xFFFFu, pixel >> 16u), number, pcg(frame.seed) + depth);
    hit = among_layers(ray, hit, throughput);
    store_part(slot, PATH_THROUGHPUT, throughput, pixel);
#endif
    store_part(slot, PATH_DIRECTION, ray.dir, hit.instance);
    store_part(slot, PATH_HIT, vec3(hit.t, hit.bary), hit.triangle);
}
