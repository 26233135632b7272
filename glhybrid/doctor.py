"""`glhybrid doctor`: what this machine offers, what is missing, and for each failure the line that mends it.

Every device is opened in its own process, so a driver that crashes or hangs is a row in the report and not its end.
Nothing here needs OpenGL, or even libEGL, to be present.
"""

import importlib.metadata
import json
import os
import platform
import signal
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from typing import Any

from glhybrid import __version__, host
from glhybrid.errors import GlhybridError
from glhybrid.host import Host, Problem

PROBE_TIMEOUT_S = 60
_LIBRARIES = ("moderngl", "glcontext", "numpy", "numba", "trimesh", "xatlas", "pillow", "OpenEXR", "cyclopts", "rich")
_EXTRAS = {
    "av": "movies: .mp4",
    "imgui-bundle": "the viewer",
    "glfw": "the viewer in a window",
    "aiohttp": "the viewer in a browser: view --web",
    "embreex": "ray tests against Embree",
    "mitsuba": "image tests against Mitsuba 3",
    "flip-evaluator": "tests of FLIP against its authors'",
    "pytest": "running the tests",
    "ruff": "lint",
    "mypy": "type checks",
}


@dataclass(frozen=True)
class Probe:
    """One device, tried: its description and limits if it works, else the error and what to do."""

    name: str  # as --device takes it
    ok: bool
    device: dict[str, Any]
    limits: dict[str, Any]
    tuning: dict[str, Any] = field(default_factory=dict)  # what glhybrid.tuning has measured
    error: str = ""
    fix: str = ""


@dataclass(frozen=True)
class Library:
    """Something optional that is there or not."""

    name: str
    version: str  # "" = missing
    use: str = ""
    fix: str = ""


@dataclass(frozen=True)
class Report:
    """All that was found. usable: whether a picture can be drawn."""

    glhybrid: str
    python: str
    platform: str
    cpus: int
    host: Host
    devices: tuple[Probe, ...]
    libraries: tuple[Library, ...]
    extras: tuple[Library, ...]
    problems: tuple[Problem, ...]
    auto: str  # the device that --device auto takes, "" if there is none

    @property
    def usable(self) -> bool:
        """Whether `--device auto` finds a device to draw with."""
        return bool(self.auto)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON, as `doctor --json` prints it."""
        return asdict(self) | {"usable": self.usable}


def examine() -> Report:
    """Looks at everything. Takes about a second per device."""
    facts = host.look()
    probes = _probes(facts)
    libraries = tuple(_library(name, "", f"pip install {name}") for name in _LIBRARIES)
    extras = tuple(_library(name, use, f"pip install {name}") for name, use in _EXTRAS.items())
    problems = host.problems(facts)
    problems += [Problem(f"{p.name} does not work: {p.error}", p.fix) for p in probes if not p.ok]
    problems += [Problem(f"the Python package {x.name} is missing", x.fix) for x in libraries if not x.version]
    working = [p for p in probes if p.ok]
    best = next((p for p in working if not p.device["software"]), working[0] if working else None)
    return Report(
        glhybrid=__version__,
        python=f"{platform.python_implementation()} {platform.python_version()} ({sys.executable})",
        platform=platform.platform(),
        cpus=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        host=facts,
        devices=tuple(probes),
        libraries=libraries,
        extras=extras,
        problems=tuple(problems),
        auto=best.name if best else "",
    )


def _probes(facts: Host) -> list[Probe]:
    """Every device tried, in the order `auto` prefers them."""
    names: list[str] = []
    failed: list[Probe] = []
    if facts.libegl:
        listed = _run("--list")
        if "error" in listed:
            failed = [_failed("egl", listed)]
        names = listed.get("devices") or (["software"] if listed.get("surfaceless") else [])
    names += ["osmesa"] if facts.libosmesa else []
    return failed + [_probe(name) for name in names]


def _probe(name: str) -> Probe:
    found = _run(name)
    return (
        _failed(name, found)
        if "error" in found
        else Probe(name, True, found["device"], found["limits"], found.get("tuning", {}))
    )


def _failed(name: str, found: dict[str, Any]) -> Probe:
    known = host.problems()
    fix = found.get("fix") or (known[0].fix if known else "update this device's driver, or use another --device")
    return Probe(name, False, {}, {}, error=str(found["error"]), fix=str(fix))


def _run(argument: str) -> dict[str, Any]:
    """Runs this module in a process of its own and reads its JSON; a crash or a hang becomes an error."""
    command = [sys.executable, "-m", "glhybrid.doctor", argument]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return {"error": f"the driver hung for {PROBE_TIMEOUT_S} s", "fix": "update the driver or restart the machine"}
    except OSError as error:
        return {"error": f"cannot start a process: {error}"}
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        return {"error": f"the driver crashed ({name})", "fix": "update the driver, or use another --device"}
    try:
        result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return result
    except (ValueError, IndexError):
        last = (done.stderr.strip().splitlines() or ["nothing was printed"])[-1]
        return {"error": f"the probe failed: {last}"}


def _answer(argument: str) -> dict[str, Any]:
    """What a probe process prints. Imports OpenGL, so it runs there only."""
    from glhybrid import context, egl, tuning

    try:
        if argument == "--list":
            devices = [d.name for d in egl.preference(egl.devices())]
            return {"devices": devices, "surfaceless": egl.has_surfaceless()}
        opened = context.open_context(argument)
    except GlhybridError as error:
        return {"error": str(error)}
    with opened:
        found = {"device": opened.device.to_dict(), "limits": opened.limits.to_dict()}
        return found | {"tuning": tuning.tuned(opened).to_dict()}


def _library(name: str, use: str, fix: str) -> Library:
    try:
        return Library(name, importlib.metadata.version(name), use)
    except importlib.metadata.PackageNotFoundError:
        return Library(name, "", use, fix)


def show(report: Report) -> None:
    """Prints the report for people."""
    from glhybrid.console import table

    facts = report.host
    rows: list[tuple[str, object]] = [
        ("glhybrid", report.glhybrid),
        ("Python", report.python),
        ("system", f"{report.platform}, {report.cpus} CPUs"),
        ("container", facts.container or "none noticed"),
        ("EGL drivers", facts.egl_vendors or ("none" if facts.libegl else "no libEGL")),
        ("NVIDIA driver", facts.nvidia_driver or "none"),
        ("DRM nodes", facts.dri_nodes or "none"),
    ]
    rows += [(name, value) for name, value in facts.environment.items()]
    table(("", ""), rows)
    print()
    _show_devices(report)
    print()
    table(("library", "version"), [(x.name, x.version or "MISSING") for x in report.libraries])
    print()
    table(("optional", "version", "for"), [(x.name, x.version or f"missing: {x.fix}", x.use) for x in report.extras])
    print()
    for problem in report.problems:
        print(f"problem: {problem.what}\n    mend: {problem.fix}")
    chosen = next((p for p in report.devices if p.name == report.auto), None)
    if chosen is None:
        print("No usable OpenGL 4.3." + ("" if report.problems else f"\n    mend: {host.MESA_FIX}"))
    else:
        kind = "software" if chosen.device["software"] else "GPU"
        print(f"--device auto takes {chosen.name}: {chosen.device['renderer']} ({kind})")


def _show_devices(report: Report) -> None:
    from glhybrid.console import table

    if not report.devices:
        print("no OpenGL device")
        return
    table(
        ("device", "renderer", "kind", "OpenGL", "CUDA", "DRM"),
        [
            (
                p.name,
                p.device["renderer"] if p.ok else f"FAILS: {p.error}",
                ("software" if p.device["software"] else "GPU") if p.ok else "",
                p.device.get("version"),
                p.device.get("cuda"),
                p.device.get("drm_node"),
            )
            for p in report.devices
        ],
    )
    working = [p for p in report.devices if p.ok]
    if working:
        print()
        names = list(working[0].limits)
        table(("limit", *(p.name for p in working)), [(n, *(p.limits[n] for p in working)) for n in names])
        print()
        names = list(working[0].tuning)
        table(("tuning", *(p.name for p in working)), [(n, *(_brief(p.tuning[n]) for p in working)) for n in names])


def _brief(value: object) -> object:
    """Numbers to three digits, also those in a dictionary."""
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_brief(item)}" for key, item in value.items())
    return f"{value:.3g}" if isinstance(value, float) else value


if __name__ == "__main__":
    print(json.dumps(_answer(sys.argv[1])))
