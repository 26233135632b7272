"""One renderer for the tests of a module."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

import glhybrid as gh

if TYPE_CHECKING:
    from glhybrid.context import Context


@pytest.fixture(scope="module")
def renderer(_shared_context: "Context") -> Iterator[gh.Renderer]:
    """Its programs are compiled once; modules that count them make a fresh one for each test."""
    _shared_context.make_current()
    with gh.Renderer(context=_shared_context) as made:
        yield made
