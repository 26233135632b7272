"""The report's first words: the cheapest way under given errors, by scene, of whole pictures and kind by kind."""

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from glhybrid import techniques
from glhybrid.study import pareto
from glhybrid.study.report.axis import shown
from glhybrid.study.report.names import ERROR_NAMES, anchor, axis_name

if TYPE_CHECKING:
    from glhybrid.study.results import Study

BARS = (0.1, 0.05, 0.02)  # of FLIP
Row = dict[str, Any]


def section(study: "Study") -> str:
    """The report's first section as HTML: of each scene what its figures say."""
    from glhybrid.study.results import error_key

    clock = study.machine.get("time", "frame_ms")
    lines = []
    for name in study.scenes:
        rows = [row for row in study.rows if row["scene"] == name]
        if not rows:
            continue
        parts = [f"<a href='#{anchor(name)}'>{escape(name)}</a>: {_cheapest(rows, 'flip', clock, 'label')}"]
        for axis in techniques.TECHNIQUES:
            mine = [row for row in rows if axis in row["axes"]]
            key = error_key(axis, mine)
            if len(mine) > 1 and key != "flip":
                says = _cheapest(mine, key, clock, axis)
                parts.append(f"{escape(axis_name(axis))} ({escape(ERROR_NAMES[key])}): {says}")
        rest = "".join(f"<li>{part}</li>" for part in parts[1:])
        lines.append(f"<li>{parts[0]}{f'<ul>{rest}</ul>' if rest else ''}</li>")
    return f"<h3>The cheapest under a given HDR-FLIP</h3><ul>{''.join(lines)}</ul>" if lines else ""


def _cheapest(rows: Sequence[Row], key: str, clock: str, named: str) -> str:
    """named: "label", or the kind whose technique a row is called by."""

    def name(row: Row) -> str:
        return f"<b>{escape(row['label'] if named == 'label' else row['names'][named])}</b>"

    found: dict[str, list[float]] = {}
    times, errors = [r[clock] for r in rows], [r[key] for r in rows]
    for bar in BARS:
        i = pareto.cheapest_under(times, errors, bar)
        if i is not None:
            found.setdefault(f"{name(rows[i])} ({shown(times[i])} ms)", []).append(bar)
    if not found:
        best = min(rows, key=lambda r: r[key])
        says = f"nothing comes under {BARS[0]:g}; nearest is {name(best)} with {shown(best[key])} in {shown(best[clock])} ms"
        return says + "."
    return "; ".join(f"under {' and '.join(f'{b:g}' for b in bars)}: {way}" for way, bars in found.items()) + "."
