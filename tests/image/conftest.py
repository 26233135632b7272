"""One renderer and one Mitsuba process for all image tests."""

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from mitsuba_client import Oracle

    from glhybrid.context import Context
    from glhybrid.renderer import Renderer

SCALE = float(os.environ.get("GLHYBRID_TEST_SCALE", "1"))  # more samples and pixels: 1 is for every day


@pytest.fixture(scope="session")
def scale() -> float:
    return SCALE


@pytest.fixture(scope="session")
def _shared_renderer(_shared_context: "Context") -> "Iterator[Renderer]":
    from glhybrid.renderer import Renderer

    renderer = Renderer(context=_shared_context)
    yield renderer
    _shared_context.make_current()
    renderer.close()


@pytest.fixture
def renderer(context: "Context", _shared_renderer: "Renderer") -> "Renderer":
    """The run's renderer; its programs are compiled once."""
    return _shared_renderer


@pytest.fixture(scope="session")
def oracle(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[Oracle]":
    """Mitsuba 3; the test is skipped, with the reason, where it does not run."""
    from mitsuba_client import Oracle, Unavailable

    try:
        started = Oracle(tmp_path_factory.mktemp("mitsuba"))
    except Unavailable as error:
        pytest.skip(str(error))
    yield started
    started.close()
