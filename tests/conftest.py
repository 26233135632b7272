"""One OpenGL context for the whole run, no GL error before or after a test, and a reason for every skip.

GLHYBRID_TEST_DEVICE chooses the device (default auto); with GLHYBRID_REQUIRE_GL=1, as `make test` sets it, a machine
without OpenGL fails instead of skipping. GLHYBRID_TEST_FORMS=gpu runs what a GPU would on a software device (programs in
parts, its forms of loops, trees built in compute; new images and buffers hold garbage): tests of pictures then find most
of what is wrong there. Tests of speed and of what software lacks do not hold so.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import unwritten

if TYPE_CHECKING:
    from glhybrid.context import Context

ROOT = Path(__file__).resolve().parent.parent
MODELS = ROOT.parent / "shared" / "models"


def pytest_configure(config: pytest.Config) -> None:
    os.environ.setdefault(
        "GLHYBRID_COMPILE", "first"
    )  # the same trees in every run, and no process of ours left behind
    os.environ.setdefault("GLHYBRID_TUNING", "off")  # no test's picture may hang on how fast the machine is today
    config.addinivalue_line("markers", "gpu: needs an OpenGL 4.3 context (tests/gpu, tests/image, tests/viewer)")
    config.addinivalue_line("markers", "slow: takes more than a few seconds on two cores")
    if "s" not in config.option.reportchars:
        config.option.reportchars += "s"  # a skipped test prints why


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if {"gpu", "image", "viewer"} & set(item.path.relative_to(ROOT).parts):
            item.add_marker(pytest.mark.gpu)


@pytest.fixture(scope="session")
def _shared_context() -> "Iterator[Context]":
    from glhybrid.context import open_context
    from glhybrid.errors import DeviceError

    try:
        opened = open_context(os.environ.get("GLHYBRID_TEST_DEVICE", "auto"))
    except DeviceError as error:
        if os.environ.get("GLHYBRID_REQUIRE_GL") == "1":
            raise
        pytest.skip(f"no OpenGL 4.3: {error}")
    with ExitStack() as stack:
        if os.environ.get("GLHYBRID_TEST_FORMS") == "gpu":
            opened.device = replace(opened.device, software=False)
            stack.enter_context(unwritten.filled())
        stack.enter_context(opened)
        yield opened


@pytest.fixture
def context(_shared_context: "Context") -> "Iterator[Context]":
    """The run's context, current, with no GL error before and after the test."""
    _shared_context.make_current()  # another test may have left its own context current
    before = _shared_context.raw.errors()
    assert not before, f"left by an earlier test: {before}"
    _shared_context.gl.detect_framebuffer(0).use()  # nor does a framebuffer of an earlier test stay bound
    yield _shared_context
    _shared_context.make_current()
    after = _shared_context.raw.errors()
    assert not after, f"GL errors left by this test: {after}"


@pytest.fixture(scope="session")
def models() -> Path:
    """The folder of test models beside the checkout; the test is skipped where it is absent."""
    if not MODELS.is_dir():
        pytest.skip("no ../shared/models beside the checkout")
    return MODELS
