"""What a reflection shows: the right object, at the right point? Asked with a scene in which every object shines in a
colour of its own and nothing else does, so that the colour at a mirror says what is seen in it, whatever made it; and
by the point that is shown there (reflected_points.py), drawn where the mirror would have it: so many pixels from the
true one.

Held against exact mirror rays in the same scene.
"""

from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glhybrid.renderer import Renderer
from glhybrid.scene import F32, F64, Camera, Instance, Material, Scene
from glhybrid.settings import Settings
from glhybrid.study.reflected_points import Rays, shown_points

SMOOTH = 0.3  # roughness up to which a surface is looked at: what rougher ones show has no outline
LEVELS = 8  # of each channel of a code: 511 objects, then codes come again
EXACT = Settings(shadows="none", reflections="ray-lerp", aa=1)
KEPT = ("normal", "base_color")  # textures that decide directions and holes
RIGHT_PX, RIGHT_SHARE = 0.5, 0.02  # a point is right within so many pixels, and this share of its distance


@dataclass(frozen=True)
class Shown:
    """right_object_percent: of smooth pixels, those that show what is there. right_point_percent: of the same, those
    that show its very point: within RIGHT_PX, and RIGHT_SHARE of its distance.

    Of those that show the right object, where a technique tells a point: reflected_error_px: median distance on the
    picture between the point shown and the true one, and _p95 its 95th percentile; reflected_distance_error_percent:
    of the length of the mirror ray, median. None where no point is told.
    """

    right_object_percent: float
    right_point_percent: float | None
    reflected_error_px: float | None
    reflected_error_px_p95: float | None
    reflected_distance_error_percent: float | None

    to_dict = asdict


NOTHING = dict.fromkeys(Shown.__dataclass_fields__)  # of a picture without mirrors


@dataclass(frozen=True, eq=False)
class Mirrors:
    """A coded scene, what its mirrors truly show, and which pixels count."""

    scene: Scene
    camera: Camera
    size: tuple[int, int]
    counted: NDArray[np.bool_]
    colour: F32
    distance: F32
    rays: Rays

    def ask(self, renderer: Renderer, settings: Settings) -> Shown:
        """What a technique shows of it; shadows have no say."""
        return self.judge(*self.look(renderer, settings))

    def look(self, renderer: Renderer, settings: Settings) -> tuple[F32, F64 | None]:
        """Colours (H, W, 3) in the mirrors, and the points (H, W, 3) shown there; None where none is to be told."""
        settings = settings.replace(shadows="none")
        aovs = ("reflection", "reflection_hit", "reason", "position")
        frame = renderer.render(self.scene, self.camera, self.size, settings, aovs=aovs)
        told = self._right(frame["reflection"]) & np.isfinite(self.distance) & (self.distance > 0)
        points = shown_points(renderer, self.scene, self.rays, frame, settings) if told.any() else None
        return frame["reflection"], points

    def _right(self, colour: F32) -> NDArray[np.bool_]:
        return self.counted & (np.abs(colour - self.colour).max(-1) < 0.25 / LEVELS)

    def judge(self, colour: F32, points: F64 | None) -> Shown:
        """The figures of what look() gave; without OpenGL."""
        right = self._right(colour)
        count = max(int(self.counted.sum()), 1)
        percent = 100 * float(right.sum()) / count
        sky = right & np.isinf(self.distance)
        if points is None:
            return Shown(percent, 100 * float(sky.sum()) / count, None, None, None)
        told = right & np.isfinite(self.distance) & (self.distance > 0)
        px, share = self.rays.error_px(points), self._away(points)
        known = told & np.isfinite(share)
        if not known.any():  # it shows objects, and tells no points
            return Shown(percent, None, None, None, None)
        exact = sky | (known & (px <= RIGHT_PX) & (share <= RIGHT_SHARE))
        middle, most = np.percentile(px[known], (50, 95), method="nearest").tolist()
        length = np.linalg.norm(points[known] - self.rays.origin[known], axis=-1)
        distance = np.abs(length / self.distance[known] - 1)
        return Shown(
            percent, 100 * float(exact.sum()) / count, float(middle), float(most), 100 * float(np.median(distance))
        )

    def _away(self, points: F64) -> F64:
        """(H, W) distance of shown points from the true ones, over the length of the mirror ray."""
        with np.errstate(invalid="ignore"):
            apart = np.linalg.norm(points - self.rays.at(self.distance), axis=-1)
            return np.asarray(apart / self.distance)


def find(renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int]) -> Mirrors | None:
    """None where no surface that the camera sees is smooth enough."""
    plain = Settings(shadows="none", reflections="none", aa=1)
    seen = renderer.render(scene, camera, size, plain, aovs=("roughness", "instance_id"))
    counted = (seen["instance_id"] != 0xFFFFFFFF) & (seen["roughness"] <= SMOOTH)
    if not counted.any():
        return None
    marked = coded(scene)
    aovs = ("reflection", "reflection_hit", "position", "normal", "normal_geometric")
    truth = renderer.render(marked, camera, size, EXACT, aovs=aovs)
    counted &= truth["reflection_hit"] > 0
    rays = Rays.of(marked, camera, size, truth)
    return Mirrors(marked, camera, size, counted, truth["reflection"], truth["reflection_hit"], rays)


def coded(scene: Scene) -> Scene:
    """Every object a mirror that shines in its code; no lights, no sky."""
    materials: list[Material] = []
    instances: list[Instance] = []
    for number, instance in enumerate(scene.instances):
        pieces = scene.meshes[instance.mesh].primitives
        chosen = instance.materials or tuple(p.material for p in pieces)
        rows = []
        for row in chosen:
            old = scene.materials[row]
            rows.append(len(materials))
            materials.append(
                replace(
                    old, base_color=(1.0, 1.0, 1.0, old.base_color[3]), metallic=1.0, roughness=0.0, unlit=False,
                    emissive=code(number), clearcoat=0.0, transmission=0.0,
                    textures={slot: t for slot, t in old.textures.items() if slot in KEPT},
                )
            )  # fmt: skip
        instances.append(replace(instance, materials=tuple(rows)))
    return scene.replace(
        lights=(), environment=None, materials=tuple(materials) or scene.materials, instances=tuple(instances)
    )


def code(number: int) -> tuple[float, float, float]:
    """A colour that no neighbour shares; black is the sky's."""
    n = number % (LEVELS**3 - 1) + 1
    return n % LEVELS / LEVELS, n // LEVELS % LEVELS / LEVELS, n // LEVELS**2 / LEVELS
