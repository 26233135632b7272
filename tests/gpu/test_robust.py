"""Bad geometry: whole frames with it are those without it; what cannot be drawn is counted or refused, never lost."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from rays import Rays, Tracer, moved, piece, scene_of

import glhybrid as gh
from glhybrid.errors import GeometryError
from glhybrid.load.shapes import box
from glhybrid.scene import (
    Camera,
    Environment,
    Image,
    Instance,
    Light,
    Material,
    Mesh,
    Scene,
    Sphere,
    Texture,
    Triangles,
)

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (120, 90)
NAMES = ("distance", "normal", "visibility", "reflection", "albedo", "position")


def settings(levels: int, **more: Any) -> gh.Settings:
    return gh.Settings(aa=1, exposure=0.0, levels=1 if levels == 1 else 2, **more)


def checker() -> Texture:
    texels = np.full((8, 8, 4), 255, np.uint8)
    texels[::2, ::2, :3] = texels[1::2, 1::2, :3] = 60
    return Texture(Image(texels))


def stage() -> tuple[Scene, Camera]:
    """Bodies on a glossy floor, a sun, a lamp and a sky; textures and a normal map, so that every attribute is read."""
    rng = np.random.default_rng(5)
    materials = (
        Material(roughness=0.2, textures={"base_color": checker(), "normal": checker()}),
        Material(metallic=1, roughness=0.0, base_color=(0.9, 0.7, 0.4, 1)),
        Material(base_color=(0.3, 0.5, 0.8, 1), double_sided=True),
    )
    shapes = (box(size=(9, 0.2, 9)), ray.soup(body(ray.uv_sphere(10, 1.0))), ray.soup(body(ray.jagged(6, rng))))
    instances = (
        Instance(0, moved((0, -1, 0))),
        Instance(1, moved((-1.3, 0.2, 0)), materials=(1,)),
        Instance(2, moved((1.6, 0, 0.5), np.eye(3) * 0.5), materials=(2,)),
        Instance(2, moved((0.3, -0.4, 2), np.diag([-0.2, 0.2, 0.2])), materials=(2,)),
    )
    lights = (Light("directional", direction=(-0.4, -0.8, -0.45)), Light("point", position=(2, 3, 3), intensity=8.0))
    scene = scene_of(*shapes, materials=materials, lights=lights)
    sky = Environment(np.full((1, 1, 3), 0.3, np.float32))
    return scene.replace(instances=instances, environment=sky), Camera.look_at((2, 2, 7), (0, -0.2, 0))


def body(made: tuple[Any, Any]) -> Any:
    position, index = made
    return position[index]


def with_pieces(scene: Scene, change: Any) -> Scene:
    """Every piece of every mesh changed."""
    change_one = lambda p: change(p) if isinstance(p, Triangles) else p  # noqa: E731
    return scene.replace(meshes=tuple(Mesh(m.name, tuple(map(change_one, m.primitives))) for m in scene.meshes))


def assert_same(a: Any, b: Any) -> None:
    assert np.isfinite(b["radiance"]).all()
    for name in ("radiance", *NAMES):
        differ = (a[name] != b[name]).reshape(*a[name].shape[:2], -1).any(-1)
        assert not differ.any(), (name, int(differ.sum()))


def polluted(p: Triangles, rng: np.random.Generator) -> Triangles:
    """A twentieth of all triangles, strewn between the others: NaN, infinite, and without area."""
    n = max(len(p.index) // 20, 6)
    bad = p.position[rng.integers(0, len(p.position), (n, 3))]  # inside the bounds: those are of everything finite
    for k in range(n):
        match k % 6:
            case 0:
                bad[k, rng.integers(3), rng.integers(3)] = np.nan
            case 1:
                bad[k, rng.integers(3), rng.integers(3)] = rng.choice([np.inf, -np.inf])
            case 2:
                bad[k, 1] = bad[k, 0]
            case 3:
                bad[k, 2] = bad[k, 1] = bad[k, 0]
            case 4:
                bad[k, 2] = bad[k, 0] * 0.5 + bad[k, 1] * 0.5 if (bad[k, 0] == -bad[k, 1]).any() else bad[k, 1]
            case 5:
                bad[k] = np.nan
    first = len(p.position)
    index = np.empty((len(p.index) + n, 3), np.uint32)
    strewn = np.zeros(len(index), bool)
    strewn[rng.permutation(len(index))[:n]] = True
    index[strewn], index[~strewn] = np.arange(first, first + 3 * n).reshape(-1, 3), p.index

    def grow(a: Any) -> Any:
        return None if a is None else np.concatenate([a, np.full((3 * n, a.shape[1]), np.nan, np.float32)])

    return replace(
        p, position=np.concatenate([p.position, bad.reshape(-1, 3)]), index=index,
        normal=grow(p.normal), uv0=grow(p.uv0), tangent=grow(p.tangent),
    )  # fmt: skip


@pytest.mark.parametrize("levels", [1, 2])
def test_bad_triangles_change_nothing(renderer: gh.Renderer, context: "Context", levels: int) -> None:
    scene, camera = stage()
    clean = renderer.render(scene, camera, SIZE, settings(levels), NAMES)
    assert np.ptp(clean.rgb) > 100 and clean.receipt["scene"]["dropped_triangles"] == 0
    rng = np.random.default_rng(0)
    dirty = renderer.render(with_pieces(scene, lambda p: polluted(p, rng)), camera, SIZE, settings(levels), NAMES)
    assert dirty.receipt["scene"]["dropped_triangles"] >= 18
    assert any("dropped" in w for w in dirty.receipt["scene"]["warnings"])
    assert_same(clean, dirty)


@pytest.mark.parametrize("levels", [1, 2])
def test_everything_twice_changes_nothing(renderer: gh.Renderer, context: "Context", levels: int) -> None:
    scene, camera = stage()
    once = renderer.render(scene, camera, SIZE, settings(levels), NAMES)
    behind = with_pieces(scene, lambda p: replace(p, index=np.concatenate([p.index, p.index])))
    between = with_pieces(scene, lambda p: replace(p, index=np.repeat(p.index, 2, axis=0)))
    for doubled in (behind, between, scene.replace(instances=scene.instances * 2)):
        assert_same(once, renderer.render(doubled, camera, SIZE, settings(levels), NAMES))
    # A hundred copies of one triangle: coincident centroids must not send the builder, or a ray, round for ever.
    many = with_pieces(
        scene, lambda p: replace(p, index=np.concatenate([p.index, np.repeat(p.index[:1], 100, axis=0)]))
    )
    assert_same(once, renderer.render(many, camera, SIZE, settings(levels), NAMES))


@pytest.mark.parametrize(("reflections", "levels"), [("ray-lerp", 1), ("ray-lerp", 2), ("reference", 2)])
@pytest.mark.parametrize("what", ["normal", "uv0", "tangent"])
def test_bad_attributes_make_no_bad_pixel(
    renderer: gh.Renderer, context: "Context", what: str, reflections: str, levels: int
) -> None:
    """NaN, infinite, zero and enormous normals, texture coordinates and tangents on good triangles."""
    rng = np.random.default_rng(1)

    def spoil(p: Triangles) -> Triangles:
        values = getattr(p, what)
        if values is None:
            return p
        values = values.copy()
        for bad in (np.nan, np.inf, -np.inf, 0.0, 3e38, -1e20, 1e-42):
            values[rng.permutation(len(values))[: len(values) // 9 + 1]] = bad
        return replace(p, **{what: values})

    scene, camera = stage()
    more = {"samples": 2} if reflections == "reference" else {}
    with np.errstate(all="ignore"):
        frame = renderer.render(
            with_pieces(scene, spoil), camera, SIZE, settings(levels, reflections=reflections, **more), NAMES
        )
    for name in ("radiance", *NAMES):
        if name not in ("distance",):
            assert np.isfinite(frame[name]).all(), (name, int((~np.isfinite(frame[name])).sum()))


@pytest.mark.parametrize(
    ("what", "reflections", "levels"),
    [
        *((what, "ray-lerp", levels) for what in ("no instance", "one triangle", "one sphere") for levels in (1, 2)),
        ("no triangle", "ray-lerp", 1),
        ("only a bad one", "ray-lerp", 2),
        ("no instance", "reference", 2),
        ("one sphere", "reference", 1),
    ],
)
def test_next_to_nothing(renderer: gh.Renderer, context: "Context", what: str, reflections: str, levels: int) -> None:
    pieces: dict[str, Triangles | Sphere] = {
        "no triangle": piece(np.zeros((0, 3)), np.zeros((0, 3))),
        "only a bad one": piece(np.full((3, 3), np.nan), [[0, 1, 2]]),
        "one triangle": piece([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]]),
        "one sphere": Sphere(1.0),
    }
    scene = scene_of(pieces[what]) if what in pieces else Scene("empty")
    sky = Environment(np.full((1, 1, 3), 0.25, np.float32))
    scene = scene.replace(lights=(Light("directional", direction=(0.0, 0.0, -1.0)),), environment=sky)
    camera = Camera.look_at((0, 0, 5), (0, 0, 0))
    more = {"samples": 2} if reflections == "reference" else {}
    names = (*NAMES, "instance_id", "triangle_id", "material_id")
    frame = renderer.render(scene, camera, (64, 48), settings(levels, reflections=reflections, **more), names)
    covered = frame["instance_id"] == 0
    assert covered.any() == what.startswith("one") and np.isfinite(frame["radiance"]).all()
    assert np.isfinite(frame["distance"][covered]).all() and np.isinf(frame["distance"][~covered]).all()
    assert np.allclose(frame["radiance"][~covered], 0.25)


@pytest.mark.parametrize("levels", [1, 2])
def test_squashed_instances_are_counted_and_the_rest_is_drawn(
    renderer: gh.Renderer, context: "Context", levels: int
) -> None:
    camera = Camera.look_at((0, 2, 5), (0, 0, 0))
    for scale in ((0, 0, 0), (1, 0, 1), (np.nan, 1, 1), (1, np.inf, 1)):
        for shape, count in ((box(), 12), (Sphere(0.5), 1)):
            scene = scene_of(box(), shape, poses=[moved((-1, 0, 0)), moved((1, 0, 0), np.diag(scale))])
            frame = renderer.render(scene, camera, (64, 48), settings(levels), ("instance_id",))
            assert (frame["instance_id"] == 0).sum() > 100 and not (frame["instance_id"] == 1).any()
            assert frame.receipt["scene"]["dropped_triangles"] == count


@pytest.mark.parametrize("levels", [1, 2])
def test_sizes_past_the_arithmetic_are_refused_and_those_within_are_right(context: "Context", levels: int) -> None:
    """Triangles at a geometric progression, which makes the deepest trees; and scenes from 1e-10 to 1e11 m."""
    from glhybrid import reference

    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.3]]) * 0.5 + np.array([1, 0.1, 0.2])
    for first, n in ((-120, 240), (-60, 118)):
        chain = corner * 2.0 ** np.arange(first, first + n)[:, None, None]
        with pytest.raises(GeometryError, match="past it products of three lengths overflow float32"):
            Tracer(context, scene_of(ray.soup(chain)), levels).close()
    for n in (77, 240, 2000):
        chain = corner * 2.0 ** np.linspace(-38, 38, n)[:, None, None]
        with Tracer(context, scene_of(ray.soup(chain)), levels, origin=None if levels == 1 else (0, 0, 0)) as tracer:
            held, rows, _ = tracer.triangles()
            # One level stands about the middle: there the tiny end has no area in float32, and is counted.
            assert len(held) + tracer.geometry.dropped == n and (tracer.geometry.dropped == 0 or levels == 1)
            size, middle = np.ptp(held, axis=1).max(1), held.mean(1)
            rays = Rays.make(middle + size[:, None] * np.array([0, 0, 1]), np.tile([0.0, 0, -1], (len(held), 1)))
            found, truth = tracer.trace(rays), reference.closest_hit(held, rays.origin, rays.direction)
            assert truth.hit.all() and found.hit.all() and found.blocked.all()
            same = found.triangle == rows[truth.triangle.astype(int)]
            assert (np.abs(found.t - truth.t)[~same] <= 1e-5 * truth.t[~same]).all()
    rng = np.random.default_rng(0)
    for size in (1e-10, 1e-6, 1e6, 1e11):
        corners = (rng.uniform(-1, 1, (50, 1, 3)) + 0.3 * rng.normal(size=(50, 3, 3))) * size
        with Tracer(context, scene_of(ray.soup(corners)), levels, origin=(0, 0, 0)) as tracer:
            rays = ray.random_rays(np.full(3, -size), np.full(3, size), 3000, rng)
            found, truth = tracer.trace(rays), reference.closest_hit(tracer.triangles()[0], rays.origin, rays.direction)
            assert np.array_equal(found.hit, truth.hit) and truth.hit.sum() > 500
            error = np.abs(found.t[truth.hit] - truth.t[truth.hit])
            assert (error <= 1e-5 * truth.t[truth.hit] + 1e-6 * size).all()


def garbage(seed: int) -> Scene:
    """Anything: sizes over twelve decades, slivers, copies, NaN, inf, coincident points, spheres, flat instances."""
    rng = np.random.default_rng(seed)
    chain = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.3]]) * 1.2 ** np.arange(-90, 20)[:, None, None]
    pieces: list[Triangles | Sphere] = [
        ray.soup(chain, material=2)
    ]  # in all, so that they need stacks of about one size
    for _ in range(rng.integers(1, 5)):
        n = int(rng.integers(0, 200))
        corners = rng.normal(size=(n, 3, 3)) * 10 ** rng.uniform(-10, 2, (n, 1, 1)) + rng.normal(size=(n, 1, 3))
        kind = rng.integers(0, 12, n)
        corners[kind == 0, 0, 0] = np.nan
        corners[kind == 1, 1] = np.inf
        corners[kind == 2, 2] = corners[kind == 2, 1]
        corners[kind == 3] = corners[:1] if n else 0
        corners[kind == 4, 2] = corners[kind == 4, 1] + 1e-7
        corners[kind == 5] = np.round(corners[kind == 5])
        corners[kind == 6, :, 1] = 0
        pieces.append(ray.soup(corners, material=int(rng.integers(0, 4))))
    pieces.append(Sphere(float(10 ** rng.uniform(-6, 1))))
    instances = [Instance(0, moved((0.0, 0.0, 0.0)))]
    for k in range(int(rng.integers(1, 20))):
        linear = ray.rotation(rng) @ np.diag(10 ** rng.uniform(-3, 1, 3) * rng.choice([-1, 1], 3))
        if k % 7 == 3:
            linear[:, rng.integers(3)] = rng.choice([0, np.nan, 1e-30])
        far = 10 ** rng.uniform(-3, 6) if k % 5 == 2 else 1.0
        instances.append(Instance(int(rng.integers(0, len(pieces))), moved(far * rng.normal(size=3), linear)))
    materials = (
        Material(), Material(double_sided=True, roughness=0.0, metallic=1), Material(roughness=0.4),
        Material(alpha_mode="MASK", textures={"base_color": checker()}),
    )  # fmt: skip
    lights = (Light("directional", direction=tuple(ray.unit(rng.normal(size=3)))), Light("point", position=(1, 2, 3)))
    sky = Environment(rng.uniform(0, 1, (4, 8, 3)).astype(np.float32))
    scene = scene_of(*pieces, materials=materials, lights=lights, environment=sky)
    return scene.replace(instances=tuple(instances))


@pytest.mark.parametrize("seed", range(20 if ray.SCALE <= 1 else int(10 * ray.SCALE)))
def test_garbage(renderer: gh.Renderer, context: "Context", seed: int) -> None:
    """A picture without a bad pixel, or one clear error."""
    scene, camera = garbage(seed), Camera.look_at((0.5, 1, 5), (0, 0, 0))
    try:
        frame = renderer.render(scene, camera, (48, 36), settings(1 + seed % 2), NAMES)
    except GeometryError as error:
        assert "\n" not in str(error) and len(str(error)) > 30
        return
    for name in ("radiance", "normal", "visibility", "albedo", "position"):
        assert np.isfinite(frame[name]).all(), name
    assert not np.isnan(frame["distance"]).any() and not np.isnan(frame["reflection"]).any()
