"""Which pictures a study makes: every technique of the registry, over what trades time for error.

A cell is one way to make a picture. An axis is swept with the other kinds at their defaults, so that a difference is of
the technique alone; then the techniques on the fronts of all axes are put together (`pairs`).
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

from glhybrid import needs, techniques
from glhybrid.errors import SettingError, unknown
from glhybrid.scene import Scene
from glhybrid.settings import Settings, Value
from glhybrid.techniques import Parameter, Technique

TRUTH = "reference"
OCTAVES = (0.25, 4.0)  # of a count that is swept: what lies between is on the line
QUICK_OCTAVES = (0.25,)
SAMPLES = "samples"  # the parameter of that name: rays a pixel
SAMPLE_COUNTS = (1, 2, 4, 8, 16, 64)
QUICK_SAMPLE_COUNTS = (1, 4)
PAIRS = "pairs"
MAIN = ("shadows", "reflections")  # kinds that a picture is called by


@dataclass(frozen=True)
class Cell:
    """techniques: one of each kind. parameters: full keys, only what is set for this cell."""

    techniques: Mapping[str, str]
    parameters: Mapping[str, Value] = field(default_factory=dict)

    def settings(self, base: Settings) -> Settings:
        """The settings that make it: one sample a pixel, through the pixel's centre."""
        return base.replace(**self.techniques, aa=1, parameters=dict(self.parameters))

    @property
    def key(self) -> str:
        """Equal for cells that make the same picture."""
        return json.dumps([dict(self.techniques), dict(self.parameters)], sort_keys=True)

    def name(self, kind: str) -> str:
        """The technique of one kind with what is set for it: "csm resolution 512", "ray-glossy 4 spp"."""
        name = self.techniques[kind]
        words = [name]
        for key, value in self.parameters.items():
            if key.startswith(f"{kind}.{name}."):
                parameter = key.rpartition(".")[2].replace("_", " ")
                words.append(f"{_shown(value)} spp" if parameter == SAMPLES else f"{parameter} {_shown(value)}")
        return " ".join(words)

    @property
    def names(self) -> dict[str, str]:
        """Of every kind."""
        return {kind: self.name(kind) for kind in self.techniques}

    @property
    def label(self) -> str:
        """Of the whole picture: "csm resolution 512 + ray-lerp". A further kind that is off is left out."""
        words = [self.name(kind) for kind in MAIN]
        rest = [kind for kind in self.techniques if kind not in MAIN and self.techniques[kind] != "none"]
        return " + ".join([*words, *(f"{kind} {self.name(kind)}" for kind in rest)])

    def axis_of(self, kind: str) -> bool:
        """Whether it is of a kind's axis: all others at their defaults."""
        usual = defaults()
        own = all(key.startswith(f"{kind}.") for key in self.parameters)
        return own and all(self.techniques[k] == name for k, name in usual.items() if k != kind)

    @property
    def stem(self) -> str:
        """A file name of it."""
        return "".join(c if c.isalnum() or c in "-." else "_" for c in self.label.replace(" + ", "__"))

    @property
    def traced(self) -> bool:
        """Whether any of its techniques sends rays."""
        return any(techniques.TECHNIQUES[k][n].traced for k, n in self.techniques.items())

    @property
    def stochastic(self) -> bool:
        """Whether any of its techniques makes noise."""
        return any(techniques.TECHNIQUES[k][n].stochastic for k, n in self.techniques.items())


def _shown(value: Value) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)


def defaults() -> dict[str, str]:
    """The technique of each kind that a frame has if nothing is said."""
    settings = Settings()
    return {kind: str(getattr(settings, kind)) for kind in techniques.TECHNIQUES}


def contestants(kind: str, only: Sequence[str] = ()) -> list[Technique]:
    """The techniques of a kind, but for the path tracer that all are held against."""
    found = [t for t in techniques.TECHNIQUES[kind].values() if t.name != TRUTH]
    return [t for t in found if not only or t.name in only]


def check_names(names: Iterable[str]) -> tuple[str, ...]:
    """Techniques asked for by name. Raises SettingError for one that no kind has in this version."""
    names = tuple(dict.fromkeys(name.strip() for name in names if name.strip()))
    known = {t.name for kind in techniques.TECHNIQUES for t in contestants(kind)}
    for name in names:
        if name not in known:
            raise SettingError(unknown("technique for a study", name, known))
    return names


def skipped_axes(scene: Scene) -> dict[str, str]:
    """Kinds that change nothing in a scene, with the reason."""
    skipped = {}
    if not scene.lights:
        skipped["shadows"] = "the scene has no light that casts shadows"
    if not any(needs.reflective(scene.materials[i], 1.0) for i in needs.used_materials(scene)):
        skipped["reflections"] = "no material is smoother than roughness 1"
    sky = scene.environment
    if sky is None or sky.intensity == 0 or not sky.radiance.any():
        skipped["ao"] = "no sky lights the scene"
    return skipped


def axis(kind: str, *, quick: bool, only: Sequence[str] = ()) -> list[Cell]:
    """Every technique of a kind, at its defaults and over the values that it declares or that a count allows."""
    cells: list[Cell] = []
    for technique in contestants(kind, only):
        chosen = defaults() | {kind: technique.name}
        cells.append(Cell(chosen))
        for parameter in technique.parameters:
            values = swept(parameter, quick, technique.stochastic)
            cells += [Cell(chosen, {technique.key(parameter): value}) for value in values]
    return unique(cells)


def swept(parameter: Parameter, quick: bool, stochastic: bool = False) -> list[Value]:
    """Values beside the default: as declared, else samples, else octaves of a whole number: a count, and so a cost."""
    if parameter.sweep is not None:
        values: list[Value] = [v for v in parameter.sweep if v != parameter.default]
        return values[:1] if quick else values
    if type(parameter.default) is not int:
        return []
    if parameter.name == SAMPLES and stochastic:
        return [n for n in (QUICK_SAMPLE_COUNTS if quick else SAMPLE_COUNTS) if n != parameter.default]
    low = 1 if parameter.low is None else parameter.low
    high = float("inf") if parameter.high is None else parameter.high
    found: list[Value] = []
    for octave in QUICK_OCTAVES if quick else OCTAVES:
        value = int(min(max(round(parameter.default * octave), low), high))
        if value != parameter.default and value not in found:
            found.append(value)
    return found


def pairs(fronts: Mapping[str, Sequence[Cell]], limit: int | None = None) -> list[Cell]:
    """All combinations of what is best on each axis, but those that an axis has measured. limit: the most."""
    kinds = list(fronts)
    measured = {cell.key for cells in fronts.values() for cell in cells}
    found = []
    for chosen in product(*(fronts[kind] for kind in kinds)):
        names = defaults()
        values: dict[str, Value] = {}
        for kind, cell in zip(kinds, chosen, strict=True):
            names[kind] = cell.techniques[kind]
            values |= {k: v for k, v in cell.parameters.items() if k.startswith(f"{kind}.")}
        pair = Cell(names, values)
        if pair.key not in measured:
            found.append(pair)
    found = unique(found)
    if limit is not None and len(found) > limit:
        step = len(found) / limit
        found = [found[int(i * step)] for i in range(limit)]
    return found


def unique(cells: Iterable[Cell]) -> list[Cell]:
    """The first of each that makes the same picture, in order."""
    found: dict[str, Cell] = {}
    for cell in cells:
        found.setdefault(cell.key, cell)
    return list(found.values())
