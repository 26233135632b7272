"""What this machine offers OpenGL, found without OpenGL: libraries, driver files, devices, containers.

Everything here works on a machine with no libEGL at all; `problems()` is what error messages and `doctor` build on.
"""

import ctypes
import ctypes.util
import json
import os
import sys
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from glhybrid.errors import DeviceError

MESA_FIX = "apt-get install -y libegl1 libegl-mesa0 libgl1-mesa-dri"
OSMESA_FIX = "apt-get install -y libosmesa6"
NVIDIA_FIX = "docker run --gpus all -e NVIDIA_DRIVER_CAPABILITIES=all ..."
_VENDOR_DIRS = ("/etc/glvnd/egl_vendor.d", "/usr/share/glvnd/egl_vendor.d")
# Where container runtimes mount NVIDIA's driver instead (GKE, some Kubernetes device plugins).
_MOUNTED_VENDOR_DIRS = ("/usr/local/nvidia/share/glvnd/egl_vendor.d", "/usr/local/glvnd/share/glvnd/egl_vendor.d")

_UNREADABLE = " (unreadable)"


@dataclass(frozen=True)
class Problem:
    """Something that keeps OpenGL, or a better OpenGL, from being used: what is wrong, and the line that mends it."""

    what: str
    fix: str
    about: Literal["all", "gpu", "software"] = "all"  # which kind of device it keeps away

    def __str__(self) -> str:
        return f"{self.what}: {self.fix}"


@dataclass(frozen=True)
class Host:
    """Facts that need no OpenGL. Paths are strings, lists sorted."""

    libegl: bool
    libosmesa: bool
    egl_vendors: tuple[str, ...]  # libraries that libglvnd's vendor files name
    broken_vendors: tuple[str, ...]  # those of them that cannot be opened
    container: str  # "" if none is noticed
    nvidia_driver: str  # the kernel module's version, "" without one
    nvidia_gl: bool  # NVIDIA's EGL library can be loaded
    nvidia_capabilities: str  # NVIDIA_DRIVER_CAPABILITIES
    dri_nodes: tuple[str, ...]
    dri_denied: tuple[str, ...]  # nodes this user may not open
    environment: dict[str, str]  # variables that redirect OpenGL

    def to_dict(self) -> dict[str, object]:
        """Ready for JSON: what `doctor --json` says of the machine."""
        return asdict(self)


def load_egl() -> ctypes.CDLL:
    """libEGL, with NVIDIA's vendor file made known where a container mounts it in an unusual place."""
    _add_mounted_vendors()
    for name in ("libEGL.so.1", "libEGL.so", ctypes.util.find_library("EGL") if sys.platform != "linux" else None):
        if name and (library := _open(name)) is not None:
            return library
    raise DeviceError(f"libEGL.so.1 is missing, so OpenGL cannot be reached without a display: {MESA_FIX}")


def _add_mounted_vendors() -> None:
    """libglvnd reads two folders only; a driver mounted elsewhere is invisible until the third is named."""
    if {"__EGL_VENDOR_LIBRARY_DIRS", "__EGL_VENDOR_LIBRARY_FILENAMES"} & os.environ.keys():
        return  # the user has decided
    mounted = [folder for folder in _MOUNTED_VENDOR_DIRS if Path(folder).is_dir()]
    known = any("nvidia" in file.name for folder in _VENDOR_DIRS for file in Path(folder).glob("*.json"))
    if mounted and not known:
        os.environ["__EGL_VENDOR_LIBRARY_DIRS"] = ":".join((*mounted, *_VENDOR_DIRS))


def _open(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None


def _vendors() -> tuple[str, ...]:
    if names := os.environ.get("__EGL_VENDOR_LIBRARY_FILENAMES"):
        files = [Path(n) for n in names.split(":") if n]
    else:
        folders = os.environ.get("__EGL_VENDOR_LIBRARY_DIRS", ":".join(_VENDOR_DIRS)).split(":")
        files = [f for folder in folders if folder for f in sorted(Path(folder).glob("*.json"))]
    found = []
    for file in files:
        try:
            found.append(str(json.loads(file.read_text())["ICD"]["library_path"]))
        except (OSError, ValueError, KeyError, TypeError):
            found.append(f"{file}{_UNREADABLE}")
    return tuple(found)


def _container() -> str:
    if Path("/.dockerenv").exists():
        return "docker"
    if Path("/run/.containerenv").exists():
        return "podman"
    if "KUBERNETES_SERVICE_HOST" in os.environ:
        return "kubernetes"
    return os.environ.get("container", "")  # noqa: SIM112, systemd's spelling


def _nvidia_driver() -> str:
    try:
        words = Path("/proc/driver/nvidia/version").read_text().split()
    except OSError:
        return ""
    return next((w for w in words if w.count(".") >= 1 and w.replace(".", "").isdigit()), "unknown")


_VARIABLES = (
    "LIBGL_ALWAYS_SOFTWARE", "GALLIUM_DRIVER", "MESA_LOADER_DRIVER_OVERRIDE", "MESA_GL_VERSION_OVERRIDE",
    "LP_NUM_THREADS", "__EGL_VENDOR_LIBRARY_FILENAMES", "__EGL_VENDOR_LIBRARY_DIRS", "EGL_PLATFORM", "LD_LIBRARY_PATH",
    "CUDA_VISIBLE_DEVICES",
    "NVIDIA_VISIBLE_DEVICES", "NVIDIA_DRIVER_CAPABILITIES", "GLHYBRID_DEVICE",
)  # fmt: skip


def has_egl() -> bool:
    """Whether libEGL can be loaded."""
    try:
        load_egl()
    except DeviceError:
        return False
    return True


def look() -> Host:
    """Looks at the machine: opens libraries and reads files, starts nothing."""
    libegl, vendors = has_egl(), _vendors()
    nodes = sorted(str(p) for p in Path("/dev/dri").glob("*[0-9]")) if Path("/dev/dri").is_dir() else []
    return Host(
        libegl=libegl,
        libosmesa=find_osmesa() is not None,
        egl_vendors=vendors,
        broken_vendors=tuple(v for v in vendors if _open(v) is None),
        container=_container(),
        nvidia_driver=_nvidia_driver(),
        nvidia_gl=_open("libEGL_nvidia.so.0") is not None,
        nvidia_capabilities=os.environ.get("NVIDIA_DRIVER_CAPABILITIES", ""),
        dri_nodes=tuple(nodes),
        dri_denied=tuple(n for n in nodes if "render" in n and not os.access(n, os.R_OK | os.W_OK)),
        environment={name: os.environ[name] for name in _VARIABLES if name in os.environ},
    )


@cache
def find_osmesa() -> str | None:
    """The name libOSMesa can be opened by, or None."""
    for name in ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"):
        if _open(name) is not None:
            return name
    return None


def problems(host: Host | None = None) -> list[Problem]:
    """What keeps OpenGL or a kind of device from being reached here, the most likely cause first."""
    host = host or look()
    found: list[Problem] = []
    if not host.libegl:
        found.append(Problem("libEGL.so.1 is missing", MESA_FIX))
    elif not host.egl_vendors:
        found.append(Problem("libEGL has no driver (no vendor file in " + ", ".join(_VENDOR_DIRS) + ")", MESA_FIX))
    found += [_broken(library, host) for library in host.broken_vendors]
    if host.nvidia_driver and not host.nvidia_gl:
        where = f"this {host.container} container lacks" if host.container else "this machine lacks"
        fix = NVIDIA_FIX if host.container else f"apt-get install -y libnvidia-gl-{host.nvidia_driver.split('.')[0]}"
        caps = f" (NVIDIA_DRIVER_CAPABILITIES={host.nvidia_capabilities})" if host.nvidia_capabilities else ""
        what = f"NVIDIA driver {host.nvidia_driver}, but {where} its OpenGL libraries{caps}"
        found.append(Problem(what, fix, "gpu"))
    elif host.nvidia_gl and host.libegl and not any("nvidia" in v for v in host.egl_vendors):
        line = """echo '{"file_format_version":"1.0.0","ICD":{"library_path":"libEGL_nvidia.so.0"}}' """
        line += "> /usr/share/glvnd/egl_vendor.d/10_nvidia.json"
        found.append(Problem("libEGL_nvidia.so.0 is here, but libEGL is not told of it", line, "gpu"))
    if host.dri_denied:
        fix = f"usermod -aG render,video {os.environ.get('USER', '$USER')}, then log in again"
        found.append(Problem(f"no right to open {', '.join(host.dri_denied)}", fix, "gpu"))
    if host.libegl and host.egl_vendors and not any("mesa" in v for v in host.egl_vendors):
        found.append(Problem("Mesa, the software renderer, is not installed", MESA_FIX, "software"))
    forced = host.environment.get("LIBGL_ALWAYS_SOFTWARE", "0") not in ("0", "", "false")
    if forced and (host.dri_nodes or host.nvidia_gl):
        found.append(Problem("LIBGL_ALWAYS_SOFTWARE forces software rendering", "unset LIBGL_ALWAYS_SOFTWARE", "gpu"))
    return found


def _broken(library: str, host: Host) -> Problem:
    if not library.endswith(_UNREADABLE):
        fix = MESA_FIX if "mesa" in library else f"ldconfig, or add the folder of {library} to LD_LIBRARY_PATH"
        return Problem(f"the EGL driver {library} is named in a vendor file, but cannot be opened", fix)
    variable = next((v for v in host.environment if v.startswith("__EGL_VENDOR_LIBRARY")), "")
    fix = f"unset {variable}" if variable else MESA_FIX
    return Problem(f"the EGL vendor file {library.removesuffix(_UNREADABLE)} cannot be read", fix)
