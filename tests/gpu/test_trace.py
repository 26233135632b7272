"""The tracer's hits against Embree and float64 brute force: none missed, none invented, the right distance.

Six kinds of rays over procedural meshes, the Stanford bunny and Sponza, in one and two levels, triangles and spheres.
GLHYBRID_TEST_SCALE=100 is the full run.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import oracles
import pytest
import rays as ray
from rays import NO_HIT, Rays, Tracer, moved, piece, scene_of

import glhybrid as gh
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Image, Instance, Material, Scene, Sphere, Texture

if TYPE_CHECKING:
    from glhybrid.context import Context

KINDS = ("camera", "shadow", "mirror", "diffuse", "random", "axis")
OPAQUE = Material(double_sided=True)


def _plain(path: Path) -> Scene:
    scene = gh.load(path)
    return scene.replace(materials=(OPAQUE,) * len(scene.materials))


def _bunny(models: Path) -> Scene:
    return _plain(models / "StanfordBunny" / "bun_zipper.ply")


def _sponza(models: Path) -> Scene:
    return _plain(models / "Sponza" / "Sponza.glb")


def _soup(models: Path) -> Scene:
    """Triangles of all sizes, from 1e-4 to 1 of the scene, slivers among them, in all directions."""
    rng = np.random.default_rng(11)
    size = 10 ** rng.uniform(-4, 0, (3000, 1, 1))
    shape = rng.normal(size=(3000, 3, 3))
    shape[::7, 2] = shape[::7, 1] + 1e-3 * shape[::7, 2]
    return scene_of(ray.soup(rng.uniform(-1, 1, (3000, 1, 3)) + size * shape))


def _thicket(models: Path) -> Scene:
    """Triangles as large as all of it: a ray meets nearly every box, and its stack is as deep as the trees are."""
    corners = np.random.default_rng(3).uniform(-1, 1, (4800, 3, 3))
    return scene_of(*(ray.soup(part) for part in np.split(corners, 12)))


def _lattice(models: Path) -> Scene:
    """Boxes that share walls and stand on integers: every axis-parallel ray meets edges, corners or whole walls."""
    boxes = [box(size=(2, 1, 1)), box(size=(1, 1, 1)), box(size=(1, 2, 1)), piece(*ray.drum(8))]
    places = [(0, 0, 0), (1.5, 0, 0), (1.5, 1.5, 1), (-2, 0, 1)]
    return scene_of(*boxes, poses=[moved(p) for p in places])


def _bodies(models: Path) -> Scene:
    """Instances under rotation, mirroring, shear and very different scales, overlapping."""
    rng = np.random.default_rng(5)
    shapes = [torus(segments=48, sides=24), piece(*ray.jagged(12, rng)), box(bevel=0.1), piece(*ray.drum(33))]
    poses, meshes = [], []
    for k in range(40):
        linear = ray.rotation(rng) * 10 ** rng.uniform(-1.5, 0.3)
        if k % 3 == 0:
            linear = linear @ np.diag(rng.uniform(0.2, 3, 3))
        if k % 5 == 0:
            linear = linear @ np.diag([-1, 1, 1])
        poses.append(moved(rng.uniform(-4, 4, 3), linear))
        meshes.append(k % len(shapes))
    scene = scene_of(*shapes)
    return scene.replace(instances=tuple(Instance(m, p) for m, p in zip(meshes, poses, strict=True)))


SCENES: dict[str, tuple[Callable[[Path], Scene], int, int]] = {  # scene, levels, rays of each kind in a full run
    "soup": (_soup, 1, 40_000),
    "thicket": (_thicket, 1, 40_000),
    "thicket two-level": (_thicket, 2, 40_000),
    "lattice": (_lattice, 1, 40_000),
    "lattice two-level": (_lattice, 2, 40_000),
    "bodies": (_bodies, 1, 40_000),
    "bodies two-level": (_bodies, 2, 40_000),
    "bunny": (_bunny, 1, 60_000),
    "bunny two-level": (_bunny, 2, 20_000),
    "sponza": (_sponza, 1, 100_000),
    "sponza two-level": (_sponza, 2, 20_000),
}


@pytest.mark.parametrize("name", SCENES)
def test_hits_are_those_of_embree_and_of_float64(context: "Context", models: Path, name: str) -> None:
    pytest.importorskip("embreex")
    make, levels, full = SCENES[name]
    rng = np.random.default_rng(sum(map(ord, name)))
    with Tracer(context, make(models), levels) as tracer:
        assert tracer.features.two_level == (levels == 2)
        corners, rows, _ = tracer.triangles()
        embree = oracles.Embree(corners)
        low, high = corners.min((0, 1)), corners.max((0, 1))
        extent = float(np.linalg.norm(high - low))
        n = ray.count(full)
        sets = {
            "camera": ray.camera_rays(low, high, n, rng),
            "random": ray.random_rays(low, high, n, rng),
            "axis": ray.lattice_rays(low, high, n, rng),
        }
        eyes = ray.camera_rays(low, high, 2 * n, rng)  # more than needed: not all hit
        t, row = embree.closest(eyes)
        hit = np.flatnonzero(row >= 0)[:n]
        edges = np.diff(corners[row[hit]], axis=1)
        normal = ray.unit(np.cross(edges[:, 0], edges[:, 1]))
        for kind in ("shadow", "mirror", "diffuse"):
            sets[kind] = ray.bounced_rays(kind, eyes[hit], t[hit], normal, extent, rng)
        assert set(sets) == set(KINDS)
        for kind, rays in sets.items():
            verdict = oracles.compare(tracer, rays, tracer.trace(rays), embree, corners, rows)
            ray.say(f"{name:18} {kind:8} {verdict}")
            assert verdict.wrong == 0, (kind, verdict)
            assert verdict.hits > 0, (kind, verdict)
            assert verdict.border <= 1e-4 * verdict.rays + 1, (kind, verdict)
            assert verdict.tiny == 0, (kind, verdict)  # t is exact, of vertices and matrices as they are uploaded


def test_barycentrics_put_the_hit_back_on_the_ray(context: "Context", models: Path) -> None:
    with Tracer(context, _bunny(models), 1) as tracer:
        corners, rows, _ = tracer.triangles()
        assert np.array_equal(rows, np.arange(len(rows)))
        rng = np.random.default_rng(3)
        rays = ray.camera_rays(corners.min((0, 1)), corners.max((0, 1)), ray.count(100_000), rng)
        found = tracer.trace(rays)
        hit = found.hit
        v, b = corners[found.triangle[hit]], found.bary[hit]
        point = v[:, 0] + b[:, :1] * (v[:, 1] - v[:, 0]) + b[:, 1:] * (v[:, 2] - v[:, 0])
        origin, direction = rays.origin[hit].astype(np.float64), rays.direction[hit].astype(np.float64)
        off = np.linalg.norm(point - origin - found.t[hit, None] * direction, axis=1)
        far = np.abs(origin).max()
        assert hit.sum() > 300 and (b >= 0).all() and (b.sum(1) <= 1 + 1e-6).all()
        assert np.quantile(off, 0.99) < 4 * 2.0**-23 * far and off.max() < 64 * 2.0**-23 * far


def test_hits_beyond_t_min_and_before_t_max(context: "Context", models: Path) -> None:
    from glhybrid import reference

    with Tracer(context, _soup(models), 1) as tracer:
        corners, _, _ = tracer.triangles()
        rng = np.random.default_rng(8)
        n = ray.count(20_000)
        plain = ray.random_rays(np.full(3, -2.0), np.full(3, 2.0), n, rng)
        t_min, t_max = np.sort(rng.uniform(0, 3, (2, n)).astype(np.float32), axis=0)
        rays = Rays(plain.origin, plain.direction, t_min, t_max)
        found, truth = tracer.trace(rays), reference.closest_hit(corners, rays.origin, rays.direction, t_min, t_max)
        assert 0.02 * n < truth.hit.sum() < 0.9 * n
        assert np.array_equal(found.hit, truth.hit) and np.array_equal(found.blocked, truth.hit)
        hit = truth.hit
        error = np.abs(found.t[hit] - truth.t[hit])
        assert (error <= 1e-5 * truth.t[hit]).mean() > 0.999 and (error <= 1e-4 * truth.t[hit] + 1e-5).all()
        # Empty intervals meet nothing, whichever end is wrong.
        backwards = tracer.trace(Rays(plain.origin, plain.direction, t_max, t_min))
        assert not backwards.hit.any() and not backwards.blocked.any()


def sphere_hit(centre: np.ndarray, radius: np.ndarray, rays: Rays) -> tuple[np.ndarray, np.ndarray]:
    """Nearest t >= 0 over spheres (S, 3), (S,), in float64, and how near, in m, the rays pass a silhouette."""
    o, d = rays.origin.astype(np.float64), ray.unit(rays.direction)
    scale = np.linalg.norm(rays.direction.astype(np.float64), axis=1)
    best, margin = np.full(len(rays), np.inf), np.full(len(rays), np.inf)
    for c, r in zip(centre, radius, strict=True):
        f = o - c
        b = -(f * d).sum(1)
        away = np.linalg.norm(f + b[:, None] * d, axis=1)
        margin = np.minimum(margin, np.abs(away - r))
        half = np.sqrt(np.maximum(r * r - away**2, 0))
        inside = np.linalg.norm(f, axis=1) < r
        t = np.where(inside, b + half, b - half) / scale
        t = np.where((away <= r) & (t >= 0), t, np.inf)
        best = np.minimum(best, t)
    return best, margin


@pytest.mark.parametrize("levels", [1, 2])
def test_spheres_against_their_equation(context: "Context", levels: int) -> None:
    """Radii from 1e-3 to 30 about one another, seen from within and from outside."""
    rng = np.random.default_rng(4)
    radius = 10 ** rng.uniform(-3, 1.5, 24)
    centre = rng.uniform(-10, 10, (24, 3))
    scene = scene_of(*[Sphere(float(r)) for r in radius], poses=[moved(c) for c in centre])
    with Tracer(context, scene, levels) as tracer:
        n = ray.count(100_000)
        parts = [ray.random_rays(np.full(3, -20.0), np.full(3, 20.0), n, rng)]
        aimed = centre[rng.integers(0, 24, n)] + radius[rng.integers(0, 24, n), None] * ray.sphere_directions(rng, n)
        origin = rng.uniform(-20, 20, (n, 3))
        parts.append(Rays.make(origin, (aimed - origin) * 10 ** rng.uniform(-2, 2, (n, 1))))  # directions of any length
        rays = ray.join(parts)
        found = tracer.trace(rays)
        world = centre - tracer.origin
        t, margin = sphere_hit(world, radius, rays)
        far = 4 * 2.0**-23 * 60
        clear = margin > far
        assert clear.mean() > 0.999
        assert np.array_equal(found.hit[clear], np.isfinite(t)[clear]) and np.array_equal(found.blocked, found.hit)
        both = clear & found.hit
        # Near the silhouette t moves by more than the ray does: by far * r / sqrt(2 r margin).
        slack = 1e-5 * t[both] + far / np.linalg.norm(rays.direction[both], axis=1) * np.sqrt(30 / margin[both])
        assert (np.abs(found.t[both] - t[both]) <= slack).all()
        assert (np.abs(found.t[both] - t[both]) <= 1e-5 * t[both]).mean() > 0.95


def test_of_coplanar_triangles_the_lowest_id_wins(context: "Context") -> None:
    rng = np.random.default_rng(6)
    position, index = ray.uv_sphere(12)
    doubled = piece(position, np.concatenate([index, index]))
    with Tracer(context, scene_of(doubled), 1) as once:
        found = once.trace(Rays.make(rng.uniform(-0.5, 0.5, (5000, 3)), ray.sphere_directions(rng, 5000)))
        assert found.hit.all() and (found.triangle < len(index)).all()


def test_what_a_ray_sees_of_one_sided_and_cut_out_surfaces(context: "Context") -> None:
    """Back faces of one-sided surfaces stop shadow rays only; a mask with alpha 0 stops none; mirrored or not."""
    position = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)  # faces +z
    quad = piece(position, [[0, 1, 2], [0, 2, 3]])
    materials = (
        Material(),
        Material(double_sided=True),
        Material(alpha_mode="MASK", base_color=(1, 1, 1, 0.2), double_sided=True),
    )
    mirror = np.diag([1.0, 1.0, -1.0])
    rng = np.random.default_rng(2)
    target = rng.uniform(-0.9, 0.9, (500, 3)) * (1, 1, 0)
    front = Rays.make(target + np.array([0.1, 0.2, 2]), np.tile([-0.1, -0.2, -2], (500, 1)))
    behind = Rays.make(target - np.array([0.1, 0.2, 2]), np.tile([0.1, 0.2, 2], (500, 1)))
    for levels in (1, 2):
        for linear in (np.eye(3), mirror):
            for material, sees in ((0, (True, False)), (1, (True, True)), (2, (False, False))):
                scene = scene_of(quad, poses=[moved((0, 0, 0), linear)], materials=materials)
                scene = scene.replace(instances=(Instance(0, moved((0, 0, 0), linear), materials=(material,)),))
                with Tracer(context, scene, levels, origin=(0, 0, 0)) as tracer:
                    assert tracer.features.single_sided == (material == 0) and tracer.features.alpha_test == (
                        material == 2
                    )
                    # A mirrored instance shows the side its geometry has in front: glTF turns the winding over.
                    from_front, from_behind = (front, behind) if linear[2, 2] > 0 else (behind, front)
                    for rays, seen in zip((from_front, from_behind), sees, strict=True):
                        found = tracer.trace(rays)
                        assert (found.hit == seen).all(), (levels, material, linear[2, 2])
                        assert (found.blocked == (material != 2)).all()
                        assert found.hit.any() or (found.triangle == NO_HIT).all()


def striped() -> Texture:
    """Sixteen meridians: whole, cut out, whole ..."""
    texels = np.full((4, 16, 4), 255, np.uint8)
    texels[:, ::2, 3] = 0
    return Texture(Image(texels))


def meridian(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether a sphere's texture is whole at these unit normals, and whether that is clear of a border."""
    column = (np.arctan2(n[:, 0], n[:, 2]) / (2 * np.pi) + 0.5) * 16
    return column.astype(int) % 2 == 1, np.abs(column - np.round(column)) > 1e-3


@pytest.mark.parametrize("levels", [1, 2])
def test_through_a_hole_in_a_sphere_its_far_side_is_seen(context: "Context", levels: int) -> None:
    rng = np.random.default_rng(13)
    cut = Material(alpha_mode="MASK", double_sided=True, textures={"base_color": striped()})
    shade = Material(alpha_mode="MASK", textures={"base_color": striped()})
    for material in (cut, shade):
        with Tracer(context, scene_of(Sphere(1.5), materials=(material,)), levels, origin=(0, 0, 0)) as tracer:
            origin = 4 * ray.sphere_directions(rng, 4000)
            origin[::3] *= 0.2  # inside
            target = 1.2 * rng.uniform(-1, 1, (4000, 3))
            rays = Rays.make(origin, ray.unit(target - origin))
            o, d = rays.origin.astype(np.float64), rays.direction.astype(np.float64)
            b = (o * d).sum(1)
            under = b * b - (o * o).sum(1) + 1.5**2
            half = np.sqrt(np.maximum(under, 0))
            want, light = np.full(4000, np.inf), np.ones(4000)
            sure = np.abs(under) > 1e-4
            for t in (-b + half, -b - half):  # the near one last
                whole, clear = meridian(ray.unit(o + t[:, None] * d))
                solid = (under > 0) & (t > 0) & whole
                light[solid] = 0
                if material.double_sided or t[0] == (-b - half)[0]:
                    want[solid] = t[solid]
                sure &= clear
            found = tracer.trace(rays)
            assert sure.sum() > 3000 and 500 < np.isfinite(want).sum() < 3500
            assert np.array_equal(found.hit[sure], np.isfinite(want)[sure])
            assert np.array_equal(found.light[sure], light[sure])
            both = sure & found.hit
            assert np.allclose(found.t[both], want[both], rtol=1e-4)


@pytest.mark.parametrize("levels", [1, 2])
def test_light_is_tinted_at_each_wall_of_a_sphere_as_of_a_mesh(context: "Context", levels: int) -> None:
    veil = Material(alpha_mode="BLEND", base_color=(1, 1, 1, 0.25), double_sided=True)
    rng = np.random.default_rng(14)
    inside = 0.3 * ray.sphere_directions(rng, 500)
    for shape in (Sphere(1.0), piece(*ray.uv_sphere(64, 1.0))):
        with Tracer(context, scene_of(shape, materials=(veil,)), levels, origin=(0, 0, 0)) as tracer:
            direction = ray.sphere_directions(rng, 500)
            through = tracer.trace(Rays.make(inside - 3 * direction, direction))
            outward = tracer.trace(Rays.make(inside, direction))
            short = tracer.trace(Rays.make(inside - 3 * direction, direction, t_max=3.0))  # a lamp inside
            assert not through.hit.any()  # blended surfaces are layers, not what is behind them
            assert np.allclose(through.light, 0.75**2) and np.allclose(outward.light, 0.75)
            assert np.allclose(short.light, 0.75)
