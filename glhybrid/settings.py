"""Settings: everything about a picture that is not the scene, the camera or its size.

One table, the dataclass's own fields, gives names, types, ranges and help to the API, `--set`, `--config` and the
receipt. Parameters of a technique are dotted keys (`shadows.pcf.radius`) and live in `parameters`.
"""

import dataclasses
import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

from glhybrid import techniques
from glhybrid.errors import SettingError, unknown

Value = bool | int | float | str | None
TONE_MAPS = ("none", "aces", "agx", "pbr-neutral")


def _setting(
    default: Any,
    help: str,
    kind: type,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[object, ...] = (),
    auto: object = ...,
) -> Any:
    """A field with its rules. kind: bool, int, float or str. auto: what the word `auto` stands for, ... if refused."""
    rule = _Rule(kind, help, low, high, choices, auto)
    return field(default=default, metadata={"rule": rule})


@dataclass(frozen=True)
class _Rule:
    kind: type
    help: str
    low: float | None = None
    high: float | None = None
    choices: tuple[object, ...] = ()
    auto: object = ...

    def expects(self) -> str:
        if self.choices:
            words = ", ".join(str(c) for c in self.choices)
        elif self.kind is bool:
            words = "true or false"
        else:
            words = "a whole number" if self.kind is int else "a number" if self.kind is float else "text"
            if self.low is not None and self.high is not None:
                words += f" from {_bound(self.low)} to {_bound(self.high)}"
        return words if self.auto is ... else f"{words}, or auto"

    def check(self, key: str, value: object) -> Any:
        """The value in the rule's type. Raises SettingError naming key, value and what is expected."""
        if self.auto is not ... and (value == "auto" or value is self.auto):
            return self.auto
        wrong = SettingError(f"{key} = {_shown(value)}: expected {self.expects()}")
        if self.choices:
            for choice in self.choices:
                if value == choice and type(value) is type(choice):
                    return choice
            near = difflib.get_close_matches(str(value), [str(c) for c in self.choices], n=1, cutoff=0.5)
            hint = f'; did you mean "{near[0]}"?' if near else ""
            raise SettingError(f"{wrong}{hint}")
        if self.kind is float and type(value) is int:
            value = float(value)
        if type(value) is not self.kind:
            raise wrong
        if isinstance(value, (int, float)):
            low = -math.inf if self.low is None else self.low
            high = math.inf if self.high is None else self.high
            if not (math.isfinite(value) and low <= value <= high):
                raise wrong
        return value

    def parse(self, key: str, text: str) -> Any:
        """The same from the command line's text."""
        value: object = text.strip()
        if not (self.auto is not ... and value == "auto"):
            value = _from_text(self, str(value))
        return self.check(key, value)


def _from_text(rule: _Rule, text: str) -> object:
    if any(text == str(choice) for choice in rule.choices):
        return next(choice for choice in rule.choices if text == str(choice))
    if rule.kind is bool:
        return {"true": True, "false": False, "on": True, "off": False, "1": True, "0": False}.get(text.lower(), text)
    if rule.kind in (int, float):
        try:
            return rule.kind(text)
        except ValueError:
            return text
    return text


def _bound(value: float) -> str:
    return str(int(value)) if value == int(value) else str(value)


def _shown(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


@dataclass(frozen=True)
class Settings:
    """How to make the picture. Values are checked on construction: SettingError names key, value and range.

    rows() says what each does. parameters: of techniques, by dotted key: `{"shadows.pcf.radius": 3}`.
    """

    shadows: str = _setting("ray", "shadow technique", str)
    reflections: str = _setting("ray-lerp", "reflection technique", str)
    ao: str = _setting("none", "ambient occlusion technique", str)
    samples: int = _setting(
        64, "paths per pixel of the reference; other techniques have a parameter of that name", int, 1, 1 << 20
    )
    bounces: int = _setting(8, "surface bounces after the first hit (reference)", int, 0, 64)
    aa: int | None = _setting(
        None, "jittered frames averaged; auto: 4 for PNG, 1 for EXR and NPZ", int, 1, 1024, auto=None
    )
    exposure: float | Literal["auto"] = _setting(
        "auto", "EV, scales the displayed picture by 2^exposure; auto: middle grey", float, -64, 64, auto="auto"
    )
    tone: str = _setting("pbr-neutral", "tone map of the displayed picture", str, choices=TONE_MAPS)
    terminator: bool = _setting(False, "shadow terminator fix for coarse smooth meshes", bool)
    seed: int = _setting(0, "random numbers of stochastic techniques", int, 0, 2**32 - 1)
    time: float | None = _setting(
        None, "seconds into the clip, held at its ends; auto: the pose at rest", float, -1e9, 1e9, auto=None
    )
    clip: str | None = _setting(
        None, "name or number of the animation to play, or all; auto: the first", str, auto=None
    )
    rebuild: float = _setting(
        1.5, "growth of a deforming tree's SAH cost that has it built anew; 1: every frame, 0: never", float, 0, 1e9
    )
    builder: Literal["auto", "cpu", "gpu"] = _setting(
        "auto", "what builds deforming trees anew; auto: a GPU itself, without one the faster", str,
        choices=("auto", "cpu", "gpu"),
    )  # fmt: skip
    levels: Literal["auto", 1, 2] = _setting("auto", "levels of the tree", str, choices=("auto", 1, 2))
    kernels: Literal["auto", "fused", "split", "joined"] = _setting(
        "auto", "reflections in one program, in three, or split with what is small joined to its neighbours", str,
        choices=("auto", "fused", "split", "joined"),
    )  # fmt: skip
    primary: Literal["auto", "raster", "trace"] = _setting(
        "auto", "how first surfaces are found", str, choices=("auto", "raster", "trace")
    )
    parameters: Mapping[str, Value] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        for name, rule in _RULES.items():
            object.__setattr__(self, name, rule.check(name, getattr(self, name)))
        techniques.find("shadows", self.shadows)
        techniques.find("reflections", self.reflections)
        techniques.find("ao", self.ao)
        object.__setattr__(self, "parameters", {k: _rule(k).check(k, v) for k, v in self.parameters.items()})

    def replace(self, **changes: Any) -> "Settings":
        """A copy with some values changed, checked; dotted keys too: `replace(**{"shadows.pcf.radius": 3})`."""
        return _build(self, changes)

    def with_overrides(self, overrides: Iterable[str]) -> "Settings":
        """A copy with `key=value` texts applied in order, as `--set` takes them."""
        changes: dict[str, Any] = {}
        for text in overrides:
            key, equals, value = text.partition("=")
            key = key.strip()
            if not equals:
                raise SettingError(f'--set "{text}": expected key=value')
            changes[key] = _rule(key).parse(key, value)
        return _build(self, changes)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "Settings":
        """Settings from `to_dict()`'s result or a part of it."""
        return _build(Settings(), values)

    def with_toml(self, path: str | Path) -> "Settings":
        """A copy with a TOML file's keys applied. A technique's parameters are quoted keys: "shadows.pcf.radius"."""
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise SettingError(f"{path}: cannot be read: {error.strerror or error}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SettingError(f"{path}: not TOML: {error}") from None
        try:
            return _build(self, values)
        except SettingError as error:
            raise SettingError(f"{path}: {error}") from None

    def to_dict(self) -> dict[str, Value]:
        """Flat and ready for JSON: fields, then the parameters that were set, by their dotted keys."""
        return {name: getattr(self, name) for name in _RULES} | dict(self.parameters)

    def parameter(self, key: str) -> Any:
        """The value of a technique's parameter: as set, else its default."""
        known = techniques.parameters()
        assert key in known, key
        return self.parameters.get(key, known[key].default)

    def aa_frames(self, data: bool) -> int:
        """How many jittered frames to average: `aa`, else 1 for data (EXR, NPZ) and 4 for pictures (PNG)."""
        return self.aa if self.aa is not None else 1 if data else 4


_RULES: dict[str, _Rule] = {f.name: f.metadata["rule"] for f in dataclasses.fields(Settings) if "rule" in f.metadata}
_FREE = _RULES.keys() - {"shadows", "reflections", "ao"}  # settings that are right by themselves


class Row(NamedTuple):
    """A key, a value that it takes as text (its default, or the name of a technique), and what that does."""

    key: str
    value: str
    meaning: str


def rows() -> list[Row]:
    """Every setting with its default, and every technique, each before its parameters; as `glhybrid settings` lists."""
    found = [Row(key, _text(getattr(Settings(), key)), _meaning(rule)) for key, rule in _RULES.items()]
    found = [row for row in found if row.key not in techniques.TECHNIQUES]
    for kind, table in techniques.TECHNIQUES.items():
        for technique in table.values():
            default = " (the default)" if technique.name == getattr(Settings(), kind) else ""
            found.append(Row(kind, technique.name, technique.summary + default))
            found += [
                Row(technique.key(p), _text(p.default), _meaning(_parameter_rule(p))) for p in technique.parameters
            ]
    return found


def _meaning(rule: _Rule) -> str:
    return f"{rule.help} ({rule.expects()})"


def _text(value: object) -> str:
    return "auto" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _parameter_rule(parameter: techniques.Parameter) -> _Rule:
    return _Rule(type(parameter.default), parameter.summary, parameter.low, parameter.high, parameter.choices)


def _rule(key: str) -> _Rule:
    known = techniques.parameters()
    if key in _RULES:
        return _RULES[key]
    if key in known:
        return _parameter_rule(known[key])
    raise SettingError(unknown("setting", key, (*_RULES, *known), "glhybrid settings"))


def _build(base: Settings, changes: Mapping[str, Any]) -> Settings:
    plain: dict[str, Any] = {}
    dotted = dict(base.parameters)
    for key, value in changes.items():
        if key == "parameters" and isinstance(value, Mapping):
            dotted.update(value)
            continue
        _rule(key)  # unknown keys end here, with the nearest known one
        (plain if key in _RULES else dotted)[key] = value
    if plain.keys() <= _FREE and dotted == base.parameters:  # a time for each of many pictures, say
        made = object.__new__(Settings)
        made.__dict__.update(base.__dict__)
        made.__dict__.update((name, _RULES[name].check(name, value)) for name, value in plain.items())
        return made
    return dataclasses.replace(base, **plain, parameters=dotted)
