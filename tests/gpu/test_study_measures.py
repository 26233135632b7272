"""What a study measures by: its reference, direct light, flicker, times, specular share."""

from pathlib import Path

import numpy as np
import pytest
from study_stage import CAMERA, SIZE, stage

import glhybrid as gh
from glhybrid.load.shapes import box
from glhybrid.scene import Camera, Environment, Light, Material
from glhybrid.settings import Settings
from glhybrid.study import direct, measure, picture, reference, stability, stages
from glhybrid.study.measure import Clock


def test_the_reference_knows_its_noise(renderer: gh.Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its expected error is the real one, measured against a picture of many more paths; and it goes on from disk."""
    scene = stage().replace(lights=())  # a sun in a glossy box is found by one path in thousands: no halves tell of it
    few = reference.converge(renderer, scene, CAMERA, SIZE, bounces=2, target=0.0, most=16, folder=tmp_path)
    many = reference.converge(renderer, scene, CAMERA, SIZE, bounces=2, target=0.0, most=512, folder=tmp_path)
    assert many.samples >= 512 and many.noise_flip < few.noise_flip / 2
    real = float(renderer.flip.hdr(few.radiance, many.radiance).mean())
    assert 0.6 < real / few.noise_flip < 1.6
    monkeypatch.setattr(reference, "LOOK_PIXELS", SIZE[0] * SIZE[1] // 3)
    monkeypatch.setattr(reference, "BAND", 4)
    again = reference.converge(renderer, scene, CAMERA, SIZE, bounces=2, target=0.0, most=512, folder=tmp_path)
    assert 0 < abs(again.noise_flip / many.noise_flip - 1) < 0.1, "of a third of the rows"
    assert np.array_equal(again.radiance, many.radiance) and again.samples == many.samples
    for path in tmp_path.glob("*.npz"):
        path.write_bytes(path.read_bytes()[:1000])
    anew = reference.converge(renderer, scene, CAMERA, SIZE, bounces=2, target=0.0, most=16, folder=tmp_path)
    assert np.array_equal(anew.radiance, few.radiance), "a damaged file is made anew"


def test_bias_is_told_against_all_light(renderer: gh.Renderer, tmp_path: Path) -> None:
    """Half of a floor's light comes from a small sun by way of a mirror, found by one path in 3,000: the picture leaves
    most of it out, as specks, and bias does not. The other half is found by every path: what has no more is 50 % off."""
    sky = np.zeros((64, 128, 3), np.float32)
    sky[16, 0] = 400  # behind whoever looks along -Z, 45 degrees up: the mirror shows it to a floor before it
    floor = Material("floor", (0.8, 0.8, 0.8, 1))
    mirror = Material("mirror", (1, 1, 1, 1), metallic=1.0, roughness=0.0)
    parts: list[stages.Part] = [(box(size=(1, 0.2, 1)), 0, (0, -0.1, 0)), (box(size=(200, 200, 1)), 1, (0, 90, -1.5))]
    down = Camera.look_at((0, 5, 0), (0, 0, 0), up=(0, 0, -1), fov_y=0.15)
    scene, camera = stages.placed("half", parts, (floor, mirror), down, environment=Environment(sky))
    size = (48, 36)
    found = reference.converge(renderer, scene, camera, size, bounces=1, target=0.0, most=256, folder=tmp_path)
    assert 20 < found.left_out_percent < 50

    def compared(bounces: int, samples: int) -> picture.Difference:
        settings = Settings(reflections="reference", aa=1, bounces=bounces, samples=samples, seed=12345)
        got = renderer.render(scene, camera, size, settings)["radiance"]
        return picture.compare(got, found.radiance, np.zeros(got.shape[:2], np.float32), found.light)

    every, direct_only = compared(1, 2048), compared(0, 64)
    assert 0.5 < every.bias_error_percent < 8
    assert (
        abs(every.bias_percent) < 4 * every.bias_error_percent
    )  # of 1.06 times that: `every` has an eighth of the variance
    assert abs(direct_only.bias_percent + 50) < 4 * direct_only.bias_error_percent
    trimmed = picture.compare(
        found.radiance, found.radiance, np.zeros(found.radiance.shape[:2], np.float32), found.light
    )
    assert trimmed.bias_percent == pytest.approx(-found.left_out_percent, abs=0.01)


def test_the_reference_ends_in_time(renderer: gh.Renderer, tmp_path: Path) -> None:
    """After the seconds given, but for what is too little to tell anything; asked again it goes on."""
    options = {"target": 0.0, "most": 1 << 20, "budget_s": 0.5, "folder": tmp_path}
    first = reference.converge(renderer, stage(), CAMERA, SIZE, **options)  # type: ignore[arg-type]
    assert not first.complete and reference.LEAST <= first.samples < 1 << 18
    more = reference.converge(renderer, stage(), CAMERA, SIZE, **options)  # type: ignore[arg-type]
    assert more.samples > first.samples and more.seconds > first.seconds


def test_direct_light_is_what_is_drawn(renderer: gh.Renderer) -> None:
    """Visibility times unblocked light, summed over lights, is the renderer's own picture without a sky."""
    lamp = Light("point", position=(1.5, 2.0, 1.0), intensity=5.0)
    scene = stage().replace(lights=(*stage().lights, lamp))
    light = direct.find(renderer, scene, CAMERA, SIZE)
    drawn = renderer.render(
        scene.replace(environment=None), CAMERA, SIZE, Settings(reflections="none", aa=1), aovs=("visibility",)
    )
    assert np.allclose(light.direct(drawn["visibility"]), drawn["radiance"], rtol=1e-4, atol=1e-5)
    assert np.array_equal(light.visibility, drawn["visibility"]), "hard lights"


def test_a_lamp_with_a_size_has_a_penumbra_of_the_right_width(renderer: gh.Renderer) -> None:
    """The truth of a half-plane's shadow under a disc: a straight edge across a disc (metrics.disc_visibility)."""
    from shadow_scenes import half_plane

    from glhybrid.study.metrics import disc_visibility

    height, half = 1.0, np.radians(2.0)
    scene, view = half_plane(height, float(half))
    light = direct.find(renderer, scene, view, (96, 6), points=256)
    assert np.isclose(view.xmag, 3 * height * np.tan(half))
    x = ((np.arange(96) + 0.5) / 96 * 2 - 1) * view.xmag
    want = disc_visibility(x / (height * np.tan(half)))
    got = light.visibility[2, :, 0]
    if got[0] > got[-1]:
        got = got[::-1]
    assert np.abs(got - want).mean() < 0.01


def test_flips_and_flicker(renderer: gh.Renderer) -> None:
    """Rays do not flip in a pan by whole pixels; maps that are not snapped to their texels do."""
    scene = stage()
    camera = stability.orthographic(CAMERA, stability.typical_depth(renderer, scene, CAMERA))
    traced = stability.pan(renderer, scene, camera, SIZE, Settings(aa=1), 3)
    coarse = {"shadows.csm.resolution": 64, "shadows.csm.snap": False}
    mapped = stability.pan(renderer, scene, camera, SIZE, Settings(shadows="csm", aa=1, parameters=coarse), 3)
    assert traced.flip_rate_percent == 0 < mapped.flip_rate_percent
    assert traced.flicker < mapped.flicker


def test_times_are_of_whole_frames(renderer: gh.Renderer) -> None:
    times = measure.time_frames(renderer, stage(), CAMERA, SIZE, Settings(aa=1), Clock(frames=4, seconds=0.0))
    assert times.frames >= 4 and times.frame_ms > 0 and times.cpu_ms > 0
    assert times.trace_ms == pytest.approx(times.passes["shadow"] + times.passes["reflect"])


def test_specular_share(renderer: gh.Renderer) -> None:
    share = measure.specular_share(renderer, stage(), CAMERA, SIZE)
    frame = renderer.render(stage(), CAMERA, SIZE, Settings(aa=1), aovs=("metallic", "instance_id"))
    metal, sky = frame["metallic"] == 1, frame["instance_id"] == 0xFFFFFFFF
    assert (share[metal] > 0.99).all() and (share[~metal & ~sky] < 0.5).all() and (share[sky] == 0).all()
