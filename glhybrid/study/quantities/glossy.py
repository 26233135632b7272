"""Measures of rough metal: bias, noise, specks, and what stays of what has gone."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from glhybrid.scene import F64, Animation, Channel, Node, Scene
from glhybrid.study.quantities.registry import quantity
from glhybrid.study.subject import Measured, Subject, developed, marked


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


@quantity("%")
def energy(subject: Subject) -> Measured:
    """How much brighter white metal is than its lobe allows under an even sky, as a mean, of the most wrong roughness.

    The truth is the directional albedo of a GGX lobe with separable masking, by quadrature: what a single bounce
    between microfacets leaves.
    """
    case, frame = subject.case, subject.frame()
    seen, sky, on = case.seen(), case.scene.environment, _rough(subject)
    assert sky is not None and sky.constant
    cosine = np.abs((seen.hit.normal * seen.direction).sum(-1))
    level = frame["radiance"].mean(-1) / (sky.radiance[0, 0].mean() * sky.intensity)
    off, wrong = [], np.zeros(on.shape, bool)
    for row, material in enumerate(case.scene.materials):
        mine = on & (seen.hit.material == row)
        if mine.any():
            want = np.interp(cosine[mine], *_albedo(material.roughness**2))
            off.append(100 * float(level[mine].mean() / want.mean() - 1))
            wrong[mine] = np.abs(level[mine] - want) > 0.05 * want
    return Measured(max(off, key=abs), marked(frame.rgb, wrong))


@lru_cache
def _albedo(alpha: float, order: int = 128) -> tuple[F64, F64]:
    """Cosines to the viewer, ascending, and what a white metal reflects there: the mean of the masking of light over
    visible normals (Heitz, "Sampling the GGX Distribution of Visible Normals", JCGT 7(4), 2018), by Gauss and Legendre
    along radii, with more nodes where light grazes."""
    x, weight = np.polynomial.legendre.leggauss(order)
    rest, weight = (1 - x) / 2, weight * (1 - x) / 2  # u = 1 - rest^2
    radius, phi = np.sqrt(1 - rest**2)[:, None], 2 * np.pi * (np.arange(order) + 0.5)[None] / order
    values, nodes = [], np.linspace(0, 1, 65)[1:]
    for mu in nodes:
        view = np.array([alpha * np.sqrt(1 - mu * mu), 0.0, mu])
        view /= np.linalg.norm(view)
        side = np.array([0.0, 1.0, 0.0])
        up = np.cross(view, side)
        a, b = radius * np.cos(phi), radius * np.sin(phi)
        share = 0.5 * (1 + view[2])
        b = (1 - share) * np.sqrt(1 - a * a) + share * b
        c = np.sqrt(np.maximum(0, 1 - a * a - b * b))
        half = a[..., None] * side + b[..., None] * up + c[..., None] * view
        half = half * [alpha, alpha, 1]
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        outward = np.array([np.sqrt(1 - mu * mu), 0.0, mu])
        light = 2 * (half @ outward) * half[..., 2] - mu
        masking = 2 * light / (light + np.sqrt(alpha**2 + (1 - alpha**2) * light**2))
        values.append(weight @ np.where(light > 0, masking, 0).mean(1))
    return nodes, np.array(values)


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


@quantity("%")
def lag(subject: Subject, later: int = 8, before: int = 12) -> Measured:
    """The share of a lamp's light that rough metal still shows so many frames after the lamp is gone, 0: the first.

    Of what the technique itself shows at rest, with the lamp and without.
    """
    on, scene = _rough(subject), _switched_off(subject.case.scene)
    film = subject.film([0.0] * before + [1.0] * (later + 1), scene)
    lit, left = (np.mean(frames, axis=0).mean(-1) for frames in (film[before - 4 : before], film[-1:]))
    dark = np.mean(subject.film([1.0] * (before + 4), scene)[-4:], axis=0).mean(-1)
    on = on & (lit - dark > 0.1 * dark)
    return Measured(100 * float((left - dark)[on].mean() / (lit - dark)[on].mean()), developed(film[-1]))


def _switched_off(scene: Scene) -> Scene:
    """The scene with a clip in which its lamps are there at 0 s and far away at 1 s."""
    nodes, lights, channels = list(scene.nodes), [], []
    for light in scene.lights:
        place = np.eye(4)
        place[:3, 3] = light.position
        nodes += [Node("place", -1, matrix=place), Node("lamp", len(nodes))]
        lights.append(replace(light, node=len(nodes) - 1))
        away = np.array([[0, 0, 0], [0, -1e6, 0]], np.float32)
        channels.append(Channel(len(nodes) - 1, "translation", "STEP", np.array([0, 1], np.float32), away))
    return scene.replace(nodes=tuple(nodes), lights=tuple(lights), animations=(Animation("off", tuple(channels)),))


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
