"""The few OpenGL entry points that moderngl lacks, called through ctypes on the addresses that the context gives.

`GL` has one method per row of `_SIGNATURES`, named like the function: one more function is one more row. A function
that the driver does not have is found out at its first call (DeviceError), not at start.

Chosen: plain ctypes. Rejected: PyOpenGL, a large dependency that picks its platform at import and is often the wrong
one in containers (pyrender's most reported fault).
"""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_float, c_int, c_int64, c_ubyte, c_uint, c_uint64, c_void_p
from typing import TYPE_CHECKING, Any

from glhybrid.errors import DeviceError

if TYPE_CHECKING:
    import moderngl

# Values from the Khronos registry (gl.xml).
GL_NO_ERROR = 0
GL_VENDOR, GL_RENDERER, GL_VERSION, GL_EXTENSIONS = 0x1F00, 0x1F01, 0x1F02, 0x1F03
GL_SHADING_LANGUAGE_VERSION, GL_NUM_EXTENSIONS = 0x8B8C, 0x821D
GL_MAJOR_VERSION, GL_MINOR_VERSION, GL_CONTEXT_PROFILE_MASK = 0x821B, 0x821C, 0x9126
GL_LOWER_LEFT, GL_UPPER_LEFT, GL_NEGATIVE_ONE_TO_ONE, GL_ZERO_TO_ONE = 0x8CA1, 0x8CA2, 0x935E, 0x935F
GL_TEXTURE0, GL_TEXTURE_2D, GL_TEXTURE_BUFFER, GL_TEXTURE_BINDING_2D = 0x84C0, 0x0DE1, 0x8C2A, 0x8069
GL_ACTIVE_TEXTURE = 0x84E0
GL_R32UI, GL_RG32UI, GL_RGBA32UI, GL_R32F, GL_RG32F, GL_RGBA32F = 0x8236, 0x823C, 0x8D70, 0x822E, 0x8230, 0x8814
GL_DEPTH_COMPONENT, GL_DEPTH_COMPONENT32F, GL_FLOAT = 0x1902, 0x8CAC, 0x1406
GL_COLOR, GL_DEPTH = 0x1800, 0x1801
GL_READ_FRAMEBUFFER, GL_DRAW_FRAMEBUFFER, GL_COLOR_BUFFER_BIT, GL_NEAREST = 0x8CA8, 0x8CA9, 0x4000, 0x2600
GL_BUFFER, GL_SHADER, GL_PROGRAM, GL_QUERY, GL_TEXTURE = 0x82E0, 0x82E1, 0x82E2, 0x82E3, 0x1702
GL_FRAMEBUFFER, GL_RENDERBUFFER, GL_VERTEX_ARRAY, GL_SAMPLER = 0x8D40, 0x8D41, 0x8074, 0x82E6
GL_TIMESTAMP, GL_QUERY_RESULT, GL_QUERY_RESULT_AVAILABLE = 0x8E28, 0x8866, 0x8867
GL_DEBUG_SOURCE_APPLICATION = 0x824A
GL_FRAGMENT_SHADER, GL_VERTEX_SHADER, GL_COMPUTE_SHADER, GL_COMPLETION_STATUS = 0x8B30, 0x8B31, 0x91B9, 0x91B1
GL_COMPILE_STATUS, GL_LINK_STATUS = 0x8B81, 0x8B82
GL_PROGRAM_BINARY_RETRIEVABLE_HINT, GL_PROGRAM_BINARY_LENGTH = 0x8257, 0x8741
GL_NUM_PROGRAM_BINARY_FORMATS = 0x87FE
GL_COPY_READ_BUFFER, GL_STREAM_READ, GL_MAP_READ_BIT = 0x8F36, 0x88E1, 0x1
GL_SYNC_GPU_COMMANDS_COMPLETE, GL_SYNC_FLUSH_COMMANDS_BIT = 0x9117, 0x1
GL_TIMEOUT_EXPIRED, GL_WAIT_FAILED = 0x911B, 0x911D
GL_VERTEX_ATTRIB_ARRAY_BARRIER_BIT, GL_ELEMENT_ARRAY_BARRIER_BIT, GL_UNIFORM_BARRIER_BIT = 0x1, 0x2, 0x4
GL_TEXTURE_FETCH_BARRIER_BIT, GL_SHADER_IMAGE_ACCESS_BARRIER_BIT, GL_COMMAND_BARRIER_BIT = 0x8, 0x20, 0x40
GL_TEXTURE_UPDATE_BARRIER_BIT, GL_BUFFER_UPDATE_BARRIER_BIT, GL_FRAMEBUFFER_BARRIER_BIT = 0x100, 0x200, 0x400
GL_SHADER_STORAGE_BARRIER_BIT, GL_ALL_BARRIER_BITS = 0x2000, 0xFFFFFFFF

_ERROR_NAMES = {
    0x0500: "GL_INVALID_ENUM",
    0x0501: "GL_INVALID_VALUE",
    0x0502: "GL_INVALID_OPERATION",
    0x0503: "GL_STACK_OVERFLOW",
    0x0504: "GL_STACK_UNDERFLOW",
    0x0505: "GL_OUT_OF_MEMORY",
    0x0506: "GL_INVALID_FRAMEBUFFER_OPERATION",
    0x0507: "GL_CONTEXT_LOST",
}

_ENUM = _UINT = _BITS = c_uint
_INT = _SIZE = c_int
_OFFSET = ctypes.c_ssize_t
_UINTS, _INTS = POINTER(c_uint), POINTER(c_int)

# name: (result, arguments), from the OpenGL 4.3 core specification.
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "glActiveTexture": (None, (_ENUM,)),
    "glAttachShader": (None, (_UINT, _UINT)),
    "glBindBuffer": (None, (_ENUM, _UINT)),
    "glBindFramebuffer": (None, (_ENUM, _UINT)),
    "glBindTexture": (None, (_ENUM, _UINT)),
    "glBlitFramebuffer": (None, (_INT,) * 8 + (_BITS, _ENUM)),
    "glBufferData": (None, (_ENUM, _OFFSET, c_void_p, _ENUM)),
    "glClearBufferfv": (None, (_ENUM, _INT, POINTER(c_float))),
    "glClearBufferuiv": (None, (_ENUM, _INT, _UINTS)),
    "glClientWaitSync": (_ENUM, (c_void_p, _BITS, c_uint64)),
    "glClipControl": (None, (_ENUM, _ENUM)),  # 4.5 or ARB_clip_control
    "glCompileShader": (None, (_UINT,)),
    "glCreateProgram": (_UINT, ()),
    "glCreateShader": (_UINT, (_ENUM,)),
    "glDeleteProgram": (None, (_UINT,)),
    "glDeleteQueries": (None, (_SIZE, _UINTS)),
    "glDeleteShader": (None, (_UINT,)),
    "glDeleteSync": (None, (c_void_p,)),
    "glDeleteTextures": (None, (_SIZE, _UINTS)),
    "glFenceSync": (c_void_p, (_ENUM, _BITS)),
    "glFinish": (None, ()),
    "glFlush": (None, ()),
    "glGenQueries": (None, (_SIZE, _UINTS)),
    "glGenTextures": (None, (_SIZE, _UINTS)),
    "glGetError": (_ENUM, ()),
    "glGetFloatv": (None, (_ENUM, POINTER(c_float))),
    "glGetInteger64v": (None, (_ENUM, POINTER(c_int64))),
    "glGetIntegeri_v": (None, (_ENUM, _UINT, _INTS)),
    "glGetIntegerv": (None, (_ENUM, _INTS)),
    "glGetProgramBinary": (None, (_UINT, _SIZE, _INTS, _UINTS, c_char_p)),
    "glGetProgramiv": (None, (_UINT, _ENUM, _INTS)),
    "glGetQueryObjectui64v": (None, (_UINT, _ENUM, POINTER(c_uint64))),
    "glGetShaderiv": (None, (_UINT, _ENUM, _INTS)),
    "glGetString": (c_char_p, (_ENUM,)),
    "glGetStringi": (c_char_p, (_ENUM, _UINT)),
    "glIsBuffer": (c_ubyte, (_UINT,)),
    "glIsFramebuffer": (c_ubyte, (_UINT,)),
    "glIsProgram": (c_ubyte, (_UINT,)),
    "glIsTexture": (c_ubyte, (_UINT,)),
    "glLinkProgram": (None, (_UINT,)),
    "glMapBufferRange": (c_void_p, (_ENUM, _OFFSET, _OFFSET, _BITS)),
    "glIsVertexArray": (c_ubyte, (_UINT,)),
    "glMemoryBarrier": (None, (_BITS,)),
    "glObjectLabel": (None, (_ENUM, _UINT, _SIZE, c_char_p)),
    "glPopDebugGroup": (None, ()),
    "glProgramBinary": (None, (_UINT, _ENUM, c_char_p, _SIZE)),
    "glProgramParameteri": (None, (_UINT, _ENUM, _INT)),
    "glProgramUniform1f": (None, (_UINT, _INT, c_float)),
    "glProgramUniform1i": (None, (_UINT, _INT, _INT)),
    "glProgramUniform1ui": (None, (_UINT, _INT, _UINT)),
    "glPushDebugGroup": (None, (_ENUM, _UINT, _SIZE, c_char_p)),
    "glQueryCounter": (None, (_UINT, _ENUM)),
    "glShaderSource": (None, (_UINT, _SIZE, POINTER(c_char_p), _INTS)),
    "glTexBuffer": (None, (_ENUM, _ENUM, _UINT)),
    "glTexBufferRange": (None, (_ENUM, _ENUM, _UINT, _OFFSET, _OFFSET)),
    "glTexImage2D": (None, (_ENUM, _INT, _INT, _SIZE, _SIZE, _INT, _ENUM, _ENUM, c_void_p)),
    "glUnmapBuffer": (c_ubyte, (_ENUM,)),
    "glUseProgram": (None, (_UINT,)),
}


class GL:
    """OpenGL functions by name: `gl.glClipControl(GL_UPPER_LEFT, GL_ZERO_TO_ONE)`.

    load: gives the address of a function, 0 if the driver has none; the context it belongs to must be current.
    """

    def __init__(self, load: Callable[[str], int]) -> None:
        self._load = load
        self.buffer_textures: dict[int, int] = {}  # bound to GL_TEXTURE_BUFFER, by unit

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in _SIGNATURES:
            raise AttributeError(f"{name}: no row in glhybrid/gl.py")
        result, arguments = _SIGNATURES[name]
        address = self._load(name)
        if not address:
            raise DeviceError(f"{name}: this OpenGL driver does not have it; update the driver or try another --device")
        function = ctypes.CFUNCTYPE(result, *arguments)(address)
        setattr(self, name, function)  # __getattr__ is not called for it again
        return function

    def has(self, name: str) -> bool:
        """Whether the driver gives an address for a function. With libglvnd that is no promise that it works."""
        return name in _SIGNATURES and bool(self._load(name))

    def get_integer(self, name: int) -> int:
        """One integer of the state or limits; 0 and a GL error if the driver does not know it."""
        value = c_int64(0)
        self.glGetInteger64v(name, ctypes.byref(value))
        return value.value

    def get_program(self, program: int, name: int) -> int:
        """One property of a program."""
        value = c_int(0)
        self.glGetProgramiv(program, name, ctypes.byref(value))
        return value.value

    def get_integer_indexed(self, name: int, index: int) -> int:
        """One integer of an indexed limit, such as a dimension of GL_MAX_COMPUTE_WORK_GROUP_COUNT."""
        value = c_int(0)
        self.glGetIntegeri_v(name, index, ctypes.byref(value))
        return value.value

    def get_string(self, name: int) -> str:
        """The driver's words; empty for a name that it does not know."""
        return (self.glGetString(name) or b"").decode("utf-8", "replace")

    def extensions(self) -> frozenset[str]:
        """Names of all extensions, such as GL_ARB_clip_control."""
        count = self.get_integer(GL_NUM_EXTENSIONS)
        return frozenset((self.glGetStringi(GL_EXTENSIONS, i) or b"").decode("ascii", "replace") for i in range(count))

    def set_sampler(self, program: "moderngl.Program | moderngl.ComputeShader", name: str, unit: int) -> None:
        """Gives a sampler its texture unit. moderngl 5.13 silently ignores `.value` on samplerBuffer uniforms."""
        self.glProgramUniform1i(program.glo, program[name].location, unit)  # type: ignore[union-attr]

    def label(self, kind: int, name: int, text: str) -> None:
        """Names an object (GL_TEXTURE, GL_BUFFER, GL_PROGRAM ...) for debuggers such as RenderDoc and apitrace."""
        data = text.encode("ascii", "replace")[:255]  # GL_MAX_LABEL_LENGTH is at least 256, the final 0 included
        self.glObjectLabel(kind, name, len(data), data)

    def errors(self) -> list[str]:
        """Takes every pending GL error, oldest first."""
        found: list[str] = []
        while (code := self.glGetError()) != GL_NO_ERROR and len(found) < 16:  # a lost context may report for ever
            found.append(_ERROR_NAMES.get(code, hex(code)))
        return found

    def set_depth_zero_to_one(self) -> None:
        """Clip space depth from 0 to 1, as reversed Z with a float target needs; row 0 stays at the bottom."""
        self.glClipControl(GL_LOWER_LEFT, GL_ZERO_TO_ONE)

    def clear_ids(self, value: int) -> None:
        """Clears the bound framebuffer: every channel of its integer target to value, depth to 0 (far, reversed)."""
        self.glClearBufferuiv(GL_COLOR, 0, (c_uint * 4)(value, value, value, value))
        self.glClearBufferfv(GL_DEPTH, 0, (c_float * 1)(0.0))

    def clear_depth(self) -> None:
        """Clears the bound framebuffer's depth to 0 (far, reversed)."""
        self.glClearBufferfv(GL_DEPTH, 0, (c_float * 1)(0.0))

    def depth32f(self, ctx: "moderngl.Context", size: tuple[int, int]) -> "moderngl.Texture":
        """A depth texture of 32-bit floats, (W, H), ready to be a moderngl depth_attachment; sampling gives raw depth.

        moderngl only makes 24-bit ones, so its storage is given again, before anything has used it.
        """
        texture = ctx.depth_texture(size)
        texture.compare_func = ""
        texture.filter = (ctx.NEAREST, ctx.NEAREST)
        texture.use(0)
        self.glTexImage2D(
            GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT32F, *size, 0, GL_DEPTH_COMPONENT, GL_FLOAT, None
        )  # fmt: skip
        return texture


class BufferTexture:
    """A buffer read by `texelFetch(usamplerBuffer, i)`: on many GPUs faster than a storage block for tree nodes.

    buffer: owns the data and must live as long. format: GL_RGBA32UI (default, 16 bytes a texel) or another sized one.
    offset and size in bytes, 0 = the whole buffer; offset is a multiple of GL_TEXTURE_BUFFER_OFFSET_ALIGNMENT.
    """

    def __init__(
        self, gl: GL, buffer: "moderngl.Buffer", format: int = GL_RGBA32UI, offset: int = 0, size: int = 0
    ) -> None:
        self._gl = gl
        self.buffer = buffer
        name = c_uint(0)
        gl.glGenTextures(1, ctypes.byref(name))
        self.glo = name.value
        self.bind(0)
        if offset or size:
            gl.glTexBufferRange(GL_TEXTURE_BUFFER, format, buffer.glo, offset, size or buffer.size - offset)
        else:
            gl.glTexBuffer(GL_TEXTURE_BUFFER, format, buffer.glo)

    def bind(self, unit: int) -> None:
        """Binds to a texture unit for the samplers that were given that number, unless it is bound there already."""
        bound = self._gl.buffer_textures
        if bound.get(unit) != self.glo:
            self._gl.glActiveTexture(GL_TEXTURE0 + unit)
            self._gl.glBindTexture(GL_TEXTURE_BUFFER, self.glo)
            bound[unit] = self.glo

    def release(self) -> None:
        """Frees the texture, not the buffer. Twice is harmless."""
        if self.glo:
            name, self.glo = c_uint(self.glo), 0
            self._gl.glDeleteTextures(1, ctypes.byref(name))
            for unit in [unit for unit, bound in self._gl.buffer_textures.items() if bound == name.value]:
                del self._gl.buffer_textures[unit]
