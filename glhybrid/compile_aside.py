"""Programs compiled by the driver's own threads while somebody is told so (KHR_parallel_shader_compile).

moderngl asks for the result at once and stands still until it is there: seconds on some drivers. Here the same text is
compiled before, and asked about now and then. Drivers keep what they have compiled, so that moderngl's turn is short;
where it is not, nothing more is compiled twice.
"""

import ctypes
import time
from collections.abc import Callable, Mapping

from glhybrid.gl import GL, GL_COMPLETION_STATUS

EXTENSIONS = ("GL_KHR_parallel_shader_compile", "GL_ARB_parallel_shader_compile")
LOOK_S = 0.005  # between two questions
SHORT_S = 0.1  # of a compilation that says nothing


class CompileAside:
    """Of one context. worth: whether run() is of use here."""

    def __init__(self, raw: GL) -> None:
        self._raw = raw
        self.worth = not raw.extensions().isdisjoint(EXTENSIONS)

    def run(self, stages: Mapping[int, str], told: Callable[[], None]) -> float:
        """Compiles and links, and forgets; returns the seconds. stages: text by kind (GL_COMPUTE_SHADER ...).

        told: called now and then; what it raises goes out. Errors of compilation are for moderngl to report.
        """
        raw, start = self._raw, time.perf_counter()
        program, shaders = raw.glCreateProgram(), [raw.glCreateShader(kind) for kind in stages]
        try:
            for shader, text in zip(shaders, stages.values(), strict=True):
                source = ctypes.c_char_p(text.encode())
                raw.glShaderSource(shader, 1, ctypes.byref(source), None)
                raw.glCompileShader(shader)
                raw.glAttachShader(program, shader)
            raw.glLinkProgram(program)
            while not raw.get_program(program, GL_COMPLETION_STATUS):
                told()
                time.sleep(LOOK_S)
        finally:
            for shader in shaders:
                raw.glDeleteShader(shader)
            raw.glDeleteProgram(program)
        return time.perf_counter() - start

    def learn(self, aside_s: float, again_s: float) -> None:
        """How long moderngl took for what run() had compiled."""
        if aside_s > SHORT_S and again_s > 0.5 * aside_s:
            self.worth = False
