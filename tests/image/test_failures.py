"""The failure library: each technique fails where theory says, by as much, and the traced ones hold.

The figures expected stand in the scene files, scenes/failures/*.toml, each with its reason.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from glhybrid.errors import LoadError, SettingError
from glhybrid.load import builtin
from glhybrid.study import failures

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer


@pytest.mark.parametrize("name", failures.cases())
def test_case(renderer: "Renderer", name: str) -> None:
    rows = failures.run(renderer, [name])
    for row in rows:
        shown = "-" if row["value"] is None else f"{row['value']:.4g} {row['unit']}"
        print(f"{name}: {row['technique']}: {shown}, expected {row['expected']}: {row['verdict']} ({row['because']})")
    wrong = [row for row in rows if row["verdict"] == failures.UNEXPECTED]
    assert not wrong, wrong
    if all(row["verdict"] == failures.SKIPPED for row in rows):
        pytest.skip(rows[0]["because"])


@pytest.mark.parametrize("name", failures.cases())
def test_case_is_complete(name: str) -> None:
    """Something fails, something traced holds, and there is a sentence that says why."""
    study = failures.load(name).study
    fails = [e for e in study.expectations if e.fails]
    holds = [e for e in study.expectations if not e.fails]
    assert holds and fails
    assert study.why.endswith(".") and len(study.why) < 200 and len(study.title) < 40
    # A range that a technique of the other kind would pass as well says nothing.
    assert all(a.high < b.low or a.low > b.high for a in holds for b in fails if not a.control), name


def expect(tmp_path: Path, old: str, new: str) -> str:
    text = (builtin.data_folder("scenes") / "failures" / "terminator.toml").read_text()
    assert text.count(old) == 1
    path = tmp_path / "case.toml"
    path.write_text(text.replace(old, new))
    return str(path)


def test_what_does_not_fail_or_does_not_hold_is_unexpected(renderer: "Renderer", tmp_path: Path) -> None:
    swapped = expect(tmp_path, 'set = { shadows = "ray", terminator = true }', 'set = { shadows = "ray" }')
    verdicts = [row["verdict"] for row in failures.run(renderer, [swapped])]
    assert verdicts == ["fails as expected", "unexpected"]
    swapped = expect(tmp_path, 'set = { shadows = "ray" }', 'set = { shadows = "none" }')
    rows = failures.run(renderer, [swapped], pictures=True)
    assert [row["verdict"] for row in rows] == ["unexpected", "holds"]
    assert all(row["picture"].shape == (240, 320, 3) and row["picture"].dtype == "uint8" for row in rows)
    assert not (rows[0]["picture"] == rows[1]["picture"]).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"falsely dark"', '"falsely drak"', 'unknown measure "falsely drak"; did you mean "falsely dark"'),
        ('set = { reflections = "none" }', "options = { where = 1 }", 'options: unknown option "where"'),
        ("terminator = true", "terminator = 3", r"ray \(terminator 3\): terminator = 3: expected true or false"),
        ('set = { shadows = "ray" }', 'set = { shadows = "rya" }', 'unknown shadows technique "rya"'),
        ('set = { shadows = "ray" }', 'control = "rya"', 'unknown control "rya"'),
    ],
)
def test_what_a_case_asks_for_in_vain_is_refused(
    renderer: "Renderer", tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(SettingError, match=message):
        failures.run(renderer, [expect(tmp_path, old, new)])


def test_unknown_cases_are_refused(renderer: "Renderer", tmp_path: Path) -> None:
    with pytest.raises(SettingError, match='unknown failure case "acme"; did you mean "acne"'):
        failures.run(renderer, ["acme"])
    with pytest.raises(SettingError, match=r"has no \[study\] table"):
        failures.load("cornell")
    with pytest.raises(LoadError):
        failures.load(str(tmp_path / "none.toml"))
