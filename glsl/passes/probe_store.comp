// passes/probe_store.comp -- a rendered face into its layer.
layout(local_size_x = 8, local_size_y = 8) in;
uniform sampler2D radiance;
uniform int layer;
layout(rgba16f) writeonly uniform image2DArray out_faces;

void main() {
    ivec2 px = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(px, imageSize(out_faces).xy))) return;
    imageStore(out_faces, ivec3(px, layer), min(texelFetch(radiance, px, 0), 65504.0));
}
