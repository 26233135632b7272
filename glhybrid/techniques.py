"""The registry of techniques: one set of names for the command line, the API, TOML, EXR layers and charts."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

from glhybrid.errors import SettingError, unknown
from glhybrid.layout import CONSTANTS

if TYPE_CHECKING:
    from glhybrid.settings import Settings

Kind = Literal["shadows", "reflections", "ao"]


@dataclass(frozen=True)
class Parameter:
    """A number or switch of one technique, set by the key `KIND.TECHNIQUE.NAME`; its type is its default's."""

    name: str
    default: bool | int | float | str
    summary: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    sweep: tuple[bool | int | float | str, ...] | None = None  # a study's values; None: octaves of a whole number


@dataclass(frozen=True)
class Technique:
    """One way to make something of a picture. stochastic: uses random numbers; more samples, less noise."""

    kind: Kind
    name: str
    summary: str
    stochastic: bool = False
    traced: bool = False  # needs the tree
    depth_maps: bool = False
    light_maps: bool = False
    mirror_pass: str = ""  # of reflections: the pass that answers what the mirror direction shows
    parameters: tuple[Parameter, ...] = ()

    def key(self, parameter: Parameter) -> str:
        """The dotted key of a parameter, as --set and Settings.parameters take it: `shadows.pcf.radius`."""
        return f"{self.kind}.{self.name}.{parameter.name}"


def _depth_map(*own: Parameter) -> tuple[Parameter, ...]:
    """What all depth maps share, then a technique's own.

    A texel hides half its size times the slope of a plane: slope_bias 0.5 is the least without acne, 0.75 serves curved
    surfaces too. Moving points along their normals moves the shadow's border as well, and was worse at any amount.
    """
    return (
        Parameter("resolution", 2048, "texels a side of each depth map", 64, 16384),
        Parameter("bias", 0.0, "m that a surface is moved to the light before the comparison", 0.0, 1e3),
        Parameter("slope_bias", 0.75, "the same in texels times the slope of the surface", 0.0, 16.0),
        Parameter("normal_bias", 0.0, "texels, times the sine, that a point is moved along its normal", 0.0, 16.0),
        *own,
    )


_CUTOFF = Parameter(
    "cutoff",
    1.0,
    "roughness from which the blurred sky stands in and nothing is looked for",
    0.0,
    1.0,
    sweep=(0.5, 0.25),
)
_STEPS = Parameter("steps", 256, "cells of the depth pyramid that a ray looks at, at most", 1, 65536)
_RADIUS = Parameter("radius", 1.0, "m: what is farther does not occlude", 1e-6, 1e9, sweep=())
_FILTER = (
    Parameter("denoise", True, "filter the noise over frames and pixels"),
    Parameter("history", 32, "frames that count, at most", 1, 1024, sweep=()),
    Parameter("iterations", 3, "steps of the filter over pixels, each twice as wide", 1, 8, sweep=()),
)
_PLANE = Parameter("receiver_plane", True, "each tap is compared with the depth of the receiver's plane there")

_ALL = (
    Technique("shadows", "none", "every light reaches every surface"),
    Technique(
        "shadows",
        "map",
        "depth map from the light, one tap",
        depth_maps=True,
        parameters=_depth_map(),
    ),
    Technique(
        "shadows",
        "pcf",
        "depth map, filtered over a fixed width",
        depth_maps=True,
        parameters=_depth_map(
            Parameter("kernel", "box", "box: all texels, exact; disc: turned Vogel disc", choices=("box", "disc")),
            Parameter("radius", 1.5, "half width of the filter, texels", 0.5, 64.0),
            Parameter("taps", 16, "of the disc, each bilinear", 1, 256),
            _PLANE,
        ),
    ),
    Technique(
        "shadows",
        "pcss",
        "depth map, filtered over a width from the blocker's distance",
        depth_maps=True,
        parameters=_depth_map(
            Parameter("blockers", 32, "taps of the search for blockers", 1, 256),
            Parameter("taps", 48, "of the filter, each bilinear", 1, 256),
            Parameter("radius", 0.5, "smallest half width of the filter, texels", 0.0, 64.0),
            Parameter("search", 64.0, "largest half width of search and filter, texels", 1.0, 512.0),
            _PLANE,
        ),
    ),
    Technique(
        "shadows",
        "csm",
        "cascaded depth maps for the sun",
        depth_maps=True,
        parameters=_depth_map(
            Parameter("cascades", 4, "maps of a directional light; the last is of the whole scene", 1, 8),
            Parameter("split", 0.75, "of the view's depth: 0 even, 1 logarithmic", 0.0, 1.0),
            Parameter("distance", 0.0, "m from the camera that the finer maps serve; 0 = to the scene's end", 0.0, 1e9),
            Parameter("blend", 0.1, "share of a map over which the next one takes over", 0.0, 0.5),
            Parameter("snap", True, "maps move by whole texels"),
            Parameter("radius", 0.5, "half width of the filter, texels", 0.5, 64.0),
            _PLANE,
        ),
    ),
    Technique(
        "shadows",
        "baked",
        "lightmap in its own UV set, traced once; static scenes",
        traced=True,
        light_maps=True,
        parameters=(
            Parameter("texels", 0.0, "a metre; 0: as many as fill the budget", 0.0, 1e6, sweep=()),
            Parameter(
                "budget", 2 << 20, "texels over all surfaces, if not given a metre", 1024, 1 << 26, sweep=(1 << 18,)
            ),
            Parameter("samples", 64, "rays a texel to a light that has a size", 1, 65536, sweep=()),
            Parameter("push", True, "points of texels inside solids are moved out of them"),
            Parameter(
                "dilation",
                8,
                "texels over which those that stay inside take their neighbours' values",
                0,
                256,
                sweep=(),
            ),
            Parameter(
                "triangles", 2_000_000, "most that are unwrapped: a million takes about a minute", 1, 1 << 27, sweep=()
            ),
        ),
    ),
    Technique("shadows", "ray", "one any-hit ray per pixel and light", traced=True),
    Technique(
        "shadows",
        "ray-soft",
        "rays to the disc of every light that has a size",
        stochastic=True,
        traced=True,
        parameters=(
            Parameter("samples", 4, "rays a pixel and light", 1, 4096),
            Parameter("hit_samples", 1, "rays a light from what a reflection or a blended layer shows", 1, 64),
            *_FILTER,
        ),
    ),
    Technique("reflections", "none", "no reflected light but the lights' highlights"),
    Technique("reflections", "env", "prefiltered environment, without occlusion"),
    Technique(
        "reflections",
        "probe",
        "box-projected local cube maps, captured in place",
        mirror_pass="probe",
        parameters=(
            _CUTOFF,
            Parameter(
                "count",
                4,
                "most that are placed where a scene has none of its own; 3.5 MiB each",
                1,
                64,
                sweep=(1, 2, 8),
            ),
            Parameter("resolution", 256, "texels a side of each of the six faces", 16, 4096),
            Parameter(
                "blend", 0.1, "m around a probe's reach over which it gives way to the next, or the sky", 0.0, 1e9
            ),
        ),
    ),
    Technique(
        "reflections",
        "ssr",
        "march in the G-buffer, environment where it fails",
        mirror_pass="ssr",
        parameters=(
            _CUTOFF,
            _STEPS,
            Parameter("thickness", 0.02, "what is seen counts as so thick: share of its distance", 0.0, 1e6),
            Parameter("thickness_m", 0.0, "the same in m, added", 0.0, 1e9),
            Parameter("fade", 0.05, "share of the picture's sides over which hits fade to its border", 0.0, 0.5),
        ),
    ),
    Technique(
        "reflections",
        "ray-lerp",
        "one mirror ray, its hit lit with its own shadow ray, mixed by roughness with the blurred sky",
        traced=True,
        mirror_pass="reflect",
        parameters=(
            Parameter(
                "cutoff",
                1.0,
                "roughness from which no ray is sent and the blurred sky stands in",
                0.0,
                1.0,
                sweep=(0.5, 0.25),
            ),
            Parameter(
                "resolution",
                "full",
                "pixels that send a ray: all, one of four, or one of two; between them only where neighbours differ",
                choices=("full", "half", "checkerboard"),
                sweep=("half", "checkerboard"),
            ),
            Parameter(
                "contrast",
                0.1,
                "share of what a pixel shows by which rays beside it may differ for it to send none",
                0.0,
                1.0,
            ),
        ),
    ),
    Technique(
        "reflections",
        "ssr-ray",
        "screen space first, a ray where that fails",
        traced=True,
        mirror_pass="ssr",
        parameters=(_CUTOFF, _STEPS),
    ),
    Technique(
        "reflections",
        "ray-glossy",
        "rays over the whole specular lobe, their hits lit with their own shadow rays",
        stochastic=True,
        traced=True,
        mirror_pass="glossy",
        parameters=(
            Parameter("samples", 4, "rays a pixel from a roughness of 0.25 on; a mirror takes one", 1, 4096),
            Parameter("sky_rays", True, "a second ray beside each, to where the sky has a sun or lamps", sweep=()),
            Parameter("lamp_rays", True, "the same, to meshes that shine much brighter than the sky", sweep=()),
            _CUTOFF,
            *_FILTER,
        ),
    ),
    Technique(
        "reflections",
        "reference",
        "unbiased path tracing of the whole picture; `shadows` has no say",
        stochastic=True,
        traced=True,
    ),
    Technique("ao", "none", "nothing keeps the sky from a surface but its occlusion texture"),
    Technique(
        "ao",
        "ssao",
        "horizons in the G-buffer (GTAO)",
        parameters=(
            _RADIUS,
            Parameter("slices", 3, "through the view direction, a pixel", 1, 64, sweep=()),
            Parameter("steps", 8, "to either side of a slice", 1, 256, sweep=()),
        ),
    ),
    Technique(
        "ao",
        "ray",
        "cosine-weighted rays of a limited length",
        stochastic=True,
        traced=True,
        parameters=(_RADIUS, Parameter("samples", 4, "rays a pixel", 1, 4096), *_FILTER),
    ),
)

SHADOWS = {t.name: t for t in _ALL if t.kind == "shadows"}
REFLECTIONS = {t.name: t for t in _ALL if t.kind == "reflections"}
AO = {t.name: t for t in _ALL if t.kind == "ao"}
TECHNIQUES: dict[str, dict[str, Technique]] = {"shadows": SHADOWS, "reflections": REFLECTIONS, "ao": AO}


def find(kind: str, name: object) -> Technique:
    """The technique of that name. Raises SettingError for one that is unknown."""
    table = TECHNIQUES[kind]
    technique = table.get(str(name))
    if technique is None:
        raise SettingError(unknown(f"{kind} technique", name, table))
    return technique


def reflect_grid(settings: "Settings") -> int:
    """Which pixels send mirror rays, a GRID_* of layout.py."""
    if settings.reflections != "ray-lerp":
        return 0
    return CONSTANTS[f"GRID_{settings.parameter('reflections.ray-lerp.resolution').upper()}"]


def cutoff(settings: "Settings") -> float:
    """Roughness from which the technique of reflections looks for nothing along the mirror direction."""
    key = f"reflections.{settings.reflections}.cutoff"
    return float(settings.parameter(key)) if key in parameters() else 1.0


@cache
def parameters() -> Mapping[str, Parameter]:
    """Every parameter of every technique, by its full key."""
    return {t.key(p): p for table in TECHNIQUES.values() for t in table.values() for p in t.parameters}
