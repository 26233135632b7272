"""Other renderers on the same scene and camera, each in a process of its own where it is installed: time and error
against the same reference. Their models differ, and each says how."""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
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


def missing(name: str) -> str:
    """Why a peer cannot be asked; empty if it can."""
    from glhybrid.bench.peers import mitsuba_missing

    if name == "mitsuba":
        return mitsuba_missing()
    return "" if importlib.util.find_spec(name) else f"{name} is not installed (pip install {name})"


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
    difference, flip = picture.compare(radiance, site.reference)
    frame, _ = develop(renderer, site.scene, site.camera, radiance, site.exposure)
    images = {"png": f"peer-{name}.png", "exr": f"peer-{name}.exr", "flip": f"peer-{name}.flip.png"}
    frame.save(site.folder / images["png"])
    frame.save(site.folder / images["exr"], aov=())
    Frame(picture.magma(flip)).save(site.folder / images["flip"])
    lost = glb.lost(site.scene)
    notes = told["notes"] + ([f"not in its file: {', '.join(lost)}"] if lost else [])
    row = {
        "scene": site.name, "renderer": name, "version": told["version"], "frame_ms": told["ms"],
        **difference.to_dict(), "notes": notes, "images": images,
    }  # fmt: skip
    store.write_json(path, row | {"key": key})
    return row


def _digest() -> str:
    return store.digest(Path(__file__).parent.glob("*.py"))


def _run(name: str, site: Site, samples: int) -> tuple[F32, dict[str, Any]] | str:
    """Radiance and what the process told; or why there is none. A process that aborts ends only itself."""
    environment = dict(os.environ)
    if name == "mitsuba" and "DRJIT_LIBLLVM_PATH" not in environment:
        from glhybrid.bench.peers import find_llvm

        if (library := find_llvm()) is not None:
            environment["DRJIT_LIBLLVM_PATH"] = str(library)
    mean = float((site.reference.astype(np.float64) @ picture.LUMINANCE).mean())
    with tempfile.TemporaryDirectory(prefix="glhybrid-peer-") as scratch:
        bundle.write(Path(scratch), site.scene, site.camera, site.size, mean, samples)
        answer = Path(scratch, "answer.npz")
        command = [sys.executable, "-m", f"glhybrid.study.peers.{name}_process", scratch, str(answer)]
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
