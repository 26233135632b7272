"""Other tracers on the same rays: Embree through embreex in this process, Mitsuba 3 in its own.

Embree is asked ray by ray, in its robust mode, embreex's default and watertight like ours, and in its fast one, which
may miss an edge; Mitsuba by its LLVM variant with all rays at once. Their rates are per CPU second, as is all that
ratios are made of.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.bench.clock import Sample
from glhybrid.bench.rays import ANY_HIT, Rays
from glhybrid.scene import F32

FAR = np.float32(1e30)  # Embree's Python module takes no infinity
MITSUBA_TIMEOUT_S = 300


class Embree:
    """Embree's tree over (T, 3, 3) corners. `missing` says why there is none, or is empty. fast: not watertight."""

    missing = "" if importlib.util.find_spec("embreex") else "embreex is not installed (pip install embreex)"

    def __init__(self, corners: F32, fast: bool = False) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self.name = "embree_fast" if fast else "embree"
        # One vertex for each place, as a mesh loaded for Embree would have it: separate corners cost it cache.
        position, index = np.unique(corners.reshape(-1, 3).view([("", np.float32)] * 3), return_inverse=True)
        self._scene = rtcore_scene.EmbreeScene(robust=not fast)
        self._mesh = TriangleMesh(
            self._scene,
            np.ascontiguousarray(position.view(np.float32).reshape(-1, 3)),
            index.reshape(-1, 3).astype(np.int32),
        )
        # The tree is built by the first ray.
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), query="OCCLUDED")

    def launch(self, name: str, rays: Rays) -> tuple[Callable[[], None], Callable[[], NDArray[Any]]]:
        """One query of all rays of a class; and what it found, as Tracer.launch has it."""
        origin, direction, far = rays.origin, rays.direction, np.minimum(rays.t_max, FAR)
        found: dict[str, NDArray[Any]] = {}

        def run() -> None:
            query = "OCCLUDED" if name == ANY_HIT else "DISTANCE"
            found["it"] = self._scene.run(origin, direction, dists=far, query=query)

        def read() -> NDArray[Any]:
            if name == ANY_HIT:
                return found["it"] == 0
            return np.where(found["it"] < FAR, found["it"], np.float32(np.inf))

        return run, read


def mitsuba_missing() -> str:
    """Why Mitsuba cannot be asked; empty if it can."""
    if importlib.util.find_spec("mitsuba") is None:
        return "mitsuba is not installed (pip install mitsuba)"
    if "DRJIT_LIBLLVM_PATH" not in os.environ and sys.platform == "linux" and find_llvm() is None:
        return "mitsuba's LLVM variant finds no libLLVM of version 17 or later (apt-get install libllvm19)"
    return ""


def find_llvm() -> Path | None:
    """The newest shared libLLVM from 17 on; older ones abort the process that loads them."""
    found = []
    for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"):
        for path in Path(folder).glob("libLLVM*so*"):
            digits = path.name.replace("libLLVM", "").replace("so", "").strip("-.").split(".")[0]
            if digits.isdigit() and int(digits) >= 17:
                found.append((int(digits), path))
    return max(found)[1] if found else None


def ask_mitsuba(
    corners: F32, rays: Mapping[str, Rays], repeats: int
) -> tuple[dict[str, tuple[Sample, NDArray[Any]]], str]:
    """By class the times and what was found; or none, and why. Mesa's LLVM and Mitsuba's do not share a process."""
    environment = dict(os.environ)
    if "DRJIT_LIBLLVM_PATH" not in environment and (library := find_llvm()) is not None:
        environment["DRJIT_LIBLLVM_PATH"] = str(library)
    with tempfile.TemporaryDirectory(prefix="glhybrid-bench-") as folder:
        given, taken = Path(folder, "given.npz"), Path(folder, "found.npz")
        arrays: dict[str, Any] = {f"rays_{name}": r.data for name, r in rays.items()}
        np.savez(given, corners=corners, repeats=repeats, **arrays)
        command = [sys.executable, "-m", "glhybrid.bench.mitsuba_process", str(given), str(taken)]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=MITSUBA_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            return {}, f"mitsuba took longer than {MITSUBA_TIMEOUT_S} s"
        if done.returncode or not taken.is_file():
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            return {}, f"mitsuba failed: {last}"
        with np.load(taken) as file:
            times = json.loads(str(file["times"]))
            return {name: (Sample(**times[name]), file[f"found_{name}"]) for name in times}, ""
