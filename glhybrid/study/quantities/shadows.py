"""Measures of shadows: right by pixels, by penumbrae, by borders."""

import numpy as np

from glhybrid.study import metrics
from glhybrid.study.quantities.registry import quantity
from glhybrid.study.subject import Measured, Subject, marked


@quantity("%")
def wrong_shadow(subject: Subject, where: str = "all") -> Measured:
    """Pixels that face the light and are on the wrong side of one half, all, or outside or inside the true border."""
    case = subject.case
    want, counted = case.visibility(), case.oracle.facing(case.seen(), case.scene.lights[0])
    got, picture = subject.visibility()
    wrong = metrics.wrong_shadow_percent(got, want, counted)
    return Measured(getattr(wrong, where), marked(picture, counted & (np.abs(got - want) > 0.5)))


@quantity("%")
def false_light(subject: Subject, over: float = 0.5) -> Measured:
    """Pixels in true shadow that are lit, of those in true shadow that face the light. over: the share that counts."""
    case = subject.case
    counted = case.oracle.facing(case.seen(), case.scene.lights[0]) & (case.visibility() == 0)
    got, picture = subject.visibility()
    lit = counted & (got > over)
    return Measured(100 * float(lit.sum()) / max(int(counted.sum()), 1), marked(picture, lit))


@quantity("%")
def false_shadow(subject: Subject, under: float = 0.5) -> Measured:
    """Pixels in the light that are dark, of those in the light. under: the visibility that counts."""
    case = subject.case
    counted = case.oracle.facing(case.seen(), case.scene.lights[0]) & (case.visibility() == 1)
    got, picture = subject.visibility()
    dark = counted & (got < under)
    return Measured(100 * float(dark.sum()) / max(int(counted.sum()), 1), marked(picture, dark))


@quantity("visibility")
def seams(subject: Subject, samples: int = 256) -> Measured:
    """The step in visibility between neighbouring pixels of smooth penumbrae that only 1 in 1,000 pairs exceeds.

    Smooth: where rays to all of the lamp, as many as `samples`, find less than 0.03 of a step.
    """
    case = subject.case
    true = subject.settings.replace(shadows="ray-soft", parameters={"shadows.ray-soft.samples": samples})
    want, _ = case.once("soft", lambda: Subject(subject.renderer, case, true).visibility())
    got, picture = subject.visibility()
    seen, facing = case.seen(), case.oracle.facing(case.seen(), case.scene.lights[0])
    steps, marks = [], np.zeros(want.shape, bool)
    for axis in (0, 1):
        low, high = ((slice(None, -1), slice(1, None))[k] for k in (0, 1))
        pair = [(s, slice(None)) if axis == 0 else (slice(None), s) for s in (low, high)]
        a, b = pair
        flat = (seen.hit.normal[a] * seen.hit.normal[b]).sum(-1) > 0.9
        smooth = facing[a] & facing[b] & flat & (seen.hit.instance[a] == seen.hit.instance[b])
        smooth &= np.abs(want[a] - want[b]) < 0.03
        step = np.abs(got[a] - got[b])
        steps.append(step[smooth])
        marks[a] |= smooth & (step > 0.08)
    return Measured(float(np.quantile(np.concatenate(steps), 0.999)), marked(picture, marks))


@quantity("visibility")
def visibility_error(subject: Subject) -> Measured:
    """Mean distance of visibility from the truth, over pixels that face the light."""
    case = subject.case
    want, counted = case.visibility(), case.oracle.facing(case.seen(), case.scene.lights[0])
    got, picture = subject.visibility()
    return Measured(metrics.visibility_mae(got, want, counted), marked(picture, counted & (np.abs(got - want) > 0.1)))


@quantity("m")
def light_gap(subject: Subject, contact: list[float]) -> Measured:
    """How far behind an object's foot light comes in: along the sun's way from a point of contact, flat."""
    case = subject.case
    seen, light = case.seen(), case.scene.lights[0]
    way = np.array([light.direction[0], 0, light.direction[2]])
    along = (seen.position - contact) @ (way / np.linalg.norm(way))
    ground = case.oracle.facing(seen, light) & (np.abs(seen.position[..., 1] - contact[1]) < 1e-6) & (along > 0)
    dark = ground & (case.visibility() == 0)
    got, picture = subject.visibility()
    lit = dark & (got > 0.5)
    near = lit & (along < np.min(along[dark & ~lit], initial=np.inf) + 1e-9)  # before the shadow begins
    return Measured(float(along[near].max(initial=0.0)), marked(picture, lit))


@quantity("times the true width")
def penumbra_width(subject: Subject, heights: list[float]) -> Measured:
    """The width of a straight edge's penumbra at x = 0, fitted, over the true one, where it is most wrong.

    A camera for each height of the edge above the floor y = 0. Every pixel of the floor is a sample of the profile.
    """
    case = subject.case
    half_angle = case.scene.lights[0].angular_diameter / 2
    ratios, picture = [], None
    for camera, height in enumerate(heights):
        seen = case.seen(camera)
        true = height * np.tan(half_angle)
        floor = seen.covered & (np.abs(seen.position[..., 1]) < 1e-6) & (np.abs(seen.position[..., 0]) < 6 * true)
        got, shown = subject.visibility(camera)
        widths = true * np.geomspace(1 / 64, 16, 241)  # 4 % steps, then the least squares' own minimum between them
        x, v = seen.position[floor][:, 0], got[floor]
        error = np.array([np.square(metrics.disc_visibility(x / w) - v).mean() for w in widths])
        k = int(np.clip(error.argmin(), 1, len(widths) - 2))
        low, middle, high = error[k - 1 : k + 2]
        shift = 0.5 * (low - high) / (low - 2 * middle + high) if low + high > 2 * middle else 0.0
        ratios.append(float(widths[k] * (widths[1] / widths[0]) ** shift / true))
        picture = shown if picture is None else np.concatenate([picture, shown], axis=1)
    assert picture is not None
    return Measured(max(ratios, key=lambda r: abs(np.log(r))), picture)


@quantity("visibility")
def penumbra_error(subject: Subject, heights: list[float]) -> Measured:
    """Mean distance of visibility from a disc's closed form in the penumbra of a straight edge at x = 0.

    The mean over the heights of the edge above the floor y = 0, a camera for each.
    """
    case = subject.case
    half_angle = case.scene.lights[0].angular_diameter / 2
    errors, pictures = [], []
    for camera, height in enumerate(heights):
        seen, true = case.seen(camera), height * np.tan(half_angle)
        floor = seen.covered & (np.abs(seen.position[..., 1]) < 1e-6) & (np.abs(seen.position[..., 0]) < true)
        got, shown = subject.visibility(camera)
        errors.append(metrics.visibility_mae(got, metrics.disc_visibility(seen.position[..., 0] / true), floor))
        pictures.append(shown)
    return Measured(float(np.mean(errors)), np.concatenate(pictures, axis=1))


@quantity("%")
def falsely_dark(subject: Subject) -> Measured:
    """Pixels in shadow though their interpolated normal faces the light, on a body that cannot shadow itself."""
    frame = subject.frame("visibility", "normal")
    lit = frame["normal"] @ -np.array(subject.case.scene.lights[0].direction, np.float32) > 0
    dark = lit & (frame["visibility"][..., 0] < 0.5)
    return Measured(100 * float(dark.sum()) / max(int(lit.sum()), 1), marked(frame.rgb, dark))


@quantity("px")
def border_step(subject: Subject, band: int = 16) -> Measured:
    """The largest change of a shadow border's softness between bands of rows, one above the other, in pixels.

    Of a border that crosses every row once. A row's softness is 6 sum V (1 - V), the width of a ramp from 0 to 1.
    """
    case = subject.case
    counted = case.oracle.facing(case.seen(), case.scene.lights[0])
    got, picture = subject.visibility()
    soft = 6 * np.where(counted, got * (1 - got), 0).sum(1)
    rows = np.flatnonzero((np.abs(np.diff(np.where(counted, case.visibility(), np.nan), axis=1)) == 1).sum(1) == 1)
    means = np.convolve(soft[rows[0] : rows[-1] + 1], np.ones(band) / band, "valid")
    steps = np.abs(means[band:] - means[:-band])
    return Measured(float(steps.max()), marked(picture, counted & (got > 0.02) & (got < 0.98)))
