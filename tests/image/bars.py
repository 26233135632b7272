"""Every tolerance of the image tests, each with its reason. A test names a row; nothing else holds a number to pass by.

Figures are of llvmpipe (LLVM 15) unless said; `relative` errors are |got - want| / (|want| + 1e-3 * mean |want|), so
that black pixels count as well.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bar:
    value: float
    reason: str


EPS = 5.97e-8  # half an ulp of float32 at 1

BARS = {
    "ray": Bar(4e-7, "the position AOV is float32, off the float64 ray by ulps, as a share of the distance"),
    "diffuse": Bar(1e-4, "issue 2; measured 1e-7: both shade in float32"),
    "mirror": Bar(1e-4, "issue 2; measured 3e-7 off edges"),
    "ggx": Bar(1e-3, "issue 2; measured 2e-5 at roughness 0.25, where D is steep"),
    "good share": Bar(0.9999, "issue 2: share of unmasked pixels within the bar"),
    "masked share": Bar(0.25, "edges are 1 px to either side of an outline; more masked would be hiding"),
}
