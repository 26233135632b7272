// passes/baked_trace.comp -- any-hit rays from the texels of the light maps to one light: as passes/shadow.comp where it
// is a point, all over its disc where it has a size.
#include "lib/bake.glsl"

layout(std430) buffer BakeSums { vec4 bake_sums[]; };
uniform uint bake_light;
uniform uint bake_first;      // sample of this dispatch
uniform uint bake_end;
uniform uint bake_samples;    // in all

// Sample i of n on the unit disc: Hammersley's points, turned for each texel (Cranley & Patterson 1976), area kept.
vec2 disc(uint i, uint n, vec2 turn) {
    vec2 xi = fract(vec2((float(i) + 0.5) / float(n), float(bitfieldReverse(i)) * (1.0 / 4294967296.0)) + turn);
    float r = sqrt(xi.x), phi = 2.0 * PI * xi.y;
    return r * vec2(cos(phi), sin(phi));
}

void main() {
    uint row = bake_row();
    if (row >= bake_count) return;
    Point p = bake_point(bake_texels[row]);
    if (bake_points[row].w == BAKE_PUSHED) p.position = bake_points[row].xyz;
    Light light = lights[bake_light];
    bool sun = light.kind == LIGHT_DIRECTIONAL;
    vec3 to_light = sun ? -light.direction : light.position - p.position;
    float away = sun ? INFINITY : length(to_light);
    vec3 dir = sun ? to_light : to_light / away;
    mat3 across = basis(dir);
    random_seed(bake_texels[row].yz, bake_texels[row].w, bake_texels[row].x);
    vec2 turn = random_vec2();
    vec3 sum = vec3(0.0);
    for (uint i = bake_first; i < bake_end; i++) {
        Ray ray = Ray(vec3(0.0), 0.0, dir, away);
        if (light.size > 0.0) {
            vec2 d = light.size * disc(i, bake_samples, turn);
            vec3 target = across[0] * d.x + across[1] * d.y + (sun ? dir : to_light);
            ray.dir = normalize(target);
            if (!sun) ray.t_max = length(target);
        }
        ray.origin = ray_origin(p, ray.dir);
        // What of the light's disc is under the surface that its middle is above does not count.
        bool above = (dot(ray.dir, p.n_geo) >= 0.0) == (dot(dir, p.n_geo) >= 0.0);
        if (above && bake_points[row].w != BAKE_INSIDE) sum += any_hit(ray);
    }
    vec4 before = bake_first > 0u ? bake_sums[row] : vec4(0.0);
    bake_sums[row] = before + vec4(sum / float(bake_samples), 0.0);
}
