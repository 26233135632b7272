"""The OpenGL functions that moderngl lacks, each by what it does on the device."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from glhybrid import gl as G
from glhybrid.context import Context
from glhybrid.errors import DeviceError

_FETCH = """#version 430
layout(local_size_x = 1) in;
uniform usamplerBuffer first;
uniform usamplerBuffer second;
layout(std430, binding = 0) buffer Result { uvec4 result[]; };
void main() {
    int i = int(gl_GlobalInvocationID.x);
    result[2 * i] = texelFetch(first, i);
    result[2 * i + 1] = texelFetch(second, i);
}
"""


def test_buffer_textures_by_unit_whole_and_in_part(context: Context) -> None:
    gl, raw = context.gl, context.raw
    data = np.arange(4 * 512, dtype=np.uint32).reshape(512, 4)
    offset = 16 * 256  # bytes; a multiple of every driver's alignment
    assert offset % context.limits.texture_buffer_alignment_bytes == 0
    buffer, out = gl.buffer(data), gl.buffer(reserve=16 * 2 * 64)
    whole, part = G.BufferTexture(raw, buffer), G.BufferTexture(raw, buffer, offset=offset)
    shader = gl.compute_shader(_FETCH)
    raw.set_sampler(shader, "first", 5)
    raw.set_sampler(shader, "second", 2)
    whole.bind(5)
    part.bind(2)
    out.bind_to_storage_buffer(0)
    shader.run(64)
    raw.glMemoryBarrier(G.GL_BUFFER_UPDATE_BARRIER_BIT)
    got = np.frombuffer(out.read(), np.uint32).reshape(64, 2, 4)
    np.testing.assert_array_equal(got[:, 0], data[:64])
    np.testing.assert_array_equal(got[:, 1], data[256:320])
    assert raw.glIsTexture(whole.glo)
    name = whole.glo
    for thing in (whole, whole, part):
        thing.release()
    assert not raw.glIsTexture(name)
    for owned in (buffer, out, shader):
        owned.release()


def test_depth_is_32_bit_float_from_0_to_1(context: Context) -> None:
    if not context.limits.clip_control:
        pytest.skip("this driver has no glClipControl")
    gl, raw = context.gl, context.raw
    depth = raw.depth32f(gl, (8, 4))
    color = gl.texture((8, 4), 4)
    frame = gl.framebuffer([color], depth)
    program = gl.program(
        vertex_shader="""#version 430
            uniform float z;
            void main() { gl_Position = vec4((gl_VertexID & 1) * 4 - 1, (gl_VertexID & 2) * 2 - 1, z, 1.0); }""",
        fragment_shader="#version 430\nout vec4 color;\nvoid main() { color = vec4(1.0); }",
    )
    triangle = gl.vertex_array(program, [])
    frame.use()
    raw.set_depth_zero_to_one()
    gl.enable(gl.DEPTH_TEST)
    gl.depth_func = ">"
    try:
        for z in (1e-7, 3.3333333e-5, 0.76543218):  # reversed Z: far away is close to 0, where 24 bits have nothing
            frame.clear(depth=0.0)
            program["z"].value = z  # type: ignore[union-attr]
            triangle.render(gl.TRIANGLES, 3)
            got = np.frombuffer(depth.read(), np.float32)
            np.testing.assert_array_equal(got, np.float32(z))
    finally:
        raw.glClipControl(G.GL_LOWER_LEFT, G.GL_NEGATIVE_ONE_TO_ONE)
        gl.depth_func = "<"
        gl.disable(gl.DEPTH_TEST)
        gl.detect_framebuffer(0).use()  # moderngl binds the last one used again later: not one that is released
    for owned in (triangle, program, frame, color, depth):
        owned.release()


def test_program_uniforms_labels_limits_and_extensions(context: Context) -> None:
    gl, raw = context.gl, context.raw
    shader = gl.compute_shader(
        "#version 430\nlayout(local_size_x=1) in; uniform int n;\n"
        "layout(std430, binding=0) buffer R { int r; }; void main() { r = n; }"
    )
    out = gl.buffer(bytes(4))
    out.bind_to_storage_buffer(0)
    raw.glProgramUniform1i(shader.glo, shader["n"].location, -77)  # type: ignore[union-attr]
    shader.run()
    assert np.frombuffer(out.read(), np.int32)[0] == -77
    raw.label(G.GL_PROGRAM, shader.glo, "a name" * 100)
    assert raw.get_integer_indexed(0x91BE, 0) == context.limits.work_group_count[0]  # GL_MAX_COMPUTE_WORK_GROUP_COUNT
    assert "GL_ARB_compute_shader" in raw.extensions()
    for owned in (out, shader):
        owned.release()


def test_timestamps_go_forward(context: Context) -> None:
    raw = context.raw
    queries = (ctypes.c_uint * 2)()
    raw.glGenQueries(2, queries)
    times = []
    for query in queries:
        raw.glQueryCounter(query, G.GL_TIMESTAMP)
        raw.glFinish()
        value = ctypes.c_uint64(0)
        raw.glGetQueryObjectui64v(query, G.GL_QUERY_RESULT, ctypes.byref(value))
        times.append(value.value)
    raw.glDeleteQueries(2, queries)
    assert 0 < times[0] <= times[1]


def test_errors_are_taken_by_name_and_only_once(context: Context) -> None:
    context.raw.glBindTexture(0xBAD, 0)
    assert context.raw.errors() == ["GL_INVALID_ENUM"] and context.raw.errors() == []


def test_functions_that_are_not_there() -> None:
    nothing = G.GL(lambda name: 0)
    assert not nothing.has("glFinish")
    with pytest.raises(DeviceError, match="glFinish: this OpenGL driver does not have it"):
        nothing.glFinish()
    with pytest.raises(AttributeError, match=Path(G.__file__).name):
        nothing.glNoSuchThing()
