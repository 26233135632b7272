"""The failure library, run: where each technique must fail, it does, by as much as theory says; the traced ones hold.

A case is a scene file of scenes/failures/. Its [study] table names a measure (quantities/), techniques that must
fail with the range expected, and techniques that must hold with their bar.
"""

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

import glhybrid
from glhybrid import techniques
from glhybrid.errors import GlhybridError, SettingError, unknown
from glhybrid.load import builtin
from glhybrid.renderer import Renderer
from glhybrid.scene import Expectation
from glhybrid.study import controls, quantities
from glhybrid.study.subject import Case, Subject, base_settings

HOLDS, FAILS, UNEXPECTED, SKIPPED = "holds", "fails as expected", "unexpected", "skipped"
AXES = ("shadows", "reflections", "ao")  # settings that name a technique
Progress = Callable[[str, int, int], None]


def cases() -> list[str]:
    """The names of all cases."""
    return list(_cases())


@lru_cache
def _cases() -> tuple[str, ...]:
    return tuple(scene.name.removeprefix("failures/") for scene in builtin.failures())  # reads every file


def load(name: str) -> Case:
    """A case by its name, or a scene file with a [study] table. Raises LoadError, SettingError."""
    scene = glhybrid.load(f"failures/{name}" if name in cases() else name)
    if scene.study is None:
        raise SettingError(f"{scene.path or name}: has no [study] table; see scenes/README.md")
    case = Case(name, scene, scene.study)
    quantities.find(case.study, str(scene.path))
    return case


def run(
    renderer: Renderer,
    chosen: Iterable[str] | None = None,
    progress: Progress | None = None,
    pictures: bool = False,
) -> list[dict[str, Any]]:
    """Every technique of the chosen cases, all by default, one row each.

    A row: `case`, `title`, `why`, `technique`, `settings`, `measure`, `unit`, `value`, `expected` [lowest, highest],
    `fails` (whether it must), `because`, `verdict`. A technique that this version has not is `skipped`, with the
    reason as `because` and no value. pictures: `picture` too, (H, W, 3) uint8, with what counts against it marked.
    """
    names = list(chosen) if chosen is not None else cases()
    for name in names:
        if name not in cases() and not name.endswith(".toml"):
            raise SettingError(unknown("failure case", name, cases()))
    rows = []
    for i, name in enumerate(names):
        if progress is not None:
            progress(f"failures: {name}", i, len(names))
        case = load(name)
        rows += [_row(renderer, case, expectation, pictures) for expectation in case.study.expectations]
        case.forget()
    if progress is not None:
        progress("failures", len(names), len(names))
    return rows


def _row(renderer: Renderer, case: Case, expectation: Expectation, pictures: bool) -> dict[str, Any]:
    study = case.study
    found = quantities.find(study, str(case.scene.path))
    row: dict[str, Any] = {
        "case": case.name, "title": study.title, "why": study.why, "technique": label(expectation),
        "settings": dict(expectation.settings), "measure": found.name, "unit": found.unit, "value": None,
        "expected": [expectation.low, expectation.high], "fails": expectation.fails, "because": expectation.because,
    }  # fmt: skip
    try:
        subject = _subject(renderer, case, expectation)
    except GlhybridError as error:
        raise SettingError(f"{case.scene.path}: [study]: {label(expectation)}: {error}") from error
    if isinstance(subject, str):
        return row | {"verdict": SKIPPED, "because": subject}
    measured = found.measure(subject, **study.options)
    right = expectation.low <= measured.value <= expectation.high
    verdict = (FAILS if expectation.fails else HOLDS) if right else UNEXPECTED
    row |= {"value": measured.value, "verdict": verdict}
    return row | {"picture": measured.picture} if pictures else row


def _subject(renderer: Renderer, case: Case, expectation: Expectation) -> Subject | str:
    """What to measure, or why there is nothing to."""
    base = base_settings(case.study)
    if expectation.control:
        return controls.find(expectation.control)(renderer, case, base)
    for axis in AXES:
        if axis not in expectation.settings:
            continue
        if axis not in techniques.TECHNIQUES:
            return f"{axis} is no axis of this version"
    return Subject(renderer, case, base.replace(**expectation.settings))


def label(expectation: Expectation) -> str:
    """`map (slope_bias 0)`: the technique, and its parameters that are not the defaults."""
    if expectation.control:
        return f"control: {expectation.control}"
    given = dict(expectation.settings)
    names = [str(given.pop(axis)) for axis in AXES if axis in given]
    rest = [f"{key.rpartition('.')[2]} {_plain(value)}" for key, value in given.items()]
    return " + ".join(names) + (f" ({', '.join(rest)})" if rest else "")


def _plain(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
