"""What the command line says of a study: its fronts as a table."""

from typing import TYPE_CHECKING

from glhybrid import console

if TYPE_CHECKING:
    from glhybrid.study.results import Study


def summary(study: "Study") -> None:
    """The front of each scene on stdout, and notes."""
    clock = study.machine.get("time", "frame_ms")
    rows = [row for name in study.scenes for row in study.rows if row["scene"] == name and row["pareto"]]
    order = list(study.scenes)
    rows.sort(key=lambda row: (order.index(row["scene"]), row[clock]))
    console.table(
        ("scene", "on the front", "ms", "FLIP", "relative MSE", "wrong shadow %", "MiB"),
        [
            (r["scene"], r["label"], r[clock], r["flip"], r["rel_mse"], r["wrong_shadow_percent"], r["bytes"] / 2**20)
            for r in rows
        ],
    )
    for note in study.notes:
        print(note)
    count = len(study.rows)
    bad = sum(f["verdict"] == "unexpected" for f in study.failures)
    cases = f", {len(study.failures)} failure cases, {bad} unexpected" if study.failures else ""
    print(f"{count} pictures measured{cases}")
