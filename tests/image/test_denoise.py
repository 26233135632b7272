"""The filter of `ray-glossy` and `ray-soft`: what it takes away, what it leaves alone, and how fast it forgets."""

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from glossy_scenes import SIZE, draw, metal_floor, painted
from scene_kit import box, constant_sky, floor, matte, metal, quad, scene, sun

from glhybrid.passes.denoise import Denoise
from glhybrid.scene import Animation, Camera, Channel, Environment, Light, Node, Scene, Sphere
from glhybrid.settings import Settings
from glhybrid.timing import Timing

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer
    from glhybrid.staged import Staged

    F64 = NDArray[np.float64]

RAW = {"denoise": False}


def rmse(got: Any, want: Any) -> float:
    return float(np.sqrt(((np.asarray(got, np.float64) - want) ** 2).mean()))


def flip(got: Any, want: Any) -> float:
    """Mean HDR-FLIP."""
    evaluator = pytest.importorskip("flip_evaluator")
    return float(evaluator.evaluate(np.asarray(want, np.float32), np.asarray(got, np.float32), "HDR")[1])


def glossy(samples: int = 4, **parameters: Any) -> Settings:
    given = {"samples": samples} | parameters
    return Settings(
        reflections="ray-glossy", aa=1, parameters={f"reflections.ray-glossy.{k}": v for k, v in given.items()}
    )


def movie(
    renderer: "Renderer", frames: "list[tuple[Scene, Camera]]", settings: Settings, number: int = 0
) -> "list[F64]":
    """Radiance of frames in a row, each following the one before; the first follows none, and has the rays of this number."""
    made = []
    for i, (world, camera) in enumerate(frames):
        staged = renderer.stage(world, settings, SIZE)
        if i == 0:
            staged.cut()
            staged._number = number
            staged.aim(settings, camera)  # of two looks a frame, none is taken for the one before
        staged.aim(settings, camera)
        staged.set(jitter_px=(0, 0), accumulate=0)
        image = staged.frame(Timing(renderer.context.gl.finish, enabled=False))
        rows = np.frombuffer(image.read(), np.float32).reshape(image.height, image.width, 4)
        made.append(rows[::-1, :, :3].astype(np.float64))
    return made


@pytest.fixture(scope="module")
def truth() -> "dict[float, F64]":
    return {}


def converged(renderer: "Renderer", truth: "dict[float, F64]", roughness: float) -> "F64":
    if roughness not in truth:
        frame = draw(renderer, metal_floor(roughness), 512, seed=9, parameters=RAW)
        truth[roughness] = frame["radiance"].astype(np.float64)
    return truth[roughness]


@pytest.mark.parametrize("samples", [1, 2, 4])
def test_error_and_bias(renderer: "Renderer", truth: "dict[float, F64]", samples: int) -> None:
    """A quarter rough, one frame: the bars of 16 random rays without a filter (bias 1 %, RMSE 0.038, HDR-FLIP 0.024)."""
    want = converged(renderer, truth, 0.25)
    raw = draw(renderer, metal_floor(0.25), samples, parameters=RAW)["radiance"]
    got = draw(renderer, metal_floor(0.25), samples)["radiance"].astype(np.float64)
    assert abs(got.mean() / want.mean() - 1) < 0.01
    assert rmse(got, want) < BARS[f"glossy, {samples}, RMSE"].value and rmse(got, want) < 0.35 * rmse(raw, want)
    assert flip(got, want) < BARS[f"glossy, {samples}, FLIP"].value


def test_a_few_frames_of_one_ray(renderer: "Renderer", truth: "dict[float, F64]") -> None:
    """One ray a pixel: four frames are as good as the bar, and none is worse than the one before."""
    world, want = metal_floor(0.25), converged(renderer, truth, 0.25)
    frames = movie(renderer, [(world, world.cameras[0])] * 4, glossy(1))
    errors = [rmse(f, want) for f in frames]
    assert errors == sorted(errors, reverse=True), errors
    assert flip(frames[-1], want) < BARS["glossy, 4, FLIP"].value


@pytest.mark.parametrize(("roughness", "bar"), [(0.1, 0.03), (0.5, 0.02), (0.8, 0.02)])
def test_other_roughness(renderer: "Renderer", truth: "dict[float, F64]", roughness: float, bar: float) -> None:
    """At each, the filter leaves less than it found, and hardly a bias."""
    want = converged(renderer, truth, roughness)
    raw = draw(renderer, metal_floor(roughness), 16, parameters=RAW)["radiance"]
    got = draw(renderer, metal_floor(roughness), 16)["radiance"].astype(np.float64)
    assert rmse(got, want) < min(0.8 * rmse(raw, want), bar)
    assert abs(got.mean() / want.mean() - 1) < 0.005


def test_round_things(renderer: "Renderer") -> None:
    """Balls of four roughnesses, whose normals turn by a lobe's width over a few pixels."""
    parts: list[Any] = [(floor(4.0), metal((0.95, 0.93, 0.9), 0.3)), (box((-2, 0, -1.3), (2, 0.8, -1.1)), matte(0.3))]
    for x, roughness in ((-1.1, 0.15), (-0.35, 0.25), (0.4, 0.4), (1.1, 0.6)):
        parts.append((Sphere(0.34), metal((0.9, 0.7, 0.4), roughness), (x, 0.34, 0.3)))
    camera = Camera.look_at((0.4, 1.3, 3.4), (0, 0.3, 0), fov_y=0.7)
    world = scene(parts, camera, environment=metal_floor(0.0).environment)
    want = draw(renderer, world, 512, seed=9, parameters=RAW)["radiance"].astype(np.float64)
    for samples, share in ((1, 0.25), (4, 0.35)):
        raw = draw(renderer, world, samples, parameters=RAW)["radiance"]
        got = draw(renderer, world, samples)["radiance"].astype(np.float64)
        assert rmse(got, want) < share * rmse(raw, want), (rmse(got, want), rmse(raw, want))
        assert abs(got.mean() / want.mean() - 1) < 0.005


@pytest.mark.parametrize("roughness", [0.1, 0.4])
def test_what_has_converged_stays(renderer: "Renderer", roughness: float) -> None:
    """512 rays: the filter changes the picture by less than the little noise that is left would allow."""
    raw = draw(renderer, metal_floor(roughness), 512, parameters=RAW)["radiance"]
    got = draw(renderer, metal_floor(roughness), 512)["radiance"]
    assert rmse(got, raw) < 0.008 and abs(got.mean() / raw.mean() - 1) < 2e-3


def test_mirrors_and_what_sends_no_ray_are_untouched(renderer: "Renderer") -> None:
    """Exact mirrors beside rough metal: bit for bit what they are without a filter."""
    parts = [(floor(4.0), metal(0.9, 0.4)), (Sphere(0.6), metal((0.9, 0.6, 0.3), 0.0), (0, 0.6, 0))]
    world = scene(parts, environment=metal_floor(0.0).environment)
    raw = draw(renderer, world, 2, "reflection", "instance_id", parameters=RAW)
    got = draw(renderer, world, 2, "reflection")
    ball = raw["instance_id"] == 1
    assert np.array_equal(raw["reflection"][ball], got["reflection"][ball]) and ball.mean() > 0.05
    assert not np.array_equal(raw["reflection"][~ball], got["reflection"][~ball])


def test_a_still_camera_gathers(renderer: "Renderer", truth: "dict[float, F64]") -> None:
    """Error over frames falls, and nothing boils: temporal deviation under 1 % of the mean."""
    world, want = metal_floor(0.25), converged(renderer, truth, 0.25)
    frames = movie(renderer, [(world, world.cameras[0])] * 32, glossy(1))
    errors = [rmse(frames[k], want) for k in (0, 7, 31)]
    assert errors[1] < 0.65 * errors[0] and errors[2] < 0.5 * errors[0], errors
    assert np.std(frames[16:], axis=0).mean() / np.mean(frames[16:]) < 0.01


def test_no_flicker_in_a_pan(renderer: "Renderer") -> None:
    """Whole pixels, parallel rays: the same points again, whose radiance may not change by more than 1 % of the mean."""
    world = metal_floor(0.25)
    base, half = Camera.look_at((2.0, 2.2, 3.0), (0, 0.3, 0)).world_from_view, 1.5
    cameras = []
    for k in range(16):
        pose = base.copy()
        pose[:3, 3] += k * 2 * half / SIZE[1] * base[:3, 0]
        cameras.append(Camera(f"pan {k}", pose, fov_y=0, ymag=half))
    frames = movie(renderer, [(world, c) for c in cameras], glossy(2))
    flicker = [np.abs(b[:, :-1] - a[:, 1:]).mean() for a, b in pairwise(frames[8:])]
    assert np.mean(flicker) / np.mean(frames) < 0.01
    # History pays: the last frame is nearer to the truth than one made alone.
    want = movie(renderer, [(world, cameras[-1])], glossy(512, denoise=False))[0]
    alone = movie(renderer, [(world, cameras[-1])], glossy(2))[0]
    assert rmse(frames[-1], want) < 0.8 * rmse(alone, want)


@pytest.mark.parametrize(("samples", "step"), [(4, 0.01), (4, 0.04), (4, 0.12), (1, 0.08)])
def test_history_does_no_harm(renderer: "Renderer", truth: "dict[float, F64]", samples: int, step: float) -> None:
    """About the scene, m a frame: not worse than a frame made alone, and better where the camera is slow."""
    world, want = metal_floor(0.25), converged(renderer, truth, 0.25)
    at = [0.4 + step * k for k in range(-8, 0)]
    cameras = [Camera.look_at((x, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44)) for x in at] + [world.cameras[0]]
    last, alone = [], []
    for seed in range(3):  # of one the ratio is 4 % off by chance where history counts
        settings = glossy(samples).replace(seed=seed)
        last.append(movie(renderer, [(world, camera) for camera in cameras], settings)[-1])
        alone.append(movie(renderer, [(world, world.cameras[0])], settings, number=8)[0])
    for error in (rmse, flip):
        ratio = sum(error(f, want) for f in last) / sum(error(f, want) for f in alone)
        assert ratio < BARS["glossy, slow" if step == 0.01 else "glossy, moving"].value, (error.__name__, ratio)


def test_a_turning_camera_keeps_what_is_sharp(renderer: "Renderer") -> None:
    """A glass front that shows posts as narrow as pixels. A look between pixels of the frame before blurs them, each frame
    anew: 1.12 times the FLIP of one made alone if that is not counted, 1.36 times in the built-in scene plaza."""
    rng = np.random.default_rng(5)
    front = quad([(-3, 0, -1), (3, 0, -1), (3, 3, -1), (-3, 3, -1)])
    parts: list[Any] = [(floor(4.0), matte(0.4)), (front, metal(0.9, 0.06))]
    for x in np.arange(-3.0, 3.0, 0.12):
        parts.append((box((x, 0, 1.5), (x + 0.05, 2.5, 1.55)), painted(*rng.uniform(0.05, 1.0, 3))))
    world = scene(parts, lights=[sun((-0.3, -1, -0.8))], environment=metal_floor(0.0).environment)
    angles = [0.023 * k for k in range(-8, 1)]
    cameras = [Camera.look_at((0, 1.2, 1.3), (np.sin(a), 1.0, 1.3 - np.cos(a)), fov_y=np.radians(60)) for a in angles]
    want = movie(renderer, [(world, cameras[-1])], glossy(256, denoise=False))[0]
    got = movie(renderer, [(world, camera) for camera in cameras], glossy(4))[-1]
    alone = movie(renderer, [(world, cameras[-1])], glossy(4), number=8)[0]
    for error in (rmse, flip):
        ratio = error(got, want) / error(alone, want)
        assert ratio < BARS["glossy, moving"].value, (error.__name__, ratio)


def test_a_lamp_that_goes_out_is_gone(renderer: "Renderer") -> None:
    """What the floor shows of lit things: a fifth is left after a frame at most, a hundredth after eight."""
    parts = [
        (floor(4.0), metal((0.95, 0.93, 0.9), 0.25)), (box((-1.4, 0, -0.8), (-0.4, 1.3, 0.2)), matte((0.8, 0.3, 0.2))),
        (Sphere(0.5), matte((0.3, 0.5, 0.9)), (1.0, 0.5, -0.1)),
    ]  # fmt: skip
    camera = Camera.look_at((0.4, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44))
    on = scene(parts, camera, lights=[sun((-0.5, -1, -0.8))], environment=constant_sky((0.2, 0.2, 0.25)))
    off = on.replace(lights=(replace(on.lights[0], intensity=1e-4),))
    lit, dark = (draw(renderer, w, 64, "instance_id", parameters=RAW) for w in (on, off))
    change = (lit["radiance"] - dark["radiance"]).sum(-1)
    seen = (lit["instance_id"] == 0) & (change > 0.3 * change[lit["instance_id"] == 0].max())
    assert seen.sum() > 200
    frames = movie(renderer, [(on, camera)] * 12 + [(off, camera)] * 10, glossy(4))
    left = [float((f - dark["radiance"]).sum(-1)[seen].mean() / change[seen].mean()) for f in frames]
    assert left[11] > 0.95 and left[12] < 0.2 and left[20] < 0.012, left[11:]


def lit_things(roughness: float) -> Scene:
    """A metal floor that shows a box, a post and a ball under a sun; the three stand on nodes that go a metre a second."""
    places = [(-0.9, 0.0, -0.3), (0.1, 0.0, 0.3), (1.0, 0.4, -0.1)]
    shapes = (box((-0.5, 0, -0.5), (0.5, 1.3, 0.5)), box((-0.05, 0, -0.05), (0.05, 1.8, 0.05)), Sphere(0.4))
    colors = ((0.8, 0.3, 0.2), (0.7, 0.7, 0.1), (0.3, 0.5, 0.9))
    parts = [(floor(4.0), metal((0.95, 0.93, 0.9), roughness))]
    parts += [(shape, matte(color), place) for shape, color, place in zip(shapes, colors, places, strict=True)]
    camera = Camera.look_at((0.4, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44))
    made = scene(parts, camera, lights=[sun((-0.5, -1, -0.8))], environment=constant_sky((0.2, 0.2, 0.25)))
    nodes = tuple(Node(f"n{i}", -1, translation=place) for i, place in enumerate(places))
    times = np.array([0, 10], np.float32)
    clip = Animation("walk", tuple(
        Channel(i, "translation", "LINEAR", times, np.array([place, np.add(place, (10, 0, 0))], np.float32))
        for i, place in enumerate(places)
    ))  # fmt: skip
    instances = tuple(replace(p, node=i - 1) for i, p in enumerate(made.instances))
    return made.replace(instances=instances, nodes=nodes, animations=(clip,))


@pytest.mark.parametrize(
    ("what", "roughness", "samples"),
    [("things", 0.1, 1), ("things", 0.25, 4), ("sun", 0.25, 4), ("off", 0.25, 4), ("on", 0.5, 1), ("sky", 0.25, 4)],
)
def test_what_changes_is_seen_at_once(renderer: "Renderer", what: str, roughness: float, samples: int) -> None:
    """The frame after a switch, or the last of twelve, is as good as the same one made without any before it.

    If history is held to three deviations only, as of lights that stay, it is 1.3 to 5 times worse.
    """
    world = lit_things(roughness)
    lamp, camera = world.lights[0], world.cameras[0]
    dark = world.replace(lights=(replace(lamp, intensity=1e-4),))
    sky = Environment(
        np.where(np.random.default_rng(1).random((16, 32, 1)) < 0.2, 1.5, 0.2).repeat(3, 2).astype(np.float32)
    )
    frames: list[tuple[Scene, float]] = []
    for k in range(12):
        if what == "things":
            frames.append((world, 0.03 * k))
        elif what == "sun":
            x, y, z = lamp.direction
            c, s = np.cos(0.03 * k), np.sin(0.03 * k)
            frames.append((world.replace(lights=(replace(lamp, direction=(c * x + s * z, y, c * z - s * x)),)), 0.0))
        elif what == "sky":
            frames.append((world.replace(environment=replace(sky, rotation=0.05 * k)), 0.0))
        else:
            frames.append((dark if (what == "off") == (k == 11) else world, 0.0))

    def last(settings: Settings, follow: bool) -> "F64":
        for k, (shown, time) in enumerate(frames):
            timed = settings.replace(time=time)
            staged = renderer.stage(shown, timed, SIZE)
            if k == 0:
                staged.cut()
            if follow or k == 11:
                staged.aim(timed, camera)
                if not follow:
                    staged.aim(timed, camera)  # of two looks a frame none is taken for the one before
                    staged._number = k  # the same rays
                staged.set(jitter_px=(0, 0), accumulate=0)
                image = staged.frame(Timing(renderer.context.gl.finish, enabled=False))
        rows = np.frombuffer(image.read(), np.float32).reshape(image.height, image.width, 4)
        return rows[::-1, :, :3].astype(np.float64)

    want = last(glossy(256, denoise=False), follow=False)
    got, alone = (last(glossy(samples), follow) for follow in (True, False))
    for error in (rmse, flip):
        ratio = error(got, want) / error(alone, want)
        assert ratio < BARS["glossy, changing"].value, (error.__name__, ratio)


def test_pictures_do_not_depend_on_those_before(renderer: "Renderer") -> None:
    """Frames of a picture share what they gather; pictures do not."""
    world, other = metal_floor(0.3), metal_floor(0.31)
    first = draw(renderer, world, 2, aa=4)["radiance"]
    draw(renderer, other, 2, aa=4)
    draw(renderer, world, 2, aa=4)
    assert np.array_equal(first, draw(renderer, world, 2, aa=4)["radiance"])


def soft(samples: int, **parameters: Any) -> Settings:
    given = {"samples": samples} | parameters
    return Settings(
        shadows="ray-soft", reflections="none", aa=1, parameters={f"shadows.ray-soft.{k}": v for k, v in given.items()}
    )


def shaded() -> Scene:
    lights = [
        replace(sun((-0.6, -1.0, -0.4)), angular_diameter=0.12),
        Light("point", (1.0, 0.7, 0.4), 5.0, position=(1.5, 2.0, -1.0), radius=0.35),
    ]
    parts = [
        (floor(4.0), matte(0.8)), (box((-0.1, 0, -0.1), (0.1, 1.2, 0.1)), matte(0.5)),
        (Sphere(0.3), matte(0.6), (0.7, 0.5, 0.4)), (box((-1.2, 0, -0.4), (-0.7, 0.5, 0.1)), matte((0.6, 0.4, 0.3))),
    ]  # fmt: skip
    return scene(parts, Camera.look_at((2.0, 2.2, 3.0), (0, 0.3, 0), fov_y=np.radians(45)), lights=lights)


def test_penumbras(renderer: "Renderer") -> None:
    """In penumbras the error falls, on average nothing is added; away from them nothing changes at all."""
    world = shaded()

    def seen(settings: Settings) -> "F64":
        return renderer.render(world, size=SIZE, settings=settings, aovs=("visibility",))["visibility"].astype(float)

    want = seen(soft(256, denoise=False))
    partly = (want > 0.01) & (want < 0.99)
    assert 0.01 < partly.mean() < 0.5
    for samples, left in ((1, 0.35), (4, 0.35), (16, 0.6)):
        raw, got = seen(soft(samples, denoise=False)), seen(soft(samples))
        assert rmse(got[partly], want[partly]) < left * rmse(raw[partly], want[partly])
        assert abs((got - want)[partly].mean()) < 0.012
        assert abs((got - want)[~partly]).mean() < 0.002
        assert got.min() >= 0 and got.max() <= 1 + 1e-6


def test_contacts_stay_sharp(renderer: "Renderer") -> None:
    """Where the box stands on the floor the shadow's border is as narrow as it is without a filter."""
    from glhybrid.study.metrics import penumbra_width

    wall = box((-3, 0, -0.1), (3, 1.0, 0.0))
    light = replace(sun((0.0, -1.0, 1.0)), angular_diameter=0.3)
    camera = replace(Camera.look_at((0, 6, 1.0), (0, 0, 1.0), (0, 0, -1)), fov_y=0.0, ymag=0.6)
    world = scene([(floor(6.0), matte(1.0)), (wall, matte(0.5))], camera, lights=[light])
    widths = []
    for settings in (soft(64, denoise=False), soft(4)):
        frame = renderer.render(world, size=SIZE, settings=settings, aovs=("visibility", "position"))
        seen, z = frame["visibility"][..., 0].mean(1), frame["position"][..., 2].mean(1)
        widths.append(penumbra_width(z, seen))
    assert widths[1] == pytest.approx(widths[0], rel=0.1), widths


def stains(
    renderer: "Renderer", settings: Settings, soil: "Callable[[Staged, int], None]", step: float = 0.02
) -> "list[F64]":
    """Radiance of six frames about a scene; soil(staged, number) is called before each."""
    world = shaded() if settings.shadows == "ray-soft" else metal_floor(0.25)
    staged = renderer.stage(world, settings, SIZE)
    staged.cut()
    made = []
    for k in range(6):
        staged.aim(settings, Camera.look_at((0.4 + step * k, 1.5, 3.4), (0, 0.25, 0), fov_y=np.radians(44)))
        staged.set(jitter_px=(0, 0), accumulate=0)
        soil(staged, k)
        image = staged.frame(Timing(renderer.context.gl.finish, enabled=False))
        made.append(
            np.frombuffer(image.read(), np.float32)
            .reshape(image.height, image.width, 4)[::-1, :, :3]
            .astype(np.float64)
        )
    return made


def stain(image: Any, value: float) -> None:
    """One texel of every layer."""
    kind = {"f2": np.float16, "f4": np.float32}[image.dtype]
    at = (SIZE[0] // 2, SIZE[1] // 3)
    layers = getattr(image, "layers", 0)
    data = np.full((max(layers, 1), image.components), value, kind).tobytes()
    image.write(data, (*at, 0, 1, 1, layers) if layers else (*at, 1, 1), alignment=1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("signal", ["reflection", "visibility"])
def test_what_is_no_number_is_gone_a_frame_later(
    renderer: "Renderer", monkeypatch: pytest.MonkeyPatch, signal: str, value: float
) -> None:
    """In any image that is kept, or in a noisy one: no picture has it, and after 3 frames nothing tells that it was there.

    Not by chance either: what comes of 0 * NaN, or of a mean with one, is NaN in this frame and all that follow.
    """
    settings = glossy(2) if signal == "reflection" else soft(2)
    clean = stains(renderer, settings, lambda *_: None)
    names = [f"{signal}_{kept}_{parity}" for kept in ("history", "counts", "level") for parity in ("even", "odd")]
    for kept in ("history", "counts", "level"):

        def soil(staged: "Staged", number: int, kept: str = kept) -> None:
            for name in names if number == 2 else ():
                if kept in name:
                    stain(staged.targets.get(name), value)

        frames = stains(renderer, settings, soil)
        assert np.array_equal(frames[1], clean[1]) and not np.array_equal(frames[2], clean[2]), kept
        assert np.isfinite(frames).all(), kept
        assert np.abs(frames[5] - clean[5]).mean() < 1e-3 * clean[5].mean(), kept

    noisy, numbers = Denoise._filter, []

    def filter_stained(self: Denoise, targets: Any, which: str, image: Any, more: dict[str, Any]) -> None:
        if numbers.count(2) and numbers[-1] == 2:  # once: lights' layers are filtered one after the other
            numbers.append(-1)
            stain(image, value)
        noisy(self, targets, which, image, more)

    monkeypatch.setattr(Denoise, "_filter", filter_stained)
    frames = stains(renderer, settings, lambda _, number: numbers.append(number))
    assert np.array_equal(frames[1], clean[1]) and not np.array_equal(frames[2], clean[2])
    assert np.isfinite(frames).all()
    assert np.abs(frames[5] - clean[5]).mean() < 2e-3 * clean[5].mean()


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("make", [glossy, soft])
def test_no_variance_is_negative(renderer: "Renderer", make: "Callable[[int], Settings]", samples: int) -> None:
    """A fast camera, whose frames hardly count any history: a share of x / x is 1, also where drivers divide to 2.5 ulp."""
    signal = "reflection" if make is glossy else "visibility"

    def look(staged: "Staged", number: int) -> None:
        for parity in ("even", "odd") if number > 1 else ():
            level, counts, history = (
                staged.targets.read(f"{signal}_{k}_{parity}") for k in ("level", "counts", "history")
            )
            counted = counts[..., ::2] > 0
            assert counted.any() and level[..., 1::2][counted].min() >= 0
            assert np.isfinite(history).all() and history.min() >= 0 and np.isfinite(counts).all()

    frames = stains(renderer, make(samples), look, step=0.12 if samples == 4 else 0.08)
    assert np.isfinite(frames).all()


def test_a_still_picture_forgets_what_is_no_number(renderer: "Renderer") -> None:
    """The mean of all frames so far begins anew in a pixel whose mean is no number."""
    settings = glossy(1)

    def soil(staged: "Staged", number: int) -> None:
        if number == 3:
            stain(staged.targets.get("radiance"), np.nan)
        staged.set(accumulate=number / (number + 1))

    assert np.isfinite(stains(renderer, settings, soil, step=0.0)[3:]).all()


def test_things_that_move_are_followed(renderer: "Renderer", models: "Path") -> None:
    """Skins and rigid parts in motion, a still camera: frames in a row are whole, and near those made alone."""
    import glhybrid

    for name in ("BoxAnimated", "CesiumMan"):
        path = next(models.rglob(f"{name}.gl*"), None)
        if path is None:
            pytest.skip(f"no {name} among the models")
        world = glhybrid.load(path)
        world = world.replace(
            lights=(replace(sun((-0.5, -1, -0.3)), angular_diameter=0.1),),
            materials=tuple(replace(m, roughness=0.3, metallic=0.5) for m in world.materials),
        )
        settings = glossy(4).replace(shadows="ray-soft", time=0.5)
        staged = renderer.stage(world, settings, SIZE)
        staged.cut()
        for time in (0.3, 0.35, 0.4, 0.45, 0.5):
            staged.aim(settings.replace(time=time), None)
            staged.set(jitter_px=(0, 0), accumulate=0)
            image = staged.frame(Timing(renderer.context.gl.finish, enabled=False))
        assert staged.features.moving
        got = np.frombuffer(image.read(), np.float32).reshape(SIZE[1], SIZE[0], 4)[::-1, :, :3]
        alone = renderer.render(world, size=SIZE, settings=settings)["radiance"]
        assert np.isfinite(got).all() and rmse(got, alone) < 0.2 * alone.std(), name
