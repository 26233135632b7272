"""From radiance to what a screen shows: exposure, tone maps, sRGB, and files that hold radiance as it is."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from scene_kit import box, camera_rays, constant_sky, floor, matte, metal, plastic, quad, scene, sun

from glhybrid.scene import Camera, Environment, Material, Scene, Sphere
from glhybrid.settings import TONE_MAPS, Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def srgb(c: "F64") -> "F64":
    """IEC 61966-2-1, 0 to 255."""
    c = np.clip(c, 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055) * 255


def tone_none(c: "F64") -> "F64":
    return c


def tone_aces(c: "F64") -> "F64":
    """Stephen Hill's fit of RRT and ODT (MJP's BakingLab), matrices by rows."""
    into = np.array([(0.59719, 0.35458, 0.04823), (0.07600, 0.90834, 0.01566), (0.02840, 0.13383, 0.83777)])
    out = np.array([(1.60475, -0.53108, -0.07367), (-0.10208, 1.10813, -0.00605), (-0.00327, -0.07276, 1.07602)])
    c = c @ into.T
    c = (c * (c + 0.0245786) - 0.000090537) / (c * (0.983729 * c + 0.4329510) + 0.238081)
    return np.clip(c @ out.T, 0, 1)


def tone_agx(c: "F64") -> "F64":
    """AgX (Sobotka) by Wrensch's minimal fit: log2 range of 16.5 stops, a polynomial, and gamma 2.2 undone."""
    into = np.array(
        [
            (0.842479062253094, 0.0784335999999992, 0.0792237451477643),
            (0.0423282422610123, 0.878468636469772, 0.0791661274605434),
            (0.0423756549057051, 0.0784336, 0.879142973793104),
        ]
    )
    stops = np.clip((np.log2(np.maximum(c @ into.T, 1e-10)) + 12.47393) / (4.026069 + 12.47393), 0, 1)
    curve = np.polyval([15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232], stops)
    return np.clip(np.maximum(curve @ np.linalg.inv(into).T, 0) ** 2.2, 0, 1)


def tone_pbr_neutral(c: "F64") -> "F64":
    """Khronos PBR Neutral tone mapper, from its specification."""
    compress, desaturate = 0.8 - 0.04, 0.15
    low = c.min(-1, keepdims=True)
    c = c - np.where(low < 0.08, low - 6.25 * low**2, 0.04)
    peak = c.max(-1, keepdims=True)
    new = 1 - (1 - compress) ** 2 / (peak + 1 - 2 * compress)
    scaled = c * new / np.maximum(peak, 1e-30)
    g = 1 / (desaturate * (peak - new) + 1)
    return np.where(peak < compress, c, scaled * g + new * (1 - g))


TONES = {"none": tone_none, "aces": tone_aces, "agx": tone_agx, "pbr-neutral": tone_pbr_neutral}


def ramp(high: float = 60.0) -> Scene:
    """A sky of random colours over many decades, nothing else in view."""
    rng = np.random.default_rng(4)
    texels = np.exp(rng.uniform(np.log(1e-4), np.log(high), (32, 64, 1))) * rng.uniform(0.02, 1, (32, 64, 3))
    texels[:, :32] = texels[:, :32].mean(-1, keepdims=True)  # half of it grey
    camera = Camera.look_at((0, 0, 0), (0.2, 0.1, -1), fov_y=2.2)
    return scene([(floor(0.01, -1000.0), matte())], camera=camera, environment=Environment(texels.astype(np.float32)))


@pytest.mark.parametrize("others", ["nothing", "lights and metals", "bright sky", "layers"])
def test_half_grey_reads_188(renderer: "Renderer", others: str) -> None:
    """An unlit linear 0.5 is 188 in a PNG at exposure 0 without tone map, beside anything."""
    card = (
        quad([(-0.5, 0.5, 1), (0.5, 0.5, 1), (0.5, 1.5, 1), (-0.5, 1.5, 1)]),
        Material("grey", (0.5, 0.5, 0.5, 1.0), unlit=True),
    )
    camera = Camera.look_at((0, 1, 4), (0, 1, 0))
    glass = plastic((1.0, 0.2, 0.2), 0.1, alpha_mode="BLEND", clearcoat=1.0)
    more: Any = {
        "nothing": ([], {}),
        "lights and metals": (
            [(floor(), metal(1.0, 0.1)), (Sphere(0.5), plastic(), (1, 0.5, 0))],
            {"lights": [sun(lux=1e5)]},
        ),
        "bright sky": ([(floor(), matte())], {"environment": constant_sky(5000.0)}),
        "layers": (
            [(box((-1, 0, -1), (1, 2, 0)), glass), (floor(), matte(emissive=(9.0, 1.0, 1.0)))],
            {"lights": [sun()]},
        ),
    }[others]
    world = scene([card, *more[0]], camera=camera, **more[1])
    for reflections in ("none", "env", "ray-lerp", "reference"):
        for aa in (1, 4):
            settings = Settings(aa=aa, exposure=0.0, tone="none", reflections=reflections, samples=4)
            frame = renderer.render(world, size=(32, 32), settings=settings)
            assert (frame.rgb[14:18, 14:18] == 188).all(), (others, reflections, aa, frame.rgb[16, 16])


@pytest.mark.parametrize("tone", TONE_MAPS)
def test_tone_maps(renderer: "Renderer", tone: str) -> None:
    """Exposure, tone map and sRGB as their authors wrote them, to one step of 255."""
    world = ramp()
    for ev in (-2.0, 0.0, 1.5):
        frame = renderer.render(world, size=(96, 64), settings=Settings(aa=1, exposure=ev, tone=tone))
        want = srgb(TONES[tone](frame["radiance"].astype(np.float64) * 2**ev))
        error = np.abs(frame.rgb - want)
        assert error.max() < BARS["display step"].value, (tone, ev, error.max())


@pytest.mark.parametrize("tone", TONE_MAPS)
def test_tone_maps_are_monotone(renderer: "Renderer", tone: str) -> None:
    """Brighter grey light never looks darker, black is black, and much light is white; nothing wraps or turns NaN."""
    texels = np.tile(np.geomspace(1e-4, 1e3, 256, dtype=np.float32)[None, :, None], (2, 1, 3))
    camera = Camera.look_at((0, 0, 0), (0, 0, -1), fov_y=0.2)
    camera = Camera("strip", camera.world_from_view, fov_y=np.radians(60))
    world = scene([(floor(0.01, -1000.0), matte())], camera=camera, environment=Environment(texels))
    frame = renderer.render(world, size=(256, 4), settings=Settings(aa=1, exposure=-1.0, tone=tone))
    row, light = frame.rgb[1].astype(int), frame["radiance"][1, :, 0]
    assert (np.diff(light) >= 0).all() and light[-1] > 100 * light[0]
    assert (np.diff(row, axis=0) >= 0).all() and (np.ptp(row, axis=1) <= 1).all()
    for radiance, exposure, low, high in ((0, 0, 0, 2), (1e4, 0, 250, 255), (1e20, 0, 250, 255), (1e20, 60, 250, 255)):
        card = Material("card", (0.0, 0.0, 0.0, 1.0), emissive=(radiance,) * 3)
        flat = scene([(floor(100.0), card)], camera=Camera.look_at((0, 1, 0.001), (0, 0, 0)))
        rgb = renderer.render(flat, size=(4, 4), settings=Settings(aa=1, exposure=exposure, tone=tone)).rgb
        assert low <= rgb.min() and rgb.max() <= high, (tone, radiance, rgb[0, 0])


def test_auto_exposure(renderer: "Renderer") -> None:
    """The log-average luminance goes to 0.18; the receipt says by how many EV; black pixels do not count."""
    world = ramp()
    frame = renderer.render(world, size=(64, 48), settings=Settings(aa=1, tone="none"))
    luminance = frame["radiance"].astype(np.float64) @ LUMINANCE
    want = np.log2(0.18) - np.log2(luminance).mean()
    ev = frame.receipt["settings"]["exposure_ev"]
    assert abs(ev - want) < 1e-3, (ev, want)
    assert abs(np.exp(np.log(luminance * 2**ev).mean()) - 0.18) < 1e-3
    assert np.abs(frame.rgb - srgb(frame["radiance"].astype(np.float64) * 2**ev)).max() < BARS["display step"].value
    # Ten times the light, the same picture.
    brighter = world.replace(environment=Environment(world.environment.radiance, intensity=10.0))  # type: ignore[union-attr]
    other = renderer.render(brighter, size=(64, 48), settings=Settings(aa=1, tone="none"))
    assert abs(other.receipt["settings"]["exposure_ev"] - ev + np.log2(10)) < 1e-3
    assert np.abs(other.rgb.astype(int) - frame.rgb).max() <= 1
    # A black half changes nothing; a picture all black is shown as it is.
    dark = scene([(quad([(-9, -9, -3), (0, -9, -3), (0, 9, -3), (-9, 9, -3)]), Material(base_color=(0, 0, 0, 1), unlit=True))],
                 camera=Camera.look_at((0, 0, 0), (0, 0, -1)), environment=constant_sky(0.7))  # fmt: skip
    half = renderer.render(dark, size=(64, 48), settings=Settings(aa=1))
    assert abs(half.receipt["settings"]["exposure_ev"] - np.log2(0.18 / 0.7)) < 1e-3
    black = renderer.render(dark.replace(environment=None), size=(16, 16), settings=Settings(aa=1))
    assert black.receipt["settings"]["exposure_ev"] == 0 and not black.rgb.any()


def test_files_hold_radiance(renderer: "Renderer", tmp_path: Path) -> None:
    """EXR and NPZ are the same whatever the exposure and the tone map, and are the radiance."""
    import OpenEXR

    world = ramp()
    arrays = []
    for name, settings in (
        ("a", Settings(aa=1, exposure=5.0, tone="agx")),
        ("b", Settings(aa=1, exposure=-3.0, tone="none")),
    ):
        frame = renderer.render(world, size=(32, 24), settings=settings)
        frame.save(tmp_path / f"{name}.exr", exr_float=True)
        frame.save(tmp_path / f"{name}.npz")
        with OpenEXR.File(str(tmp_path / f"{name}.exr")) as file:
            channels = file.channels()
            exr = channels["RGB"].pixels if "RGB" in channels else np.dstack([channels[c].pixels for c in "RGB"])
        with np.load(tmp_path / f"{name}.npz") as file:
            npz = file["radiance"]
        assert np.array_equal(exr, frame["radiance"]) and np.array_equal(npz, frame["radiance"])
        arrays.append(frame["radiance"])
    assert np.array_equal(arrays[0], arrays[1])


def test_antialiasing_is_a_box_over_the_pixel(renderer: "Renderer") -> None:
    """N frames cover an edge in steps of 1 / N, right on average, without moving it; 1 frame is the pixel centre's ray."""
    slope = 0.13
    card = quad([(-9, -9, -3), (slope * -9, -9, -3), (slope * 9, 9, -3), (-9, 9, -3)])
    world = scene([(card, Material("white", unlit=True))], camera=Camera.look_at((0, 0, 0), (0, 0, -1)))
    size = (64, 64)
    d = camera_rays(world, size).direction
    x, y = d[..., 0] / -d[..., 2] * 3, d[..., 1] / -d[..., 2] * 3
    pixel = 2 * 3 * np.tan(np.pi / 8) / 64
    # Exact coverage: the edge is nearly vertical, so the box is cut by a line.
    steps = (np.arange(64) + 0.5) / 64 - 0.5
    inside = x[..., None, None] + steps[:, None] * pixel < slope * (y[..., None, None] + steps * pixel)
    exact = inside.mean((-1, -2))
    for count in (1, 4, 16):
        got = renderer.render(world, size=size, settings=Settings(aa=count, reflections="none"))["radiance"][..., 0]
        error = got - exact
        if count == 1:
            sure = np.abs(x - slope * y) > 0.01 * pixel
            assert np.array_equal(got[sure], (x < slope * y)[sure].astype(np.float32))
        assert np.abs(error).max() < {1: 0.51, 4: 0.3, 16: 0.12}[count], (count, np.abs(error).max())
        assert abs(error.sum(1)[8:-8].mean()) < {1: 0.02, 4: 0.02, 16: 0.01}[count], (count, error.sum(1).mean())
