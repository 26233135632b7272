"""A shader as text: includes expanded, specialised by features; what compilers say of it, by file and line."""

import re
from pathlib import Path

from glhybrid import layout
from glhybrid.errors import ShaderError
from glhybrid.needs import Features
from glhybrid.shader_live import ConditionError, read

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$', re.MULTILINE)
_VERSION = "#version 430 core\n"


class Source:
    """One shader after includes: text with #line directives, and the files that the numbers in them mean."""

    def __init__(self, folders: tuple[Path, ...], path: str) -> None:
        self.path = path
        self.files: list[str] = []
        self.text = self._expand(folders, path)
        try:
            self._live = read(self.text)
        except ConditionError as error:
            raise ShaderError(f"{self._place(error.line)}: {error}") from None
        self._words = self._live.words
        self._made: dict[tuple[int, ...], tuple[str, dict[str, int]]] = {}

    def _expand(self, folders: tuple[Path, ...], path: str) -> str:
        index = len(self.files)
        self.files.append(path)
        if path == "layout.glsl":
            text = layout.glsl_header()
        elif path == "tables.glsl":
            text = layout.glsl_readers()
        else:
            file = next((f / path for f in folders if (f / path).is_file()), folders[0] / path)
            if not file.is_file():
                raise ShaderError(f'{file}: shader not found; reinstall glhybrid or check the include "{path}"')
            text = file.read_text(encoding="utf-8")
        lines = [f"#line 1 {index}"]
        for number, line in enumerate(text.splitlines(), start=1):
            match = _INCLUDE.match(line) if "#include" in line else None
            if match is None:
                lines.append(line)
                continue
            if match.group(1) not in self.files:  # each file once
                lines.append(self._expand(folders, match.group(1)))
            lines.append(f"#line {number + 1} {index}")
        return "\n".join(lines)

    def specialise(self, features: Features) -> tuple[str, dict[str, int]]:
        """The text that counts under these features, and those that it depends on."""
        known = features.defines()
        if missing := sorted(w for w in self._words if w.startswith("USE_") and w not in known):
            raise ShaderError(f"glsl/{self.path}: {missing[0]} is not a field of Features in glhybrid/needs.py")
        values = tuple(_named(known, self._words).values())
        if values not in self._made:
            try:
                text, words = self._live.live(known)
            except ConditionError as error:
                raise ShaderError(f"{self._place(error.line)}: {error}") from None
            named = _named(known, words)
            head = [f"#define {name} {value}" for name, value in named.items()]
            head += [f"const bool {n[4:]} = bool({n});" for n in named if n.startswith("USE_") and n != "USE_AOV"]
            self._made[values] = _VERSION + "\n".join(head) + "\n" + text, named
        return self._made[values]

    def _place(self, line: int) -> str:
        """A line of the text, from 0, as `glsl/FILE:LINE`."""
        lines = self.text.split("\n")
        start = next(k for k in range(line, -1, -1) if lines[k].startswith("#line "))
        _, number, index = lines[start].split()
        return f"glsl/{self.files[int(index)]}:{int(number) + line - start - 1}"

    def readable(self, log: str) -> str:
        """Mesa's `S:L(C):` and NVIDIA's `S(L) :` as `glsl/FILE:LINE:`."""

        def place(match: re.Match[str]) -> str:
            number = int(match.group(1))
            name = self.files[number] if number < len(self.files) else self.path
            return f"glsl/{name}:{match.group(2)}:"

        log = re.sub(r"\b(\d+):(\d+)\(\d+\):", place, log)
        return re.sub(r"\b(\d+)\((\d+)\) :", place, log)


def _named(known: dict[str, int], words: frozenset[str]) -> dict[str, int]:
    """Those of the defines that words name, themselves or as the constant that goes with them."""
    return {
        name: value
        for name, value in known.items()
        if name in words or (name.startswith("USE_") and name.removeprefix("USE_") in words)
    }
