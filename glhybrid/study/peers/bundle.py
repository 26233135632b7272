"""What another renderer is given: a folder with scene.glb, sky.npz and scene.json (camera, lights, size)."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.scene import Camera, Environment, Scene
from glhybrid.study.peers import glb

SKY = (256, 512)  # texels of the environment that peers get


def write(folder: Path, scene: Scene, camera: Camera, size: tuple[int, int], mean: float, samples: int) -> None:
    """mean: of the reference's luminance, for the exposure of peers with 8-bit pictures. samples: of path tracers."""
    folder.mkdir(parents=True, exist_ok=True)
    glb.write(scene, folder / "scene.glb")
    lights = [
        {
            "kind": light.kind, "color": list(light.color), "intensity": light.intensity,
            "position": list(light.position), "direction": list(light.direction), "range": light.range,
            "inner_cone": light.inner_cone, "outer_cone": light.outer_cone, "radius": light.radius,
            "angular_diameter": light.angular_diameter,
        }
        for light in scene.lights
    ]  # fmt: skip
    about: dict[str, Any] = {
        "size": list(size), "fov_y": vertical_fov(camera, size), "ymag": camera.ymag, "near": camera.near,
        "world_from_view": camera.world_from_view.tolist(), "lights": lights, "mean": mean, "samples": samples,
        "extent": float(np.linalg.norm(np.diff(scene.bounds(), axis=0))) or 1.0,
    }  # fmt: skip
    (folder / "scene.json").write_text(json.dumps(about), encoding="utf-8")
    sky = scene.environment
    texels = np.zeros((*SKY, 3), np.float32) if sky is None else turned(sky)
    np.savez(folder / "sky.npz", radiance=texels)


def vertical_fov(camera: Camera, size: tuple[int, int]) -> float:
    """Radians; 0: orthographic."""
    if camera.fov_y <= 0 or not camera.fov_short or size[1] <= size[0]:
        return max(camera.fov_y, 0.0)
    return 2 * float(np.arctan(np.tan(camera.fov_y / 2) * size[1] / size[0]))


def turned(sky: Environment) -> np.ndarray:
    """SKY equirect texels with intensity and rotation in them: (H, W, 3), the centre column looks along -Z."""
    height, width = SKY
    phi = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi + sky.rotation
    source_h, source_w = sky.radiance.shape[:2]
    u = (phi / (2 * np.pi) + 0.5) * source_w - 0.5
    v = np.clip((np.arange(height) + 0.5) / height * source_h - 0.5, 0, source_h - 1)
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    fu, fv = (u - i)[None, :, None], (v - j)[:, None, None]
    rows, columns = (j, np.minimum(j + 1, source_h - 1)), (i % source_w, (i + 1) % source_w)
    texels = sky.radiance.astype(np.float64)
    top = texels[rows[0]][:, columns[0]] * (1 - fu) + texels[rows[0]][:, columns[1]] * fu
    low = texels[rows[1]][:, columns[0]] * (1 - fu) + texels[rows[1]][:, columns[1]] * fu
    return ((top * (1 - fv) + low * fv) * sky.intensity).astype(np.float32)
