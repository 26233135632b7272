"""The report's part on scenes that were studied at several sizes: what pixels cost."""

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from glhybrid.study.report import charts
from glhybrid.study.report.axis import shown
from glhybrid.study.report.charts import Line
from glhybrid.study.report.names import clock_name

if TYPE_CHECKING:
    from glhybrid.study.results import Study

Row = dict[str, Any]


def section(study: "Study", files: dict[str, str]) -> str:
    """A chart of frame time over pixels for each such scene, a line a technique at its defaults; empty without any."""
    groups: dict[str, list[str]] = {}
    for name, about in study.scenes.items():
        groups.setdefault(about["group"], []).append(name)
    clock = study.machine.get("time", "frame_ms")
    figures = [_figure(study, group, names, clock, files) for group, names in groups.items() if len(names) > 1]
    if not any(figures):
        return ""
    return (
        '<section id="sizes"><h2>Sizes</h2><p>The same scenes at several sizes, techniques at their defaults. In brackets '
        "the power of the number of pixels that time grows by: under 1, some of a frame costs the same at any "
        f'size.</p><div class="charts">{"".join(figures)}</div></section>'
    )


def _figure(study: "Study", group: str, names: Sequence[str], clock: str, files: dict[str, str]) -> str:
    names = sorted(names, key=lambda name: math.prod(study.scenes[name]["size"]))
    found: dict[str, dict[str, Row]] = {}
    for row in study.rows:
        if row["scene"] in names and not row["parameters"]:
            found.setdefault(row["label"], {})[row["scene"]] = row
    lines = [
        _line(label, [math.prod(study.scenes[n]["size"]) for n in names if n in rows], list(_in(rows, names, clock)))
        for label, rows in found.items()
        if len(rows) > 1
    ]
    if not lines:
        return ""
    lines.sort(key=lambda line: line.y[-1])
    svg = charts.curves(
        lines, title=f"{group}: frame time over pixels", x_label="pixels", y_label=clock_name(clock), size=charts.WIDE
    )
    files[f"{group}-sizes"] = svg
    sizes = ", ".join("{} × {}".format(*study.scenes[name]["size"]) for name in names)
    return (
        f'<figure class="only"><div class="wide">{svg}</div>'
        f"<figcaption><b>{escape(group)}</b> at {escape(sizes)}.</figcaption></figure>"
    )


def _in(rows: dict[str, Row], names: Sequence[str], clock: str) -> "Sequence[float]":
    return [rows[name][clock] for name in names if name in rows]


def _line(label: str, pixels: Sequence[int], times: Sequence[float]) -> Line:
    growth = math.log(times[-1] / times[0]) / math.log(pixels[-1] / pixels[0])
    return Line(f"{label} ({shown(round(growth, 2))})", pixels, times)
