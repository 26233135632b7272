"""The registry of techniques: one set of names for the command line, the API, TOML, EXR layers and charts.

A technique that a later version brings is listed too, so that asking for it says so instead of "unknown".
"""

from dataclasses import dataclass
from typing import Literal

from glhybrid.errors import SettingError, unknown

Kind = Literal["shadows", "reflections"]


@dataclass(frozen=True)
class Parameter:
    """A number or switch of one technique, set by the key `KIND.TECHNIQUE.NAME`; its type is its default's."""

    name: str
    default: bool | int | float | str
    summary: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Technique:
    """One way to make shadows or reflections. stochastic: uses `samples` rays per pixel and random numbers."""

    kind: Kind
    name: str
    summary: str
    implemented: bool = False
    stochastic: bool = False
    traced: bool = False  # needs the tree
    parameters: tuple[Parameter, ...] = ()

    def key(self, parameter: Parameter) -> str:
        return f"{self.kind}.{self.name}.{parameter.name}"


_ALL = (
    Technique("shadows", "none", "every light reaches every surface", implemented=True),
    Technique("shadows", "map", "depth map from the light, one tap"),
    Technique("shadows", "pcf", "depth map, filtered over a fixed width"),
    Technique("shadows", "pcss", "depth map, filtered over a width from the blocker's distance"),
    Technique("shadows", "csm", "cascaded depth maps for the sun"),
    Technique("shadows", "baked", "lightmap in its own UV set, traced once; static scenes"),
    Technique("shadows", "ray", "one any-hit ray per pixel and light", implemented=True, traced=True),
    Technique("shadows", "ray-soft", "rays to the light's disc, denoised", stochastic=True, traced=True),
    Technique("reflections", "none", "no reflected light but the lights' highlights", implemented=True),
    Technique("reflections", "env", "prefiltered environment, without occlusion", implemented=True),
    Technique("reflections", "probe", "box-projected local cube map"),
    Technique("reflections", "ssr", "march in the G-buffer, environment where it fails"),
    Technique(
        "reflections",
        "ray-lerp",
        "one mirror ray, its hit lit with its own shadow ray, mixed by roughness with the blurred sky",
        implemented=True,
        traced=True,
        parameters=(
            Parameter("cutoff", 1.0, "roughness from which no ray is sent and the blurred sky stands in", 0.0, 1.0),
        ),
    ),
    Technique("reflections", "ssr-ray", "screen space first, a ray where that fails", traced=True),
    Technique("reflections", "ray-glossy", "GGX-sampled rays, denoised", stochastic=True, traced=True),
    Technique(
        "reflections",
        "reference",
        "unbiased path tracing of the whole picture; `shadows` has no say",
        implemented=True,
        stochastic=True,
        traced=True,
    ),
)

SHADOWS = {t.name: t for t in _ALL if t.kind == "shadows"}
REFLECTIONS = {t.name: t for t in _ALL if t.kind == "reflections"}
TECHNIQUES: dict[str, dict[str, Technique]] = {"shadows": SHADOWS, "reflections": REFLECTIONS}


def find(kind: str, name: object) -> Technique:
    """The technique of that name. Raises SettingError for one that is unknown or not in this version."""
    table = TECHNIQUES[kind]
    technique = table.get(str(name))
    if technique is None:
        raise SettingError(unknown(f"{kind} technique", name, table))
    if not technique.implemented:
        have = ", ".join(t.name for t in table.values() if t.implemented)
        raise SettingError(f'{kind} technique "{name}" ({technique.summary}) is not in this version; it has: {have}')
    return technique


def parameters() -> dict[str, Parameter]:
    """Every parameter of every implemented technique, by its full key."""
    return {t.key(p): p for table in TECHNIQUES.values() for t in table.values() if t.implemented for p in t.parameters}
