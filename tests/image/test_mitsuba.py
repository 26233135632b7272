"""Deterministic light against Mitsuba 3 along the same pixel-centre rays: sun on rough surfaces, one mirror bounce."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from bars import BARS
from compare import edges, keep, relative
from scene_kit import Rays, box, camera_rays, floor, matte, metal, plastic, quad, scene, soup, sun

from glhybrid.load.shapes import ellipsoid
from glhybrid.scene import Camera, Light, Material, Scene, Sphere
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from mitsuba_client import Oracle

    from glhybrid.renderer import Renderer

SIZE = (160, 120)
DATA = ("position", "normal", "instance_id", "visibility")


def stage(material: Material, wall: Material | None = None, **extra: object) -> Scene:
    """A floor, a wall, a box turned about two axes, a ball of triangles with smooth normals and an analytic one."""
    turn = np.eye(4)
    c, s = np.cos(0.6), np.sin(0.6)
    turn[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turn[:3, 3] = (-0.9, 0.75, 0.2)
    wall = wall or material
    extra.setdefault("lights", [sun((-0.5, -1.0, -0.9))])
    return scene(
        [
            (floor(), matte((0.8, 0.7, 0.6))), (box((-0.45,) * 3, (0.45,) * 3), material, turn),
            (Sphere(0.4), material, (1.2, 0.4, 0.4)), (ellipsoid(radii=(0.3, 0.4, 0.3), segments=128), material, (0.2, 0.41, 0.9)),
            (quad([(-2, 0, -1.6), (2, 0, -1.8), (2, 2.2, -1.9), (-2, 2.2, -1.7)]), wall),
            (soup([[(0.3, 0.02, 1.6), (0.9, 0.02, 1.4), (0.6, 0.6, 1.5)]]), matte((0.1, 0.5, 0.8))),
        ],
        **extra,  # type: ignore[arg-type]
    )  # fmt: skip


def agree(
    renderer: "Renderer", oracle: "Oracle", world: Scene, bar: str, folder: Path, settings: Settings,
    mirrors: tuple[int, ...] = (),
) -> None:  # fmt: skip
    """Direct light everywhere; on the instances `mirrors` one bounce more, which is all that an exact mirror shows."""
    frame = renderer.render(world, size=SIZE, settings=settings, aovs=DATA)
    rays = camera_rays(world, SIZE)
    want, variance = oracle.render(world, rays, max_depth=2, spp=2)
    seen = np.isin(frame["instance_id"], mirrors)
    if mirrors:
        part = Rays(rays.origin[seen], rays.direction[seen])
        want[seen], variance[seen] = oracle.render(world, part, max_depth=3, spp=2)
    assert variance.max() == 0, "the oracle is not deterministic here: the test would judge noise"
    error = relative(frame["radiance"], want)
    mask = edges(frame["instance_id"], frame["normal"], frame["visibility"])
    # Where the mirrored picture is steep: outlines, shadows, and round things, because Mitsuba's mirrored ray starts
    # 8.94e-5 * (1 + max|p|) off the mirror, which turns the normal it meets by that over the radius.
    mask |= seen & edges(want / want.mean() * 0.02)
    good = (error <= BARS[bar].value)[~mask].mean()
    print(f"{bar}: masked {mask.mean():.2%}, bad {1 - good:.2e} of the rest, {(error > BARS[bar].value).mean():.2e} of all, "
          f"median {np.median(error):.1e}, largest unmasked {error[~mask].max():.1e}")  # fmt: skip
    assert want.mean() > 0.05 and mask.mean() < BARS["masked share"].value
    ok = good >= BARS["good share"].value
    assert ok, keep(folder, got=frame["radiance"], want=want, error=error, mask=mask)


def test_rays_are_the_pixel_centres(renderer: "Renderer") -> None:
    """The position AOV lies on rays computed from the camera alone, perspective and orthographic, off-square sizes."""
    world = stage(matte())
    pose = world.cameras[0].world_from_view
    for camera in (world.cameras[0], Camera("ortho", pose, fov_y=0, ymag=1.7), Camera("wide", pose, fov_y=2.2)):
        for size in ((64, 48), (33, 71)):
            frame = renderer.render(
                world, camera=camera, size=size, settings=Settings(aa=1), aovs=("position", "distance")
            )
            rays = camera_rays(world, size, camera)
            t = frame["distance"].astype(np.float64)
            hit = np.isfinite(t)
            assert hit.mean() > 0.1
            on_ray = rays.origin[hit] + t[hit, None] * rays.direction[hit]
            error = np.linalg.norm(frame["position"][hit] - on_ray, axis=-1) / t[hit]
            assert np.quantile(error, 0.99) < BARS["ray"].value, (camera.name, size, np.quantile(error, 0.99))
            # At outlines the raster's 1/256 px decides what is seen; the point is then clamped to the triangle.
            pixel = 2 * (np.tan(camera.fov_y / 2) if camera.fov_y > 0 else camera.ymag / t.min()) / size[1]
            assert error.max() < pixel / 128, (camera.name, size, error.max(), pixel)


def test_sun_on_diffuse(renderer: "Renderer", oracle: "Oracle", tmp_path: Path) -> None:
    agree(renderer, oracle, stage(matte((0.2, 0.5, 0.9))), "diffuse", tmp_path, Settings(aa=1))


@pytest.mark.parametrize("roughness", [0.25, 0.5])
@pytest.mark.parametrize("kind", ["metal", "dielectric"])
def test_sun_on_ggx(renderer: "Renderer", oracle: "Oracle", tmp_path: Path, roughness: float, kind: str) -> None:
    material = metal((0.95, 0.64, 0.3), roughness) if kind == "metal" else plastic((0.6, 0.2, 0.1), roughness)
    settings = Settings(aa=1, reflections="none")
    agree(renderer, oracle, stage(material), "ggx", tmp_path, settings)


def test_mix_ior_and_specular(renderer: "Renderer", oracle: "Oracle", tmp_path: Path) -> None:
    """Half metal with an odd ior and specular factors: every input of the specular mix at once."""
    odd = plastic((0.7, 0.5, 0.2), 0.35, metallic=0.4, ior=1.9, specular=0.7, specular_color=(0.3, 1.0, 0.6))
    agree(renderer, oracle, stage(odd), "ggx", tmp_path, Settings(aa=1, reflections="none"))


def test_point_lamp(renderer: "Renderer", oracle: "Oracle", tmp_path: Path) -> None:
    world = stage(plastic(roughness=0.5), lights=[Light("point", (1.0, 0.8, 0.6), 9.0, position=(0.4, 2.2, 1.4))])
    agree(renderer, oracle, world, "ggx", tmp_path, Settings(aa=1, reflections="none"))


def test_one_mirror_bounce(renderer: "Renderer", oracle: "Oracle", tmp_path: Path) -> None:
    """`ray-lerp` at roughness 0 is Mitsuba's path of depth 3: an exact mirror, the lit scene in it with its shadows."""
    world = stage(matte((0.2, 0.5, 0.9)), wall=metal(1.0, 0.0), lights=[sun((0.5, -1.0, -0.6))])
    agree(renderer, oracle, world, "mirror", tmp_path, Settings(aa=1), mirrors=(4,))


def test_one_mirror_bounce_off_curves(renderer: "Renderer", oracle: "Oracle", tmp_path: Path) -> None:
    """Curved mirrors, analytic and of triangles, coloured, with a constant sky that is theirs alone to show."""
    world = stage(metal((0.9, 0.6, 0.3), 0.0), wall=matte((0.2, 0.5, 0.9)))
    agree(renderer, oracle, world, "mirror", tmp_path, Settings(aa=1), mirrors=(1, 2, 3))


def test_where_normals_face_away_mitsuba_is_dark(renderer: "Renderer", oracle: "Oracle") -> None:
    """A coarse ball with smooth normals. Mitsuba takes them as they are and is black where they face away, in a dotted
    line along the outline; glhybrid turns them to the edge and goes on from its neighbours. Elsewhere both agree."""
    ball = ellipsoid(radii=(0.9, 0.9, 0.9), segments=10)
    camera = Camera.look_at((0.3, 0.5, 3.0), (0, 0, 0), fov_y=np.radians(45))
    world = scene([(ball, matte((0.2, 0.5, 0.9)))], camera=camera, lights=[sun((-0.3, -0.4, -3.0))])
    frame = renderer.render(world, size=SIZE, settings=Settings(aa=1), aovs=DATA)
    rays = camera_rays(world, SIZE)
    want, _ = oracle.render(world, rays, max_depth=2, spp=2)
    seen = frame["instance_id"] == 0
    cos = -(frame["normal"].astype(np.float64) * rays.direction).sum(-1)
    turned = seen & (cos < 0.0015)  # what is turned has N.V of 0.001 and a little more
    lit = (frame["radiance"] > 0.01).any(-1)
    error = relative(frame["radiance"], want)
    print(f"turned {turned.sum()} of {seen.sum()}, of them dark: ours {(turned & ~lit).sum()}, "
          f"Mitsuba {(turned & ~want.any(-1)).sum()}; elsewhere at most {error[seen & ~turned].max():.1e}")  # fmt: skip
    assert turned.sum() > 60 and (error[seen & ~turned] < BARS["diffuse"].value).mean() >= BARS["good share"].value
    assert not want[turned].any() and lit[turned].all()
