"""Compiled programs on disk: what one context has compiled another loads, and draws alike."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import glhybrid as gh
from glhybrid import content_cache
from glhybrid.errors import ShaderError
from glhybrid.gl import GL_COMPUTE_SHADER
from glhybrid.needs import Features
from glhybrid.program_cache import ProgramCache
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (48, 36)
TEXT = """#version 430
layout(local_size_x = 1) in;
layout(std430, binding = 0) buffer Result { uint result[]; };
void main() { result[0] = 7u; }
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    return tmp_path / "program"


@pytest.fixture
def renderer(context: "Context") -> Iterator[gh.Renderer]:
    """Of a context of its own, as another process would have it."""
    device = "software" if context.device.software or os.environ.get("GLHYBRID_TEST_FORMS") else "auto"
    with gh.Renderer(device, keep_programs=True) as opened:
        if not opened.keeps_programs:
            pytest.skip("this driver gives no program binaries")
        yield opened
    context.make_current()


def programs(renderer: gh.Renderer) -> ProgramCache:
    found = renderer.context.programs
    assert found is not None
    return found


def draw(renderer: gh.Renderer) -> np.ndarray:
    """With programs for raster and compute, of several passes."""
    settings = Settings(aa=1, shadows="map", reflections="ray-lerp")
    return renderer.render(gh.load("cornell"), 0, SIZE, settings, aovs=("depth",))["radiance"]


def test_what_is_kept_is_loaded(renderer: gh.Renderer, folder: Path) -> None:
    want = draw(renderer)
    first = programs(renderer)
    assert first.loaded == 0 and first.compiled > 5 and len(list(folder.iterdir())) == first.compiled
    with gh.Renderer("software" if renderer.context.device.software else "auto", keep_programs=True) as again:
        assert np.array_equal(draw(again), want)
        assert programs(again).compiled == 0 and programs(again).loaded == first.compiled
        assert not again.context.raw.errors()
    renderer.context.make_current()


def test_what_the_driver_refuses_is_compiled(renderer: gh.Renderer, folder: Path) -> None:
    """As after an update that its version string does not tell; the file is then written anew."""
    cache, gl = programs(renderer), renderer.context.gl
    with cache.making({GL_COMPUTE_SHADER: TEXT}):
        gl.compute_shader(TEXT).release()
    (path,) = folder.iterdir()
    name = path.stem
    kept = content_cache.read("program", name)
    assert kept is not None
    content_cache.write("program", name, kept[:4] + bytes(len(kept) - 4))
    with cache.making({GL_COMPUTE_SHADER: TEXT}) as there:
        assert there
        program = gl.compute_shader(TEXT)
    result = gl.buffer(bytes(4))
    result.bind_to_storage_buffer(0)
    program.run(1)
    assert result.read() == (7).to_bytes(4, "little") and cache.compiled == 2 and cache.loaded == 0
    written = content_cache.read("program", name)
    assert not renderer.context.raw.errors() and written is not None and any(written[4:])
    program.release()
    result.release()


def test_errors_are_told_and_not_kept(renderer: gh.Renderer, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes" / "wrong.comp").write_text("layout(local_size_x = 1) in;\nvoid main() { nothing = 1; }\n")
    shaders = Shaders(renderer.context, (tmp_path,))
    for _ in range(2):
        with pytest.raises(ShaderError, match="wrong"):
            shaders.compute("wrong", Features())
    assert not folder.exists() and programs(renderer).compiled == 0
    renderer.context.raw.errors()


def test_nothing_is_kept_where_nothing_is_to_be(renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CACHE", "off")
    assert not renderer.keeps_programs
    with programs(renderer).making({GL_COMPUTE_SHADER: TEXT}) as there:
        assert not there
        renderer.context.gl.compute_shader(TEXT).release()
    assert programs(renderer).compiled == 0
    with gh.Renderer(context=renderer.context) as plain:
        assert not plain.keeps_programs


def test_an_interrupt_is_heard_once_the_program_is_made(renderer: gh.Renderer) -> None:
    """What is raised where the driver is called from C is lost: no exception goes through it."""
    cache, made = programs(renderer), []
    real = cache._raw.glLinkProgram

    def linking(program: int) -> None:
        signal.raise_signal(signal.SIGINT)
        real(program)

    cache._raw.glLinkProgram = linking  # type: ignore[method-assign]
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), cache.making({GL_COMPUTE_SHADER: TEXT}):
            made.append(renderer.context.gl.compute_shader(TEXT))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, handler)
    assert made and cache.compiled == 1
    made[0].release()
