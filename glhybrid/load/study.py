"""The [study] table of a scene file: what the scene is for. Keys in scenes/README.md."""

from typing import Any

from glhybrid.load.tables import Table
from glhybrid.scene import Expectation, Study


def read(table: Table) -> Study:
    """Raises LoadError naming table and key where something is missing, unknown or out of range."""
    for key, what in (("title", "a few words"), ("why", "one sentence"), ("measure", "the quantity that shows it")):
        table.need(key, f"needs {key}, {what}")
    expectations = [_expectation(row, fails) for key, fails in (("fails", True), ("holds", False))
                    for row in table.tables(key)]  # fmt: skip
    if not expectations:
        table.fail("needs [[study.fails]] or [[study.holds]]: the techniques that it is for")
    width, height = (int(x) for x in table.vector("size", (320, 240), _PIXELS))
    made = Study(
        title=table.string("title", ""),
        why=table.string("why", ""),
        measure=table.string("measure", ""),
        size=(width, height),
        settings=_values(table, "set"),
        options=_values(table, "options"),
        expectations=tuple(expectations),
    )
    table.finish()
    return made


def _expectation(table: Table, fails: bool) -> Expectation:
    settings, control = _values(table, "set"), table.string("control", "")
    if bool(settings) == bool(control):
        table.fail("needs either set, the settings of a technique, or control")
    table.need("expected", "needs expected = [lowest, highest], in the unit of the measure")
    low, high = table.vector("expected", (0.0, 0.0))
    if low > high:
        table.fail("the lowest value comes first", "expected")
    made = Expectation(fails, low, high, settings, control, table.string("because", ""))
    if fails and not made.because:
        table.fail("needs because, one line: what theory says")
    table.finish()
    return made


def _values(parent: Table, key: str) -> dict[str, Any]:
    """A table of plain values. What reads them knows the keys: settings, or the measure."""
    table = parent.table(key)
    return dict(table.values) if table is not None else {}


_PIXELS = (lambda x: 1 <= x <= 8192 and x == int(x), "must be whole and between 1 and 8192")
