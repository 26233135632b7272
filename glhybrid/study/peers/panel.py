"""Asks other renderers: time and error against the same reference. Their models differ, and each says how.

Each runs where it is installed: with this Python, with the one that GLHYBRID_<NAME>_PYTHON names, or with one on PATH,
since each version of bpy wants one version of Python and no other.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.image import Frame
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.study import picture, store
from glhybrid.study.develop import develop
from glhybrid.study.peers import bundle, glb

TIMEOUT_S = 600
NAMES = ("mitsuba", "pyrender", "bpy", "filly")
QUICK_SAMPLES, SAMPLES = 16, 64  # of path tracers
Note = Callable[[str], None]
# This package comes last on the path: another Python's packages are not those beside it.
START = "import runpy, sys; sys.path.append(sys.argv.pop(1)); runpy.run_module(sys.argv.pop(1), run_name='__main__')"
ROOT = str(Path(__file__).resolve().parents[3])


@dataclass(frozen=True, eq=False)
class Site:
    """A scene as a study has it: what peers are held against, and where their pictures go."""

    name: str
    scene: Scene
    camera: Camera
    size: tuple[int, int]
    reference: F32
    reference_key: str
    exposure: float
    folder: Path
    light: picture.AllLight | None = None  # of the reference, where that leaves some out


@lru_cache
def interpreter(name: str) -> str | None:
    """The Python that has a peer; None if none does. One that is named but lacks it is not passed over in silence."""
    named = os.environ.get(variable(name))
    if named:
        return named if _has(named, name) else None
    if importlib.util.find_spec(name):
        return sys.executable
    found = (shutil.which(f"python3.{minor}") for minor in range(20, 9, -1))
    return next((python for python in found if python and _has(python, name)), None)


def variable(name: str) -> str:
    """The environment variable that names its Python."""
    return f"GLHYBRID_{name.upper()}_PYTHON"


def _has(python: str, name: str) -> bool:
    code = "import importlib.util, sys; sys.exit(importlib.util.find_spec(sys.argv[1]) is None)"
    try:
        done = subprocess.run([python, "-c", code, name], capture_output=True, timeout=30, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def missing(name: str) -> str:
    """Why a peer cannot be asked; empty if it can."""
    from glhybrid.bench.peers import mitsuba_missing

    if interpreter(name) is None:
        if named := os.environ.get(variable(name)):
            return f"{variable(name)} is {named}, which cannot be run or has no {name}"
        return f"{name} is not installed (pip install {name}, or set {variable(name)} to a Python that has it)"
    return mitsuba_missing() if name == "mitsuba" and interpreter(name) == sys.executable else ""


def ask(renderer: Renderer, name: str, site: Site, samples: int, note: Note) -> dict[str, Any] | None:
    """One peer's row, kept in the scene's folder; None, with a note, where it is absent or fails."""
    if reason := missing(name):
        note(f"{name} is left out: {reason}")
        return None
    key = store.fingerprint(store.code_digest(), _digest(), site.reference_key, name, samples, site.size)
    path = site.folder / f"peer-{name}.json"
    if (kept := store.read(path, key)) is not None:
        return {k: v for k, v in kept.items() if k != "key"}
    found = _run(name, site, samples)
    if isinstance(found, str):
        note(f"{site.name}: {name} is left out: {found}")
        return None
    radiance, told = found
    flip = renderer.flip.hdr(radiance, site.reference)
    difference = picture.compare(radiance, site.reference, flip, site.light)
    frame, _ = develop(renderer, site.scene, site.camera, radiance, site.exposure)
    images = {"png": f"peer-{name}.png", "exr": f"peer-{name}.exr", "flip": f"peer-{name}.flip.png"}
    frame.save(site.folder / images["png"])
    frame.save(site.folder / images["exr"], aov=())
    Frame(picture.magma(flip)).save(site.folder / images["flip"])
    lost = glb.lost(site.scene)
    notes = told["notes"] + ([f"not in its file: {', '.join(lost)}"] if lost else [])
    row = {
        "scene": site.name, "renderer": name, "version": told["version"], "frame_ms": told["ms"],
        "frame_cpu_ms": told["cpu_ms"],
        **difference.to_dict(), "notes": notes, "images": images,
    }  # fmt: skip
    store.write_json(path, row | {"key": key})
    return row


def _digest() -> str:
    return store.digest(Path(__file__).parent.glob("*.py"))


def _run(name: str, site: Site, samples: int) -> tuple[F32, dict[str, Any]] | str:
    """Radiance and what the process told; or why there is none. A process that aborts ends only itself."""
    python, environment = str(interpreter(name)), dict(os.environ)
    if python != sys.executable:
        environment.pop("PYTHONPATH", None)  # packages of this Python are not its
    if name == "mitsuba" and "DRJIT_LIBLLVM_PATH" not in environment:
        from glhybrid.bench.peers import find_llvm

        if (library := find_llvm()) is not None:
            environment["DRJIT_LIBLLVM_PATH"] = str(library)
    mean = float((site.reference.astype(np.float64) @ picture.LUMINANCE).mean())
    with tempfile.TemporaryDirectory(prefix="glhybrid-peer-") as scratch:
        bundle.write(Path(scratch), site.scene, site.camera, site.size, mean, samples)
        answer = Path(scratch, "answer.npz")
        command = [python, "-c", START, ROOT, f"{__package__}.{name}_process", scratch, str(answer)]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            return f"it took longer than {TIMEOUT_S} s"
        if done.returncode or not answer.is_file():
            said = [line for line in done.stderr.splitlines() if line.strip()] or [f"exit status {done.returncode}"]
            return said[-1].strip()[:300]
        with np.load(answer) as file:
            radiance, told = file["radiance"], json.loads(str(file["told"]))
    if radiance.shape != site.reference.shape:
        return f"its picture is {radiance.shape[1]}x{radiance.shape[0]}"
    return radiance, told
