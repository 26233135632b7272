"""Drawn in bands, with turns in between, a picture is the same to the bit, and what a turn raises ends it."""

from typing import Any

import numpy as np
import pytest

import glhybrid
from glhybrid import Renderer, Settings, pace
from glhybrid.context import Context
from glhybrid.timing import Timing

SIZE = (88, 61)  # no whole number of tiles
CASES = (
    {}, {"primary": "trace"}, {"shadows": "ray-soft", "samples": 2}, {"shadows": "pcss", "reflections": "ssr"},
    {"reflections": "ssr-ray", "ao": "ssao"}, {"reflections": "ray-glossy", "ao": "ray"}, {"reflections": "probe"},
    {"parameters": {"reflections.ray-lerp.resolution": "half"}}, {"kernels": "split"},
    {"reflections": "reference", "samples": 3},
)  # fmt: skip


@pytest.mark.parametrize("chosen", CASES, ids=lambda c: "-".join(f"{v}" for v in c.values()) or "default")
def test_bands_are_the_whole(context: Context, chosen: dict[str, Any]) -> None:
    scene, settings = glhybrid.load("showroom"), Settings(**chosen).replace(aa=2)
    turns = 0

    def turn() -> None:
        nonlocal turns
        turns += 1

    with Renderer(context=context) as renderer:
        found = []
        for given in (None, turn):
            staged = renderer.stage(scene, settings, SIZE)
            staged.aim(settings, 0)
            with renderer.shaders.pace.turns(given):
                progress = (lambda *_: turn()) if given else None
                found.append(staged.accumulate(Timing(context.gl.finish), progress).read())
    assert found[0] == found[1]
    assert turns >= 5  # a program begins with one row of tiles of eight, then takes four at most


def test_an_interrupted_picture_can_be_drawn_again(context: Context) -> None:
    scene, settings = glhybrid.load("cornell"), Settings()
    with Renderer(context=context) as renderer:
        want = renderer.render(scene, size=SIZE, settings=settings).rgb
        for after in (1, 5, 12):
            left = after

            def turn() -> None:
                nonlocal left
                left -= 1
                if left == 0:
                    raise pace.Interrupted

            with renderer.shaders.pace.turns(turn), pytest.raises(pace.Interrupted):
                renderer.render(scene, size=SIZE, settings=settings)
            assert not renderer.shaders.pace.on
            assert np.array_equal(renderer.render(scene, size=SIZE, settings=settings).rgb, want)


def test_bands_grow_to_their_time_and_no_faster_than_is_known() -> None:
    bands = pace.Bands()
    assert bands.rows(10) == 1
    bands.note(10, 0.1, 40.0)
    assert bands.rows(10) == pace.GROWTH
    bands.note(40, 80.0, 40.0)
    assert bands.rows(10) == 2 and bands.rows(100) == 1
