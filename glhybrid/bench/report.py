"""What a bench found: rows for machines (design: machine, rows, frames, builds) and tables for people."""

import platform
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glhybrid import console
from glhybrid.bench.builds import Build
from glhybrid.bench.frames import FrameTimes
from glhybrid.bench.rays import CLASSES


@dataclass(frozen=True)
class Row:
    """One class of rays of one scene, followed by one variant of the tracer or by a peer.

    mrays_s: live rays; a GPU's by its timer, a software rasteriser's by CPU time on all its cores, a peer's by a CPU
    second. ratios: ours to that peer on one core; a GPU's rate to theirs of one core. Times: medians, ms a launch.
    """

    scene: str
    triangles: int
    rays: str
    variant: str
    live: int
    clock: str
    mrays_s: float
    spread: float
    wall_ms: float
    cpu_ms: float
    gpu_ms: float | None
    ratio_embree_per_core: float | None = None
    ratio_embree_fast_per_core: float | None = None
    ratio_mitsuba_per_core: float | None = None
    steps_per_ray: float | None = None
    own: bool = False  # the variant that the renderer uses
    peer: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: one of the report's `rows`."""
        keys = ("scene", "triangles", "rays", "variant", "mrays_s", "ratio_embree_per_core")
        return {key: getattr(self, key) for key in keys}

    def evidence(self) -> dict[str, Any]:
        """How the rate came about: one entry of machine.measurements."""
        keys = (
            "scene", "triangles", "rays", "variant", "live", "clock", "spread", "wall_ms", "cpu_ms", "gpu_ms",
            "steps_per_ray", "ratio_embree_fast_per_core", "ratio_mitsuba_per_core",
        )  # fmt: skip
        return {key: getattr(self, key) for key in keys}


@dataclass
class Report:
    """failures: a variant or a peer that found something else; notes: what was left out, and why."""

    machine: dict[str, Any]
    rows: list[Row] = field(default_factory=list)
    frames: list[FrameTimes] = field(default_factory=list)
    builds: list[Build] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Adds a remark, once."""
        if text not in self.notes:
            self.notes.append(text)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: what `bench --json` prints. Failures, notes and measurements stand under `machine`."""
        about = {
            "failures": self.failures,
            "notes": self.notes,
            "measurements": [row.evidence() for row in self.rows],
            "frame_measurements": [frame.evidence() for frame in self.frames],
        }
        return {
            "machine": self.machine | about,
            "rows": [row.to_dict() for row in self.rows],
            "frames": [frame.to_dict() for frame in self.frames],
            "builds": [build.to_dict() for build in self.builds],
        }


def machine(device: dict[str, Any], **measured: Any) -> dict[str, Any]:
    """The device, the CPU and the versions that figures belong to."""
    from glhybrid import __version__

    return {
        "device": device,
        "cpu": _cpu_name(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "glhybrid": __version__,
        **measured,
    }


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def sm_clock_mhz(cuda: int | None) -> list[int] | None:
    """An NVIDIA GPU's clock now and its highest, MHz; None without nvidia-smi."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return None
    command = [tool, "--query-gpu=clocks.sm,clocks.max.sm", "--format=csv,noheader,nounits", "-i", str(cuda or 0)]
    try:
        said = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout
        return [int(word) for word in said.strip().split(",")]
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None


_RATIO = {True: "its CPU seconds", False: "its own clock, ours that of the whole GPU"}  # by device.software


def show(report: Report) -> None:
    """Tables on stdout."""
    _show_rays(report.rows)
    if report.frames:
        passes = list(dict.fromkeys(name for frame in report.frames for name in frame.passes))
        print()
        console.table(
            ("frame", "size", *(f"{name} ms" for name in passes), "frame ms", "+-", "host us", "moving us"),
            [
                (f.scene, f"{f.size[0]}x{f.size[1]}", *(_fixed(f.passes.get(p), 2) for p in passes),
                 _fixed(f.frame_ms, 2), f"{50 * f.spread:.0f}%", _fixed(f.host_us, 0), _fixed(f.host_moving_us, 0))
                for f in report.frames
            ],
        )  # fmt: skip
    if report.builds:
        print()
        console.table(
            ("build", "triangles", "Mtris/s a core", "Mtris/s, all threads", "SAH cost", "to binned SAH"),
            [
                (b.scene, b.triangles, _fixed(b.mtris_s, 2), _fixed(b.wall_mtris_s, 2), _fixed(b.sah_cost, 2),
                 _fixed(b.ratio_sah_binned, 3))
                for b in report.builds
            ],
        )  # fmt: skip
    print()
    m = report.machine
    print(f"{m['device']['renderer']}, {m['cores']} cores; rays of {m['size'][0]}x{m['size'][1]} pixels")
    print(f"rates: million live rays a second by {m['clock']}, median of {m['repeats']}, +- half the quartile distance")
    if any(row.peer for row in report.rows):
        print(
            "embree and mitsuba: a CPU second of one core; ratios: to each of them, by "
            + _RATIO[m["device"]["software"]]
        )
    for note in report.notes:
        print(note)


def _show_rays(rows: Sequence[Row]) -> None:
    groups: dict[tuple[str, int, str], dict[str, Row]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.triangles, row.variant), {})[row.rays] = row
    peers = {
        f"to {name} a core": f"ratio_{key}_per_core"
        for key, name in (("embree", "Embree"), ("embree_fast", "fast Embree"), ("mitsuba", "Mitsuba"))
        if any(getattr(row, f"ratio_{key}_per_core") is not None for row in rows)
    }
    timed = any(row.gpu_ms is not None for row in rows)
    lines = []
    for (scene, triangles, variant), found in groups.items():
        first = next(iter(found.values()))
        line: list[object] = [scene, triangles, f"{variant} *" if first.own else variant]
        line += [_rate(found[name]) if name in found else "" for name in CLASSES]
        for ratio in peers.values():
            values = [getattr(found[c], ratio) if c in found else None for c in CLASSES]
            line.append(" ".join("-" if v is None else f"{v:.2f}" for v in values))
        if timed:
            line.append(" ".join(f"{found[c].gpu_ms or 0:.3f}/{found[c].wall_ms:.3f}" for c in CLASSES if c in found))
        lines.append(line)
    if lines:
        steps = [row.steps_per_ray for row in rows]
        columns = ["scene", "triangles", "variant (* the renderer's)", *CLASSES, *peers, *["timer/wall ms"] * timed]
        if any(step is not None for step in steps):
            columns.append("steps a ray")
            for line, found in zip(lines, groups.values(), strict=True):
                counts = [found[c].steps_per_ray if c in found else None for c in CLASSES]
                line.append(" ".join(f"{v:.0f}" for v in counts if v is not None))
        console.table(columns, lines)


def _rate(row: Row) -> str:
    return f"{row.mrays_s:.{2 if row.mrays_s < 100 else 0}f} +-{row.spread * 50:.0f}%"


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:,.{digits}f}"
