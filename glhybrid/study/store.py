"""Finished cells on disk: kept with everything that decided them, and used again only if all of that is equal."""

import csv
import hashlib
import io
import json
import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from glhybrid import __version__
from glhybrid.errors import OutputError
from glhybrid.image import replacing


def fingerprint(*parts: Any) -> str:
    """Of plain values."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:32]


@lru_cache(maxsize=1)
def renderer_digest() -> str:
    """Of the modules and shaders that make pictures: those of another version are not ours."""
    from glhybrid.load.builtin import data_folder

    package = Path(__file__).resolve().parent.parent
    files = [p for p in package.rglob("*.py") if not {"study", "bench", "viewer"} & set(p.relative_to(package).parts)]
    return digest([*files, *(p for p in data_folder("glsl").rglob("*") if p.is_file())])


@lru_cache(maxsize=1)
def code_digest() -> str:
    """The same, and of what measures them: not of the report, nor of other renderers, which have a key of their own."""
    study = Path(__file__).resolve().parent
    files = [p for p in study.rglob("*.py") if not {"report", "peers"} & set(p.relative_to(study).parts)]
    return renderer_digest() + digest(files)


def digest(files: Iterable[Path]) -> str:
    """Of this version, and of the names and bytes of files."""
    total = hashlib.sha256(__version__.encode())
    for path in sorted(files):
        total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()[:16]


def prepare(folder: Path) -> None:
    """Makes the folder. Raises OutputError where that is not possible or nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".glhybrid.probe"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written to: {error.strerror or error}; choose another folder with -o"
        ) from None


def write_json(path: Path, value: Any) -> None:
    """Whole or not at all. Numbers that JSON lacks become null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(plain(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read(path: Path, key: str) -> dict[str, Any] | None:
    """What was kept under that key; None if it is absent, damaged, of another key, or one of its images is gone."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(value, dict) or value.get("key") != key:
        return None
    images = value.get("images", {}).values()
    return value if all((path.parent / name).is_file() for name in images) else None


def write_csv(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """One line a row; what is nested is JSON in its cell."""
    rows = [{k: _cell(v) for k, v in row.items()} for row in rows]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with replacing(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _cell(value: Any) -> Any:
    return json.dumps(plain(value), sort_keys=True) if isinstance(value, (Mapping, list, tuple)) else value


def plain(value: Any) -> Any:
    """As JSON has it: NumPy scalars and arrays, paths, tuples; what is not finite is null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
