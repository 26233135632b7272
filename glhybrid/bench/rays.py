"""A scene's rays, made once, and the variants of the tracer that follow them.

Rays are made on the device as the passes make them: camera rays by 8x8 tiles in Morton order, then from their exact
hits one shadow ray to the scene's first light, one mirror ray and one cosine-distributed ray, in the same order. Only
live rays are kept. For the sake of comparison every surface is opaque and two-sided here, also in scenes from files.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from glhybrid import geometry, layout, plan
from glhybrid.context import Context
from glhybrid.gl import GL_RGBA32F, BufferTexture
from glhybrid.gpu_scene import GpuScene
from glhybrid.levels import choose_levels
from glhybrid.load.defaults import default_light
from glhybrid.owned import Owned
from glhybrid.scene import F32, F64, Camera, Light, Material, Scene, Sphere
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.view import make_view

CLASSES = ("camera", "shadow", "mirror", "diffuse")
ANY_HIT = "shadow"  # the class that asks any hit; the others ask for the closest
UNBOUNDED = 1 << 20  # inner nodes in a row: until a leaf
MOST_FLAT = 8_000_000  # triangles: instances beyond are not flattened for a variant or a peer
LIFT = 2.0**-20  # of the largest coordinate: 16 ulp, what rays of a bounce start above their surface
ROOMY_STACK = 64  # entries where nothing is timed: one program makes the rays of most scenes
MOST_RAYS = 1 << 22  # of one class: 2 texels each, 32 bytes, within the storage blocks of every driver


@dataclass(frozen=True)
class Variant:
    """One way to trace: levels of trees, and how many inner nodes a turn of the loop may visit before a leaf."""

    levels: int
    inner_steps: int

    def __str__(self) -> str:
        steps = "all" if self.inner_steps >= UNBOUNDED else str(self.inner_steps)
        return f"{self.levels} level{'s' if self.levels > 1 else ''}, inner {steps}, woop"


@dataclass(frozen=True, eq=False)
class Rays:
    """One class of rays: (R, 8) float32 origin, t_max, direction, 0; in the world rebased on the tracer's origin."""

    data: F32

    def __len__(self) -> int:
        return len(self.data)

    @property
    def origin(self) -> F32:
        """(R, 3), metres."""
        return np.ascontiguousarray(self.data[:, :3])

    @property
    def direction(self) -> F32:
        """(R, 3), unit."""
        return np.ascontiguousarray(self.data[:, 4:7])

    @property
    def t_max(self) -> F32:
        """(R,), metres; infinite unless the ray ends at a light."""
        return np.ascontiguousarray(self.data[:, 3])


def plain(scene: Scene) -> Scene:
    """The scene with opaque, two-sided materials and exactly one light: only shapes and distances are left."""
    lights = scene.lights[:1] or (default_light()[1],)
    light = lights[0]
    # No range and no cone: every surface that faces the lamp sends its ray.
    lamp = Light(
        "directional" if light.kind == "directional" else "point", position=light.position, direction=light.direction
    )
    return scene.replace(
        materials=(Material(double_sided=True),) * len(scene.materials), lights=(lamp,), environment=None
    )


def default_variant(scene: Scene, software: bool) -> Variant:
    """What the renderer would run for this scene on this device."""
    planned = plan.make(scene, Settings(), software=software)
    return Variant(planned.levels, min(planned.features.bvh_inner_steps, UNBOUNDED))


def variants(scene: Scene, software: bool) -> list[Variant]:
    """All of them, the renderer's own first: every bound of the inner loop, and the other number of levels."""
    own = default_variant(scene, software)
    found = [own, *(Variant(own.levels, steps) for steps in (1, 2, 3, 4, UNBOUNDED))]
    other = 3 - own.levels
    if choose_levels(scene, other)[0] == other and (other == 2 or scene.triangle_count() <= MOST_FLAT):
        found.append(Variant(other, own.inner_steps))
    return list(dict.fromkeys(found))


class Structure:
    """One scene on the device in one or two levels, ready for rays in the world rebased on `origin`."""

    def __init__(self, context: Context, shaders: Shaders, scene: Scene, levels: int, origin: F64) -> None:
        self.shaders = shaders
        self.geometry = geometry.build(scene, levels, tangents=False, attributes=False)
        planned = plan.make(scene, Settings(), software=context.device.software).features
        features = planned.replace(two_level=self.geometry.levels == 2)
        self.upload = GpuScene(context, scene, self.geometry, features)
        self.features = features.replace(bvh_stack=self.upload.stack_entries)
        self.upload.rebase(origin)
        self.constants = np.zeros(1, layout.dtype("FrameConstants"))
        self.constants["top_root"] = self.upload.top_root
        self.constants["top_grid_min"], self.constants["top_grid_step"] = self.upload.top_grid(origin)
        self.frame = context.gl.buffer(self.constants)
        self.resources: dict[str, Any] = {**self.upload.resources, "Frame": self.frame}

    def program(self, stem: str, **changes: Any) -> Any:
        """A kernel of glsl/bench for this scene. changes: features that differ from the renderer's."""
        return self.shaders.compute(stem, self.features.replace(**changes), folder="bench")

    def release(self) -> None:
        self.frame.release()
        self.upload.release()


class Tracer:
    """A scene, its rays of every class, and launches of any variant on them. Owns its GL objects; close() frees them.

    scene: made `plain` here. size: pixels of the camera's image, one ray of each class for each at most.
    """

    def __init__(self, context: Context, shaders: Shaders, scene: Scene, camera: Camera, size: tuple[int, int]) -> None:
        assert size[0] * size[1] <= MOST_RAYS
        self.context, self.shaders, self.scene = context, shaders, plain(scene)
        self.view = make_view(camera, size, self.scene)
        self._structures: dict[int, Structure] = {}
        self._owned = Owned()
        self.extent = float(np.abs(self.scene.bounds() - self.view.origin).max())  # largest |coordinate|, m
        self.own = default_variant(self.scene, context.device.software)
        self.rays = {name: self._make_rays(name) for name in CLASSES}
        self._sources = {name: self._upload_rays(rays) for name, rays in self.rays.items()}

    def structure(self, levels: int) -> Structure:
        """Made when it is first asked for. levels: 1 or 2."""
        if levels not in self._structures:
            self._structures[levels] = Structure(
                self.context, self.shaders, self.scene, levels, self.view.origin
            )  # fmt: skip
        return self._structures[levels]

    def _make_rays(self, name: str) -> Rays:
        structure, view = self.structure(self.own.levels), self.view
        values: dict[str, Any] = {
            "eye_ws": view.eye, "right_ws": view.right, "up_ws": view.up, "forward_ws": view.forward,
            "orthographic": view.orthographic, "size_px": view.size, "light_count": 1, "light_end": 1,
        }  # fmt: skip
        for field, value in values.items():
            structure.constants[0][field] = value
        self.context.write(structure.frame, structure.constants)
        width, height = (-(-side // 8) for side in view.size)
        target = self.context.gl.buffer(reserve=width * height * 64 * 32)
        stack = max(ROOMY_STACK, structure.features.bvh_stack)
        structure.program("rays", bvh_inner_steps=self.own.inner_steps, bvh_stack=stack).dispatch(
            {**structure.resources, "Rays": target, "ray_class": CLASSES.index(name), "lift": LIFT * self.extent},
            (width, height),
            (1, 1),
        )
        data = np.frombuffer(target.read(), np.float32).reshape(-1, 8)
        target.release()
        return Rays(data[data[:, 3] >= 0].copy())

    def _upload_rays(self, rays: Rays) -> BufferTexture:
        buffer = self._owned.add(self.context.gl.buffer(rays.data if len(rays) else bytes(32)))
        return self._owned.add(BufferTexture(self.context.raw, buffer, GL_RGBA32F))

    def launch(self, name: str, variant: Variant) -> tuple[Callable[[], None], Callable[[], NDArray[Any]]]:
        """One dispatch over the rays of a class, compiled now; and what it found: t, or whether the ray is blocked."""
        run, target, _ = self._prepare(name, variant, step_counter=False)
        return run, lambda: _found(name, target, len(self.rays[name]))

    def steps(self, name: str, variant: Variant) -> float:
        """Inner nodes and triangles visited, a ray. Its own program: counting costs time."""
        run, _, counts = self._prepare(name, variant, step_counter=True)
        run()
        assert counts is not None
        total = np.frombuffer(counts.read(), np.uint32)[: len(self.rays[name])]
        return float(total.mean()) if len(total) else 0.0

    def _prepare(self, name: str, variant: Variant, step_counter: bool) -> tuple[Callable[[], None], Any, Any]:
        structure, count = self.structure(variant.levels), len(self.rays[name])
        stem = "any" if name == ANY_HIT else "closest"
        program = structure.program(stem, bvh_inner_steps=variant.inner_steps, step_counter=step_counter)
        target = self._buffer(max(count, 1) * (4 if name == ANY_HIT else 8))
        resources = {**structure.resources, "rays": self._sources[name], "Found": target, "ray_count": count}
        counts = self._buffer(max(count, 1) * 4) if step_counter else None
        if counts is not None:
            resources["Steps"] = counts
        grid = (min(count, 65536), -(-count // 65536))
        return lambda: program.dispatch(resources, grid, (64, 1)), target, counts

    def _buffer(self, size: int) -> moderngl.Buffer:
        return self._owned.add(self.context.gl.buffer(reserve=size))

    def triangles(self) -> F32 | None:
        """(T, 3, 3) everything there is, in the space of the rays; None with analytic spheres or too many triangles."""
        spheres = any(isinstance(p, Sphere) for i in self.scene.instances for p in self.scene.meshes[i.mesh].primitives)
        if spheres or self.scene.triangle_count() > MOST_FLAT:
            return None
        found, corners = self.structure(self.own.levels).geometry, []
        for mesh, pose in zip(found.instance_mesh.tolist(), found.world_from_object, strict=True):
            rows = np.concatenate([np.arange(first, first + n) for first, n in found.meshes[mesh].geometries])
            local = found.vertices[found.triangles[rows, :3], :3].astype(np.float64)
            corners.append((local @ pose[:3, :3].T + (pose[:3, 3] - self.view.origin)).astype(np.float32))
        return np.concatenate(corners) if corners else None

    def close(self) -> None:
        """Frees rays and structures."""
        self._owned.release()
        for structure in self._structures.values():
            structure.release()
        self._structures.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _found(name: str, target: moderngl.Buffer, count: int) -> NDArray[Any]:
    data = np.frombuffer(target.read(), np.uint32)
    if name == ANY_HIT:
        return data[:count] == 1
    return data.reshape(-1, 2)[:count, 0].copy().view(np.float32)
