"""What the raster covers is what primary rays hit: the two ways to a G-buffer name the same instance and triangle.

They may differ where a pixel's centre is nearer to an edge than the raster resolves (it snaps vertices to 1/256 of a
pixel), or two surfaces are nearer to one another than a depth buffer tells; each such pixel is proved to be one in
float64.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from oracles import border_distance
from rays import moved, piece, scene_of
from texture_oracle import linear, sampled, transformed

import glhybrid as gh
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Camera, Image, Instance, Material, Scene, Sphere, Texture
from glhybrid.view import make_view

if TYPE_CHECKING:
    from glhybrid.context import Context

NONE = 0xFFFFFFFF
TWO_SIDED = Material(double_sided=True)
ONE_SIDED = Material()
View = tuple[Scene, Camera]


def bodies(materials: tuple[Material, ...] = (TWO_SIDED,)) -> Scene:
    """Forty instances of four meshes: turned, mirrored, stretched, of all sizes, one through another."""
    rng = np.random.default_rng(5)
    shapes = [torus(segments=32, sides=16), piece(*ray.jagged(8, rng)), box(bevel=0.1), piece(*ray.drum(17))]
    instances = []
    for k in range(40):
        linear = ray.rotation(rng) * 10 ** rng.uniform(-1, 0.2)
        linear = linear @ np.diag(rng.uniform(0.2, 3, 3) if k % 3 == 0 else np.ones(3))
        linear = linear @ np.diag([-1, 1, 1] if k % 2 else [1, 1, 1])
        pose = moved(rng.uniform(-4, 4, 3), linear)
        instances.append(Instance(k % 4, pose, f"body {k}", materials=(k % len(materials),)))
    return scene_of(*shapes, materials=materials).replace(instances=tuple(instances))


def perforated() -> Material:
    """A cut-out of discs: a texture whose alpha changes slowly, so that its border is smooth."""
    y, x = np.mgrid[0:32, 0:32] / 32 * 2 * np.pi
    texels = np.full((32, 32, 4), 255, np.uint8)
    texels[..., 3] = np.round(127.5 + 120 * np.sin(x) * np.sin(y))
    return Material(alpha_mode="MASK", double_sided=True, textures={"base_color": Texture(Image(texels))})


def _far_orbit(scene: Scene, fov: float = 0.6) -> View:
    return scene, Camera.look_at((11, 7, 13), (0, 0, 0), fov_y=fov, near=0.05)


def _cut_outs(_: Path) -> View:
    rng = np.random.default_rng(3)
    sheet = [torus(segments=24, sides=12), box(size=(2, 2, 0.1))]
    poses = [moved(rng.uniform(-2, 2, 3), ray.rotation(rng) * rng.uniform(1, 2)) for _ in range(8)]
    scene = scene_of(*sheet, materials=(perforated(), TWO_SIDED))
    instances = tuple(Instance(k % 2, p, materials=(int(k > 5),)) for k, p in enumerate(poses))
    return _far_orbit(scene.replace(instances=instances))


def _spheres(_: Path) -> View:
    rng = np.random.default_rng(2)
    poses = [moved(rng.uniform(-3, 3, 3), np.diag(np.full(3, 10 ** rng.uniform(-1.5, 0.2)))) for _ in range(40)]
    scene = scene_of(Sphere(1.0), box(size=(8, 0.1, 8)), materials=(TWO_SIDED,))
    return _far_orbit(scene.replace(instances=(*(Instance(0, p) for p in poses), Instance(1, moved((0, -0.5, 0))))))


def _cut_out_spheres(_: Path) -> View:
    scene, camera = _spheres(Path())
    instances = tuple(replace(i, materials=(1,)) if i.mesh == 0 else i for i in scene.instances)
    return scene.replace(materials=(TWO_SIDED, perforated()), instances=instances), camera


def _stretched_spheres(_: Path) -> View:
    rng = np.random.default_rng(2)
    poses = [
        moved(rng.uniform(-3, 3, 3), ray.rotation(rng) @ np.diag(10 ** rng.uniform(-1, 0.2, 3))) for _ in range(20)
    ]
    return _far_orbit(scene_of(Sphere(1.0)).replace(instances=tuple(Instance(0, p) for p in poses)))


def _inside_a_sphere(_: Path) -> View:
    scene = scene_of(Sphere(5.0), Sphere(1.0), poses=[np.eye(4), moved((0, 0, -3))])
    return scene, Camera.look_at((0.5, 0.3, 1), (0, 0, -3), fov_y=1.5)


def _one_sided_spheres(_: Path) -> View:
    """From within one that has no inside."""
    scene = scene_of(Sphere(5.0), Sphere(1.0), poses=[np.eye(4), moved((0, 0, -3))], materials=(ONE_SIDED,))
    return scene, Camera.look_at((0.5, 0.3, 1), (0, 0, -3), fov_y=1.5)


def _sphere_at_the_near_plane(_: Path) -> View:
    """Cut open by it: the inside of its far half is seen."""
    scene = scene_of(Sphere(1.0), Sphere(0.3), poses=[moved((0, 0, -1.5)), moved((0.2, 0, -1.2))])
    return scene, Camera.look_at((0, 0, 0), (0.1, 0, -1), fov_y=1.2, near=1.0)


def _one_sided(_: Path) -> View:
    """Open shells, half of them mirrored: backs are seen through."""
    rng = np.random.default_rng(8)
    position, index = ray.uv_sphere(8, 1.0)
    shell = piece(position, index[: len(index) * 2 // 3])
    poses = [
        moved(rng.uniform(-3, 3, 3), ray.rotation(rng) @ np.diag([-1.0 if k % 2 else 1.0, 1, 1])) for k in range(24)
    ]
    scene = scene_of(shell, materials=(ONE_SIDED, TWO_SIDED))
    return _far_orbit(
        scene.replace(instances=tuple(Instance(0, p, materials=(k % 5 // 4,)) for k, p in enumerate(poses)))
    )


def _orthographic(_: Path) -> View:
    pose = Camera.look_at((11, 7, 13), (0, 0, 0)).world_from_view
    return bodies((TWO_SIDED, ONE_SIDED)), Camera("flat", pose, fov_y=0.0, near=0.05, xmag=7.0, ymag=5.0)


def _duplicates(_: Path) -> View:
    """Every triangle twice in a mesh, and every instance twice: of equals the lowest id is seen in both."""
    rng = np.random.default_rng(1)
    position, index = ray.jagged(8, rng)
    twice = piece(position, np.concatenate([index, index]))
    poses = [moved(rng.uniform(-3, 3, 3), ray.rotation(rng)) for _ in range(6)]
    return _far_orbit(scene_of(twice).replace(instances=tuple(Instance(0, p) for p in poses + poses)))


def _near_plane(_: Path) -> View:
    """The camera among things, some of them nearer than its near plane."""
    return bodies(), Camera.look_at((0.5, 0.2, 0.3), (3, 1, -2), fov_y=1.2, near=0.8)


def _sponza(models: Path) -> View:
    scene = gh.load(models / "Sponza" / "Sponza.glb")
    low, high = scene.bounds()
    at = lambda x, y, z: tuple(low + np.array([x, y, z]) * (high - low))  # noqa: E731
    return scene, Camera.look_at(at(0.2, 0.3, 0.5), at(0.8, 0.4, 0.45), fov_y=1.0, near=0.1)


SCENES: dict[str, Callable[[Path], View]] = {
    "instances": lambda _: _far_orbit(bodies()),
    "two materials, one-sided": lambda _: _far_orbit(bodies((ONE_SIDED, TWO_SIDED))),
    "one-sided shells": _one_sided,
    "cut-outs": _cut_outs,
    "spheres": _spheres,
    "stretched spheres": _stretched_spheres,
    "cut-out spheres": _cut_out_spheres,
    "inside a sphere": _inside_a_sphere,
    "one-sided spheres": _one_sided_spheres,
    "sphere at the near plane": _sphere_at_the_near_plane,
    "orthographic": _orthographic,
    "duplicates": _duplicates,
    "near plane": _near_plane,
    "sponza": _sponza,
}


def ids_of(renderer: gh.Renderer, scene: Scene, camera: Camera, size: tuple[int, int], **settings: Any) -> Any:
    """(H, W, 2) uint32: row of instances, row of triangles; and the distance. Row 0 at the top."""
    chosen = gh.Settings(aa=1, exposure=0.0, shadows="none", reflections="none", **settings)
    frame = renderer.render(scene, camera, size, chosen, ("distance",))
    staged = renderer.stage(scene, chosen, size, ("distance",))
    assert frame.receipt["plan"]["primary"] == settings["primary"]
    ids = np.frombuffer(staged.targets.get("gbuffer_id").read(), np.uint32).reshape(size[1], size[0], 2)[::-1]
    return ids, frame["distance"].astype(np.float64), staged.upload.geometry


@pytest.mark.parametrize(("name", "levels"), [(n, k) for n in SCENES for k in (1, 2) if (n, k) != ("sponza", 2)])
def test_raster_and_rays_name_the_same_triangles(
    renderer: gh.Renderer, context: "Context", models: Path, name: str, levels: int
) -> None:
    scene, camera = SCENES[name](models)
    size = (320, 240) if ray.SCALE < 100 else (1280, 960)
    drawn, drawn_t, geometry = ids_of(renderer, scene, camera, size, primary="raster", levels=levels)
    traced, traced_t, _ = ids_of(renderer, scene, camera, size, primary="trace", levels=levels)
    assert (traced[..., 1] != NONE).mean() > 0.03
    other = (drawn != traced).any(-1)
    edge = edges(traced)
    off_edges = int((other & ~edge).sum())
    ray.say(f"{name:26} levels {levels}: {other.sum()} of {edge.sum()} edge pixels differ, {off_edges} others")
    assert (other & edge).sum() <= 0.005 * edge.sum() + 1
    # Distances agree wherever the ids do.
    same = ~other & (traced[..., 1] != NONE)
    assert (np.abs(drawn_t[same] - traced_t[same]) <= 1e-5 * traced_t[same]).mean() > 0.999
    unproved = [
        (int(r), int(c), drawn[r, c].tolist(), traced[r, c].tolist())
        for r, c in np.argwhere(other)
        if not excused(geometry, camera, size, scene, (r, c), drawn[r, c], traced[r, c])
    ]
    assert not unproved, f"{len(unproved)} of {other.sum()}: {unproved[:5]}"


def edges(ids: Any) -> Any:
    """Pixels with a neighbour of another id."""
    padded = np.pad(ids, ((1, 1), (1, 1), (0, 0)), mode="edge")
    h, w = ids.shape[:2]
    shifts = [padded[y : y + h, x : x + w] for y in range(3) for x in range(3)]
    return np.any([(s != ids).any(-1) for s in shifts], axis=0)


def at_the_cutoff(geometry: Any, instance: int, triangle: int, corners: Any, point: Any) -> bool:
    """Whether the alpha of a cut-out is, at this point, within 1e-3 of where it cuts."""
    row = geometry.first_record[instance] + geometry.triangles[triangle, 3]
    material = geometry.materials[geometry.hit_groups[geometry.records[row, 0], 1]]
    if material.alpha_mode != "MASK":
        return False
    texture, vertices = material.textures["base_color"], geometry.vertices[geometry.triangles[triangle, :3]]
    assert texture.uv_set == 0
    weights = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(point, 1), rcond=None)[0]
    uv = transformed(texture, weights @ vertices[:, [3, 7]].astype(np.float64))
    alpha = sampled(texture, linear(texture.image.texels, True), uv[None])[0, 3] * material.base_color[3]
    return bool(abs(alpha - material.alpha_cutoff) < 1e-3)


def excused(
    geometry: Any, camera: Camera, size: tuple[int, int], scene: Scene, pixel: Any, drawn: Any, traced: Any
) -> bool:
    """Whether a pixel's centre lies on an edge (1/128 px) of what it shows, or what it shows is at one depth or cut there."""
    view = make_view(camera, size, scene)
    x, y = (pixel[1] + 0.5) / size[0] * 2 - 1, 1 - (pixel[0] + 0.5) / size[1] * 2
    origin, direction = view.eye, view.forward
    if view.orthographic:
        origin = origin + x * view.right + y * view.up
    else:
        direction = ray.unit(view.forward + x * view.right + y * view.up)
    spheres = {int(s[0]): s for m in geometry.meshes for s in m.spheres}
    distances, border = [], np.inf
    for instance, triangle in (drawn, traced):
        if triangle == NONE:
            continue
        pose = geometry.world_from_object[instance].copy()
        pose[:3, 3] -= view.origin
        if int(triangle) in spheres:
            sphere = spheres[int(triangle)][2].astype(np.float64)
            inverse = np.linalg.inv(pose)
            o, d = inverse[:3, :3] @ origin + inverse[:3, 3] - sphere[:3], inverse[:3, :3] @ direction
            mid = -(o @ d) / (d @ d)
            off = np.linalg.norm(o + mid * d)
            half = np.sqrt(max(sphere[3] ** 2 - off**2, 0) / (d @ d))
            t = mid - half if mid - half > 0 else mid + half
            border = min(border, abs(off - sphere[3]) / (max(t, 1e-9) * view.pixel_angle * np.linalg.norm(d)))
        else:
            corners = (
                geometry.vertices[geometry.triangles[triangle, :3], :3].astype(np.float64) @ pose[:3, :3].T
                + pose[:3, 3]
            )
            n = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            t = float((corners[0] - origin) @ n / (direction @ n))
            footprint = view.pixel_angle * (1 if view.orthographic else max(abs(t), 1e-9))
            border = min(border, border_distance(corners, origin, direction) / footprint)
            if at_the_cutoff(geometry, instance, triangle, corners, origin + t * direction):
                return True
        distances.append(t)
    if border <= 1 / 128:
        return True
    return len(distances) == 2 and abs(distances[0] - distances[1]) <= 1e-5 * abs(distances[1])
