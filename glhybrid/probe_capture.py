"""Captures reflection probes: the six faces of each are frames of the renderer itself, that reflect the sky."""

import dataclasses
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from glhybrid import content_cache, needs, probe_placement, probe_surfaces, techniques
from glhybrid.passes.probe import Probe
from glhybrid.probe_placement import SIGHT, Sight
from glhybrid.probe_surfaces import clarity
from glhybrid.scene import F64, Camera
from glhybrid.scene import Probe as Placed
from glhybrid.timing import Progress, Timing
from glhybrid.view import View, make_view

if TYPE_CHECKING:
    from glhybrid.staged import Staged

VERSION = 3  # of how places are chosen
FEW_TRIANGLES = 100_000  # past it a tree is sooner built than all is drawn some 200 times
EYES = 4  # cameras of a scene that have a say


class _Looking:
    """Frames of a staging from a point along an axis, with its trees, buffers and lights. size: pixels a side."""

    def __init__(self, staged: "Staged", size: int, fov: float, **changes: str) -> None:
        self._staged, self._fov = staged, fov
        settings = staged.settings.replace(aa=1, **changes)
        self.inner = type(staged)(
            staged.context, staged.shaders, staged.scene, settings, (size, size), (), (staged.upload, staged.mover)
        )
        bounds = staged.bounds
        self._near = min(0.01, 1e-4 * float(np.linalg.norm(bounds[1] - bounds[0])) or 0.01)

    def view(self, position: F64, face: int) -> View:
        staged = self._staged
        camera = Camera("probe", probe_placement.face_pose(position, face), fov_y=self._fov, near=self._near)
        clip_control = staged.context.limits.clip_control
        return make_view(camera, self.inner.targets.size, staged.drawn, clip_control, staged.bounds)

    def release(self) -> None:
        self.inner.release(keep_upload=True)


class Capture:
    """Renders what a staging shows from its probes."""

    def __init__(self, staged: "Staged", probe: Probe) -> None:
        # A border texel around 90 degrees, so that texels are blended across edges with what lies there.
        fov = 2 * float(np.arctan(1 + 2 / probe.resolution))
        self._looking, self._probe, self._staged = (
            _Looking(staged, probe.face_size, fov, reflections="env"),
            probe,
            staged,
        )

    def run(self, wanted: list[int]) -> None:
        """Captures these of the placed probes."""
        looking, inner, probe, staged = self._looking, self._looking.inner, self._probe, self._staged
        inner.scene, inner.drawn = staged.scene, staged.drawn
        inner.constants.under(staged.scene, inner.settings)
        inner.resume(staged.scene, inner.settings, inner.targets.size)
        timing = Timing(staged.context.gl.finish, enabled=False)
        for k in wanted:
            for face in range(6):
                inner.look(looking.view(np.asarray(probe.placed[k].position), face))
                inner.set(jitter_px=(0, 0), accumulate=0)
                probe.store(k, face, inner.frame(timing))
            probe.blur(k, keep=staged.mover is None)
            probe.captured.add(k)

    def release(self) -> None:
        self._looking.release()


def place(staged: "Staged", probe: Probe, progress: Progress | None) -> None:
    """Where the scene has probes, or where its surfaces want them: as kept on disk, or looked for."""
    scene = staged.drawn
    placed = scene.probes
    if not placed:
        name = _key(staged)
        kept = content_cache.read("probe", name)
        found = _read(kept) if kept is not None else _choose(staged, progress)
        if kept is None:
            content_cache.write("probe", name, json.dumps([dataclasses.asdict(p) for p in found]).encode())
        placed = tuple(found)
    boxes = None
    if staged.mover is None:  # what moves may come anywhere
        cutoff = techniques.cutoff(staged.settings)
        mirrors = [needs.reflective(m, cutoff) for m in scene.materials]
        own = [[p.material for p in mesh.primitives] for mesh in scene.meshes]
        wanted = [any(mirrors[m] for m in i.materials or own[i.mesh]) for i in scene.instances]
        boxes = scene.instance_bounds[np.array(wanted, bool)]
    probe.place(placed, boxes)


def _read(kept: bytes) -> list[Placed]:
    """Places as written by place()."""

    def tuples(value: Any) -> Any:
        return tuple(map(tuples, value)) if isinstance(value, list) else value

    return [Placed(**{name: tuples(value) for name, value in row.items()}) for row in json.loads(kept)]


def _choose(staged: "Staged", progress: Progress | None) -> list[Placed]:
    settings, scene, bounds = staged.settings, staged.drawn, staged.bounds
    surfaces = probe_surfaces.sample(scene, techniques.cutoff(settings))
    eyes = [c.world_from_view[:3, 3] for c in scene.cameras[:EYES] if np.isfinite(c.world_from_view).all()]
    eyes = [eye for eye in eyes if (eye > bounds[0]).all() and (eye < bounds[1]).all()]
    trace = staged.upload.trees is not None or scene.triangle_count() > FEW_TRIANGLES
    plain = {"shadows": "none", "reflections": "none", "ao": "none", "primary": "trace" if trace else "raster"}
    looking = _Looking(staged, SIGHT, np.pi / 2, **plain)
    done = 0

    def look(position: F64) -> Sight:
        nonlocal done
        faces = []
        for face in range(6):
            view = looking.view(position, face)
            looking.inner.look(view)
            faces.append(looking.inner.aov("distance", view)[::-1])
        done += 1
        if progress is not None:
            progress("placing probes", done, 0)
        return Sight(position, np.stack(faces).astype(np.float64))

    count = int(settings.parameter("reflections.probe.count"))
    blend = float(settings.parameter("reflections.probe.blend"))
    try:
        looking.inner.resume(staged.scene, looking.inner.settings, looking.inner.targets.size)
        found = probe_placement.place(surfaces, eyes, bounds, count, blend, look)
    finally:
        looking.release()
    return list(found)


def _key(staged: "Staged") -> str:
    """Of all that the places depend on."""
    scene, geometry, settings = staged.drawn, staged.upload.geometry, staged.settings
    cutoff = techniques.cutoff(settings)
    arrays = (
        geometry.vertices, geometry.triangles, geometry.instance_mesh, geometry.world_from_object, geometry.records,
        geometry.hit_groups, staged.bounds, *(c.world_from_view for c in scene.cameras[:EYES]),
    )  # fmt: skip
    numbers = (
        VERSION, staged.mover is not None, [(clarity(m, cutoff), m.double_sided) for m in geometry.materials],
        settings.parameter("reflections.probe.count"), settings.parameter("reflections.probe.blend"),
        str(staged.context.device),
    )  # fmt: skip
    return content_cache.key(*(np.ascontiguousarray(a).tobytes() for a in arrays), repr(numbers).encode())
