// passes/baked_trace.comp -- any-hit rays from the texels of the light maps to one light that has a size, all over its disc,
// or that shines through tints.
#include "lib/bake.glsl"

layout(std430) buffer BakeSums { vec4 bake_sums[]; };    // light, N.L of the front
uniform uint bake_light;
uniform uint bake_first;      // sample of this dispatch
uniform uint bake_end;
uniform bool bake_more;       // adds to what is there

void main() {
    uint row = bake_row();
    if (row >= bake_count) return;
    Point p = bake_point(bake_texels[row]);
    if (bake_points[row].w == BAKE_PUSHED) p.position = bake_points[row].xyz;
    Light light = light_row(bake_light);
    bool sun = light.kind == LIGHT_DIRECTIONAL;
    vec3 to_light = sun ? -light.direction : light.position - p.position;
    float away = sun ? INFINITY : length(to_light);
    vec3 dir = sun ? to_light : to_light / away;
    mat3 across = basis(dir);
    random_seed(bake_texels[row].yz, bake_texels[row].w, bake_texels[row].x);
    uvec2 start = uvec2(pcg(random_state), pcg(random_state ^ 0x9E3779B9u));
    vec3 sum = vec3(0.0);
    bool looked_at = bake_points[row].w != BAKE_INSIDE && (dot(dir, p.n_geo) > 0.0 || !bake_front_only(bake_texels[row]));
    for (uint i = bake_first; i < bake_end && looked_at; i++) {
        Ray ray = Ray(vec3(0.0), 0.0, dir, away);
        if (light.size > 0.0) {
            vec2 xi = sequence_point(start, i);
            float r = light.size * sqrt(xi.x), phi = 2.0 * PI * xi.y;
            vec3 target = across[0] * (r * cos(phi)) + across[1] * (r * sin(phi)) + (sun ? dir : to_light);
            ray.dir = normalize(target);
            if (!sun) ray.t_max = length(target);
        }
        ray.origin = ray_origin(p, ray.dir);
        // What of the light's disc is under the surface that its middle is above does not count.
        bool above = (dot(ray.dir, p.n_geo) >= 0.0) == (dot(dir, p.n_geo) >= 0.0);
        if (above) sum += any_hit(ray);
    }
    if (bake_more) sum += bake_sums[row].rgb;
    bake_sums[row] = vec4(sum, dot(dir, p.n_geo));
}
