"""Compiling by the driver's own threads: somebody is told meanwhile, may end it, and nothing is left behind."""

from typing import Any

import pytest

from glhybrid.compile_aside import CompileAside
from glhybrid.context import Context
from glhybrid.gl import GL_COMPUTE_SHADER, GL_FRAGMENT_SHADER, GL_VERTEX_SHADER

COMPUTE = "#version 430 core\nlayout(local_size_x = 1) in;\nbuffer B { uint n; };\nvoid main() { n = 3u; }\n"
VERTEX = "#version 430 core\nvoid main() { gl_Position = vec4(0.0); }\n"
FRAGMENT = "#version 430 core\nlayout(location = 0) out vec4 color;\nvoid main() { color = vec4(1.0); }\n"


def alive(context: Context) -> int:
    return sum(context.raw.glIsProgram(n) for n in range(1, 20_000))


@pytest.mark.parametrize(
    "stages",
    [{GL_COMPUTE_SHADER: COMPUTE}, {GL_VERTEX_SHADER: VERTEX, GL_FRAGMENT_SHADER: FRAGMENT}, {GL_COMPUTE_SHADER: "no"}],
    ids=["compute", "raster", "broken"],
)
def test_somebody_is_told_until_it_is_done(context: Context, monkeypatch: pytest.MonkeyPatch, stages: Any) -> None:
    aside = CompileAside(context.raw)
    if not aside.worth:
        pytest.skip("the driver compiles while one waits")
    before, told, real = alive(context), [], context.raw.get_program
    monkeypatch.setattr(context.raw, "get_program", lambda *given: len(told) > 2 and real(*given))
    assert aside.run(stages, lambda: told.append(0)) > 0
    assert len(told) >= 3 and alive(context) == before and not context.raw.errors()


def test_it_can_be_ended(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    aside = CompileAside(context.raw)
    monkeypatch.setattr(context.raw, "get_program", lambda *_: 0)
    before = alive(context)

    def end() -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        aside.run({GL_COMPUTE_SHADER: COMPUTE}, end)
    assert alive(context) == before and not context.raw.errors()


def test_drivers_that_keep_nothing_compile_once(context: Context) -> None:
    aside = CompileAside(context.raw)
    aside.worth = True
    for aside_s, again_s, worth in ((2.0, 0.1, True), (0.01, 0.01, True), (2.0, 1.9, False)):
        aside.learn(aside_s, again_s)
        assert aside.worth == worth
