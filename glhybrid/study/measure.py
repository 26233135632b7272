"""One cell: its picture, its time and its figures."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid import outputs
from glhybrid.bench.clock import pass_clock, unpaced, warm_up
from glhybrid.bench.frames import steady_frame
from glhybrid.bvh.blas import threads_available
from glhybrid.image import Frame
from glhybrid.readback import at_once
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import metrics, picture
from glhybrid.study.direct import Direct
from glhybrid.study.sweep import Cell
from glhybrid.timing import Timing

AOVS = ("visibility",)
LONG_MS = 50.0  # of a frame whose passes a few looks tell
WARM_UP_S = 0.3  # an H100 needs 0.29 s to reach its clock; more follows when it is timed
REST = 17  # frames at rest: 16 of history
NOT_TRACED = {"skin", "refit", "gbuffer", "composite", "display"}  # passes that every technique has in common


@dataclass(frozen=True)
class Clock:
    """How long a cell is timed after a warm-up: at least `frames` frames and `seconds`; two batches after `most_s`."""

    frames: int = 5
    seconds: float = 0.5
    most_s: float = 4.0


@dataclass(frozen=True)
class Times:
    """frame_ms: median of frames that are not cut up, from finish() to finish(); cpu_ms: CPU time of the process on all
    cores over their number: on a software rasteriser, the frame on an idle machine; spread, cpu_spread: half the
    distance of the quartiles over the median; passes: ms by pass; trace_ms: of the passes that a technique brings."""

    frame_ms: float
    cpu_ms: float
    spread: float
    cpu_spread: float
    frames: int
    passes: dict[str, float]

    @property
    def trace_ms(self) -> float:
        """Of the passes that send rays or stand in their place."""
        return sum(ms for name, ms in self.passes.items() if name not in NOT_TRACED)


def time_frames(
    renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int], settings: Settings, clock: Clock,
    alone: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> Times:  # fmt: skip
    """Frames of a scene at rest, as a viewer would draw them. What is timed has been drawn before. alone: within it
    nobody else uses the device."""
    context, threads = renderer.context, threads_available()
    frame, off = steady_frame(renderer, scene, size, settings, camera), Timing(context.gl.finish, enabled=False)
    batch = 1 if context.device.software else 8  # a pause after every frame lets a GPU's clock fall
    if not context.device.software:
        warm_up(context, lambda: frame(off), WARM_UP_S)  # others may still be at work: its clock rises all the same
    with alone():
        sample = unpaced(context, lambda: frame(off), clock.frames, clock.seconds, batch, clock.most_s)
        frame_ms, passes = sample.median("wall"), pass_clock(context)
        for _ in range(3 if context.device.software or frame_ms > LONG_MS else 10):  # the first does not count
            frame(passes)
        medians = passes.medians()
    frames = len(sample.wall) * sample.batch
    cpu_ms, spread, cpu_spread = sample.median("cpu") / threads, sample.spread("wall") / 2, sample.spread("cpu") / 2
    return Times(frame_ms, cpu_ms, spread, cpu_spread, frames, medians)


def draw(renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int], settings: Settings) -> Frame:
    """The picture, at an exposure that follows from the scene alone once it is given by `settings`."""
    return renderer.render(scene, camera, size, settings, aovs=AOVS)


@dataclass(frozen=True, eq=False)
class Truth:
    """What pictures of a scene are held against. radiance (H, W, 3): the reference; light: None where there is none;
    specular (H, W): the share of a pixel's reflectance that is specular, 0 to 1; all_light: what bias is told against,
    default the reference's own."""

    radiance: F32
    light: Direct | None
    specular: F32
    all_light: picture.AllLight | None = None
    _shadows: dict[bytes, dict[str, Any]] = field(default_factory=dict, repr=False)  # figures by content

    def shadow_figures(self, visibility: F32) -> dict[str, Any]:
        """`shadow_figures`, once for equal ones: techniques of other kinds leave shadows alone."""
        key = hashlib.blake2b(np.ascontiguousarray(visibility).data, digest_size=16).digest()
        if key not in self._shadows:
            self._shadows[key] = shadow_figures(visibility, self.light)
        return self._shadows[key]


def film(
    renderer: Renderer, scene: Scene, camera: int | Camera, size: tuple[int, int], settings: Settings,
    times: Sequence[float | None],
) -> Iterator[F32]:  # fmt: skip
    """(H, W, 3) radiance of frames in a row, a clip's seconds each: temporal filters go on from one to the next. Each
    is read when it is asked for."""
    staged = renderer.stage(scene, settings.replace(time=times[0]), size)
    staged.cut()
    timing = Timing(renderer.context.gl.finish, enabled=False)
    for at in times:
        staged.aim(settings.replace(time=at), camera)
        staged.set(jitter_px=(0, 0), accumulate=0)
        yield at_once(outputs.texels(staged.frame(timing), 0, 3))


@dataclass(frozen=True, eq=False)
class ErrorMaps:
    """HDR-FLIP of a picture and of a later frame of it at rest, for what temporal filters make of it: (H, W), 0 to 1.
    shadow: mean of its direct light alone; None where the scene has no light."""

    picture: F32
    at_rest: F32 | None = None
    shadow: float | None = None


def compared(frame: Frame, maps: ErrorMaps, truth: Truth, folder: Path, stem: str) -> dict[str, Any]:
    """Errors of a picture, and the names of its images once they are written."""
    row: dict[str, Any] = picture.compare(frame["radiance"], truth.radiance, maps.picture, truth.all_light).to_dict()
    row["flip_reflection"] = picture.weighted_mean(maps.picture, truth.specular)
    row |= truth.shadow_figures(frame["visibility"]) | {"flip_shadow": maps.shadow}
    later = maps.at_rest
    row["flip_at_rest"] = None if later is None else float(later.mean(dtype=np.float64))
    row["flip_reflection_at_rest"] = None if later is None else picture.weighted_mean(later, truth.specular)
    return row | {"images": save_images(folder, stem, frame, maps.picture)}


def shadow_figures(visibility: F32, light: Direct | None) -> dict[str, Any]:
    """Of the direct light alone, all lights together: nothing that other parts of a picture get wrong counts."""
    names = (
        "wrong_shadow_percent", "wrong_shadow_outside_percent", "wrong_shadow_inside_percent", "visibility_mae",
    )  # fmt: skip
    if light is None:
        return dict.fromkeys(names)
    counted = light.counted
    got = visibility[..., list(light.lights)]
    bands = np.stack([metrics.edge_band(light.visibility[..., i] > 0.5) for i in range(got.shape[-1])], -1)
    wrong = metrics.wrong_shadow_percent(got, light.visibility, counted, bands)
    values = wrong.all, wrong.outside, wrong.inside, metrics.visibility_mae(got, light.visibility, counted)
    return dict(zip(names, values, strict=True))


def specular_share(renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int]) -> F32:
    """(H, W): how much of what a pixel reflects is specular, by Karis' fit of the split-sum table (2014)."""
    names = ("albedo", "roughness", "metallic", "normal", "position", "instance_id")
    plain = Settings(shadows="none", reflections="none", aa=1)
    frame = renderer.render(scene, camera, size, plain, aovs=names)
    pose = camera.world_from_view
    to_eye = pose[:3, 3] - frame["position"].astype(np.float64) if camera.fov_y > 0 else pose[:3, 2]
    to_eye = np.broadcast_to(to_eye, frame["position"].shape)
    length = np.maximum(np.linalg.norm(to_eye, axis=-1), 1e-12)
    nov = np.clip((frame["normal"] * to_eye).sum(-1) / length, 0, 1)
    rough, metallic = frame["roughness"].astype(np.float64), frame["metallic"].astype(np.float64)
    f0 = 0.04 * (1 - metallic[..., None]) + frame["albedo"] * metallic[..., None]
    r = rough[..., None] * np.array([-1, -0.0275, -0.572, 0.022]) + np.array([1, 0.0425, 1.04, -0.04])
    a004 = np.minimum(r[..., 0] ** 2, np.exp2(-9.28 * nov)) * r[..., 0] + r[..., 1]
    scale, bias = -1.04 * a004 + r[..., 2], 1.04 * a004 + r[..., 3]
    specular = np.maximum((f0 * scale[..., None] + bias[..., None]) @ picture.LUMINANCE, 0)
    diffuse = (frame["albedo"] * (1 - metallic[..., None])) @ picture.LUMINANCE
    share = specular / np.maximum(specular + diffuse, 1e-6)
    return np.where(frame["instance_id"] != 0xFFFFFFFF, share, 0).astype(np.float32)


def memory(receipt: dict[str, Any]) -> int:
    """Bytes of images and buffers on the device."""
    return int(receipt["plan"]["image_bytes"] + receipt["plan"]["buffer_bytes"])


def save_images(folder: Path, stem: str, frame: Frame, flip: F32 | None) -> dict[str, str]:
    """EXR and PNG of the picture, PNG of its FLIP map -> file names by kind."""
    images = {"exr": f"{stem}.exr", "png": f"{stem}.png"}
    frame.save(folder / images["exr"], aov=())
    frame.save(folder / images["png"])
    if flip is not None:
        images["flip"] = f"{stem}.flip.png"
        Frame(picture.magma(flip)).save(folder / images["flip"])
    return images


def describe(cell: Cell, times: Times) -> dict[str, Any]:
    """The part of a row that says what was made, and how long it took."""
    return {
        **cell.techniques, "parameters": dict(cell.parameters), "label": cell.label, "names": cell.names,
        "frame_ms": times.frame_ms, "trace_ms": times.trace_ms, "frame_cpu_ms": times.cpu_ms,
        "frame_ms_spread": times.spread, "frame_cpu_ms_spread": times.cpu_spread, "passes": times.passes,
    }  # fmt: skip
