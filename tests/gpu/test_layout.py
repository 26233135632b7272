"""The table of structs and images: what NumPy writes is what GLSL reads, field by field, three elements of each."""

from typing import TYPE_CHECKING, Any

import moderngl
import numpy as np
import pytest

from glhybrid import layout
from glhybrid.gl import BufferTexture

if TYPE_CHECKING:
    from glhybrid.context import Context

COMPONENTS = {"float": 1, "uint": 1, "int": 1, "vec2": 2, "ivec2": 2, "uvec2": 2, "vec3": 3, "uvec3": 3, "vec4": 4}
COLUMNS = {"mat4": (4, 4), "mat4x3": (4, 3)}
ELEMENTS = 3  # elements 1 and 2 show the stride


def run(context: "Context", text: str, size: int, **buffers: Any) -> np.ndarray:
    """Dispatches one invocation of a shader; buffers by block name; returns `size` uint32 of its block Out."""
    program: Any = context.gl.compute_shader("#version 430 core\n" + layout.glsl_header() + text)
    made = {name: context.gl.buffer(np.ascontiguousarray(data)) for name, data in buffers.items()}
    made["Out"] = context.gl.buffer(reserve=4 * size)
    try:
        for binding, name in enumerate(made):
            program[name].binding = binding
            made[name].bind_to_storage_buffer(binding)
        program.run(1)
        context.gl.memory_barrier()
        return np.frombuffer(made["Out"].read(), np.uint32)
    finally:
        for buffer in made.values():
            buffer.release()
        program.release()


def bits_of(kind: str, expression: str) -> list[str]:
    """GLSL uints of the components of an expression, in order."""
    kind, _, count = kind.partition("[")
    if count:
        return [bit for i in range(int(count.rstrip("]"))) for bit in bits_of(kind, f"{expression}[{i}]")]
    if kind in COLUMNS:
        columns, rows = COLUMNS[kind]
        return [f"floatBitsToUint({expression}[{c}][{r}])" for c in range(columns) for r in range(rows)]
    parts = [expression] if COMPONENTS[kind] == 1 else [f"{expression}[{i}]" for i in range(COMPONENTS[kind])]
    cast = "uint({})" if kind.startswith(("u", "i")) else "floatBitsToUint({})"
    return [cast.format(part) for part in parts]


def elements(name: str) -> tuple[np.ndarray, np.ndarray]:
    """ELEMENTS rows of a struct, and the bits of their fields in order."""
    rows = layout.STRUCTS[name]
    kind_of = layout.dtype(name)
    assert kind_of.names == tuple(field for _, field, _ in rows)
    rng = np.random.default_rng(len(name))
    data = np.zeros(ELEMENTS, kind_of)
    data.view(np.uint8)[:] = 0xA5  # padding holds something else than zero
    wanted = []
    for element in range(ELEMENTS):
        for kind, field, _ in rows:
            shape = data[field].shape[1:]
            whole = kind.startswith(("u", "i"))
            data[field][element] = rng.integers(0, 2**31 - 1, shape) if whole else rng.normal(size=shape)
            written = np.ravel(data[field][element]) if shape else data[field][element : element + 1]
            if kind == "mat4x3":  # four columns, of which the fourth row is padding
                written = data[field][element][:, :3].reshape(-1)
            wanted.append(np.ascontiguousarray(written).view(np.uint32))
    return data, np.concatenate(wanted)


def copying(name: str, given: str, declared: str) -> tuple[str, int]:
    """A shader that copies every field of the elements; `given` with an index says where they are. And how many words."""
    values = [
        bit for e in range(ELEMENTS) for kind, field, _ in layout.STRUCTS[name]
        for bit in bits_of(kind, f"{given.format(e)}.{field}")
    ]  # fmt: skip
    body = "\n".join(f"    copied[{i}] = {value};" for i, value in enumerate(values))
    text = f"""
layout(local_size_x = 1) in;
{declared}
layout(std430) writeonly buffer Out {{ uint copied[]; }};
void main() {{
{body}
}}
"""
    return text, len(values)


def compare(name: str, got: np.ndarray, expected: np.ndarray) -> None:
    fields = [
        f"{f} of element {e}" for e in range(ELEMENTS) for k, f, _ in layout.STRUCTS[name] for _ in bits_of(k, "")
    ]
    wrong = [fields[i] for i in np.flatnonzero(got != expected)]
    assert not wrong, f"{name}: {wrong}"


@pytest.mark.parametrize("name", layout.STRUCTS)
def test_every_field_arrives(context: "Context", name: str) -> None:
    data, expected = elements(name)
    text, count = copying(name, "given[{}]", f"layout(std430) readonly buffer In {{ {name} given[]; }};")
    assert count == len(expected)
    compare(name, run(context, text, count, In=data), expected)


@pytest.mark.parametrize("name", layout.TABLES)
def test_every_field_arrives_through_texels(context: "Context", name: str) -> None:
    data, expected = elements(name)
    declared = "uniform usamplerBuffer table;\n" + layout.glsl_readers()
    text, count = copying(name, f"read_{name}(table, {{}}u)", declared)
    buffer = context.gl.buffer(data)
    view = BufferTexture(context.raw, buffer)
    view.bind(0)
    try:
        compare(name, run(context, text, count), expected)
    finally:
        view.release()
        buffer.release()


def test_matrices_are_written_as_columns(context: "Context") -> None:
    rng = np.random.default_rng(1)
    pose, clip, point = rng.normal(size=(4, 4)), rng.normal(size=(4, 4)), rng.normal(size=3)
    pose[3] = 0, 0, 0, 1
    instance, frame = np.zeros(1, layout.dtype("Instance")), np.zeros(1, layout.dtype("FrameConstants"))
    instance["world_from_object"], frame["clip_from_world"] = layout.columns(pose[:3]), layout.columns(clip)
    text = """
layout(local_size_x = 1) in;
layout(std430) readonly buffer Instances { Instance instance; };
layout(std430) readonly buffer Frame { FrameConstants frame; };
layout(std430) readonly buffer Points { vec4 point; };
layout(std430) writeonly buffer Out { uint bits[]; };
void main() {
    vec3 world = instance.world_from_object * point;
    vec4 clip = frame.clip_from_world * point;
    for (int i = 0; i < 3; i++) bits[i] = floatBitsToUint(world[i]);
    for (int i = 0; i < 4; i++) bits[3 + i] = floatBitsToUint(clip[i]);
}
"""
    homogeneous = np.append(point, 1).astype(np.float32)
    got = run(context, text, 7, Instances=instance, Frame=frame, Points=homogeneous).view(np.float32)
    assert np.allclose(got[:3], (pose @ np.append(point, 1))[:3], rtol=1e-5, atol=1e-6)
    assert np.allclose(got[3:], clip @ np.append(point, 1), rtol=1e-5, atol=1e-6)


def test_constants_are_those_of_python(context: "Context") -> None:
    names = list(layout.CONSTANTS)
    body = "\n".join(f"    values[{i}] = {name};" for i, name in enumerate(names))
    head = "layout(local_size_x = 1) in;\nlayout(std430) writeonly buffer Out { uint values[]; };\n"
    text = f"{head}void main() {{\n{body}\n}}\n"
    assert dict(zip(names, run(context, text, len(names)).tolist(), strict=True)) == layout.CONSTANTS


@pytest.mark.parametrize("name", layout.CHANNELS)
def test_images_hold_what_shaders_store(context: "Context", name: str) -> None:
    """A value stored through the channel's GLSL format is what moderngl's dtype reads back, and no other texel's."""
    channel = layout.CHANNELS[name]
    prefix = "u" if channel.glsl_format.endswith("ui") else ""
    size = (5, 3)
    values: Any = {
        "u4": np.arange(60, dtype=np.uint32) * np.uint32(71582788) + np.uint32(3),
        "u1": (np.arange(60) * 4 % 251).astype(np.uint8),
        "f4": np.float32(np.arange(60)) * np.float32(1.1e-3) - np.float32(7e4),
        "f2": np.float16(np.arange(60) / 8 - 2),
        "f1": (np.arange(60) * 4 % 251).astype(np.uint8),
    }[channel.dtype].reshape(3, 5, 4)[..., : channel.components]
    numbers: Any = values / 255 if channel.dtype == "f1" else values.astype(np.float64)
    padded = np.zeros((3, 5, 4), np.uint32 if prefix else np.float32)
    padded[..., : channel.components] = numbers
    text = f"""#version 430 core
layout(local_size_x = 1) in;
layout({channel.glsl_format}) writeonly uniform {prefix}image2D target;
layout(std430) readonly buffer In {{ {prefix}vec4 given[]; }};
void main() {{
    ivec2 px = ivec2(gl_WorkGroupID.xy);
    imageStore(target, px, given[px.y * {size[0]} + px.x]);
}}
"""
    gl = context.gl
    program, source = gl.compute_shader(text), gl.buffer(padded)
    image = gl.texture(size, channel.components, dtype=channel.dtype)
    image.filter = (moderngl.NEAREST, moderngl.NEAREST)
    try:
        source.bind_to_storage_buffer(0)
        image.bind_to_image(0, read=False, write=True)
        program.run(*size)
        gl.memory_barrier()
        read = np.frombuffer(image.read(alignment=1), values.dtype).reshape(values.shape)
        assert np.array_equal(read, values)
        assert len(image.read(alignment=1)) == channel.bytes_per_pixel * size[0] * size[1]
    finally:
        for owned in (image, source, program):
            owned.release()
