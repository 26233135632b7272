"""What the command line says while it works: log lines, progress, tables. Everything but results goes to stderr."""

import contextlib
import io
import json
import logging
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from glhybrid.timing import Progress

PATIENCE_S = 1.0  # work that takes longer shows its progress


def error(message: object) -> None:
    """One line on stderr."""
    print(f"glhybrid: error: {' '.join(str(message).split())}", file=sys.stderr)


class _Lines(logging.Handler):
    """Log records as plain lines on stderr, also while a progress bar is drawn (rich redirects sys.stderr then)."""

    def emit(self, record: logging.LogRecord) -> None:
        level = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        print(f"glhybrid: {level}{record.getMessage()}", file=sys.stderr)


def start_log(quiet: bool) -> None:
    """Shows the log of glhybrid on stderr: from INFO, or only errors."""
    logger = logging.getLogger("glhybrid")
    logger.handlers = [_Lines()]
    logger.propagate = False
    logger.setLevel(logging.ERROR if quiet else logging.INFO)


@contextlib.contextmanager
def progress(shown: bool) -> Iterator["Progress"]:
    """A callback `(stage, done, total)` that draws a bar on stderr once work has gone on for PATIENCE_S.

    total 0 = unknown. Draws nothing where `shown` is false or stderr is no terminal.
    """
    if not shown or not sys.stderr.isatty():
        yield lambda stage, done, total: None
        return
    bar = _Bar()
    timer = threading.Timer(PATIENCE_S, bar.start)  # by the clock: loading a file calls nothing back
    timer.daemon = True
    timer.start()
    try:
        yield bar.show
    finally:
        timer.cancel()
        bar.stop()


class _Bar:
    """rich's progress bar, made when it is first wanted."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state: tuple[str, int, int] = ("", 0, 0)
        self._bar: Any = None
        self._task: Any = None
        self._stopped = False

    def show(self, stage: str, done: int, total: int) -> None:
        with self._lock:
            self._state = stage, done, total
            if self._bar is not None:
                self._bar.update(self._task, description=stage, completed=done, total=total or None)

    def start(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
        from rich.progress import TimeElapsedColumn as Elapsed
        from rich.progress import TimeRemainingColumn as Remaining

        with self._lock:
            if self._stopped:
                return
            stage, done, total = self._state
            columns = (
                TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), Elapsed(), TextColumn("left"),
                Remaining(),
            )  # fmt: skip
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task(stage, completed=done, total=total or None)
            self._bar.start()

    def stop(self) -> None:
        with self._lock:
            self._stopped = True
            if self._bar is not None:
                self._bar.stop()


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """A table on stdout: with lines on a terminal, plain columns that never wrap elsewhere."""
    from rich.box import ROUNDED
    from rich.console import Console
    from rich.table import Table

    terminal = sys.stdout.isatty()
    grid = Table(box=ROUNDED if terminal else None, pad_edge=terminal, show_header=any(columns))
    for column in columns:
        grid.add_column(column, no_wrap=not terminal)
    for row in rows:
        grid.add_row(*(_cell(value) for value in row))
    if terminal:
        Console(highlight=False).print(grid)
        return
    text = io.StringIO()
    Console(file=text, width=1000, highlight=False).print(grid)
    print("\n".join(line.rstrip() for line in text.getvalue().splitlines()))


def _cell(value: object) -> str:
    from rich.markup import escape

    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{_cell(key)}: {_cell(v)}" for key, v in value.items())
    if isinstance(value, (list, tuple)):
        words = [str(v) for v in value]
        return escape(("\n" if any(" " in word for word in words) else ", ").join(words))
    return escape("" if value is None else str(value))


def tree(values: Mapping[str, Any]) -> None:
    """A nested result for people: lists of records as tables, records as two columns, the rest line by line."""
    plain = {key: value for key, value in values.items() if not _is_nested(value)}
    if plain:
        table(("", ""), list(plain.items()))
    for key, value in values.items():
        if isinstance(value, Mapping):
            table((key, ""), list(value.items()))
        elif _is_nested(value):
            columns = list(dict.fromkeys(name for row in value for name in row))
            table([f"{key}: {columns[0]}", *columns[1:]], [[row.get(c) for c in columns] for row in value])


def _is_nested(value: object) -> bool:
    if isinstance(value, Mapping):
        return bool(value)
    return isinstance(value, (list, tuple)) and bool(value) and all(isinstance(v, Mapping) for v in value)


def say_warnings(warnings: Sequence[str], most: int = 5) -> None:
    """Of a scene, as log lines: the first `most`, and how many more there are."""
    log = logging.getLogger("glhybrid")
    for warning in warnings[:most]:
        log.warning("%s", warning)
    if len(warnings) > most:
        log.warning("and %d more; --json lists them all", len(warnings) - most)


def print_json(value: Any) -> None:
    """One JSON object or array on stdout."""
    print(json.dumps(value, indent=2, default=_plain))


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays, paths and sets as JSON has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return sorted(value) if isinstance(value, (set, frozenset)) else str(value)
