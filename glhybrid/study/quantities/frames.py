"""Measures of a whole frame: what it hits, what changes it, how open its sky is, and what flips in motion."""

from dataclasses import replace

import numpy as np

from glhybrid.image import Frame
from glhybrid.study import metrics, temporal
from glhybrid.study.quantities.registry import quantity
from glhybrid.study.subject import Measured, Subject, grey, marked


@quantity("%")
def wrong_hit(subject: Subject, border: bool = True) -> Measured:
    """Pixels whose first surface is another, or 1e-4 of the distance off. border: outlines by a pixel do not count."""
    seen = subject.case.seen()
    instance, distance, picture = subject.hits()
    with np.errstate(invalid="ignore"):
        off = np.abs(distance - seen.hit.t) > 1e-4 * seen.hit.t
    wrong = (instance != seen.hit.instance) | (seen.covered & (instance >= 0) & off)
    counted = seen.covered | (instance >= 0)
    if border:
        flat = np.isfinite(seen.hit.t)
        with np.errstate(divide="ignore"):
            steps = np.where(flat, np.floor(np.log2(np.where(flat, seen.hit.t, 1))), 1e6)
        counted &= ~metrics.edge_band(steps)
    return Measured(100 * float((wrong & counted).sum()) / max(int(counted.sum()), 1), marked(picture, wrong & counted))


@quantity("%")
def parity(subject: Subject, where: str = "outside") -> Measured:
    """Pixels where rays from the camera meet another object than its raster shows, or 1e-4 of the distance off.

    where: outside the pixels next to an outline, or inside: on those, of which both ways may take either side.
    """
    raster = Subject(subject.renderer, subject.case, subject.case_settings.replace(primary="raster"))
    want, distance, _ = subject.case.once("raster", raster.hits)
    instance, got, picture = subject.hits()
    with np.errstate(invalid="ignore"):
        off = (want >= 0) & ~(np.abs(got - distance) <= 1e-4 * distance)
    wrong, edge = (instance != want) | off, metrics.edge_band(want)
    if where == "inside":
        wrong = instance != want
    counted = ((want >= 0) | (instance >= 0)) & (edge if where == "inside" else ~edge)
    return Measured(100 * float((wrong & counted).sum()) / max(int(counted.sum()), 1), marked(picture, wrong & counted))


@quantity("%")
def changed(subject: Subject, without: str) -> Measured:
    """Pixels whose radiance differs by more than a hundredth from the picture without the objects of a name."""
    scene = subject.case.scene
    clean = scene.replace(instances=tuple(i for i in scene.instances if i.name != without))
    assert len(clean.instances) < len(scene.instances), f'no object is named "{without}"'
    want = subject.frame(scene=clean)["radiance"]
    frame = subject.frame()
    got = frame["radiance"]
    with np.errstate(invalid="ignore"):
        wrong = ~(np.abs(got - want) <= 0.01 * np.abs(want) + 1e-4).all(-1)
    return Measured(100 * float(wrong.mean()), marked(frame.rgb, wrong))


@quantity("open share")
def occlusion_error(subject: Subject, height: float, reach: float = 3.0) -> Measured:
    """Mean distance of ambient occlusion from its closed form, on the floor y = 0 before a wall of a height at x = 0.

    A(x) = (1 + x / sqrt(x^2 + height^2)) / 2 for an endless wall; only where 0 < x < reach.
    """
    seen, frame = subject.case.seen(), subject.frame("occlusion")
    x = seen.position[..., 0]
    floor = seen.covered & (np.abs(seen.position[..., 1]) < 1e-6) & (x > 0) & (x < reach)
    error = np.abs(frame["occlusion"] - 0.5 * (1 + x / np.hypot(x, height)))
    return Measured(float(error[floor].mean()), grey(frame["occlusion"]))


@quantity("%")
def sky_let_in(subject: Subject) -> Measured:
    """The open share of the sky that ambient occlusion finds, as a mean over all pixels: of a closed room none."""
    frame = subject.frame("occlusion")
    return Measured(100 * float(frame["occlusion"].mean()), grey(frame["occlusion"]))


@quantity("% a frame")
def flips(subject: Subject, what: str = "visibility", frames: int = 9) -> Measured:
    """Points whose shadow changes sides from frame to frame of a pan by whole pixels of an orthographic camera.

    what: visibility, or reflection: mirror images that change by more than a thousandth.
    """
    case = subject.case
    camera, size = case.scene.cameras[0], case.study.size
    assert camera.fov_y == 0, "a pan shows the same points again only without perspective"
    shots: list[Frame] = []
    for k in range(frames):
        pose = camera.world_from_view.copy()
        pose[:3, 3] += k * 2 * camera.ymag / size[1] * pose[:3, 0]
        moved = replace(camera, name=f"pan {k}", world_from_view=pose)
        shots.append(subject.frame(what, "motion", "triangle_id", "instance_id", camera=moved))
    old, new = shots[-2:]
    fixed, row, column = temporal.matches(old, new)
    if what == "visibility":
        rate, marks = temporal.flip_rate(shots), ((old[what][row, column] > 0.5) != (new[what] > 0.5)).any(-1)
    else:
        rate = temporal.change_rate(shots, [np.asarray((shot[what] > 0).any(-1)) for shot in shots[1:]])
        marks = np.abs(old[what][row, column] - new[what]).max(-1) > 0.1 * new[what].max(-1)
    return Measured(rate, marked(new.rgb, fixed & marks))
