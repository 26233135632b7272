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
    "diffuse": Bar(1e-4, "float32 against float32; measured 1e-7"),
    "mirror": Bar(1e-4, "float32 against float32; measured 3e-7 off edges"),
    "ggx": Bar(1e-3, "float32 against float32; measured 2e-5 at roughness 0.25, where D is steep"),
    "good share": Bar(0.9999, "share of unmasked pixels within the bar"),
    "masked share": Bar(0.25, "edges are 1 px to either side of an outline; more masked would be hiding"),
    # test_brdf.py
    "brdf value": Bar(2e-3, "float32 at alpha 1e-3, where 1 ulp of N.H is 1e-4 of D; share of value + 1e-3"),
    "density sum": Bar(0.01, "midpoint rule over 240 x 480 directions of a lobe 1e-2 sr small"),
    "chi-square": Bar(
        4.0, "standard deviations; 18 tests: one in 30,000 runs would fail by chance, with fixed seeds none"
    ),
    "furnace": Bar(0.002, "the table is 64 x 64 half floats; measured 8e-4"),
    "split-sum table": Bar(0.006, "256 points a texel, half floats"),
    "oracle brdf": Bar(5e-5, "float32 on Mitsuba's side; accuracy 5e-6 relative to the value"),
    # test_reference.py
    "z passed": Bar(0.9975, "Mitsuba's own share of pixels, alpha 0.01 with Sidak's correction"),
    "z of a tile": Bar(5.0, "largest of 48 tiles x 3 channels, not independent: 4.2 is alpha 0.005 over 144"),
    "z of the picture": Bar(4.0, "one in 5,000 by chance; with fixed seeds never"),
    "z spread, low": Bar(0.2, "pixels that see the sky or a lamp have no noise and count as 0"),
    "z spread, high": Bar(
        1.3, "1 where variances are right; above it when rare bright paths are missing from one side"
    ),
    "closed room": Bar(0.005, "200 k paths of 40 vertices, relative deviation of each about 1; pbrt's bar is 0.025"),
    "white sky": Bar(0.005, "as the closed room"),
    # test_environment_gpu.py
    "sky lookup": Bar(1e-4, "2e-7 rad of float32 direction over texels 50 times as bright as the next, 128 columns"),
    "irradiance, median": Bar(0.005, "nodes of at most 0.12 rad; measured 0.002"),
    "irradiance, largest": Bar(0.015, "measured 0.0064, in a studio 2,000 times brighter at its lamps than around"),
    "prefilter, median": Bar(0.01, "measured 0.003"),
    "prefilter, largest": Bar(0.08, "measured 0.048, beside a lamp 2,000 times brighter; 256 samples were 8.0 off"),
    "half float": Bar(1e-3, "convolutions and the split-sum table are half floats, 2^-11, twice"),
    # test_denoise.py
    "glossy, 1, RMSE": Bar(0.016, "16 random rays leave 0.038; measured 0.0136 over seven seeds"),
    "glossy, 2, RMSE": Bar(0.0135, "measured 0.0115 over four seeds"),
    "glossy, 4, RMSE": Bar(0.0115, "measured 0.0097 over four seeds"),
    "glossy, 1, FLIP": Bar(0.0255, "measured 0.0238 over twelve seeds"),
    "glossy, 2, FLIP": Bar(0.0225, "16 random rays leave 0.030; measured 0.0208"),
    "glossy, 4, FLIP": Bar(0.019, "measured 0.0169 over seven seeds"),
    "glossy, moving": Bar(
        1.02, "error of a ninth frame over that of one alone with the same rays; measured 0.99 to 1.007"
    ),
    "glossy, changing": Bar(1.06, "error over that of one alone with the same rays; measured 0.84 to 1.02"),
    "glossy, slow": Bar(0.94, "the same; measured 0.89 and 0.90, of one seed 0.96"),
    # test_display.py
    "display step": Bar(0.52, "of 255: half a step is rounding, the rest pow and log2; measured 0.501 on llvmpipe"),
    # test_direct.py, test_textures.py and the like
    "analytic light": Bar(3e-4, "float32 of D at the flank of a highlight, relative to the pixel; measured 5e-5"),
    "analytic light, GPU": Bar(1e-3, "the same where normalize is rounded more; measured 4.3e-4 on an H100"),
    "normal": Bar(2e-6, "a few ulps of a unit vector"),
    "albedo": Bar(
        3e-4, "uv of float32, 1e-7 of 4 m, times 5 texels as far apart as black and white; half-float vertex colours"
    ),
    "ray-lerp": Bar(6e-3, "the split-sum table: 2e-3 off, 64 x 64 half floats, linear between; measured 4e-3"),
    # test_models.py
    "surface": Bar(2e-3, "bilinear texels of real textures, uv of float32 and colours of half floats, as a share of 1"),
    "same picture": Bar(1e-3, "another tree and another space of the same triangles: float32 roundings, textures"),
    "same picture, pixels": Bar(2e-3, "shadow edges and cut-outs may fall on the other side"),
}
