"""OSMesa through ctypes: Mesa's software renderer without EGL, drawing to memory.

For machines with a Mesa older than 25.1, which dropped it; EGL on llvmpipe is the better software path elsewhere.
"""

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_ubyte, c_uint, c_void_p
from typing import Any

from glhybrid import egl, host
from glhybrid.errors import DeviceError

# Values from Mesa's include/GL/osmesa.h.
_FORMAT, _DEPTH_BITS, _PROFILE, _CORE_PROFILE, _MAJOR, _MINOR = 0x22, 0x30, 0x33, 0x34, 0x36, 0x37
_RGBA, _UNSIGNED_BYTE = 0x1908, 0x1401


class OsmesaContext:
    """An OpenGL core context on OSMesa, current from the start; moderngl's context-object protocol.

    OSMesa and Mesa's EGL share one thread-local dispatch table without telling each other, so EGL's context is unbound
    before this one is made current, and bound anew by whoever wants it next.
    """

    def __init__(self, version: tuple[int, int] = (4, 3)) -> None:
        name = host.find_osmesa()
        if name is None:
            raise DeviceError(f"libOSMesa.so.8 is missing (Mesa 25.1 dropped it; use software): {host.OSMESA_FIX}")
        self._library = library = ctypes.CDLL(name)
        for function, result, arguments in (
            ("OSMesaCreateContextAttribs", c_void_p, (POINTER(c_int), c_void_p)),
            ("OSMesaDestroyContext", None, (c_void_p,)),
            ("OSMesaGetCurrentContext", c_void_p, ()),
            ("OSMesaGetProcAddress", c_void_p, (c_char_p,)),
            ("OSMesaMakeCurrent", c_ubyte, (c_void_p, c_void_p, c_uint, c_int, c_int)),
        ):
            entry: Any = getattr(library, function, None)
            if entry is None:
                raise DeviceError(f"{name} has no {function}; it is older than Mesa 12: {host.OSMESA_FIX}")
            entry.restype, entry.argtypes = result, arguments
        wanted = [
            _FORMAT,
            _RGBA,
            _DEPTH_BITS,
            24,
            _PROFILE,
            _CORE_PROFILE,
            _MAJOR,
            version[0],
            _MINOR,
            version[1],
            0,
            0,
        ]
        self._context = library.OSMesaCreateContextAttribs((c_int * len(wanted))(*wanted), None)
        if not self._context:
            raise DeviceError(
                f"OSMesaCreateContextAttribs: {name} has no OpenGL {version[0]}.{version[1]} core profile"
            )
        self._pixel = (c_ubyte * 4)()  # OSMesa needs memory to draw to; all our targets are framebuffer objects
        self.make_current()

    def make_current(self) -> None:
        """Raises DeviceError where another thread has it."""
        egl.unbind()
        if not self._library.OSMesaMakeCurrent(self._context, self._pixel, _UNSIGNED_BYTE, 1, 1):
            raise DeviceError("OSMesaMakeCurrent failed: is the context current in another thread?")

    def is_current(self) -> bool:
        """Whether it is this thread's context."""
        return bool(self._context) and self._library.OSMesaGetCurrentContext() == self._context

    def load_opengl_function(self, name: str) -> int:
        """Its address; 0 if the driver has none."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    load = load_opengl_function

    def __enter__(self) -> "OsmesaContext":
        self.make_current()
        return self

    def __exit__(self, *_: object) -> None:
        pass  # stays current: OSMesa has no other context of ours to go back to

    def release(self) -> None:
        """Frees the context and everything made in it. Twice is harmless."""
        if self._context:
            if self._library.OSMesaGetCurrentContext() == self._context:
                self._library.OSMesaMakeCurrent(None, None, 0, 0, 0)
            self._library.OSMesaDestroyContext(self._context)
            self._context = None
