// passes/reference_connect.comp -- `reference` in parts, 3: whether the light that a path has looked for arrives.
#include "lib/path.glsl"

uniform uint light_list;

void main() {
    uint slot;
    if (!listed(light_list, slot)) return;
    uint part = PATH_LIGHT + PATH_LIGHT_PARTS * (light_list - TO_LAMPS);
    uvec4 origin = load_part(slot, part);
    vec3 direction = uintBitsToFloat(load_part(slot, part + 1u).xyz);
    vec3 arrives = any_hit(Ray(uintBitsToFloat(origin.xyz), 0.0, direction, uintBitsToFloat(origin.w)));
    if (max3(arrives) > 0.0) {
        vec3 light = arrives * uintBitsToFloat(load_part(slot, part + 2u).xyz);
        store_part(slot, part + 3u, uintBitsToFloat(load_part(slot, part + 3u).xyz) + light, 0u);
    }
}
