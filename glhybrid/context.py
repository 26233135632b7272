"""An OpenGL 4.3 context with no display: which device, what it can do, and one clear error when there is none.

    with open_context("auto") as context:
        context.gl          # moderngl.Context
        context.raw         # glhybrid.gl.GL: what moderngl lacks
        context.device      # which backend and driver, software or not; context.limits: what it can do

A driver is believed only after a compute dispatch gave the right numbers: some advertise 4.3 and do not run it.
"""

import logging
import os
import threading
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, Self

import moderngl

from glhybrid import host
from glhybrid.bindings import Bindings
from glhybrid.egl import SURFACELESS, EglContext, EglDevice, devices, has_surfaceless, preference
from glhybrid.errors import DeviceError, SettingError, unknown
from glhybrid.gl import GL, GL_RENDERER, GL_VENDOR, GL_VERSION
from glhybrid.osmesa import OsmesaContext
from glhybrid.program_cache import ProgramCache

log = logging.getLogger("glhybrid")
_thread = threading.local()  # .context: the Context that was made current in it last
_drivers: list[int] = []  # the process that first loaded them; a fork inherits it, but not their threads

REQUIRED_VERSION = (4, 3)
_BETTER_VERSIONS = ((4, 6), (4, 5))  # Mesa gives its best whatever was asked for, NVIDIA gives just that
TEXTURES = 16  # units for them: what a compute shader has at least; buffer textures come behind
MOST_BLOCKS = 64  # more than there are names
DEVICE_NAMES = ("auto", "gpu", "software", "egl:N", "cuda:N", "osmesa")
_SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swr (", "software rasterizer", "swiftshader", "basic render")
_ELSEWHERE = "use --device auto, or see `glhybrid doctor`"


class Native(Protocol):
    """A context moderngl can run on: EglContext, OsmesaContext, or a window's."""

    def load_opengl_function(self, name: str) -> int:
        """The address of an OpenGL function; 0 if the driver has none."""

    def make_current(self) -> None:
        """Makes it this thread's context. Raises DeviceError where another thread has it."""

    def is_current(self) -> bool:
        """Whether it is this thread's context, as far as the driver's library knows."""

    def __enter__(self) -> object: ...
    def __exit__(self, *_: object) -> None: ...
    def release(self) -> None:
        """Ends the context and all that lives in it."""


@dataclass(frozen=True)
class Device:
    """What a context runs on; the receipt's `device`. version: the driver's words. egl_index, cuda: None if absent."""

    backend: Literal["egl", "osmesa", "window"]
    vendor: str
    renderer: str
    version: str
    software: bool
    egl_index: int | None = None
    cuda: int | None = None
    drm_node: str = ""

    def to_dict(self) -> dict[str, object]:
        """Ready for JSON: the receipt's `device`."""
        return asdict(self)

    def __str__(self) -> str:
        kind = "software" if self.software else "GPU"
        where = self.backend if self.egl_index is None else f"egl:{self.egl_index}"
        where += f", cuda:{self.cuda}" if self.cuda is not None else ""
        return f"{self.renderer} ({kind}, {where}), OpenGL {self.version}"


@dataclass(frozen=True)
class Limits:
    """What the driver allows. Bytes where the name says so; texels, units and counts elsewhere."""

    storage_block_bytes: int
    storage_blocks: int  # in one compute shader
    storage_bindings: int  # of all programs together
    storage_alignment_bytes: int
    texture_buffer_texels: int
    texture_buffer_alignment_bytes: int
    uniform_block_bytes: int
    texture_size: int
    texture_layers: int
    texture_units: int  # in one compute shader
    image_units: int
    compute_images: int  # in one compute shader
    color_attachments: int
    work_group_count: tuple[int, int, int]
    work_group_size: tuple[int, int, int]
    work_group_invocations: int
    shared_bytes: int
    clip_control: bool  # depth 0 to 1: OpenGL 4.5 or ARB_clip_control
    memory_bytes: int  # of the GPU; 0 if the driver does not say

    def to_dict(self) -> dict[str, object]:
        """Ready for JSON, as `doctor --json` prints it."""
        return asdict(self)


# field of Limits: (GL enum, least value we can work with: the minimum that OpenGL 4.3 core, table 23, guarantees).
_LIMITS = {
    "storage_block_bytes": (0x90DE, 1 << 24),
    "storage_blocks": (0x90DB, 8),
    "storage_bindings": (0x90DD, 8),
    "storage_alignment_bytes": (0x90DF, 1),
    "texture_buffer_texels": (0x8C2B, 1 << 16),
    "texture_buffer_alignment_bytes": (0x919F, 1),
    "uniform_block_bytes": (0x8A30, 1 << 14),
    "texture_size": (0x0D33, 1 << 14),
    "texture_layers": (0x88FF, 2048),
    "texture_units": (0x91BC, 16),
    "image_units": (0x8F38, 8),
    "compute_images": (0x91BD, 8),
    "color_attachments": (0x8CDF, 8),
    "work_group_invocations": (0x90EB, 1024),
    "shared_bytes": (0x8262, 1 << 15),
}
_WORK_GROUP_COUNT, _WORK_GROUP_SIZE, _NVX_DEDICATED_KIB = 0x91BE, 0x91BF, 0x9047


class Context:
    """A current OpenGL context and everything known about it. `close()` frees it and all that was made in it."""

    def __init__(
        self,
        native: Native,
        backend: Literal["egl", "osmesa", "window"],
        egl: EglDevice | None = None,
        keep_programs: bool = False,
    ) -> None:
        """keep_programs: on disk, for the next context and for those beside it."""
        self.native = native
        self.closed, self._process = False, os.getpid()
        _thread.context = self  # current from the start
        try:
            self.raw = GL(native.load_opengl_function)
            self.device = _device(self.raw, backend, egl)
            driver = " ".join((self.device.vendor, self.device.renderer, self.device.version))
            self.programs = ProgramCache(native, self.raw, driver) if keep_programs else None
            settings: Any = {"context": self.programs or native}  # moderngl's stub takes settings for a dict
            self.gl: moderngl.Context = moderngl.create_context(require=430, standalone=True, **settings)
            self.limits = _limits(self.raw)
            _require(self.limits, self.device)
            blocks = min(self.limits.storage_bindings, MOST_BLOCKS)
            self.bindings = Bindings(blocks, TEXTURES, self.limits.image_units)
            _canary(self.gl, self.device)
        except Exception as error:
            _thread.context = None
            native.release()
            if isinstance(error, DeviceError):
                raise
            raise DeviceError(f"moderngl cannot use this context: {error}") from error

    def write(self, buffer: moderngl.Buffer, data: Any, offset: int = 0) -> None:
        """Bytes into a buffer that shaders read as a storage block or a texture, in their turn among dispatches.

        glBufferSubData alone is not enough on NVIDIA (580, H100): once another buffer has taken the binding point, it
        writes at once, and dispatches on their way read what was meant for later ones. A buffer that is bound anywhere
        waits its turn.
        """
        if not self.device.software:
            bound = self.bindings.blocks.bound
            if bound[-1] is not buffer:  # several writes in a row
                buffer.mglo.bind_to_storage_buffer(len(bound) - 1, 0, -1)
                bound[-1] = buffer
        buffer.write(data, offset)

    def make_current(self) -> None:
        """Makes this the calling thread's context, unless it is already.

        Names of objects mean others in each context, ours or of other libraries in this process: whoever is called from
        outside calls this before anything else.
        Raises DeviceError where another thread has it, or another process made it.
        """
        if _thread.__dict__.get("context") is self and self.native.is_current():
            return
        if self._process != os.getpid():
            raise DeviceError(
                f"this context was opened by process {self._process}, and this one was forked from it: open a Renderer "
                'in each process, of multiprocessing.get_context("spawn")'
            )
        if self.closed:
            raise DeviceError("this context is closed")
        self.native.make_current()
        _thread.context = self

    def close(self) -> None:
        """Frees the context. Twice is harmless; using any object made in it afterwards is not."""
        if not self.closed:
            self.closed = True
            if _thread.__dict__.get("context") is self:
                _thread.context = None
            if self._process == os.getpid():
                self.native.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


os.register_at_fork(after_in_child=lambda: _thread.__dict__.clear())


def open_context(device: str = "auto", keep_programs: bool = False) -> Context:
    """Opens a context and logs one line that says which. keep_programs: as Context takes it.

    device: `auto` (a GPU if there is one, else software), `gpu` (a GPU or an error), `software` (Mesa's llvmpipe),
    `egl:N` (EGL's N-th device), `cuda:N` (the GPU that CUDA calls N), `osmesa`. `auto` reads GLHYBRID_DEVICE first.
    Raises DeviceError with what was tried, why it failed and the line that mends it; SettingError for other names.
    """
    if not isinstance(device, str):
        raise SettingError(f"device = {device!r}: must be a name: {', '.join(DEVICE_NAMES)}")
    if not _drivers:
        _drivers.append(os.getpid())
    if _drivers[0] != os.getpid():
        raise DeviceError(
            f"this process was forked from process {_drivers[0]}, which had used OpenGL: threads of the driver are "
            'missing here, and it would wait for them for ever; start processes by multiprocessing.get_context("spawn")'
        )
    if device == "auto":
        device = os.environ.get("GLHYBRID_DEVICE") or "auto"
    kind, _, number = device.partition(":")
    if kind in ("egl", "cuda") and number.isdecimal():
        candidates = [_numbered(kind, int(number))]
        context = _first(candidates, f"{device} cannot be used", lambda _: "", keep_programs=keep_programs)
    elif device == "osmesa":
        context = Context(OsmesaContext(REQUIRED_VERSION), "osmesa")
    elif device == "gpu":
        context = _first(
            _hardware(), "no GPU can be used for OpenGL", _must_be_hardware, keep_programs=keep_programs
        )  # fmt: skip
    elif device == "software":
        context = _software(keep_programs)
    elif device == "auto":
        context = _auto(keep_programs)
    else:
        raise SettingError(unknown("device", device, DEVICE_NAMES))
    log.info("device: %s", context.device)
    return context


def open_egl(device: EglDevice, keep_programs: bool = False) -> Context:
    """A context on one EGL device. Raises DeviceError, without a remedy."""
    for version in (*_BETTER_VERSIONS, REQUIRED_VERSION):
        try:
            native = EglContext(device, version)
        except DeviceError as error:
            if version == REQUIRED_VERSION:
                raise DeviceError(_too_old(device) or str(error)) from None
            continue
        break
    return Context(native, "egl", device, keep_programs)


def _auto(keep_programs: bool) -> Context:
    hardware = _hardware()
    if hardware:
        try:
            return _first(hardware, "no GPU can be used", _must_be_hardware, keep_programs=keep_programs)
        except DeviceError as error:
            log.warning("falling back to software rendering: %s", error)
    context = _software(keep_programs)
    for problem in host.problems():
        if problem.about == "gpu":
            log.warning("the GPU is not used: %s", problem)
    return context


def _software(keep_programs: bool) -> Context:
    candidates = [d for d in _listed() if d.software]
    if not candidates and host.has_egl() and has_surfaceless():
        candidates = [SURFACELESS]  # a Mesa that does not list its software device
    try:
        return _first(candidates, "no software renderer can be used", _must_be_software, "software", keep_programs)
    except DeviceError as error:
        try:
            return Context(OsmesaContext(REQUIRED_VERSION), "osmesa")
        except DeviceError:
            raise error from None  # EGL's Mesa is the one to mend


def _hardware() -> list[EglDevice]:
    found = [d for d in preference(_listed()) if not d.software]
    if Path("/dev/dxg").exists() and host.has_egl() and has_surfaceless():
        found.append(SURFACELESS)  # WSL: Mesa's d3d12 driver has no DRM node to be listed by
    return found


def _listed() -> list[EglDevice]:
    return devices() if host.has_egl() else []


def _numbered(kind: str, number: int) -> EglDevice:
    found = _listed()
    match = [d for d in found if (d.index if kind == "egl" else d.cuda) == number]
    if match:
        return match[0]
    what = "EGL device" if kind == "egl" else "EGL device with CUDA ordinal"
    if found:
        raise DeviceError(f"no {what} {number}; this machine has: {', '.join(str(d) for d in found)}; use one of these")
    raise DeviceError(f"no {what} {number}; this machine has none{_remedy('gpu')}")


def _first(
    candidates: Iterable[EglDevice],
    failure: str,
    objection: Callable[[Device], str],
    kind: Literal["gpu", "software"] = "gpu",
    keep_programs: bool = False,
) -> Context:
    """The first candidate that opens and to which there is no objection; otherwise one error with every reason."""
    reasons: list[str] = []
    for candidate in candidates:
        try:
            context = open_egl(candidate, keep_programs)
        except DeviceError as error:
            reasons.append(f"{candidate}: {error}")
            continue
        reason = objection(context.device)
        if not reason:
            return context
        context.close()
        reasons.append(f"{candidate}: {reason}")
    if not reasons:
        reasons.append("EGL lists none")
    raise DeviceError(f"{failure}: {'; '.join(reasons)}{_remedy(kind)}")


def _must_be_hardware(device: Device) -> str:
    return f"it is a software renderer, {device.renderer}" if device.software else ""


def _must_be_software(device: Device) -> str:
    return "" if device.software else f"it is a GPU, {device.renderer}"


def _remedy(kind: Literal["gpu", "software"]) -> str:
    """What mends it: the first problem of this machine that keeps such a device away, else what to try instead."""
    for problem in host.problems():
        if problem.about in ("all", kind):
            return f". {problem.what}; to mend: {problem.fix}"
    return f"; {_ELSEWHERE}" if kind == "gpu" else f"; to mend: {host.MESA_FIX}"


def _too_old(device: EglDevice) -> str:
    """What to say of a device that gives a context, but not one of the version we need; empty if it gives none."""
    try:
        native = EglContext(device, (3, 1))
    except DeviceError:
        return ""
    raw = GL(native.load_opengl_function)
    name, version = raw.get_string(GL_RENDERER), raw.get_string(GL_VERSION)
    native.release()
    return f"{name} has OpenGL {version}, below 4.3: its driver must be newer"


def is_software(renderer: str) -> bool:
    """Whether GL_RENDERER names a renderer that runs on the CPU."""
    return any(name in renderer.lower() for name in _SOFTWARE_RENDERERS)


def _device(raw: GL, backend: Literal["egl", "osmesa", "window"], egl: EglDevice | None) -> Device:
    renderer = raw.get_string(GL_RENDERER)
    return Device(
        backend=backend,
        vendor=raw.get_string(GL_VENDOR),
        renderer=renderer,
        version=raw.get_string(GL_VERSION),
        software=is_software(renderer),
        egl_index=egl.index if egl and egl.index >= 0 else None,
        cuda=egl.cuda if egl else None,
        drm_node=egl.drm_node if egl else "",
    )


def _limits(raw: GL) -> Limits:
    extensions = raw.extensions()
    values: dict[str, Any] = {name: raw.get_integer(enum) for name, (enum, _) in _LIMITS.items()}
    for name, enum in (("work_group_count", _WORK_GROUP_COUNT), ("work_group_size", _WORK_GROUP_SIZE)):
        values[name] = tuple(raw.get_integer_indexed(enum, axis) for axis in range(3))
    values["clip_control"] = "GL_ARB_clip_control" in extensions
    memory = "GL_NVX_gpu_memory_info" in extensions
    values["memory_bytes"] = raw.get_integer(_NVX_DEDICATED_KIB) * 1024 if memory else 0
    raw.errors()  # an unknown enum leaves 0, which _require reports
    return Limits(**values)


def _require(limits: Limits, device: Device) -> None:
    short = [
        f"{name} {value} < {least}" for name, (_, least) in _LIMITS.items() if (value := getattr(limits, name)) < least
    ]
    if short:
        raise DeviceError(f"{device.renderer} falls short of OpenGL 4.3's own minimum: {', '.join(short)}")


_CANARY = """#version 430
layout(local_size_x = 64) in;
layout(std430, binding = 0) buffer Result { uint result[]; };
shared uint neighbour[64];
void main() {
    uint i = gl_GlobalInvocationID.x, l = gl_LocalInvocationID.x;
    neighbour[l] = i * i;
    barrier();
    result[i] = neighbour[63u - l] + 7u;
}
"""


def _canary(gl: moderngl.Context, device: Device) -> None:
    """Runs a compute shader over shared memory and a storage block and compares every number."""
    try:
        shader = gl.compute_shader(_CANARY)
        buffer = gl.buffer(bytes(4 * 256))
        buffer.bind_to_storage_buffer(0)
        shader.run(4)
        got = memoryview(buffer.read()).cast("I").tolist()
        shader.release()
        buffer.release()
    except Exception as error:
        raise DeviceError(f"{device.renderer} cannot run a compute shader: {error}") from error
    want = [(64 * (i // 64) + 63 - i % 64) ** 2 + 7 for i in range(256)]
    if got != want:
        wrong = sum(a != b for a, b in zip(got, want, strict=True))
        raise DeviceError(
            f"{device.renderer} {device.version} runs compute shaders wrongly: {wrong} of 256 numbers differ"
        )
