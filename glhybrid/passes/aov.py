"""Typed arrays of the exact pixel-centre rays, one dispatch each, only those asked for; a program for each kind."""

from typing import Any

import numpy as np

from glhybrid.geometry import Geometry
from glhybrid.gpu_scene import GpuScene
from glhybrid.image import AOVS
from glhybrid.layout import CONSTANTS
from glhybrid.needs import Features
from glhybrid.readback import Reading
from glhybrid.scene import F64
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets

_KINDS = {
    "motion": "MOTION", "bvh_steps": "RAYS",
    **dict.fromkeys(("normal", "albedo", "roughness", "metallic", "emissive"), "MATERIAL"),
}  # fmt: skip


class Aov:
    """Whatever is asked of the first surface; only its programs are kept."""

    name = "aov"

    def __init__(self, shaders: Shaders, scene: GpuScene, features: Features) -> None:
        self._shaders, self._scene, self._features = shaders, scene, features

    def run(self, targets: Targets, ids: Any, name: str, origin: F64) -> Reading[np.ndarray]:
        """(H, W, ...) array as image.AOVS describes it, row 0 at the top."""
        kind = CONSTANTS[f"AOVS_{_KINDS.get(name, 'POINT')}"]
        features = self._features.replace(aov=kind, step_counter=name == "bvh_steps")
        target = targets.get("aov")
        program = self._shaders.compute("aov", features)
        which = CONSTANTS[f"AOV_{name.upper()}"]
        program.dispatch({**self._scene.resources, "gbuffer_id": ids, "out_aov": target, "aov": which}, targets.size)
        width, height = targets.size
        bits = np.frombuffer((yield target), np.uint32).reshape(height, width, 4)[::-1]
        row = AOVS[name]
        if row.dtype == "uint32":
            return np.array(_scene_ids(bits[..., 0], name, self._scene.geometry), order="C")
        values = bits.view(np.float32)
        count = len(row.channels)
        result = np.array(values[..., 0] if count == 1 else values[..., :count], order="C")
        if name == "position":
            hit = np.isfinite(result).all(-1) & (bits[..., :3] != 0).any(-1)
            result[hit] += origin.astype(np.float32)
        return result


def _scene_ids(ids: np.ndarray, name: str, geometry: Geometry) -> np.ndarray:
    """Rows of GPU tables as indices into the scene."""
    table = {"material_id": geometry.material_index, "triangle_id": geometry.source_triangle}.get(name)
    if table is None:
        return ids
    miss = ids == CONSTANTS["ID_NONE"]
    return np.where(miss, CONSTANTS["ID_NONE"], table[np.where(miss, 0, ids)] if len(table) else ids).astype(np.uint32)
