"""Charts as SVG text: a scatter of time against error with its front, and curves over one parameter.

Written by hand: the page needs labels that avoid each other, colours that follow its scheme and text that stays text,
which plotting libraries give only after as many lines. Kinds of techniques differ by shape as well as by colour.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise

from glhybrid.study.report.axis import Axis, fit, shown

WIDE, NARROW = (960, 500), (570, 420)  # px: a chart on its own, and one of two side by side
LEFT, RIGHT, TOP, BOTTOM = 62, 18, 18, 50
CHARACTER = 6.15  # px, mean advance of the 11.5 px face
LINE = 14.0
NOTHING = 1e-5  # of the largest value of a chart: less is rounding, and drawn as 0
MARK = 5.2  # px, half a mark of the front
Box = tuple[float, float, float, float]  # left, top, right, bottom, px

STYLE = """
.chart{--ink:#1c2024;--soft:#60666d;--grid:#e3e6ea;--paper:#fff;--raster:#0b62a8;--traced:#c4480a;--random:#067a55;
--front:#1c2024;--c0:#0b62a8;--c1:#c4480a;--c2:#067a55;--c3:#8a3a9c;--c4:#8a6a00;--c5:#b0245f;--c6:#4d5560;--c7:#00828c}
@media (prefers-color-scheme:dark){.chart{--ink:#eceff2;--soft:#a4abb3;--grid:#333a42;--paper:#15181c;--raster:#6cb8f5;
--traced:#ff9a5c;--random:#4fd6a6;--front:#eceff2;--c0:#6cb8f5;--c1:#ff9a5c;--c2:#4fd6a6;--c3:#d59ae8;--c4:#e3c04f;
--c5:#ff86b0;--c6:#b4bcc6;--c7:#5cd3dc}}
.chart text{font:11.5px system-ui,"Segoe UI",Helvetica,Arial,sans-serif;fill:var(--ink)}
.chart .soft,.chart .tick{fill:var(--soft)}.chart .tick,.chart .small{font-size:10.5px}
.chart .name{font-weight:650}.chart .grid{stroke:var(--grid);stroke-width:1}.chart .axis{stroke:var(--soft)}
.chart .front{fill:none;stroke:var(--front);stroke-width:1.6;stroke-dasharray:none;opacity:.75}
.chart .floor{stroke:var(--soft);stroke-dasharray:3 4}.chart .leader{stroke:var(--soft);stroke-width:.8}
.chart .raster{fill:var(--raster);stroke:var(--raster)}.chart .traced{fill:var(--traced);stroke:var(--traced)}
.chart .random{fill:var(--random);stroke:var(--random)}.chart .mark{stroke-width:1.4;fill-opacity:.25}
.chart .mark.on{fill-opacity:1}.chart .whisker{fill:none;stroke-width:1;opacity:.6}.chart .bg{fill:var(--paper)}
.chart .halo{paint-order:stroke;stroke:var(--paper);stroke-width:3px;stroke-linejoin:round}
.chart .curve{fill:none;stroke-width:2}.chart .broken{stroke-width:2;fill:var(--paper)}
"""


@dataclass(frozen=True)
class Point:
    """kind: raster, traced or random. front: on the front, and so named. named: named if there is room. spread: of x,
    as a share of it to either side."""

    x: float
    y: float
    label: str
    kind: str
    front: bool = False
    named: bool = True
    spread: float = 0.0


@dataclass(frozen=True)
class Line:
    """values of y at x; breaks: the x from which on it has failed, if it has."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    breaks: float | None = None


def scatter(
    points: Sequence[Point],
    *,
    title: str,
    x_label: str,
    y_label: str,
    floor: float | None = None,
    floor_label: str = "",
    size: tuple[int, int] = WIDE,
) -> str:
    """Log-log; the front as a staircase through its points. floor: the error that cannot be told from none."""
    points = [p for p in points if math.isfinite(p.x) and math.isfinite(p.y)]
    width, height = size
    x = fit([p.x for p in points], LEFT, width - RIGHT, room=0.09)
    y = fit([p.y for p in points], height - BOTTOM, TOP, room=0.07)
    parts = [_frame(x, y, x_label, y_label, height)]
    walls: list[Box] = []  # what names keep clear of
    if floor is not None and floor <= y.low:
        below, right, foot = f"{floor_label}: {shown(floor)} ↓", width - RIGHT - 4, height - BOTTOM - 6
        where = f'text-anchor="end" x="{right}" y="{foot}"'
        parts.append(f'<text class="soft small" {where}>{escape(below)}</text>')
        walls.append((right - CHARACTER * len(below), foot - 11, right, foot + 3))
    elif floor is not None:
        at = y.at(floor)
        parts.append(f'<line class="floor" x1="{LEFT}" x2="{width - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(f'<text class="soft small" x="{LEFT + 4}" y="{at - 4:.1f}">{escape(floor_label)}</text>')
        walls.append((LEFT + 4, at - 15, LEFT + 4 + CHARACTER * len(floor_label), at))
    front = sorted((p for p in points if p.front), key=lambda p: (p.x, -p.y))
    if len(front) > 1:
        path = f"M{x.at(front[0].x):.1f} {y.at(front[0].y):.1f}"
        path += "".join(f"H{x.at(p.x):.1f}V{y.at(p.y):.1f}" for p in front[1:])
        parts.append(f'<path class="front" d="{path}"/>')
        for p, q in pairwise(front):
            (x0, y0), (x1, y1) = (x.at(p.x), y.at(p.y)), (x.at(q.x), y.at(q.y))
            walls += [(x0, y0 - 2, x1, y0 + 2), (x1 - 2, min(y0, y1), x1 + 2, max(y0, y1))]
    for p in sorted(points, key=lambda p: p.front):
        ends = x.at(p.x * (1 - p.spread)), x.at(p.x * (1 + p.spread))
        if ends[1] - ends[0] > 2 * MARK:
            at = y.at(p.y)
            parts.append(
                f'<path class="whisker {p.kind}" d="M{ends[0]:.1f} {at - 3:.1f}v6m0 -3H{ends[1]:.1f}m0 -3v6"/>'
            )
        tip = f"{p.label}: {shown(p.x)} ms ± {100 * p.spread:.0f} %, {shown(p.y)}"
        parts.append(_mark(x.at(p.x), y.at(p.y), p, tip))
    parts += _labels([(x.at(p.x), y.at(p.y), p) for p in points], walls, size)
    return _svg(parts, title, size)


def curves(
    lines: Sequence[Line],
    *,
    title: str,
    x_label: str,
    y_label: str,
    log_x: bool = True,
    bar: float | None = None,
    size: tuple[int, int] = NARROW,
) -> str:
    """Error over a parameter, a line a technique, named at its end; a ring marks where it passes `bar`."""
    width, height = size
    finite = [v for line in lines for v in line.y if math.isfinite(v)]
    least = NOTHING * max([*finite, bar or 0.0], default=0.0)
    finite = [v if v > least else 0.0 for v in finite]
    right = max([len(line.label) for line in lines], default=0) * CHARACTER + 14
    x = fit([v for line in lines for v in line.x], LEFT, width - RIGHT - right, log=log_x, room=0.0)
    y = fit([*finite, *([bar] if bar else [])], height - BOTTOM, TOP)
    parts = [_frame(x, y, x_label, y_label, height)]
    if bar is not None:
        at = y.at(bar)
        parts.append(f'<line class="floor" x1="{LEFT}" x2="{x.end:.1f}" y1="{at:.1f}" y2="{at:.1f}"/>')
    ends: list[tuple[float, int]] = []
    for i, line in enumerate(lines):
        places = [(a, b if b > least else 0.0) for a, b in zip(line.x, line.y, strict=True) if math.isfinite(b)]
        where = [(x.at(a), y.at(b)) for a, b in places]
        if not where:
            continue
        path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in where)
        dash = ("", "6 3", "2 3", "8 3 2 3")[i // 2 % 4]
        parts.append(
            f'<path class="curve" style="stroke:var(--c{i % 8})" stroke-dasharray="{dash}" d="{path}">'
            f"<title>{escape(line.label)}</title></path>"
        )
        if line.breaks is not None and line.breaks in list(line.x):
            value = line.y[list(line.x).index(line.breaks)]
            parts.append(
                f'<circle class="broken" style="stroke:var(--c{i % 8})" cx="{x.at(line.breaks):.1f}" '
                f'cy="{y.at(value):.1f}" r="5"><title>{escape(line.label)} breaks at {shown(line.breaks)}</title></circle>'
            )
        ends.append((where[-1][1], i))
    for (at, i), placed in zip(sorted(ends), _stack(sorted(at for at, _ in ends), height - 8), strict=True):
        parts.append(
            f'<line class="leader" x1="{x.end:.1f}" x2="{x.end + 8:.1f}" y1="{at:.1f}" y2="{placed:.1f}"/>'
            f'<text class="small" style="fill:var(--c{i % 8})" x="{x.end + 11:.1f}" y="{placed + 3.5:.1f}">'
            f"{escape(lines[i].label)}</text>"
        )
    if bar is not None:
        where_bar = f'x="{LEFT + 4}" y="{y.at(bar) - 4:.1f}"'
        parts.append(f'<text class="soft small halo" {where_bar}>broken above {shown(bar)}</text>')
    return _svg(parts, title, size)


def _stack(wanted: Sequence[float], lowest: float) -> list[float]:
    """Where names stand, LINE apart and none past `lowest`, near where they want to; ascending."""
    placed: list[float] = []
    for at in wanted:
        placed.append(max(at, placed[-1] + LINE) if placed else at)
    limit = lowest
    for k in reversed(range(len(placed))):
        placed[k] = min(placed[k], limit)
        limit = placed[k] - LINE
    return placed


def standalone(svg: str) -> str:
    """The same chart as a file: with its colours and a background."""
    head, _, rest = svg.partition(">")
    head = head.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    return f'{head}><style>{STYLE}</style><rect class="bg" width="100%" height="100%"/>{rest}\n'


def _svg(parts: Sequence[str], title: str, size: tuple[int, int]) -> str:
    width, height = size
    body = "".join(parts)
    return (
        f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title, quote=True)}">'
        f"{body}</svg>"
    )


def _frame(x: Axis, y: Axis, x_label: str, y_label: str, height: int) -> str:
    bottom = height - BOTTOM
    parts = []
    for value in y.ticks():
        at = y.at(value)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{x.end:.1f}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(f'<text class="tick" text-anchor="end" x="{LEFT - 7}" y="{at + 3.5:.1f}">{shown(value)}</text>')
    if y.zero is not None:
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{x.end:.1f}" y1="{y.zero:.1f}" y2="{y.zero:.1f}"/>')
        parts.append(f'<text class="tick" text-anchor="end" x="{LEFT - 7}" y="{y.zero + 3.5:.1f}">0</text>')
    last = -math.inf
    for value in ([0.0] if x.zero is not None else []) + x.ticks():
        at = x.at(value)
        text = shown(value)
        parts.append(f'<line class="grid" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{bottom}"/>')
        if at - last > len(text) * CHARACTER + 8:
            parts.append(f'<text class="tick" text-anchor="middle" x="{at:.1f}" y="{bottom + 17}">{text}</text>')
            last = at
    parts.append(f'<line class="axis" x1="{LEFT}" x2="{x.end:.1f}" y1="{bottom}" y2="{bottom}"/>')
    middle = (LEFT + x.end) / 2
    parts.append(f'<text class="soft" text-anchor="middle" x="{middle:.1f}" y="{height - 10}">{escape(x_label)}</text>')
    at_y = (TOP + bottom) / 2
    parts.append(
        f'<text class="soft" text-anchor="middle" transform="translate(14 {at_y:.0f}) rotate(-90)">{escape(y_label)}</text>'
    )
    return "".join(parts)


def _mark(x: float, y: float, point: Point, tip: str) -> str:
    r = MARK if point.front else 4.0
    kind = f'class="mark {point.kind}{" on" if point.front else ""}"'
    if point.kind == "raster":
        shape = f'<rect {kind} x="{x - r * 0.9:.1f}" y="{y - r * 0.9:.1f}" width="{r * 1.8:.1f}" height="{r * 1.8:.1f}"'
    elif point.kind == "random":
        corners = f"{x:.1f},{y - r * 1.2:.1f} {x + r * 1.1:.1f},{y + r * 0.8:.1f} {x - r * 1.1:.1f},{y + r * 0.8:.1f}"
        shape = f'<polygon {kind} points="{corners}"'
    else:
        shape = f'<circle {kind} cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}"'
    name = shape[1:].split(" ", 1)[0]
    return f"{shape}><title>{escape(tip)}</title></{name}>"


def _labels(points: Sequence[tuple[float, float, Point]], walls: Sequence[Box], size: tuple[int, int]) -> list[str]:
    """Names beside their points: those of the front always, the others where nothing is in the way."""
    taken: list[Box] = [*walls, *((x - 6, y - 6, x + 6, y + 6) for x, y, _ in points)]
    parts = []
    for x, y, p in sorted(points, key=lambda it: (not it[2].front, it[1])):
        if not (p.front or p.named):
            continue
        wide = len(p.label) * (CHARACTER + (0.45 if p.front else -0.5)) + 4
        spot = _spot(x, y, wide, taken, 12 if p.front else 1, size)
        if spot is None:
            continue
        left, top = spot
        taken.append((left, top, left + wide, top + LINE))
        if min(abs(left - x), abs(left + wide - x)) > 14 or abs(top + LINE / 2 - y) > 16:
            near = min(max(x, left), left + wide)
            parts.append(
                f'<line class="leader" x1="{x:.1f}" y1="{y:.1f}" x2="{near:.1f}" '
                f'y2="{top + (LINE if top + LINE < y else 0 if top > y else LINE / 2):.1f}"/>'
            )
        style = "name" if p.front else "soft small"
        parts.append(f'<text class="{style} halo" x="{left + 2:.1f}" y="{top + 11:.1f}">{escape(p.label)}</text>')
    return parts


def _spot(
    x: float,
    y: float,
    wide: float,
    taken: Sequence[Box],
    rings: int,
    size: tuple[int, int],
) -> tuple[float, float] | None:
    """The nearest free place for a box of `wide` x LINE about a point: (left, top), None if there is none."""
    width, height = size
    best, least = None, math.inf
    for ring in range(rings):
        reach = 8 + 13 * ring
        for angle in range(0, 360, 30 if ring else 45):
            dx, dy = reach * math.cos(math.radians(angle)), reach * math.sin(math.radians(angle))
            left = x + dx if dx > 2 else x + dx - wide if dx < -2 else x - wide / 2
            top = y + dy - LINE / 2 if abs(dx) > 2 else (y + dy if dy > 0 else y + dy - LINE)
            if left < LEFT + 2 or left + wide > width - 2 or top < 2 or top + LINE > height - BOTTOM:
                continue
            overlap = sum(
                max(0.0, min(left + wide, c) - max(left, a)) * max(0.0, min(top + LINE, d) - max(top, b))
                for a, b, c, d in taken
            )
            if overlap == 0:
                return left, top
            if overlap < least:
                best, least = (left, top), overlap
    return best if rings > 1 else None
