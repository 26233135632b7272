"""The BSDF against the float64 specification in numpy_brdf.py: values, samples, albedo, and the split-sum table."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from numpy_brdf import Brdf, albedo, specular_albedo, unit
from scene_kit import constant_sky, quad, scene

from glhybrid import layout
from glhybrid.needs import Features
from glhybrid.scene import Camera, Material
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders

if TYPE_CHECKING:
    from mitsuba_client import Oracle
    from numpy.typing import NDArray

    from glhybrid.context import Context
    from glhybrid.renderer import Renderer

HERE = Path(__file__).parent


class Probe:
    """probes/bsdf.comp."""

    def __init__(self, context: "Context") -> None:
        self.context = context
        self.shaders = Shaders(context, extra=(HERE,))

    def run(
        self,
        brdfs: list[Brdf],
        v: Any,
        l: Any,
        n_coat: Any = (0, 0, 1),
        repeats: int = 1,
        seed: int = 0,
    ) -> "NDArray[np.float64]":
        """(count, repeats, 3, 4): as the probe's Results."""
        count = max(len(brdfs), np.size(v) // 3, np.size(l) // 3)
        rows = np.zeros((count, 6, 4), np.float32)
        rows[:, 0, :3] = [np.broadcast_to(b.base_color, 3) for b in brdfs]
        rows[:, 1, :3] = [b.f0 for b in brdfs]
        names = (("metallic", 0, 3), ("specular", 1, 3), ("roughness", 2, 0), ("transmission", 2, 1),
                 ("clearcoat", 2, 2), ("clearcoat_roughness", 2, 3))  # fmt: skip
        for name, slot, part in names:
            rows[:, slot, part] = [getattr(b, name) for b in brdfs]
        for slot, directions in ((3, v), (4, l), (5, n_coat)):
            rows[:, slot, :3] = np.asarray(directions)
        coated = any(b.clearcoat > 0 for b in brdfs)
        program = self.shaders.compute("bsdf", Features(clearcoat=coated), folder="probes")
        gl = self.context.gl
        cases, results = gl.buffer(rows.tobytes()), gl.buffer(reserve=count * repeats * 48)
        given = {"Cases": cases, "Results": results, "count": count, "repeats": repeats, "seed": seed}
        program.dispatch(given, (65536, -(-count * repeats // 65536)), group=(64, 1))
        out = np.frombuffer(results.read(), np.float32).reshape(count, repeats, 3, 4).astype(np.float64)
        cases.release()
        results.release()
        return out

    def close(self) -> None:
        self.shaders.release()


@pytest.fixture
def probe(context: "Context") -> Any:
    made = Probe(context)
    yield made
    made.close()


def hemisphere(rng: np.random.Generator, count: int, lowest: float = 0.02) -> "NDArray[np.float64]":
    """Unit directions with z from `lowest` to 1."""
    z, phi = rng.uniform(lowest, 1, count), rng.uniform(0, 2 * np.pi, count)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def random_brdf(rng: np.random.Generator, **fixed: Any) -> Brdf:
    values = {
        "base_color": rng.uniform(0, 1, 3), "metallic": rng.choice([0, 1, rng.uniform()]), "roughness": rng.uniform(0.03, 1),
        "ior": rng.uniform(1, 2.5), "specular": rng.uniform(), "specular_color": rng.uniform(0, 1, 3),
        "transmission": rng.choice([0, rng.uniform()]), "clearcoat": rng.uniform(), "clearcoat_roughness": rng.uniform(0.03, 1),
    }  # fmt: skip
    return Brdf(**(values | fixed))


@pytest.mark.parametrize("coated", [False, True])
def test_values(probe: Probe, coated: bool) -> None:
    """4,000 random materials and direction pairs, half of them around the highlight."""
    rng = np.random.default_rng(11)
    count = 4000
    brdfs = [random_brdf(rng, **({} if coated else {"clearcoat": 0.0})) for _ in range(count)]
    v, l = hemisphere(rng, count), hemisphere(rng, count)  # noqa: E741
    # Around the mirror direction, as wide as the lobe is.
    width = np.array([b.alpha for b in brdfs])[:, None]
    near = unit(v * (-1, -1, 1) + width * rng.normal(size=(count, 3)))
    l = np.where((rng.uniform(size=count) < 0.5)[:, None] & (near[:, 2:] > 0.02), near, l)  # noqa: E741
    n_coat = unit(np.array([0, 0, 1]) + rng.uniform(-0.2, 0.2, (count, 3))) if coated else np.array([0, 0, 1.0])
    v, l, n_coat = (x.astype(np.float32).astype(np.float64) for x in (v, l, n_coat))  # noqa: E741
    got = probe.run(brdfs, v, l, n_coat)[:, 0, 0, :3]
    normals = np.broadcast_to(n_coat, v.shape)
    want = np.stack([b.times_cosine((0, 0, 1), v[i], l[i], normals[i]) for i, b in enumerate(brdfs)])
    error = np.abs(got - want) / (np.abs(want) + 1e-3)
    print(f"largest {error.max():.1e}, median {np.median(error):.1e}")
    assert np.isfinite(got).all() and (want > 1e-3).mean() > 0.8
    assert error.max() < BARS["brdf value"].value


def test_behind(probe: Probe) -> None:
    """Nothing where light or viewer are behind the normal, and no NaN at grazing or opposite directions."""
    up = unit([0.3, 0.1, 0.5])
    sides: Any = [(up, -up), (-up, up), (-up, -up), ((1, 0, 0), up), (up, (1, 0, 0)), ((1, 0, 0), (-1, 0, 0))]
    for brdf in (Brdf(), Brdf(metallic=1, roughness=0.1), Brdf(clearcoat=1, clearcoat_roughness=0.1)):
        for v, l in sides:  # noqa: E741
            got = probe.run([brdf], v, l)[0, 0]
            assert np.array_equal(got[0, :3], np.zeros(3)), (brdf, v, l, got)
            if v[2] <= 0:
                assert np.array_equal(got[2, :3], np.zeros(3)), (brdf, v, got)


SAMPLED = {
    "metal 0.15": Brdf(metallic=1, roughness=0.15),
    "metal 0.3": Brdf(metallic=1, roughness=0.3),
    "metal 1": Brdf(metallic=1, roughness=1),
    "plastic": Brdf((0.6, 0.3, 0.2), roughness=0.4),
    "half": Brdf((0.6, 0.3, 0.2), metallic=0.5, roughness=0.7),
    "coat": Brdf((0.6, 0.3, 0.2), roughness=0.8, clearcoat=1, clearcoat_roughness=0.3),
}


@pytest.mark.parametrize("mu", [0.95, 0.5, 0.15])
@pytest.mark.parametrize("name", SAMPLED)
def test_samples_follow_the_density(probe: Probe, name: str, mu: float, scale: float) -> None:
    """Chi-square of drawn directions against the density integrated over bins of the whole sphere; weight = value / density."""
    brdf, v = SAMPLED[name], np.array([np.sqrt(1 - mu**2), 0, mu])
    draws, rows, columns = int(200_000 * scale), 60, 120
    fine, thin = 6, 20  # points a bin: at grazing angles a lobe is narrow in azimuth
    out = probe.run([brdf], v, (0, 0, 1), repeats=draws, seed=3)[0]
    l, pdf, weight = out[:, 1, :3], out[:, 1, 3], out[:, 2, :3]  # noqa: E741
    assert np.abs(np.linalg.norm(l, axis=1) - 1).max() < 1e-5
    # Bins of equal solid angle.
    z = (np.arange(rows * fine) + 0.5) / (rows * fine) * 2 - 1
    phi = (np.arange(columns * thin) + 0.5) / (columns * thin) * 2 * np.pi
    r = np.sqrt(1 - z**2)[:, None]
    grid = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z[:, None]), -1).reshape(-1, 3)
    density = probe.run([brdf], v, grid)[:, 0, 0, 3]
    density = np.where(np.isfinite(density), density, 0)
    share = density.reshape(rows, fine, columns, thin).mean((1, 3)) * 4 * np.pi / (rows * columns)
    assert abs(share.sum() - 1) < BARS["density sum"].value, share.sum()
    place = np.minimum(((l[:, 2] + 1) / 2 * rows).astype(int), rows - 1) * columns
    place += np.minimum((np.arctan2(l[:, 1], l[:, 0]) % (2 * np.pi) / (2 * np.pi) * columns).astype(int), columns - 1)
    seen = np.bincount(place, minlength=rows * columns)
    z_score = chi_square(seen, share.ravel() / share.sum() * draws)
    assert z_score < BARS["chi-square"].value, z_score
    # The weight is the specification's BRDF over the density: its mean is the albedo, without any bin.
    want = brdf.times_cosine((0, 0, 1), v, l) / np.maximum(pdf, 1e-12)[:, None]
    ok = l[:, 2] > 0.01
    assert (np.abs(weight - want)[ok] / (want[ok] + 1e-2)).max() < BARS["brdf value"].value
    mean, error = weight.mean(0), weight.std(0) / np.sqrt(draws)
    assert (np.abs(mean - albedo(brdf, mu)) < 5 * error + 2e-4).all(), (mean, albedo(brdf, mu), error)


def chi_square(seen: "NDArray[Any]", expected: "NDArray[Any]", least: float = 8.0) -> float:
    """Standard normal score of Pearson's statistic (Wilson-Hilferty); bins that expect little are pooled."""
    order = np.argsort(expected)
    small = max(int(np.searchsorted(expected[order].cumsum(), least)), int((expected < least).sum()))
    pool = order[:small]
    keep = order[small:]
    terms = [((seen[keep] - expected[keep]) ** 2 / expected[keep]).sum()]
    if expected[pool].sum() > least:
        terms.append((seen[pool].sum() - expected[pool].sum()) ** 2 / expected[pool].sum())
    k = len(keep) + len(terms) - 2
    return float(((sum(terms) / k) ** (1 / 3) - (1 - 2 / (9 * k))) / np.sqrt(2 / (9 * k)))


ROUGHNESS = (0.1, 0.25, 0.5, 0.75, 1.0)


@pytest.mark.parametrize("mu", [0.95, 0.5, 0.25, 0.1])
def test_white_furnace(renderer: "Renderer", mu: float, scale: float) -> None:
    """A plane in a uniform sky of 1, seen at one angle: radiance is the directional albedo. Strips of many materials."""
    kinds = [
        *(("metal", r, Brdf(metallic=1, roughness=r)) for r in ROUGHNESS),
        *(("dielectric", r, Brdf(roughness=r)) for r in ROUGHNESS),
        ("mirror", 0.0, Brdf((0.7, 0.4, 0.2), metallic=1, roughness=0.0)),
        ("coat", 0.3, Brdf((0.5, 0.7, 0.2), roughness=0.8, clearcoat=0.8, clearcoat_roughness=0.3)),
        (
            "odd",
            0.6,
            Brdf((0.9, 0.3, 0.2), roughness=0.6, metallic=0.3, ior=2.0, specular=0.6, specular_color=(0.2, 1, 0.5)),
        ),
    ]
    parts = []
    for i, (name, _, b) in enumerate(kinds):
        fields = {
            k: getattr(b, k) for k in ("metallic", "roughness", "ior", "specular", "clearcoat", "clearcoat_roughness")
        }
        color = tuple(float(c) for c in np.broadcast_to(b.specular_color, 3))
        red, green, blue = (float(c) for c in np.broadcast_to(b.base_color, 3))
        material = Material(name, (red, green, blue, 1.0), specular_color=color, **fields)  # type: ignore[arg-type]
        strip = quad([(i, 0, 30.0), (i + 1, 0, 30.0), (i + 1, 0, -30.0), (i, 0, -30.0)])
        parts.append((strip, material))
    toward = np.array([0, mu, np.sqrt(1 - mu**2)])
    middle = np.array([len(kinds) / 2, 0, 0])
    pose = Camera.look_at(tuple(middle + 40 * toward), tuple(middle)).world_from_view
    camera = Camera("ortho", pose, fov_y=0, xmag=len(kinds) / 2, ymag=1.0)
    world = scene(parts, camera=camera, environment=constant_sky(1.0))
    width, height = 16 * len(kinds), 48
    settings = Settings(reflections="reference", samples=int(512 * scale), bounces=0, aa=1)
    picture = renderer.render(world, size=(width, height), settings=settings)["radiance"].astype(np.float64)
    strips = picture.reshape(height, len(kinds), 16, 3).mean((0, 2))
    for (name, r, b), got in zip(kinds, strips, strict=True):
        want = (
            np.asarray(b.base_color) + (1 - np.asarray(b.base_color)) * (1 - mu) ** 5
            if name == "mirror"
            else albedo(b, mu)
        )
        print(f"{name} {r} mu {mu}: {got} {want}")
        assert np.abs(got - want).max() < BARS["furnace"].value, (name, r, mu, got, want)


def test_published_albedos() -> None:
    """The quadrature itself, against figures found before: alpha = roughness^2, separable Smith, white metal."""
    for roughness, mu, want in ((0.25, 0.5, 0.9885), (0.5, 0.1, 0.854), (1.0, 0.95, 0.315)):
        assert abs(sum(specular_albedo(mu, roughness**2)) - want) < 5e-4


def test_split_sum_table(renderer: "Renderer") -> None:
    """F0 * scale + F90 * bias of the table the hybrid reads, against quadrature, over angle and roughness."""
    world = scene(
        [(quad([(0, 0, 0), (1, 0, 0), (1, 0, -1), (0, 0, -1)]), Material(roughness=0.5))], environment=constant_sky()
    )
    staged = renderer.stage(world, Settings(aa=1), (8, 8))
    texture = staged.sky.resources["dfg"]
    size = layout.DFG_SIZE
    table = np.frombuffer(texture.read(), np.float16).reshape(size, size, 4)[..., :2].astype(np.float64)
    worst = 0.0
    for row in (8, 16, 24, 32, 48, 63):
        for column in (1, 4, 12, 24, 40, 63):
            mu, roughness = column / (size - 1), row / (size - 1)
            want = specular_albedo(min(mu, 1 - 1e-9), max(roughness**2, 4e-4))
            worst = max(worst, np.abs(table[row, column] - want).max())
    print(f"largest error {worst:.1e}")
    assert worst < BARS["split-sum table"].value


def test_the_oracle_has_the_same_brdf(oracle: "Oracle") -> None:
    """Mitsuba's side: its glTF BSDF is the specification, passes Mitsuba's own chi-square test, and equals `principled`."""
    rng = np.random.default_rng(5)
    wi, wo = hemisphere(rng, 4000, 0.05), hemisphere(rng, 4000, 0.05)
    for brdf in (
        Brdf((0.9, 0.6, 0.3), 1, 0.3),
        Brdf((0.6, 0.2, 0.1), 0, 0.5),
        Brdf((0.7, 0.5, 0.2), 0.4, 0.7, 1.9, 0.7),
    ):
        spec = {"type": "gltf", "base_color": list(brdf.base_color), "metallic": float(brdf.metallic),
                "roughness": brdf.roughness, "f0": brdf.f0.tolist(), "f90": brdf.specular}  # fmt: skip
        got = oracle.ask({"job": "evaluate", "bsdf": spec}, wi=wi, wo=wo)["value"]
        want = brdf.times_cosine((0, 0, 1), wi, wo)
        assert (np.abs(got - want) / (want + 1e-3)).max() < BARS["oracle brdf"].value
        if brdf.metallic == 1:
            other = {
                "type": "principled",
                "base_color": list(brdf.base_color),
                "metallic": 1.0,
                "roughness": brdf.roughness,
            }
            value = oracle.ask({"job": "evaluate", "bsdf": other}, wi=wi, wo=wo)["value"]
            assert (np.abs(value - want) / (want + 1e-3)).max() < BARS["oracle brdf"].value
        assert oracle.ask({"job": "chi2", "bsdf": spec, "wi": unit([0.5, 0.2, 0.6]).tolist()})["ok"]
