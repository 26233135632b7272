"""Several renderers in one process: each draws its own, whatever another one did in between; threads and forks are told."""

import os
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import glhybrid as gh
from glhybrid.errors import DeviceError
from glhybrid.renderer import Renderer

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (48, 32)


def own_device(context: "Context") -> str:
    """The name of the same device, for a context beside the shared one."""
    if context.device.backend == "osmesa":
        return "osmesa"
    return f"egl:{context.device.egl_index}" if context.device.egl_index is not None else "auto"


def other_device() -> str:
    try:
        Renderer("osmesa").close()
    except DeviceError as error:
        pytest.skip(f"no second kind of context: {error}")
    return "osmesa"


@pytest.mark.parametrize("second", ["the same", "osmesa"])
def test_renderers_take_turns(context: "Context", second: str) -> None:
    # Names of GL objects are small numbers that every context gives out anew: those of one mean others in the next.
    rooms, settings = [gh.load("cornell"), gh.load("failures/curved")], gh.Settings(aa=1)
    device = other_device() if second == "osmesa" else own_device(context)
    with Renderer(context=context) as alone:
        want = [alone.render(room, size=SIZE, settings=settings).rgb for room in rooms]
    with Renderer(device) as alone:
        there = [alone.render(room, size=SIZE, settings=settings).rgb for room in rooms]
    assert (want[0] != want[1]).any()
    with Renderer(context=context) as a, Renderer(device) as b:
        for first, then in ((0, 1), (1, 1), (1, 0), (0, 0)):
            # The scenes differ, so what one context has under a number is nothing that the other could use.
            np.testing.assert_array_equal(a.render(rooms[first], size=SIZE, settings=settings).rgb, want[first])
            np.testing.assert_array_equal(b.render(rooms[then], size=SIZE, settings=settings).rgb, there[then])
        shots = [gh.Shot(camera=rooms[1].cameras[0])] * 6
        for frame in a.frames(rooms[1], shots, SIZE, settings, in_flight=2):  # read back after the other one has drawn
            np.testing.assert_array_equal(frame.rgb, want[1])
            b.render(rooms[0], size=SIZE, settings=settings)
        b.close()
        np.testing.assert_array_equal(a.render(rooms[0], size=SIZE, settings=settings).rgb, want[0])


def test_another_thread_is_told(context: "Context") -> None:
    if context.device.backend != "egl":
        pytest.skip("OSMesa lets any thread have a context")
    told: list[Any] = []
    with Renderer(context=context) as renderer:
        scene = gh.load("cornell")
        renderer.render(scene, size=SIZE)

        def draw() -> None:
            try:
                renderer.render(scene, size=SIZE)
            except DeviceError as error:
                told.append(str(error))

        thread = threading.Thread(target=draw)
        thread.start()
        thread.join()
        assert len(told) == 1 and "belongs to the thread that opened it" in told[0]
        renderer.render(scene, size=SIZE)


FORKED = """
import os, sys
import glhybrid as gh
scene = gh.load("cornell")
renderer = gh.Renderer(sys.argv[1])
renderer.render(scene, size=(16, 16))
if os.fork() == 0:
    for draw in (lambda: renderer.render(scene, size=(16, 16)), lambda: gh.Renderer(sys.argv[1])):
        try:
            draw()
        except gh.DeviceError as error:
            print(error, flush=True)
    renderer.close()
    os._exit(0)
os.wait()
renderer.render(scene, size=(16, 16))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_fork_is_refused_where_it_would_wait_for_ever(context: "Context") -> None:
    line = [sys.executable, "-c", FORKED, own_device(context)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert len(said) == 2 and all('get_context("spawn")' in line for line in said), said
