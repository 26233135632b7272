"""Starts tests/image/mitsuba_oracle.py and asks it questions. Mitsuba is never imported in this process."""

import functools
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scene_kit import Rays

from glhybrid.bench.peers import find_llvm
from glhybrid.scene import Environment, Material, Scene, Sphere

F64 = NDArray[np.float64]
SKY_SIZE = (1025, 2048)  # of maps given to Mitsuba: fine enough that its own grid does not matter


class Unavailable(Exception):
    """No Mitsuba here, with the reason."""


class Oracle:
    """One Mitsuba process; `close` ends it."""

    def __init__(self, folder: Path) -> None:
        if importlib.util.find_spec("mitsuba") is None:
            raise Unavailable("mitsuba is not installed (pip install mitsuba)")
        self._folder, self._count = folder, 0
        error = "no variant tried"
        for variant in ("llvm_ad_rgb", "scalar_rgb"):
            environment = os.environ | {"GLHYBRID_MITSUBA_VARIANT": variant}
            if variant.startswith("llvm") and "DRJIT_LIBLLVM_PATH" not in environment:
                library = find_llvm()
                if library is None:
                    error = "no libLLVM >= 17 (apt-get install libllvm19)"
                    continue
                environment["DRJIT_LIBLLVM_PATH"] = str(library)
            # A child that aborts only ends itself; what it said is in its log.
            log = folder / f"mitsuba-{variant}.log"
            with log.open("w") as said:
                self._process = subprocess.Popen(
                    [sys.executable, str(Path(__file__).with_name("mitsuba_oracle.py"))],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, text=True, env=environment,
                )  # fmt: skip
            answer = self._read()
            if "ready" in answer:
                self.variant, self.version = answer["ready"], answer["version"]
                return
            self.close()
            error = f"{variant}: {log.read_text()[-500:]}"
        raise Unavailable(f"mitsuba does not start: {error}")

    def _read(self) -> dict[str, Any]:
        """The next answer: lines of other things that print are passed over."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("{"):
                return dict(json.loads(line))
        return {"error": "the oracle ended"}

    def ask(self, spec: dict[str, Any], **arrays: Any) -> dict[str, NDArray[Any]]:
        self._count += 1
        into, out = (str(self._folder / f"{self._count}-{k}.npz") for k in ("in", "out"))
        np.savez(into, request=json.dumps(spec), **arrays)
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([into, out]) + "\n")
        self._process.stdin.flush()
        answer = self._read()
        assert "done" in answer, answer["error"]
        with np.load(out) as file:
            result = dict(file)
        Path(out).unlink()
        return result

    def render(self, scene: Scene, rays: Rays, max_depth: int, spp: int = 1, seed: int = 1) -> tuple[F64, F64]:
        """Mean radiance and variance of the mean along rays: as their shape, (..., 3)."""
        spec, arrays = describe(scene)
        shape = rays.direction.shape
        spec |= {"job": "render", "max_depth": max_depth, "spp": spp, "seed": seed}
        answer = self.ask(spec, origin=rays.origin.reshape(-1, 3), direction=rays.direction.reshape(-1, 3), **arrays)
        return answer["mean"].reshape(shape), answer["variance"].reshape(shape)

    def close(self) -> None:
        self._process.stdin and self._process.stdin.close()
        self._process.wait(timeout=20)
        self._process.stdout and self._process.stdout.close()


def material_spec(material: Material) -> dict[str, Any]:
    """A glTF material without textures. Refuses what the oracle's BSDF does not have."""
    assert material.alpha_mode == "OPAQUE" and not material.textures and not material.unlit, material
    assert material.clearcoat == 0 and material.transmission == 0, material
    f0 = np.minimum(((material.ior - 1) / (material.ior + 1)) ** 2 * np.array(material.specular_color), 1)
    return {
        "type": "gltf", "base_color": list(material.base_color[:3]), "metallic": material.metallic,
        "roughness": material.roughness, "f0": (f0 * material.specular).tolist(), "f90": material.specular,
    }  # fmt: skip


def describe(scene: Scene) -> tuple[dict[str, Any], dict[str, Any]]:
    """A scene in the oracle's words: world-space triangles in the renderer's float32, and numbers."""
    shapes: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for instance in scene.instances:
        mesh = scene.meshes[instance.mesh]
        for k, shape in enumerate(mesh.primitives):
            material = scene.materials[(instance.materials or tuple(p.material for p in mesh.primitives))[k]]
            entry: dict[str, Any] = {"bsdf": material_spec(material)}
            name = f"shape{len(shapes)}"
            if max(material.emissive) > 0:
                entry["emitter"] = list(material.emissive)
            m = instance.world_from_object
            if isinstance(shape, Sphere):
                entry["sphere"] = [*m[:3, 3].tolist(), shape.radius * abs(np.linalg.det(m[:3, :3])) ** (1 / 3)]
            else:
                index = shape.index if np.linalg.det(m[:3, :3]) > 0 else shape.index[:, ::-1]
                world = shape.position.astype(np.float64) @ m[:3, :3].T + m[:3, 3]
                arrays[f"{name}_position"] = world[index].astype(np.float32)
                entry["position"] = f"{name}_position"
                normal = shape.normal.astype(np.float64) @ np.linalg.inv(m[:3, :3])
                corner = world[index]
                flat = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
                flat /= np.linalg.norm(flat, axis=1, keepdims=True)
                normal /= np.linalg.norm(normal, axis=1, keepdims=True)
                if "emitter" in entry and material.double_sided:
                    # Mitsuba's lamps shine to the front alone: a second one, turned over, lies close behind the first.
                    gap = 1e-4 * np.ptp(world, axis=0).max()
                    arrays[f"{name}_back"] = (corner - gap * flat[:, None])[:, ::-1].astype(np.float32)
                    shapes.append({**entry, "position": f"{name}_back"})
                if np.abs(normal[index] - flat[:, None]).max() > 1e-4:
                    arrays[f"{name}_normal"] = normal[index].astype(np.float32)
                    entry["normal"] = f"{name}_normal"
            shapes.append(entry)
    lights = []
    for light in scene.lights:
        value = (np.array(light.color) * light.intensity).tolist()
        if light.kind == "directional":
            lights.append({"type": "directional", "direction": list(light.direction), "irradiance": value})
        else:
            assert light.kind == "point" and light.range == 0, "spot cones of Mitsuba have another falloff"
            lights.append({"type": "point", "position": list(light.position), "intensity": value})
    spec: dict[str, Any] = {"shapes": shapes, "lights": lights}
    if scene.environment is not None:
        if scene.environment.constant:
            spec["sky"] = (scene.environment.radiance[0, 0] * scene.environment.intensity).astype(float).tolist()
        else:
            spec["sky"] = "sky"
            arrays["sky"] = mitsuba_map(scene.environment)
    return spec, arrays


def sky_radiance(environment: Environment, direction: F64) -> F64:
    """Radiance of an equirect environment along unit directions (..., 3): scene.py's words in float64 NumPy.

    Bilinear, texel centres at 0.5, columns wrap, rows clamp; the centre column looks along -Z, +X is to its right;
    rotation is right-handed about +Y, so a direction is turned back by it before the lookup.
    """
    d = np.asarray(direction, np.float64)
    c, s = np.cos(environment.rotation), np.sin(environment.rotation)
    x, y, z = c * d[..., 0] - s * d[..., 2], d[..., 1], s * d[..., 0] + c * d[..., 2]
    texels = environment.radiance.astype(np.float64)
    height, width = texels.shape[:2]
    u = (0.5 + np.arctan2(x, -z) / (2 * np.pi)) * width - 0.5
    v = np.arccos(np.clip(y, -1, 1)) / np.pi * height - 0.5
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    fu, fv = (u - i)[..., None], (v - j)[..., None]
    rows = np.clip(j, 0, height - 1), np.clip(j + 1, 0, height - 1)
    columns = i % width, (i + 1) % width
    top = texels[rows[0], columns[0]] * (1 - fu) + texels[rows[0], columns[1]] * fu
    low = texels[rows[1], columns[0]] * (1 - fu) + texels[rows[1], columns[1]] * fu
    return (top * (1 - fv) + low * fv) * environment.intensity


@functools.lru_cache(maxsize=4)  # environments compare by identity
def mitsuba_map(environment: Environment) -> NDArray[np.float32]:
    """The same light on Mitsuba's grid: columns at (i + 0.5) / W from -Z towards -X.., rows at j / (H - 1)."""
    height, width = SKY_SIZE
    u = (np.arange(width) + 0.5) / width * 2 * np.pi  # Mitsuba: u = atan2(x, -z) / 2 pi
    v = np.arange(height) / (height - 1) * np.pi
    phi, theta = np.meshgrid(u, v)
    direction = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)
    return sky_radiance(environment, direction).astype(np.float32)
