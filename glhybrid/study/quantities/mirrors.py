"""Measures of exact mirrors."""

from dataclasses import replace
from typing import Any

import numpy as np

from glhybrid.scene import F64
from glhybrid.study import metrics
from glhybrid.study.quantities.registry import quantity
from glhybrid.study.subject import Case, Measured, Subject, marked


@quantity("%")
def wrong_reflection(subject: Subject, of: str = "", mirrors: str = "", bounces: int = 8) -> Measured:
    """Mirror pixels that do not show the colour of what their ray meets, but for a border of one pixel in the image.

    For scenes of perfect mirrors, unlit colours and a constant sky. of: only where the truth is an object of that name,
    or "sky"; mirrors: only pixels on an object of that name. bounces: mirrors
    after the first that the truth follows; pixels that would need more do not count.
    """
    case = subject.case
    want, met, counted = case.once(("mirrored", bounces), lambda: _mirrored(case, bounces))
    names = np.array([*(i.name for i in case.scene.instances), "sky"])
    if mirrors:
        counted = counted & (names[case.seen().hit.instance] == mirrors)
    border = metrics.edge_band(np.stack([met, case.seen().hit.instance], -1))
    counted = counted & ~border
    if of:
        counted = counted & (names[met] == of)
    frame = subject.frame()
    scale = max(float(want[counted].max(initial=0)), 1e-6)
    wrong = counted & ~(np.abs(frame["radiance"] - want) <= 0.1 * scale).all(-1)
    return Measured(100 * float(wrong.sum()) / max(int(counted.sum()), 1), marked(frame.rgb, wrong))


@quantity("%")
def wrong_image(subject: Subject, mirror: str) -> Measured:
    """Pixels of a flat mirror that differ from the raster of the world behind it, but for a border of one pixel.

    The world behind: everything else upside down, without the mirror, rasterised from the same camera. For a perfect
    mirror in the plane y = 0, of colour 1, under unlit bodies: its pixels are then those of that picture. No ray, no
    tree and no reflected direction has a part in it.
    """
    case, size = subject.case, subject.case.study.size

    def behind() -> tuple[Any, Any]:
        turned = np.diag([1.0, -1.0, 1.0, 1.0])
        kept = tuple(
            replace(i, world_from_object=turned @ i.world_from_object) for i in case.scene.instances if i.name != mirror
        )
        assert len(kept) < len(case.scene.instances), f'no object is named "{mirror}"'
        plain = subject.case_settings.replace(shadows="none", reflections="none", primary="raster")
        world = case.scene.replace(instances=kept)
        frame = subject.renderer.render(world, 0, size, plain, ("instance_id",))
        return frame["radiance"], frame["instance_id"]

    want, met = case.once(("behind", mirror), behind)
    names = np.array([*(i.name for i in case.scene.instances), "sky"])
    on = names[case.seen().hit.instance] == mirror
    counted = on & ~metrics.edge_band(np.stack([met.astype(np.int64), case.seen().hit.instance], -1))
    frame = subject.frame()
    wrong = counted & ~(np.abs(frame["radiance"] - want) <= 0.1 * float(want[counted].max())).all(-1)
    return Measured(100 * float(wrong.sum()) / max(int(counted.sum()), 1), marked(frame.rgb, wrong))


def _mirrored(case: Case, bounces: int) -> tuple[F64, Any, Any]:
    """What mirrors show, (H, W, 3), the instance met, (H, W), -1 for the sky, and which pixels these are.

    Pixels that see one mirror after another for more than `bounces` are not among them.
    """
    scene, seen = case.scene, case.seen()
    materials = scene.materials
    mirror = np.array([m.metallic == 1 and m.roughness < 0.02 and not m.unlit for m in materials] + [False])
    assert all(m.unlit or known for m, known in zip(materials, mirror, strict=False)), "mirrors and unlit colours only"
    assert scene.environment is None or scene.environment.constant
    sky = scene.environment.radiance[0, 0] * scene.environment.intensity if scene.environment else np.zeros(3)
    color = np.array([[x + y for x, y in zip(m.base_color, (*m.emissive, 0), strict=False)][:3] for m in materials])
    color = np.concatenate([color, sky[None]])
    on = seen.covered & mirror[seen.hit.material]
    start, way, normal = seen.position[on], seen.direction[on], seen.hit.normal[on]
    material, through = seen.hit.material[on], np.ones((int(on.sum()), 3))
    shown, met = np.zeros_like(through), np.full(len(through), -1)
    live = np.arange(len(through))
    for _ in range(bounces + 1):
        cosine = np.abs((way * normal).sum(1, keepdims=True))
        through[live] *= color[material] + (1 - color[material]) * (1 - cosine) ** 5  # Schlick, F0 = colour of a metal
        way = way - 2 * (way * normal).sum(1, keepdims=True) * normal
        hit = case.oracle.closest(start + case.oracle.offset * normal, way)
        met[live] = hit.instance
        again = mirror[hit.material]
        shown[live[~again]] = color[hit.material[~again]]
        live, material, normal = live[again], hit.material[again], hit.normal[again]
        start, way = start[again] + hit.t[again, None] * way[again], way[again]
    image, instance = np.zeros((*on.shape, 3)), np.full(on.shape, -1)
    image[on], instance[on] = through * shown, met
    on[tuple(place[live] for place in np.nonzero(on))] = False
    return image, instance, on
