// passes/baked_push.comp -- moves the points of texels that lie inside a solid out of it, along their own surface.
// A floor goes on under the walls that stand on it; a texel whose middle is there would be dark, and darken the floor
// beside the wall. A point is inside if rays all over its front meet nothing but the backs of surfaces.
#include "lib/bake.glsl"

uniform float bake_reach;    // m: how far to look for the way out

const int DIRECTIONS = 6;    // all over the hemisphere, before a point is said to be inside
const int WAYS = 8;          // along the surface

// Whether a ray meets the back of something first; how far away. Triangles and spheres of two-sided materials have a
// back too: where their normals say.
bool meets_back(Ray ray, out float t) {
    Hit hit = closest_hit(ray);
    t = hit.t;
    if (hit.triangle == ID_NONE) return false;
    Instance inst = instance_row(hit.instance);
    uvec4 tri = texelFetch(triangles, int(hit.triangle));
    Point p = triangle_point(tri, hit.bary, inst);
    if (SPHERES && tri.x == tri.y) p = sphere_point(tri, ray, hit.t, inst);
    return dot(p.n_geo, ray.dir) > 0.0;
}

void main() {
    uint row = bake_row();
    if (row >= bake_count) return;
    Point p = bake_point(bake_texels[row]);
    vec4 result = vec4(p.position, BAKE_HERE);
    vec3 origin = p.position + p.offset * p.n_geo;
    mat3 frame_n = basis(p.n_geo);
    bool inside = true;
    float t;
    for (int i = 0; i < DIRECTIONS && inside; i++) {                       // most end after the first
        float phi = float(i) * 2.3999632, z = (float(i) + 0.5) / float(DIRECTIONS), r = sqrt(1.0 - z * z);
        inside = meets_back(Ray(origin, 0.0, frame_n * vec3(r * cos(phi), r * sin(phi), z), INFINITY), t);
    }
    if (inside) {
        result.w = BAKE_INSIDE;
        float nearest = bake_reach;
        for (int i = 0; i < WAYS; i++) {
            float phi = (float(i) + 0.5) * (2.0 * PI / float(WAYS));
            vec3 way = frame_n * vec3(cos(phi), sin(phi), 0.0);
            if (meets_back(Ray(origin, 0.0, way, nearest), t)) {
                nearest = t;
                result = vec4(p.position + (t + 1e-3 * bake_reach) * way, BAKE_PUSHED);
            }
        }
    }
    bake_points[row] = result;
}
