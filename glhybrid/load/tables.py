"""Checked reading of TOML tables: every key asked for by name and type, every key left over an error.

`Table` keeps where it is in its file, so that each message reads `FILE: [[object]] 3 "lamp": scale = 0: must not be 0`.
"""

import difflib
import math
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from glhybrid.errors import LoadError, unknown

Check = Callable[[float], bool]
POSITIVE: tuple[Check, str] = (lambda x: x > 0, "must be greater than 0")
NOT_NEGATIVE: tuple[Check, str] = (lambda x: x >= 0, "must not be negative")
NOT_ZERO: tuple[Check, str] = (lambda x: x != 0, "must not be 0")
# Far beyond any use, and far inside what float32 can square.
LIGHT: tuple[Check, str] = (lambda x: 0 <= x <= 1e15, "must not be negative, nor greater than 1e15")
PLACE: tuple[Check, str] = (lambda x: abs(x) <= 1e12, "must be within 1e12 m of the origin")
SCALE: tuple[Check, str] = (lambda x: 1e-9 <= abs(x) <= 1e9, "must not be 0, and between 1e-9 and 1e9 in size")
UNIT: tuple[Check, str] = (lambda x: 0 <= x <= 1, "must be between 0 and 1")
ANY: tuple[Check, str] = (lambda x: True, "")


def between(low: float, high: float) -> tuple[Check, str]:
    """A check of a number's range, with its words."""
    return (lambda x: low <= x <= high, f"must be between {low:g} and {high:g}")


def parse(text: bytes, path: Path) -> "Table":
    """The root table of a TOML file. Raises LoadError with line and column where it is not TOML."""
    try:
        return Table(tomllib.loads(text.decode("utf-8-sig")), str(path), root=True)
    except UnicodeDecodeError as error:
        raise LoadError(f"{path}: not a text file: byte {error.start} is not UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise LoadError(f"{path}: not valid TOML: {error}") from error


class Table:
    """One TOML table. Each getter removes nothing but remembers its key; `finish` refuses the keys nobody asked for."""

    def __init__(self, values: dict[str, Any], where: str, root: bool = False) -> None:
        self.values, self.where, self.root = values, where, root
        self.known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        self.known.add(key)
        return key in self.values

    def fail(self, message: str, key: str | None = None) -> NoReturn:
        """Raises LoadError: file and table, key and value if there is one, what is wrong."""
        given = f"{key} = {_shown(self.values.get(key))}: " if key else ""
        raise LoadError(f"{self.where}: {given}{message}")

    def need(self, key: str, message: str) -> None:
        """Raises LoadError where a key is absent; a misspelt one is named instead."""
        if key not in self:
            others = [k for k in self.values if k not in self.known]
            near = difflib.get_close_matches(key, others, n=1)
            self.fail(unknown("key", near[0], [key]) if near else message)

    def finish(self) -> None:
        """Raises LoadError for the first key that is not one of those read so far."""
        for key in self.values:
            if key not in self.known:
                self.fail(unknown("key", key, self.known))

    def _get(self, key: str) -> Any:
        self.known.add(key)
        return self.values.get(key)

    def number(self, key: str, default: float, check: tuple[Check, str] = ANY) -> float:
        """A finite number, or the default. Raises LoadError if it is none or fails the check."""
        value = self._get(key)
        return float(default) if value is None else self._number(value, key, check)

    def integer(self, key: str, default: int, low: int = 1, high: int = 2**31 - 1) -> int:
        """A whole number in a range, or the default. Raises LoadError."""
        value = self._get(key)
        if value is None:
            return default
        if type(value) is not int:
            self.fail("must be a whole number", key)
        if not low <= value <= high:
            self.fail(f"must be between {low} and {high}", key)
        return value

    def boolean(self, key: str, default: bool) -> bool:
        """true or false, or the default. Raises LoadError."""
        value = self._get(key)
        if value is not None and type(value) is not bool:
            self.fail("must be true or false", key)
        return default if value is None else value

    def string(self, key: str, default: str, choices: Sequence[str] = ()) -> str:
        """A text, one of the choices if there are any, or the default. Raises LoadError with the nearest choice."""
        value = self._get(key)
        if value is None:
            return default
        if type(value) is not str:
            self.fail("must be a text in quotes", key)
        if choices and value not in choices:
            self.fail(unknown(key, value, choices))
        return value

    def vector(self, key: str, default: Sequence[float], check: tuple[Check, str] = ANY) -> tuple[float, ...]:
        """As many numbers as the default has."""
        value = self._get(key)
        if value is None:
            return tuple(float(x) for x in default)
        if not isinstance(value, list) or len(value) != len(default):
            self.fail(f"must be a list of {len(default)} numbers", key)
        return tuple(self._number(x, key, check) for x in value)

    def raw(self, key: str) -> Any:
        """The value as TOML has it, None if absent; the caller checks it."""
        return self._get(key)

    def table(self, key: str) -> "Table | None":
        """The table [key], or None."""
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            self.fail("must be a table", key)
        return Table(value, f"{self.where}: [{key}]" if self.root else f"{self.where}: {key}")

    def tables(self, key: str) -> "list[Table]":
        """The tables [[key]], counted from 1 and named by their `name` in messages."""
        value = self._get(key) or []
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            self.fail(f"must be an array of tables: write [[{key}]] above each", key)
        return [Table(v, f"{self.where}: [[{key}]] {i}{_label(v)}") for i, v in enumerate(value, 1)]

    def named_tables(self, key: str) -> "list[tuple[str, Table]]":
        """The tables [key.NAME] in the file's order."""
        value = self._get(key) or {}
        if not isinstance(value, dict) or not all(isinstance(v, dict) for v in value.values()):
            self.fail(f"must hold named tables: write [{key}.main]", key)
        return [(name, Table(v, f"{self.where}: [{key}.{name}]")) for name, v in value.items()]

    def _number(self, value: Any, key: str, check: tuple[Check, str]) -> float:
        if type(value) not in (int, float):
            self.fail(
                f"must be made of numbers, not {_shown(value)}" if isinstance(value, str) else "not a number", key
            )
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail("must be finite", key)
        if not check[0](number):
            self.fail(check[1], key)
        return number


def _label(values: dict[str, Any]) -> str:
    name = values.get("name")
    return f' "{name}"' if isinstance(name, str) else ""


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"' if len(value) < 60 else f'"{value[:57]}..."'
    text = repr(value)
    return text if len(text) < 80 else text[:77] + "..."
