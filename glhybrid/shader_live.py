"""What of a shader's text counts under given features: conditions are decided; what main() does not lead to goes.

Includes bring whole libraries, and their text differs by features that a program has nothing to do with. Compilers
leave out what is not called, but read it first, and drivers keep what they compiled by its text. So two programs that
differ in nothing they run are one text here, read and compiled once.

Lines stay where they are, for messages to name them: what is left out is blank. Relied on: declarations start in the
first column; one over several lines ends with the next line that starts with "}" or, without braces, that has its ";".
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

_COMMENT = re.compile(r"//.*")
_WORD = re.compile(r"(?<![.\w])[A-Za-z_]\w*")  # not a member's name
_USE = re.compile(r"(?<![.\w])([A-Za-z_]\w*)(\s*\()?")
_DIRECTIVE = re.compile(r"\s*#\s*(if|ifdef|ifndef|elif|else|endif|define|undef|line|version|error|extension)\b\s*(.*)")
_DEFINE = re.compile(r"(\w+)(\([^)]*\))?\s*(.*)")
_FUNCTION = re.compile(r"(?:\w+\s+)+(\w+)\s*\(")
_BLOCK = re.compile(r"layout\s*\([^)]*\)\s*(?:\w+\s+)*?(?:buffer|uniform)\s+\w+\s*\{(.*)\}\s*(\w*)[^;]*;", re.DOTALL)
_VARIABLE = re.compile(
    r"(?:layout\s*\([^)]*\)\s*)?(?:(?:const|uniform|shared|readonly|writeonly|restrict|coherent)\s+)*(?!in\b|out\b|flat\b|buffer\b)"
    r"\w+\s+(\w+\s*[^({]*(?:=.*)?);",
    re.DOTALL,
)
_NESTED = re.compile(r"\([^()]*\)|\[[^\[\]]*\]|\{[^{}]*\}")
_SAFE = re.compile(r"[\d\s()!=<>&|+*~-]*")


class ConditionError(Exception):
    """A condition that cannot be decided, or that does not begin or end: line (from 0) and why."""

    def __init__(self, line: int, why: str) -> None:
        super().__init__(why)
        self.line = line


class _Line(NamedTuple):
    """A line without its comment. words: as _used(). kind, rest: of a directive, else empty."""

    code: str
    words: frozenset[str]
    kind: str
    rest: str


class _Item(NamedTuple):
    """One declaration, first to last line. names: what it declares; empty: kept in any case. words: those in it.

    guards: words of conditions around it. whole: no condition is in it.
    """

    first: int
    last: int
    names: frozenset[str]
    words: frozenset[str]
    guards: frozenset[str]
    whole: bool


class Text:
    """A shader after includes, read once; live() says what counts of it. Raises ConditionError."""

    def __init__(self, text: str) -> None:
        self._lines = [_read_line(line) for line in text.split("\n")]
        self._directives = [k for k, line in enumerate(self._lines) if line.kind]
        self.words: frozenset[str] = frozenset().union(*(line.words for line in self._lines))  # whatever counts
        self._by_name: dict[str, list[_Item]] = defaultdict(list)
        self._always: list[_Item] = []
        for item in self._read():
            for name in item.names:
                self._by_name[name].append(item)
            if not item.names:
                self._always.append(item)

    def _read(self) -> Iterator[_Item]:
        lines, guards, k = self._lines, [frozenset[str]()], 0
        while k < len(lines):
            line, first = lines[k], k
            if line.kind in ("if", "ifdef", "ifndef"):
                guards.append(guards[-1] | line.words)
            elif line.kind in ("elif", "else", "endif"):
                if len(guards) == 1:
                    raise ConditionError(k, f'"{line.code.strip()}" without its #if')
                guards[-1] |= line.words
                if line.kind == "endif":
                    guards.pop()
            elif line.kind == "define" and (named := _DEFINE.match(line.rest)):
                yield _Item(k, k, frozenset({named.group(1)}), line.words, guards[-1], True)
            elif line.code and not line.kind:
                while not ("{" in lines[k].code or ";" in lines[k].code) and k + 1 < len(lines):
                    k += 1
                if lines[k].code.count("{") > lines[k].code.count("}"):  # without an end, the compiler will say so
                    k = next((i for i in range(k + 1, len(lines)) if lines[i].code.startswith("}")), len(lines) - 1)
                inside = lines[first : k + 1]
                names = _declared("\n".join(line.code for line in inside if not line.kind))
                words = frozenset().union(*(line.words for line in inside))
                yield _Item(first, k, names, words, guards[-1], not any(line.kind for line in inside))
            k += 1
        if len(guards) > 1:
            raise ConditionError(len(lines) - 1, "#if without its #endif")

    def live(self, defines: Mapping[str, int]) -> tuple[str, frozenset[str]]:
        """The text, what does not count blank, and the words that it depends on: its own, and of conditions it met.

        So values of words that are not among them have no say in it.
        """
        on, met = self._decide(defines)
        lines, words, wanted = self._lines, set[str](), [*self._always, *self._by_name["main("]]
        kept = {k for k in self._directives if lines[k].kind == "line" or (lines[k].kind == "error" and on[k])}
        while wanted:
            found: set[str] = set()
            for item in wanted:
                found |= item.guards
                if item.whole:
                    if on[item.first]:
                        kept.update(range(item.first, item.last + 1))
                        found |= item.words
                    continue
                for k in range(item.first, item.last + 1):
                    if on[k]:
                        kept.add(k)
                    if on[k] or k in met:
                        found |= lines[k].words
            found -= words
            words |= found
            wanted = [item for name in found for item in self._by_name.get(name, ())]
        return "\n".join(line.code if k in kept else "" for k, line in enumerate(lines)), frozenset(words)

    def _decide(self, defines: Mapping[str, int]) -> tuple[bytearray, set[int]]:
        """Which lines conditions leave, and those of the conditions that were met on the way."""
        macros: dict[str, str] = {name: str(value) for name, value in defines.items()}
        on, met = bytearray(len(self._lines)), set[int]()
        stack: list[list[bool]] = []  # is this branch taken, was one, is what is around
        now, last = True, 0
        for k in self._directives:
            if now:
                on[last:k] = b"\1" * (k - last)
            last = k + 1
            _, _, kind, rest = self._lines[k]
            if kind in ("if", "ifdef", "ifndef"):
                if now:
                    met.add(k)
                taken = now and _holds(kind, rest, macros, k)
                stack.append([taken, taken, now])
                now = taken
            elif kind in ("elif", "else"):
                top = stack[-1]
                if top[2]:
                    met.add(k)
                top[0] = top[2] and not top[1] and (kind == "else" or _holds("if", rest, macros, k))
                top[1] = top[1] or top[0]
                now = top[0]
            elif kind == "endif":
                now = stack.pop()[2]
            else:
                on[k] = now
                if now and kind == "define" and (named := _DEFINE.match(rest)):
                    macros[named.group(1)] = named.group(3)
                elif now and kind == "undef":
                    macros.pop(rest, None)
        if now:
            on[last:] = b"\1" * (len(on) - last)
        return on, met


@lru_cache(128)
def read(text: str) -> Text:
    """The same object for the same text."""
    return Text(text)


@lru_cache(1 << 14)
def _read_line(line: str) -> _Line:
    code = _COMMENT.sub("", line).rstrip()
    kind, rest = found.groups() if (found := _DIRECTIVE.match(code)) else ("", "")
    return _Line(code, frozenset(_used(code)) - {kind}, kind, rest)


def _used(line: str) -> Iterator[str]:
    """Words of a line; those that may be calls also with their parenthesis, as functions are known by."""
    for name, call in _USE.findall(line):
        yield name
        if call:
            yield f"{name}("


@lru_cache(1 << 12)
def _declared(whole: str) -> frozenset[str]:
    """Names that a declaration makes, empty if it is of no known kind."""
    header = whole.partition("{")[0]
    if found := re.match(r"struct\s+(\w+)", whole):
        return frozenset({found.group(1)})
    if found := _BLOCK.fullmatch(whole):
        return frozenset(
            {found.group(2)} if found.group(2) else re.findall(r"(\w+)\s*(?:\[[^\]]*\]\s*)?;", found.group(1))
        )
    if (found := _FUNCTION.match(header)) and "=" not in header[: found.end()]:
        return frozenset({f"{found.group(1)}("})
    if found := _VARIABLE.fullmatch(whole):
        flat = found.group(1)
        while (shorter := _NESTED.sub("", flat)) != flat:
            flat = shorter
        return frozenset(word.group() for part in flat.split(",") if (word := _WORD.search(part)))
    return frozenset()


def _holds(kind: str, rest: str, macros: Mapping[str, str], line: int) -> bool:
    """The value of a condition."""
    if kind in ("ifdef", "ifndef"):
        return (rest in macros) == (kind == "ifdef")
    text = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda m: str(int(m.group(1) in macros)), rest)
    for _ in range(8):  # macros in macros
        text = _WORD.sub(lambda m: f"({macros[m.group()]})" if macros.get(m.group()) else m.group(), text)
    try:
        return _value(text)
    except (ValueError, SyntaxError, TypeError) as error:
        raise ConditionError(line, f'"{rest}": {error}') from None


@lru_cache(1 << 12)
def _value(text: str) -> bool:
    """Of a condition whose names are numbers by now."""
    if not _SAFE.fullmatch(text):
        raise ValueError("neither features nor macros, or no number")
    text = re.sub(r"!(?!=)", " not ", text.replace("&&", " and ").replace("||", " or "))
    return bool(eval(text, {"__builtins__": {}}))
