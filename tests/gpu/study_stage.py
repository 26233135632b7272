"""The small scene of the studies that are tested."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from rays import moved, scene_of

from glhybrid import jit
from glhybrid.load.shapes import box
from glhybrid.scene import Camera, Environment, Light, Material, Scene, Sphere

SIZE = (64, 48)
CAMERA = Camera.look_at((3.0, 2.5, 4.0), (0, 0.4, 0), fov_y=0.7, name="main")


def stage(light: Light | None = None) -> Scene:
    """A metal box and a ball on a floor, under a sky and a sun, from flat pieces."""
    materials = (Material(double_sided=True), Material(metallic=1.0, roughness=0.1, double_sided=True))
    shapes = (box(size=(8, 0.2, 8)), replace(box(size=(0.8, 1, 0.8)), material=1), Sphere(0.5, 0))
    poses = [moved(np.array(at)) for at in ((0, -0.1, 0), (-0.5, 0.5, 0), (0.8, 0.5, 0.4))]
    scene = scene_of(*shapes, poses=poses, materials=materials)
    sun = light or Light("directional", direction=(-0.6, -0.7, -0.4), intensity=3.0)
    sky = Environment(np.full((1, 1, 3), 0.5, np.float32))
    return scene.replace(name="stage", sha256="0", lights=(sun,), environment=sky, cameras=(CAMERA,))


def own_cache(folder: Path) -> dict[str, str]:
    """Variables that keep everything in a folder, but for compiled kernels: every process would compile them anew."""
    kernels = jit.folder()
    return {"GLHYBRID_CACHE": str(folder / "cache")} | ({"NUMBA_CACHE_DIR": str(kernels)} if kernels else {})
