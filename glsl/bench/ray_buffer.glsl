// bench/ray_buffer.glsl -- rays given once: the same for every variant of the tracer and for its peers.
layout(local_size_x = 64) in;
uniform samplerBuffer rays;     // 2 texels each: origin, t_max; direction, 0
uniform uint ray_count;
#if USE_STEP_COUNTER
layout(std430) writeonly buffer Steps { uint steps[]; };
#endif

uint ray_index() { return gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65536u; }

Ray ray_at(uint i) {
    vec4 from = texelFetch(rays, int(2u * i)), along = texelFetch(rays, int(2u * i + 1u));
    return Ray(from.xyz, 0.0, along.xyz, from.w);
}
