"""EGL through ctypes: the devices of this machine and a context on one of them, with no display server.

`EglContext` is the context object that `moderngl.create_context(context=...)` takes. Rejected: glcontext's EGL backend
(3.1). It takes device 0 unless told a number, knows neither kind nor name of a device, needs libGL and ldconfig besides
libEGL, and fails with a bare hexadecimal code.
Displays are opened once per device and kept: EGL gives the same display to every caller in the process, so
terminating it would end the contexts of the others.
"""

import ctypes
import os
from collections.abc import Iterator
from ctypes import POINTER, byref, c_char_p, c_int, c_ssize_t, c_uint, c_void_p
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from glhybrid import host
from glhybrid.errors import DeviceError

# Values from the Khronos registry (egl.xml).
_FALSE = 0
_SUCCESS, _VENDOR, _VERSION, _EXTENSIONS, _NONE = 0x3000, 0x3053, 0x3054, 0x3055, 0x3038
_OPENGL_API, _OPENGL_BIT, _RENDERABLE_TYPE, _SURFACE_TYPE, _PBUFFER_BIT = 0x30A2, 0x8, 0x3040, 0x3033, 0x1
_WIDTH, _HEIGHT, _DRAW, _READ = 0x3057, 0x3056, 0x3059, 0x305A
_CONTEXT_MAJOR, _CONTEXT_MINOR, _CONTEXT_PROFILE, _CONTEXT_CORE, _CONTEXT_DEBUG = 0x3098, 0x30FB, 0x30FD, 0x1, 0x31B0
_PLATFORM_DEVICE, _PLATFORM_SURFACELESS = 0x313F, 0x31DD
_DRM_DEVICE_FILE, _DRM_RENDER_NODE_FILE, _CUDA_DEVICE, _RENDERER = 0x3233, 0x3377, 0x323A, 0x335F
_ERRORS = {
    0x3001: "EGL_NOT_INITIALIZED", 0x3002: "EGL_BAD_ACCESS", 0x3003: "EGL_BAD_ALLOC", 0x3004: "EGL_BAD_ATTRIBUTE",
    0x3005: "EGL_BAD_CONFIG", 0x3006: "EGL_BAD_CONTEXT", 0x3007: "EGL_BAD_CURRENT_SURFACE", 0x3008: "EGL_BAD_DISPLAY",
    0x3009: "EGL_BAD_MATCH", 0x300A: "EGL_BAD_NATIVE_PIXMAP", 0x300B: "EGL_BAD_NATIVE_WINDOW",
    0x300C: "EGL_BAD_PARAMETER", 0x300D: "EGL_BAD_SURFACE", 0x300E: "EGL_CONTEXT_LOST",
}  # fmt: skip

_PTR = c_void_p
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "eglBindAPI": (c_uint, (c_uint,)),
    "eglChooseConfig": (c_uint, (_PTR, POINTER(c_int), POINTER(_PTR), c_int, POINTER(c_int))),
    "eglCreateContext": (_PTR, (_PTR, _PTR, _PTR, POINTER(c_int))),
    "eglCreatePbufferSurface": (_PTR, (_PTR, _PTR, POINTER(c_int))),
    "eglDestroyContext": (c_uint, (_PTR, _PTR)),
    "eglDestroySurface": (c_uint, (_PTR, _PTR)),
    "eglGetCurrentContext": (_PTR, ()),
    "eglGetCurrentDisplay": (_PTR, ()),
    "eglGetCurrentSurface": (_PTR, (c_int,)),
    "eglGetError": (c_int, ()),
    "eglGetPlatformDisplayEXT": (_PTR, (c_uint, _PTR, POINTER(c_int))),
    "eglGetProcAddress": (_PTR, (c_char_p,)),
    "eglInitialize": (c_uint, (_PTR, POINTER(c_int), POINTER(c_int))),
    "eglMakeCurrent": (c_uint, (_PTR, _PTR, _PTR, _PTR)),
    "eglQueryDeviceAttribEXT": (c_uint, (_PTR, c_int, POINTER(c_ssize_t))),
    "eglQueryDeviceStringEXT": (c_char_p, (_PTR, c_int)),
    "eglQueryDevicesEXT": (c_uint, (c_int, POINTER(_PTR), POINTER(c_int))),
    "eglQueryString": (c_char_p, (_PTR, c_int)),
}


@dataclass(frozen=True)
class EglDevice:
    """What EGL says of a device before any context exists; empty or None where the driver does not say.

    index: position in eglQueryDevicesEXT's list, -1 for Mesa's surfaceless platform (no device named).
    cuda: EGL_CUDA_DEVICE_NV, the ordinal CUDA gives the same GPU. software: EGL_MESA_device_software.
    """

    index: int
    handle: int
    extensions: frozenset[str] = frozenset()
    vendor: str = ""
    renderer: str = ""
    drm_node: str = ""
    render_node: str = ""
    cuda: int | None = None
    software: bool = False

    @property
    def name(self) -> str:
        """As --device takes it; `surfaceless` for Mesa's platform without a device."""
        return f"egl:{self.index}" if self.index >= 0 else "surfaceless"

    def __str__(self) -> str:
        facts = [self.renderer or self.vendor, f"cuda:{self.cuda}" if self.cuda is not None else "", self.drm_node]
        facts += ["software"] if self.software else []
        return f"{self.name} ({', '.join(f for f in facts if f) or 'unnamed'})"


SURFACELESS = EglDevice(-1, 0)


class _Egl:
    """libEGL's functions, each typed at its first use."""

    def __init__(self) -> None:
        self.library = host.load_egl()

    def __getattr__(self, name: str) -> Any:
        result, arguments = _SIGNATURES[name]
        try:
            function = getattr(self.library, name)  # core functions are exported; the rest come by address
            function.restype, function.argtypes = result, arguments
        except AttributeError:
            address = self.eglGetProcAddress(name.encode())
            if not address:
                raise DeviceError(f"libEGL has no {name}; it is too old: {host.MESA_FIX}") from None
            function = ctypes.CFUNCTYPE(result, *arguments)(address)
        setattr(self, name, function)
        return function

    def string(self, display: int | None, name: int) -> str:
        return (self.eglQueryString(display, name) or b"").decode("utf-8", "replace")

    def error(self) -> str:
        code = self.eglGetError()
        return "no EGL error code" if code == _SUCCESS else _ERRORS.get(code, hex(code))


@cache
def _egl() -> _Egl:
    return _Egl()


def client_extensions() -> frozenset[str]:
    """EGL's own extensions, those of no display."""
    return frozenset(_egl().string(None, _EXTENSIONS).split())


def devices() -> list[EglDevice]:
    """Every EGL device, hardware and software, in EGL's order. Empty where libEGL cannot enumerate."""
    egl = _egl()
    extensions = client_extensions()
    if not extensions & {"EGL_EXT_device_base", "EGL_EXT_device_enumeration"}:
        return []
    count = c_int(0)
    if not egl.eglQueryDevicesEXT(0, None, byref(count)) or count.value <= 0:
        return []
    handles = (c_void_p * count.value)()
    if not egl.eglQueryDevicesEXT(count.value, handles, byref(count)):
        return []
    return [_describe(egl, i, handles[i] or 0) for i in range(count.value)]


def _describe(egl: _Egl, index: int, handle: int) -> EglDevice:
    def text(name: int) -> str:
        return (egl.eglQueryDeviceStringEXT(handle, name) or b"").decode("utf-8", "replace")

    device = EglDevice(index, handle)
    if not client_extensions() & {"EGL_EXT_device_base", "EGL_EXT_device_query"}:
        return device
    extensions = frozenset(text(_EXTENSIONS).split())
    device = replace(device, extensions=extensions, software="EGL_MESA_device_software" in extensions)
    if "EGL_EXT_device_query_name" in extensions:
        device = replace(device, vendor=text(_VENDOR), renderer=text(_RENDERER))
    if "EGL_EXT_device_drm" in extensions:
        device = replace(device, drm_node=text(_DRM_DEVICE_FILE))
    if "EGL_EXT_device_drm_render_node" in extensions:
        device = replace(device, render_node=text(_DRM_RENDER_NODE_FILE))
    ordinal = c_ssize_t(-1)
    if "EGL_NV_device_cuda" in extensions and egl.eglQueryDeviceAttribEXT(handle, _CUDA_DEVICE, byref(ordinal)):
        device = replace(device, cuda=ordinal.value)
    return device


def unbind() -> None:
    """Leaves no EGL context current in this thread; does nothing if EGL was never used."""
    if _egl.cache_info().currsize and (display := _egl().eglGetCurrentDisplay()):
        _egl().eglMakeCurrent(display, None, None, None)


def has_surfaceless() -> bool:
    """Whether Mesa's platform without a display server is there."""
    return "EGL_MESA_platform_surfaceless" in client_extensions()


@cache
def _display(index: int, handle: int) -> int:
    """The initialised display of a device; opened once per process. Raises DeviceError with EGL's own code."""
    egl = _egl()
    platform, native = (_PLATFORM_SURFACELESS, None) if index < 0 else (_PLATFORM_DEVICE, handle)
    display = egl.eglGetPlatformDisplayEXT(platform, native, None)
    if not display:
        raise DeviceError(f"eglGetPlatformDisplayEXT: {egl.error()}")
    if not egl.eglInitialize(display, None, None):
        raise DeviceError(f"eglInitialize: {egl.error()}")
    return int(display)


class EglContext:
    """An OpenGL core context without a surface, current from the start; moderngl's context-object protocol.

    Raises DeviceError naming the EGL call that failed and its code; the caller adds the device and the remedy.
    """

    def __init__(self, device: EglDevice, version: tuple[int, int] = (4, 3)) -> None:
        egl = _egl()
        self.device = device
        self._display = display = _display(device.index, device.handle)
        self._previous: list[tuple[int | None, ...]] = []
        self._surface: int | None = None
        self._context: int | None = None
        extensions = frozenset(egl.string(display, _EXTENSIONS).split())
        self.egl_version, self.egl_vendor = egl.string(display, _VERSION), egl.string(display, _VENDOR)
        if not egl.eglBindAPI(_OPENGL_API):
            raise DeviceError(f"eglBindAPI: {egl.error()}: this driver has OpenGL ES only")
        surfaceless = "EGL_KHR_surfaceless_context" in extensions
        config = None
        if not (surfaceless and "EGL_KHR_no_config_context" in extensions):
            config = self._choose_config(egl, 0 if surfaceless else _PBUFFER_BIT)
        major, minor = version
        wanted = [_CONTEXT_MAJOR, major, _CONTEXT_MINOR, minor, _CONTEXT_PROFILE, _CONTEXT_CORE]
        if os.environ.get("GLHYBRID_DEBUG", "0") >= "3":
            wanted += [_CONTEXT_DEBUG, 1]
        self._context = egl.eglCreateContext(display, config, None, (c_int * (len(wanted) + 1))(*wanted, _NONE))
        if not self._context:
            raise DeviceError(f"eglCreateContext: {egl.error()}: no OpenGL {major}.{minor} core profile")
        if not surfaceless:
            size = (c_int * 5)(_WIDTH, 1, _HEIGHT, 1, _NONE)
            self._surface = egl.eglCreatePbufferSurface(display, config, size)
        try:
            self.make_current()
        except DeviceError:
            self.release()
            raise

    def _choose_config(self, egl: _Egl, surface_bits: int) -> int | None:
        wanted = (c_int * 5)(_RENDERABLE_TYPE, _OPENGL_BIT, _SURFACE_TYPE, surface_bits, _NONE)
        config, count = c_void_p(None), c_int(0)
        if not egl.eglChooseConfig(self._display, wanted, byref(config), 1, byref(count)) or count.value < 1:
            raise DeviceError(f"eglChooseConfig: {egl.error()}: no configuration for OpenGL")
        return config.value

    def make_current(self) -> None:
        """Raises DeviceError where another thread has it."""
        egl = _egl()
        if not egl.eglMakeCurrent(self._display, self._surface, self._surface, self._context):
            raise DeviceError(
                f"eglMakeCurrent: {egl.error()}: a Renderer belongs to the thread that opened it: open one in each"
            )

    def is_current(self) -> bool:
        """Whether it is this thread's context."""
        return bool(self._context) and _egl().eglGetCurrentContext() == self._context

    def load_opengl_function(self, name: str) -> int:
        """Its address; 0 if the driver has none."""
        return _egl().eglGetProcAddress(name.encode()) or 0

    load = load_opengl_function  # moderngl's newer name for the same

    def __enter__(self) -> "EglContext":
        egl = _egl()
        self._previous.append(
            (
                egl.eglGetCurrentDisplay(),
                egl.eglGetCurrentSurface(_DRAW),
                egl.eglGetCurrentSurface(_READ),
                egl.eglGetCurrentContext(),
            )
        )
        self.make_current()
        return self

    def __exit__(self, *_: object) -> None:
        display, draw, read, context = self._previous.pop()
        _egl().eglMakeCurrent(display or self._display, draw, read, context)

    def release(self) -> None:
        """Frees the context and all that was made in it; the display stays open for others. Twice is harmless."""
        egl = _egl()
        if self._context and egl.eglGetCurrentContext() == self._context:
            egl.eglMakeCurrent(self._display, None, None, None)
        if self._surface:
            egl.eglDestroySurface(self._display, self._surface)
        if self._context:
            egl.eglDestroyContext(self._display, self._context)
        self._surface = self._context = None


def preference(all_devices: list[EglDevice]) -> Iterator[EglDevice]:
    """Devices in the order `auto` and `gpu` try them: CUDA order, then DRM nodes, then unnamed ones; software last."""

    def rank(device: EglDevice) -> tuple[int, int, int]:
        if device.software:
            return 3, 0, device.index
        if device.cuda is not None:
            return 0, device.cuda, device.index
        return (1 if device.drm_node else 2), 0, device.index

    yield from sorted(all_devices, key=rank)
