"""The progressive path tracer: what all techniques are held against."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from glhybrid import layout
from glhybrid.context import Context
from glhybrid.geometry import Geometry
from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SAMPLES_AT_ONCE = 4  # in a dispatch on a GPU; one on a CPU, where a dispatch cannot be interrupted for a second


class Reference:
    """Owns the tables that light is sampled by: what shines, and the sky's distribution."""

    name = "reference"

    def __init__(self, context: Context, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._owned: list[Any] = []
        self._resources = dict(scene.resources)
        self.emissive_weight = 0.0
        self._at_once = 1 if context.device.software else SAMPLES_AT_ONCE
        if features.emitters:
            rows, self.emissive_weight = emitter_rows(scene.geometry)
            features = features.replace(emitters=len(rows) > 0)
            if len(rows):
                buffer = context.gl.buffer(rows.tobytes())
                self._owned.append(buffer)
                self._resources["Emitters"] = buffer
        self._program = shaders.compute("reference", features)

    def run(self, targets: Targets, staged: Any, timing: Any, progress: Any) -> Any:
        """Averages settings.samples paths a pixel -> radiance."""
        radiance = targets.get("radiance")
        for done, _ in self.steps(targets, staged, timing):
            if progress is not None:
                progress("samples", done, staged.settings.samples)
        return radiance

    def steps(self, targets: Targets, staged: Any, timing: Any) -> Iterator[tuple[int, Any]]:
        """(paths a pixel so far, radiance) after each part of a dispatch, until settings.samples are averaged.

        Between parts anything may be drawn; the upper rows of the image then have more paths than the rest.
        """
        settings = staged.settings
        radiance = targets.get("radiance")
        resources = {**self._resources, "radiance": radiance}
        spread = 0.0 if settings.aa == 1 else 1.0
        done = 0
        while done < settings.samples:
            count = min(self._at_once, settings.samples - done)
            for number, part in enumerate(self._program.parts(resources, targets.size)):
                if number:
                    yield done, radiance
                timing.frame()
                staged.set(
                    sample_first=done, sample_count=count, jitter_px=(spread, spread),
                    emissive_weight=self.emissive_weight,
                )  # fmt: skip
                timing.run("reference", part)
            done += count
            yield done, radiance

    def release(self) -> None:
        for owned in self._owned:
            owned.release()
        self._owned.clear()


def emitter_rows(geometry: Geometry) -> tuple[np.ndarray, float]:
    """Rows of layout Emitter over all shining triangles and spheres, and the sum of their area times luminance.

    A sphere under a scale that is not uniform counts as one of the same volume: passes/reference.comp does so too.
    """
    groups, materials = geometry.hit_groups, geometry.materials
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for i, mesh_row in enumerate(geometry.instance_mesh.tolist()):
        for number, (first, count) in enumerate(geometry.meshes[mesh_row].geometries):
            material = materials[groups[geometry.records[geometry.first_record[i] + number, 0], 1]]
            luminance = float(LUMINANCE @ np.asarray(material.emissive))
            if luminance <= 0 or material.unlit:
                continue
            for row, geometry_number, sphere in geometry.meshes[mesh_row].spheres:
                if geometry_number == number:
                    volume = abs(float(np.linalg.det(geometry.world_from_object[i, :3, :3])))
                    area = np.array([4 * np.pi * float(sphere[3]) ** 2 * volume ** (2 / 3)])
                    parts.append((np.array([i], np.uint32), np.array([row], np.uint32), area * luminance))
            if count == 0:
                continue
            rows = np.arange(first, first + count, dtype=np.uint32)
            corner = geometry.vertices[geometry.triangles[rows, :3], :3].astype(np.float64)
            edges = (corner[:, 1:] - corner[:, :1]) @ geometry.world_from_object[i, :3, :3].T
            area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
            parts.append((np.full(count, i, np.uint32), rows, area * luminance))
    if not parts:
        return np.zeros(0, layout.dtype("Emitter")), 0.0
    table = np.zeros(sum(len(p[1]) for p in parts), layout.dtype("Emitter"))
    weight = np.concatenate([p[2] for p in parts])
    table["instance"], table["triangle"] = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
    table["cdf"] = np.cumsum(weight) / weight.sum()
    table["cdf"][-1] = 1
    return table, float(weight.sum())
