"""Numbers and maps of errors, made on the device, against NumPy in float64; every part of the window in between lives."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glhybrid import Settings
from glhybrid.viewer import views
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.compare import Differ
from glhybrid.viewer.picture import Picture

Open = Callable[..., Viewer]


def map_of(viewer: Viewer, side: str) -> np.ndarray:
    """(H, W, 3) of the map that is shown, row 0 at the top."""
    image, flipped = viewer.pictures.image(side)  # type: ignore[arg-type,misc]
    assert flipped
    return np.frombuffer(image.read(), np.uint8).reshape(image.height, image.width, 4)[::-1, :, :3]


def by_hand(ours: Picture, theirs: Picture) -> tuple[float, float]:
    """(PSNR in dB, relMSE) in float64."""
    levels = ours.rgb().astype(np.float64) - theirs.rgb()
    a, r = ours.radiance().astype(np.float64), theirs.radiance().astype(np.float64)
    relative = np.square(a - r).sum(-1) / (np.square(r).sum(-1) + 0.01)
    return 20 * np.log10(255 / np.sqrt(np.square(levels).mean())), float(relative[np.isfinite(relative)].mean())


@pytest.mark.parametrize("size", [(96, 64), (61, 37), (17, 9)])
def test_errors_are_those_by_hand(open_viewer: Open, size: tuple[int, int]) -> None:
    viewer = open_viewer("yard", size=size, a=Settings(shadows="none"), b=Settings(), mode="difference", against="b")
    viewer.settle()
    ours, theirs = viewer.pictures.sides["a"], viewer.pictures.sides["b"]
    error, (psnr, rel_mse) = viewer.pictures.measure.errors["a"], by_hand(ours, theirs)
    assert error.psnr == pytest.approx(psnr, rel=1e-9) and psnr < 60  # levels are whole numbers: nothing is rounded
    assert error.rel_mse == pytest.approx(rel_mse, rel=1e-5) and rel_mse > 1e-4  # sums of 64 floats


def test_pixels_that_are_not_finite_are_left_out(open_viewer: Open) -> None:
    viewer = open_viewer(
        "yard", size=(24, 16), a=Settings(shadows="none"), b=Settings(), mode="difference", against="b"
    )
    viewer.settle()
    ours, theirs = viewer.pictures.sides["a"], viewer.pictures.sides["b"]
    image = ours.image
    texels = np.frombuffer(image.read(), np.float32).reshape(16, 24, 4).copy()
    texels[3, 5], texels[9, 20], texels[15, 0] = np.nan, np.inf, 3e38  # the last one's square is not finite
    image.write(texels)
    error = viewer.pictures.measure.differ.error(ours, theirs)
    with np.errstate(over="ignore", invalid="ignore"):
        a, r = texels[::-1, :, :3], theirs.radiance()
        relative = np.square(a - r).sum(-1) / (np.square(r).sum(-1) + np.float32(0.01))
    assert np.isfinite(relative).sum() == 24 * 16 - 3
    assert error.rel_mse == pytest.approx(float(relative[np.isfinite(relative)].mean(dtype=np.float64)), rel=1e-5)


@pytest.mark.parametrize("gain", [1.0, 4.0, 9.5])
def test_the_map_is_the_largest_difference_of_the_channels(open_viewer: Open, gain: float) -> None:
    state: dict[str, Any] = dict(a=Settings(shadows="none"), b=Settings(), mode="difference", against="b", gain=gain)
    viewer = open_viewer("yard", size=(61, 37), **state)
    viewer.settle()
    ours, theirs = (viewer.pictures.sides[side].rgb().astype(np.float64) for side in ("a", "b"))
    want = views.heat(np.abs(ours - theirs).max(-1), 255 / gain, "")[0]
    got = map_of(viewer, "a")
    # A level lies at most one colour off, where gain times a level falls between two of them.
    low, high = (views.heat(np.abs(ours - theirs).max(-1) + e / gain, 255 / gain, "")[0] for e in (-0.01, 0.01))
    assert ((got == want) | (got == low) | (got == high)).all() and len(np.unique(got)) > 8
    legend = viewer.pictures.legend
    assert isinstance(legend, views.Scale) and legend.high == pytest.approx(255 / gain)
    viewer.session.gain = 2 * gain  # a slider alone draws it anew
    viewer.settle()
    assert not np.array_equal(map_of(viewer, "a"), got)


def test_the_difference_of_two_techniques_is_shown_in_motion(open_viewer: Open) -> None:
    viewer = open_viewer(
        "yard", size=(96, 64), a=Settings(shadows="none"), b=Settings(), mode="difference", against="b"
    )
    viewer.settle()
    viewer.session.use_camera(1)
    viewer.tick()
    assert viewer.pictures.moving
    ours, theirs = (viewer.pictures.sides[side].rgb().astype(np.float64) for side in ("a", "b"))
    want = views.heat(np.abs(ours - theirs).max(-1), 255 / 4, "")[0]
    assert np.array_equal(map_of(viewer, "a"), want) and len(np.unique(want)) > 8


def test_flip_is_the_authors(open_viewer: Open) -> None:
    flip_evaluator = pytest.importorskip("flip_evaluator", reason="the authors' flip-evaluator is not installed")
    viewer = open_viewer("yard", size=(64, 48), a=Settings(shadows="none"), b=Settings(), mode="flip", against="b")
    viewer.settle()
    ours, theirs = (viewer.pictures.sides[side].rgb().astype(np.float32) / 255 for side in ("a", "b"))
    error, mean, _ = flip_evaluator.evaluate(theirs, ours, "LDR", applyMagma=False)
    assert viewer.pictures.measure.errors["a"].flip == pytest.approx(float(mean), rel=1e-3)  # filters, another way up
    want = views.heat(np.asarray(error).reshape(48, 64), 1.0, "")[0].astype(int)
    assert np.abs(map_of(viewer, "a") - want).max() <= 6 and want.max() > 60


def test_images_of_other_sizes_are_made_anew(open_viewer: Open) -> None:
    viewer = open_viewer(
        "yard", size=(64, 48), a=Settings(shadows="none"), b=Settings(), mode="difference", against="b"
    )
    viewer.settle()
    differ = viewer.pictures.measure.differ
    assert isinstance(differ, Differ)
    for width, height in ((80, 40), (33, 70)):
        viewer.surface.resize((viewer.surface.size[0] - viewer.picture_size[0] + width, height))  # type: ignore[attr-defined]
        viewer.settle()
        assert map_of(viewer, "a").shape == (height, width, 3)
        psnr = by_hand(viewer.pictures.sides["a"], viewer.pictures.sides["b"])[0]
        assert viewer.pictures.measure.errors["a"].psnr == pytest.approx(psnr)
