"""The report's tables: all figures of a scene, the paper again, other renderers."""

import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from glhybrid.study.report import charts
from glhybrid.study.report.axis import shown
from glhybrid.study.report.charts import Line

Row = dict[str, Any]
Column = tuple[str, str, str]  # key, head, what it means
TIME: tuple[Column, ...] = (
    ("frame_ms", "frame<br>ms", "median, from finish to finish"),
    ("frame_cpu_ms", "CPU<br>ms", "processor time over threads"),
)
ERRORS: tuple[Column, ...] = (
    ("trace_ms", "its passes<br>ms", "passes that this technique brings"),
    ("bytes", "memory<br>MiB", "images and buffers on the device"),
    ("flip", "FLIP", "HDR-FLIP, mean"),
    ("flip_at_rest", "FLIP,<br>at rest", "of the 17th frame at rest: what temporal filters make of random rays"),
    ("flip_shadow", "FLIP,<br>direct light", "of the direct light alone"),
    ("flip_reflection", "FLIP,<br>specular", "weighted by specular share"),
    ("rel_mse", "relative<br>MSE", ""),
    ("psnr", "PSNR<br>dB", ""),
    ("ssim", "SSIM", ""),
    (
        "bias_percent",
        "bias<br>%",
        "of mean luminance, against all light; with the standard deviation of the reference's",
    ),
)
PARTS: tuple[Column, ...] = (
    ("wrong_shadow_percent", "wrong<br>shadow %", "of pixels that face a light"),
    ("wrong_shadow_outside_percent", "outside<br>edges %", "outside the one-pixel band of the true edge"),
    ("wrong_shadow_inside_percent", "inside<br>edges %", "inside that band"),
    ("right_object_percent", "right<br>object %", "of smooth pixels whose mirror image shows the object that is there"),
    ("right_point_percent", "right<br>point %", "of those that show its very point: within 0.5 px and 2 % of its way"),
    ("reflected_error_px", "point<br>off by px", "median distance in the picture, where the object is right"),
    ("reflected_error_px_p95", "95 % within<br>px", "of those"),
    ("flicker", "flicker<br>%", "mean change of a world point from frame to frame of a pan, of mean luminance"),
    ("flicker_p99", "of the worst<br>1 %", "the change that one point in a hundred exceeds, likewise"),
    ("flip_rate_percent", "shadow<br>flips %", "points whose shadow changes sides, a frame of that pan"),
)
SHARES = ("flicker", "flicker_p99")  # shown in %
LEAST_SHARE = 1e-3  # %: less is rounding of float32
PIXELS = ("reflected_error_px", "reflected_error_px_p95")
LEAST_PX = 1e-3  # likewise


def cells(rows: Sequence[Row], clock: str, reference: Row) -> str:
    """All figures of a scene: of the whole picture; then of shadows, mirrors and motion, where they were asked for."""
    time = [column for column in TIME if column[0] == "frame_ms" or clock != "frame_ms"]
    errors = [column for column in ERRORS if column[0] != "trace_ms" or clock == "frame_ms"]
    told = [row for row in rows if any(row.get(key) is not None for key, _, _ in PARTS)]
    only = [column for column in time if column[0] == clock]
    return (
        "<h3>All figures</h3><p class='soft'>A dot: on the front of the whole picture. A head sorts.</p>"
        f"{_sortable(rows, [*time, *errors], clock, _noise_row(reference))}<h3>Shadows, mirrors, and what changes in motion</h3>"
        "<p class='soft'>Mirrors are asked of reflection techniques. Motion is of every technique at its defaults: the "
        "camera pans by whole pixels, so that nothing that changes at a point of the world is right.</p>"
        f"{_sortable(told, [*only, *PARTS], clock)}"
    )


def _noise_row(reference: Row) -> Row:
    """What a picture would read that differs from the truth by no more than the reference does."""
    return {"flip": reference["noise_flip"], "rel_mse": reference["noise_rel_mse"]}


def _sortable(rows: Sequence[Row], columns: Sequence[Column], clock: str, noise: Row | None = None) -> str:
    columns = [c for c in columns if any(row.get(c[0]) is not None for row in rows)]
    head = "".join(f'<th title="{escape(tip, quote=True)}"><button>{text}</button></th>' for _, text, tip in columns)
    body = []
    for row in sorted(rows, key=lambda r: r[clock]):
        figures = "".join(_cell(row, key) for key, _, _ in columns)
        front = ' class="front"' if row["pareto"] else ""
        body.append(f"<tr{front}><td>{escape(row['label'])}</td>{figures}</tr>")
    foot = ""
    if noise is not None:
        figures = "".join(_cell(noise, key) for key, _, _ in columns)
        foot = f'<tfoot><tr class="soft"><td>the reference’s own noise</td>{figures}</tr></tfoot>'
    return (
        f'<div class="wide"><table class="sortable"><thead><tr><th><button>technique</button></th>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody>{foot}</table></div>"
    )


def _cell(row: Row, key: str) -> str:
    value = row.get(key)
    if value is None:
        return '<td data-value=""></td>'
    if key == "bytes":
        value = value / 2**20
    if key in PIXELS and value < LEAST_PX:
        value = 0.0
    if key == "bias_percent":
        return f'<td data-value="{value:.9g}">{bias(row)}</td>'
    if key in SHARES:
        value = 100 * value if 100 * value >= LEAST_SHARE else 0.0
    spread = row.get(f"{key}_spread")
    extra = f" title='± {100 * spread:.0f} %'" if spread is not None else ""
    return f'<td data-value="{value:.9g}"{extra}>{shown(float(value))}</td>'


def bias(row: Row) -> str:
    """ "+8.1 ± 0.2", both to the digit that the second has; what is surer than a hundredth has no second."""
    value, error = row["bias_percent"], row.get("bias_error_percent") or 0.0
    if error < 0.005:
        return f"{value:+.2f}".replace("-", "−")
    digits = max(0, -math.floor(math.log10(error)))
    return f"{value:+.{digits}f} ± {error:.{digits}f}".replace("-", "−")


def paper(found: Row, clock: str, files: dict[str, str]) -> str:
    """Table 1 and figure 8."""
    parts = [
        '<section id="paper"><h2>The paper again</h2><p>Kim sets one mirror ray, lerped by roughness with the blurred sky, '
        "and one shadow ray against Unreal Engine's many rays and denoiser, by frame rate and by eye. Here both are of one "
        "renderer on this device, and both have an error.</p>"
    ]
    if found.get("table"):
        parts.append(_table_1(found["table"], found.get("printed", ())))
    if found.get("ladder"):
        parts.append(_figure_8(found["ladder"], clock, files))
    return "".join([*parts, "</section>"])


def _table_1(lines: Sequence[Row], printed: Sequence[Row]) -> str:
    body = []
    for line in lines:
        kim, many = line["kim"], line["many"]
        cells = [line["scene"], _rate(kim), "" if many is None else f"{many.get('samples') or ''}", _rate(many)]
        cells.append("" if line["lead_percent"] is None else f"{line['lead_percent']:+.0f} %")
        for name in ("flip", "flip_reflection"):
            cells += [_figure(kim, name), _figure(many, name), _figure(many, f"{name}_at_rest")]
        cells += [
            _figure(kim, "flip_shadow"),
            _figure(many, "flip_shadow"),
            bias(kim),
            "" if many is None else bias(many),
        ]
        body.append("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in cells) + "</tr>")
    heads = ("scene", "Kim,<br>frames/s", "rays", "many rays,<br>frames/s", "Kim is<br>faster by", "FLIP<br>Kim",
             "<br>many", "many,<br>at rest", "specular<br>Kim", "<br>many", "many,<br>at rest", "direct light<br>Kim",
             "<br>many", "bias, %<br>Kim", "<br>many")  # fmt: skip
    said = "; ".join(
        f"scene {p['scene']}: {_range(p['kim'])} against {_range(p['unreal'])}, {_range(p['lead'])} %" for p in printed
    )
    about = (
        "<p class='soft'>Random rays are denoised, in time and error. Their error is of one frame on its own, and at rest "
        "of the 17th, filtered over those before. Bias is of the mean of one frame, against all light of the reference, "
        "± whose standard deviation.</p>"
    )
    about += f"<p class='soft'>The paper printed, on an RTX 2070 SUPER against Unreal 4: {said}.</p>" if said else ""
    return (
        '<h3>Table 1</h3><div class="wide"><table><thead><tr>'
        f"{''.join(f'<th>{h}</th>' for h in heads)}</tr></thead><tbody>{''.join(body)}</tbody></table></div>{about}"
    )


def _rate(row: Row | None) -> str:
    return "" if row is None else shown(row["frames_per_second"])


def _figure(row: Row | None, name: str) -> str:
    return "" if row is None or row.get(name) is None else shown(row[name])


def _range(pair: Sequence[float]) -> str:
    return f"{pair[0]:g}–{pair[1]:g}"


def _figure_8(ladder: Row, clock: str, files: dict[str, str]) -> str:
    rows = [row for row in ladder["rows"] if "error" not in row]
    roughness = sorted({row["roughness"] for row in rows})
    labels = list(dict.fromkeys(row["label"] for row in rows))

    def of(label: str, name: str) -> list[float]:
        by = {row["roughness"]: row[name] for row in rows if row["label"] == label}
        return [by.get(r, float("nan")) for r in roughness]

    figures = []
    for name, what in (("flip", "HDR-FLIP of the floor"), ("bias", "bias, % of mean radiance")):
        key = "flip" if name == "flip" else "bias_percent"
        values = {label: [abs(v) for v in of(label, key)] for label in labels}
        lines = [Line(label, roughness, values[label]) for label in labels]
        svg = charts.curves(lines, title=f"{what} over roughness", x_label="roughness", y_label=what, log_x=False)
        files[f"paper-{name}"] = svg
        figures.append(f'<figure><div class="wide">{svg}</div></figure>')
    body = "".join(
        f"<tr><td>{escape(row['label'])}</td><td>{row['roughness']:g}</td><td>{bias(row)}</td>"
        f"<td>{shown(row['rmse'])}</td><td>{shown(row['flip'])}</td><td>{shown(row[clock])}</td></tr>"
        for row in sorted(rows, key=lambda r: (r["roughness"], labels.index(r["label"])))
    )
    return (
        f"<h3>Figure 8: roughness</h3><p>{_in_words(rows, clock)}</p>"
        f'<div class="charts">{"".join(figures)}</div><div class="wide"><table><thead><tr><th>way</th><th>roughness</th>'
        "<th>bias, %</th><th>RMSE</th><th>FLIP</th><th>ms</th></tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
        '<p class="soft">A metal floor under a smooth sky mirrors unlit bodies, so the error is of the lobe alone. Bias and '
        "RMSE are over the floor, in units of its mean radiance; ± is the reference's own standard deviation.</p>"
    )


def _in_words(rows: Sequence[Row], clock: str) -> str:
    """The bias at the paper's roughness, and the cheapest way without it."""
    at = [row for row in rows if row["roughness"] == 0.25]
    kim = next((row for row in at if row["label"] == "ray-lerp"), None)
    if kim is None:
        return ""
    says = f"At roughness 0.25 the paper's lerp is {bias(kim)} % off in the mean, FLIP {shown(kim['flip'])}, in {shown(kim[clock])} ms."
    better = [r for r in at if abs(r["bias_percent"]) <= 1 and r["flip"] < kim["flip"]]
    if better:
        best = min(better, key=lambda r: r[clock])
        says += (
            f" The cheapest way that is within 1 % and nearer is <b>{escape(best['label'])}</b>: {bias(best)} %, "
            f"FLIP {shown(best['flip'])}, in {shown(best[clock])} ms, {best[clock] / kim[clock]:.2g} times the frame."
        )
    return says


def peers(found: Sequence[Row], clock: str, output: Path, embedded: Callable[[Path, int], str]) -> str:
    """Other renderers: figures, pictures, and how their models differ. embedded: a file as a data URI."""
    body = "".join(
        f"<tr><td>{escape(row['scene'])}</td><td class='text'>{escape(row['renderer'])} {escape(row['version'])}</td>"
        f"<td>{shown(row[clock])}</td><td>{shown(row['flip'])}</td><td>{shown(row['rel_mse'])}</td>"
        f"<td>{bias(row)}</td><td class='text long'>{escape('; '.join(row['notes']))}</td></tr>"
        for row in found
    )
    figures = []
    for row in found:
        pictures = "".join(
            f'<img loading="lazy" alt="{escape(row["renderer"])}" '
            f'src="{embedded(output / row["scene"] / row["images"][kind], 480)}">'
            for kind in ("png", "flip")
        )
        about = f"{escape(row['scene'])}: FLIP {shown(row['flip'])}, {shown(row[clock])} ms"
        figures.append(f"<figure>{pictures}<figcaption><b>{escape(row['renderer'])}</b>, {about}</figcaption></figure>")
    return (
        '<section id="peers"><h2>Other renderers</h2><p>The same scene and camera in other programs, against the same '
        "reference. What they model otherwise is not wrong for that; the last column says what it is.</p>"
        '<div class="wide"><table><thead><tr><th>scene</th><th class="text">renderer</th><th>picture, ms</th><th>FLIP</th>'
        '<th>relative MSE</th><th>bias, %</th><th class="text">differences</th></tr></thead>'
        f'<tbody>{body}</tbody></table></div><div class="strip">{"".join(figures)}</div></section>'
    )
