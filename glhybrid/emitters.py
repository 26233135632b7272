"""What shines: the table that glsl/lib/emitters.glsl draws points from. No OpenGL."""

from typing import TYPE_CHECKING

import numpy as np

from glhybrid import layout
from glhybrid.environment_cdf import LAMP, mean_luminance
from glhybrid.scene import Material, Scene

if TYPE_CHECKING:
    from glhybrid.geometry import Geometry

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def has_lamps(scene: Scene, materials: list[Material]) -> bool:
    """Whether some mesh shines so much brighter than the sky that few rays of a rough surface find much of its light.

    materials: those in use. Not where things move: the table holds for the areas that there were at first. Nor among
    blended layers, whose light is found on the way.
    """
    if scene.animations or any(m.alpha_mode == "BLEND" or m.transmission > 0 for m in materials):
        return False
    brightest = max((float(LUMINANCE @ np.asarray(m.emissive)) for m in materials if not m.unlit), default=0.0)
    sky = mean_luminance(scene.environment) if scene.environment is not None else 0.0
    return brightest > LAMP * sky and brightest > 0


def emitter_rows(geometry: "Geometry") -> tuple[np.ndarray, float]:
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
