"""The measures of the failure library: from one technique on one scene to a number with a unit.

A measure takes a Subject and the options of the [study] table, its keyword arguments, and returns a Measured.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from glhybrid.errors import SettingError, unknown
from glhybrid.image import Frame
from glhybrid.scene import F64, Animation, Channel, Node, Scene, Study
from glhybrid.study import metrics, temporal
from glhybrid.study.subject import Case, Measured, Subject, developed, grey, marked


@dataclass(frozen=True)
class Quantity:
    name: str
    unit: str
    meaning: str  # one line
    measure: Callable[..., Measured]

    def options(self) -> list[str]:
        return list(inspect.signature(self.measure).parameters)[1:]


QUANTITIES: dict[str, Quantity] = {}


def quantity(unit: str) -> Callable[[Callable[..., Measured]], Callable[..., Measured]]:
    """Registers a function under its name, with blanks; its docstring's first line is the meaning."""

    def register(function: Callable[..., Measured]) -> Callable[..., Measured]:
        name = function.__name__.replace("_", " ")
        meaning = (inspect.getdoc(function) or "").splitlines()[0]
        QUANTITIES[name] = Quantity(name, unit, meaning, function)
        return function

    return register


def find(study: Study, where: str) -> Quantity:
    """The measure that a [study] table names. Raises SettingError for one, or an option of one, that there is not."""
    if study.measure not in QUANTITIES:
        raise SettingError(f"{where}: [study]: {unknown('measure', study.measure, QUANTITIES)}")
    found = QUANTITIES[study.measure]
    for key in study.options:
        if key not in found.options():
            raise SettingError(f"{where}: [study]: options: {unknown('option', key, found.options())}")
    return found


# Shadows ---------------------------------------------------------------------------------------------------------


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


# Motion ----------------------------------------------------------------------------------------------------------


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


# Mirrors ---------------------------------------------------------------------------------------------------------


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


# Glossy surfaces -------------------------------------------------------------------------------------------------


def _rough(subject: Subject) -> Any:
    """(H, W) pixels of rough metal, the surfaces that these measures are about."""
    case = subject.case
    rough = np.array([m.metallic == 1 and not m.unlit for m in case.scene.materials] + [False])
    return case.seen().covered & rough[case.seen().hit.material]


@quantity("%")
def bias(subject: Subject, samples: int = 64) -> Measured:
    """How much brighter rough metal is than in the path tracer's picture, as a mean over its pixels."""
    on, want = _rough(subject), subject.reference(samples=samples).mean(-1)
    frame = subject.frame()
    got = frame["radiance"].mean(-1)
    wrong = on & (np.abs(got - want) > 0.25 * want)
    return Measured(100 * float(got[on].mean() / want[on].mean() - 1), marked(frame.rgb, wrong))


@quantity("of the mean")
def error(subject: Subject, frames: int = 8, samples: int = 512) -> Measured:
    """Root mean square difference of rough metal from the path tracer's picture, over its mean; a film's last frame."""
    on, want = _rough(subject), subject.reference(samples=samples)
    got = subject.film([None] * frames)[-1]
    return Measured(float(np.sqrt(np.square(got - want)[on].mean()) / want[on].mean()), developed(got))


@quantity("per million")
def fireflies(subject: Subject, times: float = 10.0, samples: int = 64) -> Measured:
    """Pixels of rough metal that are so many times as bright as the brightest of the 3 x 3 about them in truth."""
    on, want = _rough(subject), subject.reference(samples=samples).mean(-1)
    height, width = want.shape
    padded = np.pad(want, 1, mode="edge")
    brightest = np.max([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)], axis=0)
    frame = subject.frame()
    wrong = on & ~(frame["radiance"].mean(-1) <= times * brightest)
    return Measured(1e6 * float(wrong[on].mean()), marked(frame.rgb, wrong))


@quantity("of the mean")
def boiling(subject: Subject, frames: int = 32) -> Measured:
    """The deviation in time of rough metal that nothing changes, over its mean, in the second half of a film."""
    film = np.stack(subject.film([None] * frames)[frames // 2 :]).mean(-1)
    on = _rough(subject)
    return Measured(float(film.std(0)[on].mean() / film[:, on].mean()), developed(film[-1]))


@quantity("frames")
def ghost(subject: Subject, of: str, before: int = 12, after: int = 36, samples: int = 128) -> Measured:
    """Frames until at most 5 % is left, on rough metal, of the image of an object that was taken away."""
    case, on = subject.case, _rough(subject)
    scene, gone = _vanishing(case.scene, of)
    there = subject.reference(samples=samples)
    clean = case.once(("clean", samples), lambda: subject.frame(scene=gone, reflections="reference", samples=samples))
    change = (there - clean["radiance"]).mean(-1)
    on = on & (np.abs(change) > 0.1 * clean["radiance"].mean(-1))
    film = subject.film([0.0] * before + [1.0] * after, scene)
    left = [((f - clean["radiance"]).mean(-1) * np.sign(change))[on].mean() / np.abs(change)[on].mean() for f in film]
    life = next((k for k, share in enumerate(left[before:]) if share <= 0.05), after)
    shown = film[min(before + 4, len(film) - 1)]
    return Measured(float(life), developed(shown))


def _vanishing(scene: Scene, of: str) -> tuple[Scene, Scene]:
    """The scene with a clip in which the objects of a name are there at 0 s and far away at 1 s; and without them."""
    nodes, instances, channels = list(scene.nodes), [], []
    for instance in scene.instances:
        if instance.name == of:
            nodes += [Node("place", -1, matrix=instance.world_from_object), Node("object", len(nodes))]
            instance = replace(instance, node=len(nodes) - 1)
            away = np.array([[0, 0, 0], [0, -1e4, 0]], np.float32)
            times = np.array([0, 1], np.float32)
            channels.append(Channel(len(nodes) - 1, "translation", "STEP", times, away))
        instances.append(instance)
    assert channels, f'no object is named "{of}"'
    clip = Animation("vanish", tuple(channels))
    gone = scene.replace(instances=tuple(i for i in scene.instances if i.name != of))
    return scene.replace(nodes=tuple(nodes), instances=tuple(instances), animations=(clip,)), gone


@quantity("times the true width")
def edge_width(subject: Subject, rows: list[int], band: int = 8, samples: int = 64) -> Measured:
    """How wide an upright edge in the picture's middle is mirrored by rough metal, over how wide it truly is.

    In bands of rows that begin at `rows`; the value is the one that is most wrong.
    """
    want, frame = subject.reference(samples=samples).mean(-1), subject.frame()
    got, on = frame["radiance"].mean(-1), _rough(subject)
    ratios = []
    for row in rows:
        assert on[row : row + band].all(), f"rows {row} to {row + band} are not all of rough metal"
        true, width = (_ramp(image[row : row + band].mean(0)) for image in (want, got))
        ratios.append(width / true)
    return Measured(max(ratios, key=lambda r: abs(np.log(max(r, 1e-6)))), frame.rgb)


def _ramp(profile: Any) -> float:
    """The width of a step in a line of values, pixels: that of the logistic curve which fits it best, over its slope.

    0 where there is no step.
    """
    n = len(profile)
    if np.ptp(np.convolve(profile, np.ones(8) / 8, "valid")) < 0.05 * abs(profile.mean()):
        return 0.0
    width = np.geomspace(0.25, n, 60)[:, None, None]
    centre = np.linspace(0.25, 0.75, 81)[None, :, None] * n
    curve = 0.5 + 0.5 * np.tanh(2 * (np.arange(n) + 0.5 - centre) / width)
    # low and high of each curve by least squares: what is left of the variance that the curve does not explain
    curve -= curve.mean(-1, keepdims=True)
    flat = profile - profile.mean()
    explained = (curve @ flat) ** 2 / np.maximum((curve * curve).sum(-1), 1e-12)
    best = explained.max(1)
    k = int(np.clip(best.argmax(), 1, len(best) - 2))
    low, middle, high = best[k - 1 : k + 2]
    shift = 0.5 * (low - high) / (low - 2 * middle + high) if low + high < 2 * middle else 0.0
    return float(width[k, 0, 0] * (width[1, 0, 0] / width[0, 0, 0]) ** np.clip(shift, -1, 1))


# Ambient occlusion ----------------------------------------------------------------------------------------------


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


# The scene itself ------------------------------------------------------------------------------------------------


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
