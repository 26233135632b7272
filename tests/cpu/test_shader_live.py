"""What counts of a shader's text: conditions decided as a preprocessor does, and nothing that main() does not lead to."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from glhybrid.errors import ShaderError
from glhybrid.load.builtin import data_folder
from glhybrid.needs import Features
from glhybrid.shader_live import ConditionError, Text
from glhybrid.shader_source import Source

GLSL = data_folder("glsl")
PASSES = sorted(p.name for p in (GLSL / "passes").iterdir())

TEXT = """\
#define SIDE USE_A
#define TWICE(x) helper((x), B)
const uint B = 2u, C = 3u;
struct Used {
    float x;
    float lonely;
#if USE_D
    float d;
#endif
};
struct Unused { float y; };
layout(std430) readonly buffer Rows { Used rows[]; };
layout(std430) readonly buffer Others { Unused others[]; };
uniform sampler2D tex;       // tex
uniform sampler2D untouched;
float helper(float x, uint k) { return x * float(k) + rows[k].x; }
float helper(float x) { return x + rows[0].lonely; }
float lonely() { return 5.0; }
#if SIDE && !defined(NOTHING) || USE_D == 7
float chosen() { return texture(tex, vec2(0.0)).x; }
#elif USE_D >= 2
float chosen() { return 2.0; }
#else
float chosen() { return 1.0; }
#endif
float dead(
    float x
) {
#if USE_E
    return chosen();
#endif
    return x;
}
void main() {
    float a = TWICE(chosen());
#if USE_D
    a += 1.0;
#endif
}
"""


def live(**values: int) -> tuple[str, frozenset[str]]:
    return Text(TEXT).live({"USE_A": 0, "USE_D": 0, "USE_E": 0} | values)


def test_what_main_leads_to_stays_in_its_line() -> None:
    text, words = live()
    given, left = TEXT.split("\n"), text.split("\n")
    assert len(left) == len(given)
    for before, after in zip(given, left, strict=True):
        assert after in ("", before.partition("//")[0].rstrip())
    for kept in (
        "#define TWICE",
        "const uint B",
        "struct Used",
        "buffer Rows",
        "float helper(float x, uint k)",
        "1.0; }",
    ):
        assert kept in text, kept
    for gone in ("Unused", "others", "tex", "untouched", "dead", "lonely()", "2.0", "#if", "#else", "float d;", "+="):
        assert gone not in text, gone
    assert {"USE_A", "USE_D", "SIDE"} <= words and "USE_E" not in words  # dead() alone asks for E


def test_conditions() -> None:
    assert "tex" in live(USE_A=1)[0] and "tex" in live(USE_D=7)[0]
    assert "2.0" in live(USE_D=2)[0] and "float d;" in live(USE_D=1)[0] and "+= 1.0" in live(USE_D=1)[0]
    assert live(USE_E=1) == live() and live(USE_A=1)[0] != live()[0]


@pytest.mark.parametrize(
    ("text", "line"),
    [("#endif", 0), ("\n#else", 1), ("#if 1\nvoid main() {}", 1), ("#if UNKNOWN\n#endif", 0), ("\n#if 1 +\n#endif", 1)],
)
def test_broken_conditions(text: str, line: int) -> None:
    with pytest.raises(ConditionError) as caught:
        Text(text).live({})
    assert caught.value.line == line


def test_an_unfinished_function_is_left_to_the_compiler() -> None:
    assert Text("void main() {\n    int x = 1;").live({})[0] == "void main() {\n    int x = 1;"


def test_errors_name_file_and_line(tmp_path: Path) -> None:
    (tmp_path / "passes").mkdir()
    (tmp_path / "lib.glsl").write_text("// a library\n#if WHAT\n#endif\n")
    (tmp_path / "passes" / "x.comp").write_text('\n#include "lib.glsl"\nvoid main() {}\n')
    with pytest.raises(ShaderError, match=r'glsl/lib.glsl:2: "WHAT"'):
        Source((tmp_path,), "passes/x.comp").specialise(Features())


def random_features(rng: np.random.Generator) -> Features:
    """Any flags, whether or not they make sense together."""
    return Features(**{
        name: bool(rng.integers(2)) if isinstance(value, bool) else int(rng.integers(1, 5))
        for name, value in vars(Features()).items()
    })  # fmt: skip


@pytest.mark.parametrize("name", PASSES)
def test_named_features_decide_the_text(name: str) -> None:
    """Others, changed at random, change nothing: equal keys are equal programs."""
    source, rng = Source((GLSL,), f"passes/{name}"), np.random.default_rng(1)
    for _ in range(3):
        features = random_features(rng)
        text, named = source.specialise(features)
        defines = features.defines()
        assert named == {k: defines[k] for k in named} and "void main()" in text
        other = random_features(rng)
        free = {n for n, d in zip(vars(other), other.defines(), strict=True) if d not in named}
        assert source.specialise(features.replace(**{n: getattr(other, n) for n in free})) == (text, named)


@pytest.mark.skipif(shutil.which("cpp") is None, reason="no C preprocessor to compare with")
@pytest.mark.parametrize("name", ["composite.comp", "gbuffer.vert", "reflect.comp"])
def test_a_preprocessor_leaves_the_same(name: str) -> None:
    """All that is left is there, in order, in what the C preprocessor makes of the whole text."""

    def expanded(text: str) -> list[str]:
        body = "\n".join(line for line in text.split("\n") if not line.startswith(("#version", "#line")))
        done = subprocess.run(
            ["cpp", "-P", "-undef", "-nostdinc", "-x", "c"], input=body, capture_output=True, text=True, check=True
        ).stdout
        return [" ".join(line.split()) for line in done.splitlines() if line.strip()]

    source, rng = Source((GLSL,), f"passes/{name}"), np.random.default_rng(2)
    for _ in range(2):
        features = random_features(rng)
        text, _ = source.specialise(features)
        head = "".join(f"#define {k} {v}\n" for k, v in features.defines().items())
        whole = iter([*expanded(head + "const bool _ = bool(0);\n" + source.text), "END"])
        left = [line for line in expanded(text) if not line.startswith("const bool ")]
        for line in left:
            assert any(line == other for other in whole), line  # `whole` goes on behind it
