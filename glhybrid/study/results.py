"""What a study found, the fronts in it, and the files made of it."""

import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glhybrid import techniques
from glhybrid.study import paper, pareto, store

BUSY = 1.25  # times the CPU time: from here on wall time measures the neighbours
ERRORS = {"shadows": "flip_shadow", "reflections": "flip_reflection"}  # what tells an axis' techniques apart


@dataclass
class Study:
    """What was found: `machine`, `rows` and `failures` as results.json has them; scenes: by name, what rows have in
    common; curves, peers, paper: further parts; seconds: wall time of each part in this run; notes: what was left out,
    and why."""

    machine: dict[str, Any]
    rows: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)
    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    curves: list[dict[str, Any]] = field(default_factory=list)
    peers: list[dict[str, Any]] = field(default_factory=list)
    paper: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Adds a remark, once."""
        if text not in self.notes:
            self.notes.append(text)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """What is done within counts for that part."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - started

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: results.json."""
        names = ("machine", "rows", "failures", "scenes", "curves", "peers", "paper", "seconds", "notes")
        return {name: getattr(self, name) for name in names}


def write(study: Study, output: Path) -> None:
    """Fronts, and every file that is made of results."""
    from glhybrid.study.report import html

    mark_fronts(study)
    if any(paper.AXIS in row["axes"] for row in study.rows):
        study.paper["table"] = paper.table(study.rows, study.machine["time"])
    store.write_json(output / "results.json", study.to_dict())
    store.write_csv(output / "results.csv", study.rows)
    html.write(study, output)


def time_key(study: Study) -> str:
    """Which time a study goes by: on a software rasteriser whose machine had other work, that of the processor."""
    ratios = [row["frame_ms"] / row["frame_cpu_ms"] for row in study.rows if row.get("frame_cpu_ms")]
    software = study.machine["device"].get("software")
    busy = bool(software and ratios and statistics.median(ratios) > BUSY)
    study.machine["busy"] = statistics.median(ratios) if busy else None
    return "frame_cpu_ms" if busy else "frame_ms"


def mark_fronts(study: Study) -> None:
    """Rows get `pareto`: on their scene's front, whole picture; `pareto_axes`: the axes whose front they are on."""
    clock = study.machine["time"] = time_key(study)
    for name in study.scenes:
        rows = [row for row in study.rows if row["scene"] == name]
        on = set(pareto.front([r[clock] for r in rows], [r["flip"] for r in rows]))
        for i, row in enumerate(rows):
            row["pareto"], row["pareto_axes"] = i in on, []
        for kind in techniques.TECHNIQUES:
            mine = [row for row in rows if kind in row["axes"]]
            key = error_key(kind, mine)
            for i in pareto.front([r[clock] for r in mine], [r[key] for r in mine]):
                mine[i]["pareto_axes"].append(kind)


def error_key(kind: str, rows: Sequence[dict[str, Any]]) -> str:
    """The measure of an axis: its own, where the scene has it."""
    key = ERRORS.get(kind, "flip")
    return key if rows and all(row.get(key) is not None for row in rows) else "flip"
