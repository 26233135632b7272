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
from dataclasses import dataclass

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


@dataclass
class _Item:
    """One declaration. names: what it declares; empty: kept in any case. guards: words of conditions around it."""

    first: int
    last: int
    names: frozenset[str]
    guards: frozenset[str] = frozenset()


class Text:
    """A shader after includes, read once; live() says what counts of it. Raises ConditionError."""

    def __init__(self, text: str) -> None:
        self.lines = [_COMMENT.sub("", line).rstrip() for line in text.split("\n")]
        self._words = [frozenset(_used(line)) for line in self.lines]
        self._directives = {k: m.groups() for k, line in enumerate(self.lines) if (m := _DIRECTIVE.match(line))}
        self._items = list(self._read())
        self._by_name: dict[str, list[_Item]] = defaultdict(list)
        for item in self._items:
            for name in item.names:
                self._by_name[name].append(item)

    @property
    def words(self) -> frozenset[str]:
        """Every word in it, whatever counts."""
        return frozenset().union(*self._words)

    def _read(self) -> Iterator[_Item]:
        guards: list[frozenset[str]] = []
        k = 0
        while k < len(self.lines):
            line, first = self.lines[k], k
            if k in self._directives:
                kind, rest = self._directives[k]
                if kind in ("if", "ifdef", "ifndef"):
                    guards.append(frozenset(_WORD.findall(rest)))
                elif kind in ("elif", "else", "endif") and not guards:
                    raise ConditionError(k, f'"{line.strip()}" without its #if')
                elif kind == "elif":
                    guards[-1] |= frozenset(_WORD.findall(rest))
                elif kind == "endif":
                    guards.pop()
                elif kind == "define" and (named := _DEFINE.match(rest)):
                    yield _Item(k, k, frozenset({named.group(1)}), frozenset().union(*guards))
            elif line:
                while not ("{" in self.lines[k] or ";" in self.lines[k]) and k + 1 < len(self.lines):
                    k += 1
                if self.lines[k].count("{") > self.lines[k].count("}"):  # without an end, the compiler will say so
                    rest_of_it = range(k + 1, len(self.lines))
                    k = next((i for i in rest_of_it if self.lines[i].startswith("}")), len(self.lines) - 1)
                whole = "\n".join(self.lines[i] for i in range(first, k + 1) if i not in self._directives)
                yield _Item(first, k, _declared(whole), frozenset().union(*guards))
            k += 1
        if guards:
            raise ConditionError(len(self.lines) - 1, "#if without its #endif")

    def live(self, defines: Mapping[str, int]) -> tuple[str, frozenset[str]]:
        """The text, what does not count blank, and the words that it depends on: its own, and of conditions it met.

        So values of words that are not among them have no say in it.
        """
        on, met = self._decide(defines)
        kept = {k for k, (kind, _) in self._directives.items() if kind == "line" or (kind == "error" and on[k])}
        words: set[str] = set()
        wanted = [*(item for item in self._items if not item.names), *self._by_name["main("]]
        while wanted:
            found: set[str] = set()
            for item in wanted:
                found |= item.guards
                for k in range(item.first, item.last + 1):
                    if on[k]:
                        kept.add(k)
                        found |= self._words[k]
                    else:
                        found |= met.get(k, frozenset())
            found -= words
            words |= found
            wanted = [item for name in found for item in self._by_name.get(name, ())]
        return "\n".join(line if k in kept else "" for k, line in enumerate(self.lines)), frozenset(words)

    def _decide(self, defines: Mapping[str, int]) -> tuple[list[bool], dict[int, frozenset[str]]]:
        """Which lines conditions leave, and the words of the conditions that were met on the way, by line."""
        macros: dict[str, str] = {name: str(value) for name, value in defines.items()}
        met: dict[int, frozenset[str]] = {}
        on: list[bool] = []
        stack: list[list[bool]] = []  # is this branch taken, was one, is what is around
        now = True
        for k in range(len(self.lines)):
            kind, rest = self._directives.get(k, ("", ""))
            if kind in ("if", "ifdef", "ifndef"):
                taken = now and _holds(kind, rest, macros, k)
                if now:
                    met[k] = self._words[k] - {kind}
                stack.append([taken, taken, now])
                now = taken
            elif kind in ("elif", "else"):
                top = stack[-1]
                if top[2] and kind == "elif":
                    met[k] = self._words[k] - {kind}
                top[0] = top[2] and not top[1] and (kind == "else" or _holds("if", rest, macros, k))
                top[1] = top[1] or top[0]
                now = top[0]
            elif kind == "endif":
                now = stack.pop()[2]
            elif now and kind == "define" and (named := _DEFINE.match(rest)):
                macros[named.group(1)] = named.group(3)
            elif now and kind == "undef":
                macros.pop(rest, None)
            on.append(now and kind not in ("if", "ifdef", "ifndef", "elif", "else", "endif"))
        return on, met


def _used(line: str) -> Iterator[str]:
    """Words of a line; those that may be calls also with their parenthesis, as functions are known by."""
    for name, call in _USE.findall(line):
        yield name
        if call:
            yield f"{name}("


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
    if not _SAFE.fullmatch(text):
        raise ConditionError(line, f'"{rest}": neither features nor macros, or no number')
    text = re.sub(r"!(?!=)", " not ", text.replace("&&", " and ").replace("||", " or "))
    try:
        return bool(eval(text, {"__builtins__": {}}))
    except (SyntaxError, TypeError) as error:
        raise ConditionError(line, f'"{rest}": {error}') from None
