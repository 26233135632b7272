"""Mitsuba's ray intersection on given rays, in a process of its own: `python -m ... GIVEN.npz FOUND.npz`."""

import json
import sys
import time
from typing import Any

import numpy as np


def main(given: str, taken: str) -> None:
    """Reads corners (T, 3, 3), rays by class and repeats; writes what was found, and ms by launch in two clocks."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    with np.load(given) as file:
        arrays = {name: file[name] for name in file.files}
    position, index = np.unique(arrays["corners"].reshape(-1, 3), axis=0, return_inverse=True)
    mesh = mi.Mesh("bench", len(position), index.size // 3)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(position.ravel())
    parameters["faces"] = mi.UInt32(index.ravel().astype(np.uint32))
    parameters.update()
    scene = mi.load_dict({"type": "scene", "mesh": mesh})
    times: dict[str, dict[str, list[float]]] = {}
    found: dict[str, Any] = {}
    for key in (k for k in arrays if k.startswith("rays_")):
        name, rays = key.removeprefix("rays_"), arrays[key]
        origin, direction = mi.Point3f(rays[:, :3].T), mi.Vector3f(rays[:, 4:7].T)
        far = mi.Float(np.minimum(rays[:, 3], np.finfo(np.float32).max))
        dr.eval(origin, direction, far)
        sample: dict[str, list[float]] = {"wall": [], "cpu": []}
        for turn in range(int(arrays["repeats"]) + 1):  # the first compiles
            dr.sync_thread()
            wall, cpu = time.perf_counter(), time.process_time()
            ray = mi.Ray3f(origin, direction)
            ray.maxt = far  # type: ignore[assignment]  # two names of one type
            if name == "shadow":
                result: Any = scene.ray_test(ray, coherent=False)
            else:
                result = scene.ray_intersect_preliminary(ray, coherent=name == "camera").t
            dr.eval(result)
            dr.sync_thread()
            if turn:
                sample["cpu"].append((time.process_time() - cpu) * 1e3)
                sample["wall"].append((time.perf_counter() - wall) * 1e3)
        times[name], found[f"found_{name}"] = sample, np.array(result)
    found["times"] = json.dumps(times)
    np.savez(taken, **found)


if __name__ == "__main__":
    main(*sys.argv[1:])
