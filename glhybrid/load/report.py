"""What a loader had to drop or change, collected while it works and said in one sentence per kind."""

from pathlib import Path

from glhybrid.errors import LoadError


class Report:
    """Warnings of one file. Equal remarks on several things become one sentence that names the first few."""

    NAMED = 3  # things named in a sentence before "and N more"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._things: dict[str, list[str]] = {}

    def warn(self, remark: str, thing: str = "") -> None:
        """Notes that `thing` (mesh "lamp", primitive 2) met with `remark` (lines are not drawn)."""
        self._things.setdefault(remark, []).append(thing)

    def sentences(self) -> tuple[str, ...]:
        """Scene.warnings: one for each remark, with the things it is about."""
        return tuple(self._sentence(remark, things) for remark, things in self._things.items())

    def _sentence(self, remark: str, things: list[str]) -> str:
        named = list(dict.fromkeys(t for t in things if t))
        if not named:
            return remark
        more = f" and {len(named) - self.NAMED} more" if len(named) > self.NAMED else ""
        return f"{'; '.join(named[: self.NAMED])}{more}: {remark}"

    def finish(self, strict: bool) -> tuple[str, ...]:
        """The sentences; raises LoadError with the first of them if strict and there is any."""
        sentences = self.sentences()
        if strict and sentences:
            more = f" (and {len(sentences) - 1} more)" if len(sentences) > 1 else ""
            raise LoadError(f"{self.path}: {sentences[0]}{more}; strict loading refuses this, load without it to go on")
        return sentences
