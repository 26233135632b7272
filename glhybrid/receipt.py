"""The receipt of a picture: what was drawn, how, on what, and how long it took."""

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from glhybrid import __version__, checks, kernels, pose
from glhybrid.timing import Timing
from glhybrid.view import View

if TYPE_CHECKING:
    from glhybrid.staged import Staged

SOFTWARE_LIGHTS = 500  # whose shadow rays, of some 100 turns each, one invocation is sure to finish


def make(staged: "Staged", view: View, timing: Timing, first_image_ms: float) -> dict[str, Any]:
    """Of the picture just drawn, ready for JSON. Waits for the device: the exposure is read back.

    first_image_ms: from the call that asked for the picture until it was read.
    """
    scene, upload, plan = staged.scene, staged.upload, staged.plan
    mover, probe, maps = staged.mover, staged.probe, staged.passes.maps
    medians = (mover.ms if mover is not None else {}) | timing.medians()
    if probe is not None and mover is not None:
        medians["probe"] = probe.ms  # anew for every time
    trees = upload.bvh_stats()
    images = (staged.targets, staged.sky, *(part for part in (maps, probe) if part is not None))
    found = {
        "version": __version__,
        "scene": {
            "name": scene.name, "path": str(scene.path) if scene.path else None, "sha256": scene.sha256,
            "triangles": scene.triangle_count(), "instances": len(scene.instances), "lights": len(scene.lights),
            "materials": len(upload.geometry.materials), "dropped_triangles": upload.geometry.dropped,
            "warnings": [*warnings(staged), *checks.check_view(view, staged.bounds)],
        },
        "device": staged.context.device.to_dict(),
        "settings": staged.settings.to_dict() | {
            "size": list(view.size), "camera": view.camera.name, "exposure_ev": staged.display.exposure_ev(),
        },
        "camera": camera(view),
        "plan": {
            "passes": list(plan.passes), "programs": staged.shaders.names, "primary": plan.primary,
            "levels": upload.geometry.levels, "reasons": [*plan.reasons, *[kernels.QUICK] * trees.get("quick", False)],
            "image_bytes": upload.image_bytes + sum(part.bytes for part in images),
            "buffer_bytes": upload.buffer_bytes + staged.constants.buffer.size
            + (mover.bytes if mover is not None else 0),
            "skipped": list(plan.skipped),
        },
        "bvh": trees,
        "passes": [{"name": name, "ms": ms} for name, ms in medians.items()],
        "frame_ms": sum(medians.values()),
        "first_image_ms": first_image_ms,
    }  # fmt: skip
    if probe is not None:
        found["probes"] = {
            "placed": [dataclasses.asdict(p) for p in probe.placed], "captured": sorted(probe.captured),
            "capture_ms": probe.ms, "bytes": probe.bytes,
        }  # fmt: skip
    return found


def camera(view: View) -> dict[str, Any]:
    """What data needs of a camera: where it is and how it projects, ready for JSON.

    world_from_view: (4, 4), metres, glTF's axes: +X right, +Y up, looking down -Z. Perspective: `intrinsics` is K,
    (3, 3) in pixels, of points in OpenCV's axes (+X right, +Y down, +Z ahead); the first pixel's centre is (0.5, 0.5).
    Orthographic: `half_extents` (x, y), metres.
    """
    shot, (width, height) = view.camera, view.size
    told: dict[str, Any] = {"name": shot.name, "world_from_view": np.asarray(shot.world_from_view).tolist()}
    if view.orthographic:
        reach = [float(np.linalg.norm(axis)) for axis in (view.right, view.up)]
        return told | {"projection": "orthographic", "half_extents": reach, "near": shot.near}
    focal = 1 / view.pixel_angle
    k = [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]
    fov = math.degrees(2 * math.atan(height / 2 * view.pixel_angle))
    return told | {"projection": "perspective", "intrinsics": k, "fov_y_deg": fov, "near": shot.near}


def warnings(staged: "Staged") -> list[str]:
    """What the loader could not keep, and what this picture may show wrong."""
    scene, settings, geometry = staged.scene, staged.settings, staged.upload.geometry
    said = list(scene.warnings)
    if settings.time is not None or settings.clip is not None:
        said += pose.notes(scene, settings.time, settings.clip)
    if not scene.lights and scene.environment is None and not any(m.unlit or any(m.emissive) for m in scene.materials):
        said.append("no light and no environment: all is black; glhybrid.with_defaults(scene) adds a sky and a sun")
    if lost := geometry.flattened_away:
        said.append(f"{lost} triangles dropped: too small for one level of trees over all; --set levels=2 shows them")
    if dropped := geometry.dropped - lost:
        said.append(f"{dropped} triangles dropped: without area, or with a vertex that is not finite")
    rays = staged.features.mirror_rays or staged.features.blended
    if staged.context.device.software and rays and len(scene.lights) > SOFTWARE_LIGHTS:
        said.append(
            f"{len(scene.lights)} lights: a software device ends the loops of a pixel at 65,535 turns: what "
            f"mirror rays and blended layers show may lack shadows of those past {SOFTWARE_LIGHTS}; a GPU does not"
        )
    return said
