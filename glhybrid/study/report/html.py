"""report.html: all that a study found on one page that opens anywhere, without a network; charts also as files."""

import base64
import io
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from glhybrid import __version__, techniques
from glhybrid.bvh.blas import threads_available
from glhybrid.image import replacing
from glhybrid.study.report import charts, findings, sizes, tables
from glhybrid.study.report.axis import shown
from glhybrid.study.report.charts import Line, Point
from glhybrid.study.report.names import ERROR_NAMES, anchor, axis_name, clock_name

if TYPE_CHECKING:
    from glhybrid.study.results import Study

HERE = Path(__file__).parent
WIDEST = 640  # pixels of an embedded picture
Row = dict[str, Any]


def write(study: "Study", output: Path) -> None:
    """report.html and charts/*.svg in `output`, whole or not at all."""
    files: dict[str, str] = {}
    page = _page(study, output, files)
    (output / "charts").mkdir(exist_ok=True)
    for name, svg in files.items():
        with replacing(output / "charts" / f"{name}.svg") as temporary:
            temporary.write_text(charts.standalone(svg), encoding="utf-8")
    with replacing(output / "report.html") as temporary:
        temporary.write_text(page, encoding="utf-8")


def _page(study: "Study", output: Path, files: dict[str, str]) -> str:
    parts = [_header(study), "<main>", findings.section(study), sizes.section(study, files)]
    for name in study.scenes:
        parts.append(_scene(study, name, output, files))
    parts += [
        _curves(study, files),
        tables.paper(study.paper, study.machine["time"], files) if study.paper else "",
        tables.peers(study.peers, study.machine["time"], output, embedded) if study.peers else "",
        _failures(study, output),
        _reading(study),
        _notes(study),
    ]
    parts.append("</main>")
    css = (HERE / "report.css").read_text(encoding="utf-8") + charts.STYLE
    script = (HERE / "report.js").read_text(encoding="utf-8")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>glhybrid study: {escape(', '.join(study.scenes))}</title><style>{css}</style></head><body>"
        f"{''.join(parts)}<footer>glhybrid {__version__}</footer><script>{script}</script></body></html>\n"
    )


# Parts ----------------------------------------------------------------------------------------------------------------


def _header(study: "Study") -> str:
    m = study.machine
    device = m["device"]
    kind = " (a CPU, through Mesa)" if device.get("software") else ""
    links = [(f"#{anchor(name)}", name) for name in study.scenes]
    for part, there in (
        ("stability", study.curves), ("paper", study.paper), ("peers", study.peers), ("failures", study.failures),
        ("reading", True), ("notes", True),
    ):  # fmt: skip
        if there:
            links.append(
                (
                    f"#{part}",
                    {"reading": "how to read this", "paper": "the paper again", "peers": "other renderers"}.get(
                        part, part
                    ),
                )
            )
    facts = {
        "device": f"{device.get('renderer', '')}{kind}",
        "driver": device.get("version", ""),
        "processor": f"{m.get('cpu', '')}, {m.get('cores', '?')} threads used",
        "system": f"{m.get('platform', '')}, Python {m.get('python', '')}",
        "glhybrid": m.get("glhybrid", ""),
    }
    command = f"<pre>{escape(m['command'])}</pre>" if m.get("command") else ""
    return (
        f"<header><h1>What each technique costs, and how wrong it is</h1>"
        f'<p class="soft">A study of {escape(", ".join(study.scenes))} by glhybrid: every shadow and reflection '
        f"technique against a path-traced reference on the same device.</p>"
        f"<nav>{''.join(f'<a href={chr(34)}{a}{chr(34)}>{escape(t)}</a>' for a, t in links)}</nav>"
        f'<dl class="facts">{"".join(f"<dt>{k}</dt><dd>{escape(str(v))}</dd>" for k, v in facts.items())}</dl>'
        f"{command}{_busy(study)}</header>"
    )


def _busy(study: "Study") -> str:
    ratio = study.machine.get("busy")
    if not ratio:
        return ""
    return (
        f'<p class="warn">Other programs had the processor while this was measured: frames took {ratio:.1f} times the '
        "time they would have had alone. Charts and fronts therefore go by processor time over the number of threads.</p>"
    )


def _scene(study: "Study", name: str, output: Path, files: dict[str, str]) -> str:
    about, rows = study.scenes[name], _of(study, name)
    reference = about["reference"]
    w, h = about["size"]
    reached = "" if reference["complete"] else ", stopped by its limit of time or paths"
    parts = [
        f'<section id="{anchor(name)}"><h2>{escape(name)}</h2>',
        f'<p class="soft">{about["triangles"]:,} triangles drawn, {_count(about["lights"], "light")}, {w} × {h} pixels, camera '
        f"“{escape(about['camera'])}”. The reference has {reference['samples']:,} paths a pixel of up to "
        f"{reference['bounces']} bounces ({_duration(reference['seconds'])}{reached}); its own noise is "
        f"FLIP {shown(reference['noise_flip'])}, relative MSE {shown(reference['noise_rel_mse'])}: smaller errors "
        f"cannot be told apart.{_left_out(reference)}</p>",
        _key(),
        '<div class="charts">',
    ]
    clock = study.machine.get("time", "frame_ms")
    for axis in ("", *techniques.TECHNIQUES):
        svg, caption = _chart(name, axis, rows, clock, reference)
        if svg:
            files[f"{name}-{axis or 'picture'}"] = svg
            only = "" if axis else ' class="only"'
            parts.append(f'<figure{only}><div class="wide">{svg}</div><figcaption>{caption}</figcaption></figure>')
    parts += [
        "</div>",
        _compare(name, rows),
        tables.cells(rows, clock, reference),
        _strip(name, about, rows, output),
        "</section>",
    ]
    return "".join(parts)


def _left_out(reference: Row) -> str:
    share = reference["left_out_percent"]
    if share < 0.05:
        return ""
    return (
        f" {shown(share)} % of the light came by so few paths that it would be specks, and is left out of the picture: mostly "
        "suns and lamps seen in glossy surfaces by way of rough ones. Bias counts it."
    )


def _chart(name: str, axis: str, rows: Sequence[Row], clock: str, reference: Row) -> tuple[str, str]:
    from glhybrid.study.results import error_key

    if axis:
        rows = [row for row in rows if axis in row["axes"]]
    if len(rows) < 2:
        return "", ""
    key = error_key(axis, rows) if axis else "flip"
    points = [
        Point(
            row[clock], row[key], row["names"].get(axis, row["label"]) if axis else row["label"], _kind(row, axis),
            axis in row["pareto_axes"] if axis else row["pareto"], not row["parameters"] or bool(axis),
            row.get(f"{clock}_spread") or 0.0,
        )
        for row in rows
    ]  # fmt: skip
    title = f"{name}: frame time against error" + (f", {axis}" if axis else "")
    floor = reference["noise_flip"] if key != "flip_shadow" else None
    svg = charts.scatter(
        points,
        title=title,
        x_label=clock_name(clock),
        y_label=ERROR_NAMES[key],
        floor=floor,
        floor_label="noise of the reference",
        size=charts.NARROW if axis else charts.WIDE,
    )
    if axis:
        others = ", ".join(sorted({row[k] for row in rows for k in techniques.TECHNIQUES if k != axis} - {"none"}))
        caption = f"<b>{axis_name(axis)}.</b> All with {escape(others)}. The line joins what nothing beats in both (the Pareto front)."
    else:
        caption = (
            "<b>The whole picture.</b> Everything measured; the line joins what nothing beats in both time and error (the "
            "Pareto front). Whiskers: half of all frames took that long."
        )
    return svg, caption


def _pictured(rows: Sequence[Row]) -> list[Row]:
    """Whose pictures are in the page: techniques at their defaults, and what is on a front."""
    return [row for row in rows if not row["parameters"] or row["pareto"] or row["pareto_axes"]]


def _compare(name: str, rows: Sequence[Row]) -> str:
    labels = ["reference", *(row["label"] for row in _pictured(rows))]
    if len(labels) < 2:
        return ""

    def options(chosen: str) -> str:
        return "".join(f"<option{' selected' if label == chosen else ''}>{escape(label)}</option>" for label in labels)

    worst = max(_pictured(rows), key=lambda r: r["flip"])["label"]
    return (
        f'<h3>Side by side</h3><div class="compare" data-scene="{anchor(name)}" hidden><div class="pick">'
        f'<label>left <select class="cell">{options(worst)}</select></label>'
        f'<label>right <select class="cell">{options("reference")}</select></label>'
        '<label><input type="checkbox" class="flip"> FLIP maps</label></div>'
        '<div class="stage"><img alt=""><img class="over" alt=""><div class="bar"></div>'
        '<span class="tag left"></span><span class="tag right"></span>'
        '<input type="range" min="0" max="100" step="0.5" value="50" aria-label="share of the left picture"></div></div>'
    )


def _strip(name: str, about: Row, rows: Sequence[Row], output: Path) -> str:
    folder = output / name
    shots = [("reference", f"{about['reference']['samples']:,} paths a pixel", {"png": "reference.png"})]
    for row in sorted(_pictured(rows), key=lambda r: r["flip"]):
        shots.append((row["label"], f"FLIP {shown(row['flip'])}", row["images"]))
    with ThreadPoolExecutor(threads_available()) as pool:
        figures = list(pool.map(lambda shot: _figure(shot[0], shot[1], folder, shot[2]), shots))
    return (
        "<h3>Pictures, and where they are wrong</h3>"
        '<p class="soft">Below each picture its FLIP map: 0 <span class="scale"></span> 1. '
        f"Full pictures, with EXR, are in the folder <code>{escape(name)}/</code>.</p>"
        f'<div class="strip">{"".join(figures)}</div>'
    )


def _figure(label: str, says: str, folder: Path, images: dict[str, str]) -> str:
    parts = []
    for kind in ("png", "flip"):
        if kind in images:
            alt = label if kind == "png" else f"FLIP map of {label}"
            parts.append(
                f'<img data-cell="{escape(label, quote=True)}" data-kind="{kind}" loading="lazy" '
                f'alt="{escape(alt, quote=True)}" src="{embedded(folder / images[kind])}">'
            )
    return f"<figure>{''.join(parts)}<figcaption><b>{escape(label)}</b>, {says}</figcaption></figure>"


def embedded(path: Path, widest: int = WIDEST) -> str:
    """An image file as a data URI: WebP, at most `widest` pixels wide. Known again: a study writes its page often."""
    return _embedded(path, path.stat().st_mtime_ns, widest)


@lru_cache(maxsize=4096)
def _embedded(path: Path, _mtime_ns: int, widest: int) -> str:
    from PIL import Image

    with Image.open(path) as image:
        picture = image.convert("RGB")
    if picture.width > widest:
        picture = picture.resize(
            (widest, max(1, round(picture.height * widest / picture.width))), Image.Resampling.LANCZOS
        )
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", quality=90, method=4)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode()


def _curves(study: "Study", files: dict[str, str]) -> str:
    if not study.curves:
        return ""
    parts = [
        '<section id="stability"><h2>Stability</h2><p>Error over one parameter at a time. A ring marks where a technique '
        'breaks: the first value past the bar, walking away from where it is best.</p><div class="charts">'
    ]
    for curve in study.curves:
        lines = []
        broken: list[str] = []
        for found in curve["lines"]:
            errors = _numbers(found["errors"])
            always = all(v > curve["bar"] for v in errors if math.isfinite(v))
            lines.append(Line(found["technique"], curve["values"], errors, None if always else found["breaks"]))
            if found["breaks"] is not None:
                broken.append(f"{found['technique']} {'everywhere' if always else 'at ' + shown(found['breaks'])}")
        svg = charts.curves(
            lines, title=curve["title"], x_label=curve["parameter"], y_label=curve["measure"], log_x=curve["log"],
            bar=curve["bar"],
        )  # fmt: skip
        files[f"stability-{curve['name']}"] = svg
        says = f"Breaks: {', '.join(broken)}." if broken else "Nothing breaks."
        parts.append(
            f'<figure><div class="wide">{svg}</div><figcaption><b>{escape(curve["title"])}.</b> '
            f"{escape(curve.get('about', ''))} {escape(says)}</figcaption></figure>"
        )
    return "".join([*parts, "</div></section>"])


def _numbers(values: Sequence[float | None]) -> list[float]:
    return [float("nan") if v is None else v for v in values]


VERDICTS = {"holds": "good", "fails as expected": "soft", "unexpected": "bad"}


def _failures(study: "Study", output: Path) -> str:
    if not study.failures:
        return ""
    body = "".join(
        f"<tr><td><a href='#case-{anchor(f['case'])}'>{escape(str(f['case']))}</a></td><td class='text'>{escape(str(f['technique']))}</td>"
        f"<td class='text'>{escape(_measured(f))}</td><td data-value='{_sortable(f['value'])}'>{_value(f['value'])}</td>"
        f"<td class='text'>{_expected(f['expected'])}</td>"
        f"<td class='text {VERDICTS.get(f['verdict'], '')}'>{escape(str(f['verdict']))}</td></tr>"
        for f in study.failures
    )
    names = ("case", "technique", "measure", "value", "expected", "verdict")
    head = "".join(f"<th class='text'><button>{name}</button></th>" for name in names)
    pictured = [f for f in study.failures if f.get("image")]
    with ThreadPoolExecutor(threads_available()) as pool:
        drawn = dict(zip(map(id, pictured), pool.map(lambda f: _failed(f, output / "failures"), pictured), strict=True))
    gallery = []
    for case in dict.fromkeys(f["case"] for f in study.failures):
        rows = [f for f in study.failures if f["case"] == case]
        figures = "".join(drawn[id(f)] for f in rows if f.get("image"))
        if figures:
            title, why = escape(str(rows[0].get("title", case))), escape(str(rows[0].get("why", "")))
            gallery.append(
                f"<h3 id='case-{anchor(case)}'>{title}</h3><p class='soft'>{why}</p><div class='strip'>{figures}</div>"
            )
    return (
        '<section id="failures"><h2>The failure library</h2><p>Small scenes, each made to break one technique. A technique '
        f"that theory breaks must fail by about as much as expected; the traced ones must hold. {_counted(study.failures)} A "
        "<i>control</i> is a common way that no technique here goes, on the CPU. What counts against a technique is red in "
        "its picture.</p>"
        f'<div class="wide"><table class="sortable"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
        f"{''.join(gallery)}</section>"
    )


def _counted(rows: Sequence[Row]) -> str:
    """ "46 cases: 80 techniques fail as expected, 85 hold, none is unexpected." """
    fails, holds, odd = (
        sum(row["verdict"] == verdict for row in rows) for verdict in ("fails as expected", "holds", "unexpected")
    )
    cases = len({row["case"] for row in rows})
    return f"{_count(cases, 'case')}: {fails} ways fail as expected, {holds} hold, {odd or 'none'} unexpected."


def _failed(row: Row, folder: Path) -> str:
    because = f"<br><span class='soft'>{escape(row['because'])}</span>" if row.get("because") else ""
    return (
        f'<figure><img loading="lazy" alt="{escape(row["technique"], quote=True)}" src="{embedded(folder / row["image"], 400)}">'
        f"<figcaption><b>{escape(row['technique'])}</b>, {_value(row['value'])} {escape(str(row.get('unit', '')))}: "
        f"<span class='{VERDICTS.get(row['verdict'], '')}'>{escape(row['verdict'])}</span>{because}</figcaption></figure>"
    )


def _measured(row: Row) -> str:
    unit = row.get("unit")
    return f"{row['measure']}, {unit}" if unit else str(row["measure"])


def _expected(value: object) -> str:
    if isinstance(value, (list, tuple)) and len(value) == 2:
        return _value(value[0]) if value[0] == value[1] else f"{_value(value[0])} to {_value(value[1])}"
    return _value(value)


def _value(value: object) -> str:
    return (
        shown(float(value)) if isinstance(value, (int, float)) and not isinstance(value, bool) else escape(str(value))
    )


def _sortable(value: object) -> str:
    return f"{value:.9g}" if isinstance(value, (int, float)) else ""


def _reading(study: "Study") -> str:
    return (
        '<section id="reading"><h2>How to read this</h2>'
        "<p><b>Time</b> is a whole frame at one sample a pixel, median, from finish to finish after a warm-up; hover over it "
        "for its spread. <b>Error</b> is HDR-FLIP: 0 is equal, 1 as different as can be seen; about 0.02 is hard to see "
        "side by side, 0.1 is plain. Pictures are compared in linear radiance, through the pixels' centres, so nothing is "
        "antialiased.</p>"
        "<p><b>The reference</b> is the full light transport: sky behind obstacles and light between surfaces too. The "
        "techniques here leave those out, so the whole picture keeps an error that no choice of shadow or reflection "
        "removes. Its parts are put together by pixel so that light which one path in thousands found is not a speck that "
        "counts against everybody (Buisine et al. 2021); what is left out falls as paths are added. <b>Bias</b> alone is told "
        "against all light, the plain mean of all paths; ± is the standard deviation of that. The picture's noise is half the "
        "difference of its halves; a relative MSE contains the reference's own, which may be subtracted, and a FLIP "
        "well above it hardly does. The charts by kind leave that part out: <b>direct light</b> is lights alone, held against rays to points "
        "all over each light; <b>specular</b> weights a pixel's error by how much of its reflectance is specular.</p>"
        "<p><b>Wrong shadow</b>: pixels on the other side of one half than the truth, of those that face the light, also "
        "outside and inside the band of one pixel about the true edge. <b>Flicker</b> and <b>flips</b>: what changes at the "
        "same world points while an orthographic camera pans by whole pixels.</p></section>"
    )


def _notes(study: "Study") -> str:
    notes = "".join(f"<li>{escape(note)}</li>" for note in study.notes) or "<li>Nothing was left out.</li>"
    if study.seconds:
        parts = ", ".join(f"{escape(part)} {_duration(s)}" for part, s in study.seconds.items())
        notes += f"<li>The run that wrote this page took {_duration(sum(study.seconds.values()))}: {parts}.</li>"
    return f'<section id="notes"><h2>Notes</h2><ul class="notes">{notes}</ul></section>'


# Words ----------------------------------------------------------------------------------------------------------------


def _of(study: "Study", name: str) -> list[Row]:
    return [row for row in study.rows if row["scene"] == name]


def _kind(row: Row, axis: str) -> str:
    """raster, traced or random: of the axis' technique, or of all."""
    names = [(axis, row[axis])] if axis else [(k, row[k]) for k in techniques.TECHNIQUES]
    used = [techniques.TECHNIQUES[k][n] for k, n in names]
    if any(t.stochastic for t in used):
        return "random"
    return "traced" if any(t.traced for t in used) else "raster"


def _key() -> str:
    marks: tuple[tuple[str, Callable[[], str]], ...] = (
        ("no rays", lambda: '<rect class="mark raster on" x="3" y="3" width="9" height="9"/>'),
        ("rays", lambda: '<circle class="mark traced on" cx="7.5" cy="7.5" r="5"/>'),
        ("random rays", lambda: '<polygon class="mark random on" points="7.5,2 13,12 2,12"/>'),
    )
    spans = "".join(f'<span><svg class="chart" viewBox="0 0 15 15">{mark()}</svg>{name}</span>' for name, mark in marks)
    return f'<div class="key">{spans}<span>filled: on the front</span></div>'


def _duration(seconds: float) -> str:
    from glhybrid.study.progress import spoken

    return spoken(seconds)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
