// passes/skin.comp -- morph targets, then joints: one vertex a thread, written where raster and rays both read it.
// The same sums as glhybrid/deform.py, in float32. Normals go by the cofactors of the blended matrix, the inverse transpose
// but for its length: a flattened limb divides by nothing.
#include "layout.glsl"

layout(local_size_x = 64) in;

layout(std430) readonly buffer SkinPieces { SkinPiece pieces[]; };
layout(std430) readonly buffer RestVertices { RestVertex rest[]; };
layout(std430) readonly buffer Influences { Influence influences[]; };
layout(std430) readonly buffer Deltas { float deltas[]; };             // 3 a row
layout(std430) readonly buffer Morphs { Morph morphs[]; };             // targets with a weight now
layout(std430) readonly buffer Joints { Joint joints[]; };
layout(std430) buffer VerticesOut { vec4 vertices_out[]; };            // 2 a vertex: position, u; normal, v
#if USE_TANGENTS
layout(std430) buffer TangentsOut { vec4 tangents_out[]; };
#endif
uniform int vertex_total;

const uint DELTA_POSITION = 1u, DELTA_NORMAL = 2u, DELTA_TANGENT = 4u;

// What the targets add to one attribute of a vertex. part: DELTA_*.
vec3 morphed(SkinPiece piece, uint vertex, uint part, vec3 base) {
    if ((piece.delta_parts & part) == 0u) return base;
    uint stride = uint(bitCount(piece.delta_parts)), place = uint(bitCount(piece.delta_parts & (part - 1u)));
    for (uint i = 0u; i < piece.morph_count; i++) {
        Morph m = morphs[piece.morph_first + i];
        uint row = 3u * (piece.delta_first + (m.target * piece.vertex_count + vertex) * stride + place);
        base += m.weight * vec3(deltas[row], deltas[row + 1u], deltas[row + 2u]);
    }
    return base;
}

vec3 unit(vec3 v) {
    v /= max(max(abs(v.x), abs(v.y)), max(abs(v.z), 1e-30));           // else the squares of small ones underflow
    float squared = dot(v, v);
    return squared > 0.0 ? v * inversesqrt(squared) : vec3(0.0, 0.0, 1.0);
}

void main() {
    uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u;
    if (i >= uint(vertex_total)) return;
    SkinPiece piece = pieces[rest[i].piece];
    uint vertex = i - piece.rest_first, row = piece.vertex_first + vertex;
    vec3 position = morphed(piece, vertex, DELTA_POSITION, rest[i].position);
    vec3 normal = rest[i].normal;
    if (piece.flat_shaded == 1u) {                                     // its triangle's, whose vertices lie together
        uint first = vertex - vertex % 3u;
        vec3 a = morphed(piece, first, DELTA_POSITION, rest[piece.rest_first + first].position);
        vec3 b = morphed(piece, first + 1u, DELTA_POSITION, rest[piece.rest_first + first + 1u].position);
        vec3 c = morphed(piece, first + 2u, DELTA_POSITION, rest[piece.rest_first + first + 2u].position);
        vec3 e1 = b - a, e2 = c - a;
        float extent = max(max(max(abs(e1.x), abs(e1.y)), max(abs(e1.z), abs(e2.x))), max(max(abs(e2.y), abs(e2.z)), 1e-30));
        normal = cross(e1 / extent, e2 / extent);
    } else {
        normal = morphed(piece, vertex, DELTA_NORMAL, normal);
    }
    normal = unit(normal);
#if USE_TANGENTS
    vec3 tangent = unit(morphed(piece, vertex, DELTA_TANGENT, rest[i].tangent.xyz));
#endif
    if (piece.influence_count > 0u) {
        vec3 x = vec3(0.0), y = vec3(0.0), z = vec3(0.0), offset = vec3(0.0);
        for (uint k = 0u; k < piece.influence_count; k++) {
            Influence f = influences[piece.influence_first + vertex * piece.influence_count + k];
            if (f.weight == 0.0) continue;
            uint j = piece.joint_first + f.joint;
            x += f.weight * joints[j].anchored_from_bind[0];
            y += f.weight * joints[j].anchored_from_bind[1];
            z += f.weight * joints[j].anchored_from_bind[2];
            offset += f.weight * joints[j].anchored_from_bind[3];
        }
        mat3 linear = mat3(x, y, z);
        position = linear * position + offset;
        normal = unit(mat3(cross(y, z), cross(z, x), cross(x, y)) * normal);
#if USE_TANGENTS
        tangent = unit(linear * tangent);
#endif
    }
    vertices_out[2u * row].xyz = position;
    vertices_out[2u * row + 1u].xyz = normal;
#if USE_TANGENTS
    if (piece.has_tangents == 1u) tangents_out[row].xyz = tangent;
#endif
}
