"""Leaving a surface: no ray finds the surface it left, at any scale and place; what touches it still casts a shadow.

Whole frames through the Renderer. GLHYBRID_TEST_SCALE=100 is the full run: 32 surfaces in each place.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rays as ray
from rays import HERE, moved, piece, scene_of

import glhybrid as gh
from glhybrid.load.shapes import box, torus
from glhybrid.scene import F64, Camera, Environment, Light, Material, Scene, Sphere
from glhybrid.shaders import Shaders

if TYPE_CHECKING:
    from glhybrid.context import Context

SCALES = (1e-3, 1.0, 1e3)
PLACES = (0.0, 1e3, 1e5)
SURFACES = ray.count(3200) // 100 if ray.SCALE < 100 else 32
MIRROR = Material(double_sided=True, metallic=1, roughness=0.0)
EXACT = gh.Settings(aa=1, exposure=0.0)


def settings(levels: int) -> gh.Settings:
    return gh.Settings(aa=1, exposure=0.0, levels=1 if levels == 1 else 2)


def sunlit(scene: Scene, towards_sun: Any) -> Scene:
    return scene.replace(lights=(Light("directional", direction=tuple(-ray.unit(towards_sun))),))


def tilted(size: float, place: float, k: int) -> tuple[F64, F64, Camera, F64]:
    """Corners of a square about 0, where it is put, a camera ten sizes away, and a sun above the side it sees."""
    rng = np.random.default_rng(k)
    turn = ray.rotation(rng)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) @ turn.T * size / 2
    offset = place * ray.unit(rng.normal(size=3))
    normal = turn[:, 2] * (1 if k % 2 else -1)
    eye = offset + 10 * size * ray.unit(normal + rng.uniform(0, 4) * ray.unit(np.cross(normal, rng.normal(size=3))))
    sun = ray.unit(normal + 10 ** rng.uniform(-1, 1.5) * ray.unit(np.cross(normal, rng.normal(size=3))))  # to 2 deg
    return corners, offset, Camera.look_at(tuple(eye), tuple(offset), fov_y=0.12, near=1e-3 * size), sun


def square(corners: F64, offset: F64, baked: bool) -> Scene:
    index = [[0, 1, 2], [0, 2, 3]]
    if baked:
        return scene_of(piece(corners + offset, index), materials=(MIRROR,))
    return scene_of(piece(corners, index), poses=[moved(offset)], materials=(MIRROR,))


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", SCALES)
def test_no_surface_shadows_or_mirrors_itself(
    renderer: gh.Renderer, context: "Context", size: float, place: float, levels: int
) -> None:
    for baked in (False, True) if place and size >= 1 else (False,):  # in the vertices, where float32 can hold it there
        seen = 0
        for k in range(SURFACES):
            corners, offset, camera, sun = tilted(size, place, k)
            scene = sunlit(square(corners, offset, baked), sun)
            frame = renderer.render(
                scene, camera, (48, 36), settings(levels), ("visibility", "reflection_hit", "distance")
            )
            hit = np.isfinite(frame["distance"])
            seen += int(hit.sum())
            assert (frame["visibility"][hit] == 1).all(), (baked, k)
            assert np.isinf(frame["reflection_hit"][hit]).all(), (baked, k)
        assert seen > 150 * SURFACES


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("body", ["sphere", "triangles", "drum"])
def test_no_convex_body_shadows_itself(renderer: gh.Renderer, context: "Context", body: str, levels: int) -> None:
    """Also near edges, where neighbours are met. A mesh is convex only to rounding, hence the sun's height."""
    for size in SCALES:
        for place in PLACES:
            position, index = ray.uv_sphere(10) if body == "triangles" else ray.drum(16)
            shape = Sphere(size) if body == "sphere" else ray.soup(size * position[index])
            rng = np.random.default_rng(3)
            offset = place * ray.unit(rng.normal(size=3))
            sun = ray.unit((1, 2, 3))
            scene = sunlit(scene_of(shape, poses=[moved(offset, ray.rotation(rng))], materials=(MIRROR,)), sun)
            camera = Camera.look_at(
                tuple(offset + 10 * size * ray.unit((2, 1, 3))), tuple(offset), fov_y=0.4, near=1e-3 * size
            )
            names = ("visibility", "reflection_hit", "distance", "normal_geometric")
            frame = renderer.render(scene, camera, (96, 72), settings(levels), names)
            hit = np.isfinite(frame["distance"])
            lit = hit & (frame["normal_geometric"] @ sun > 1e-2)
            assert hit.sum() > 1000 and lit.sum() > 0.6 * hit.sum()
            assert (frame["visibility"][lit] == 1).all(), (size, place)
            assert (frame["visibility"][frame["normal_geometric"] @ sun < 0] == 0).all()
            assert np.isinf(frame["reflection_hit"][hit]).all(), (size, place)


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("size", SCALES)
def test_a_box_on_a_plane_keeps_its_contact_shadow(
    renderer: gh.Renderer, context: "Context", size: float, levels: int
) -> None:
    """Every pixel of the plane against a float64 shadow ray from its exact point, those at the box's foot too."""
    from glhybrid import reference

    width, height = 160, 120
    sun = ray.unit((-1.0, 0.8, 0.3))
    floor = piece(np.array([[-3, 0, -3], [-3, 0, 3], [3, 0, 3], [3, 0, -3]]) * size, [[0, 1, 2], [0, 2, 3]])
    cube = box(size=(size, size, size))
    tint = (Material(double_sided=True),)
    for place in PLACES:
        offset = place * ray.unit((3.0, 1.0, -2.0))
        lift = moved(offset + np.array([0, size / 2, 0]))
        scene = sunlit(scene_of(floor, cube, poses=[moved(offset), lift], materials=tint), sun)
        eye = offset + size * np.array([3.0, 2.5, 2.0])
        camera = Camera.look_at(tuple(eye), tuple(offset + size * np.array([0.6, 0, 0])), fov_y=0.5, near=1e-3 * size)
        frame = renderer.render(scene, camera, (width, height), settings(levels), ("visibility", "instance_id"))
        on_floor = frame["instance_id"] == 0
        directions = pixel_directions(camera, width, height)
        start = eye - offset
        point = start - directions * (start[1] / directions[..., 1:2])
        corners = cube.position[cube.index].astype(np.float64) + np.array([0, size / 2, 0])
        shaded = reference.any_hit(corners, point[on_floor], np.broadcast_to(sun, point[on_floor].shape))
        lit = frame["visibility"][..., 0][on_floor] == 1
        # Within 2e-5 of the box's size of the shadow's border float32 may decide either way: push the point both ways.
        sure = np.ones(len(lit), bool)
        for push in 2e-5 * size * np.array([(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)]):
            sure &= (
                reference.any_hit(corners, point[on_floor] + push, np.broadcast_to(sun, point[on_floor].shape))
                == shaded
            )
        assert shaded.sum() > 1000 and (~shaded).sum() > 1000 and sure.mean() > 0.999
        assert (lit != shaded)[sure].all(), (place, int((lit == shaded)[sure].sum()))
        # At the foot itself, on the dark side: the pixels whose neighbour to the left is the box.
        foot = np.zeros_like(on_floor)
        foot[:, 1:] = on_floor[:, 1:] & (frame["instance_id"][:, :-1] == 1)
        dark = np.zeros_like(on_floor)
        dark[on_floor] = shaded
        assert (foot & dark).sum() > 10
        assert (frame["visibility"][..., 0][foot & dark] == 0).all()


def pixel_directions(camera: Camera, width: int, height: int) -> F64:
    """(H, W, 3) directions through pixel centres, row 0 at the top."""
    y, x = np.meshgrid(
        1 - (np.arange(height) + 0.5) / height * 2, (np.arange(width) + 0.5) / width * 2 - 1, indexing="ij"
    )
    up = np.tan(camera.fov_y / 2)
    view = np.stack([x * up * width / height, y * up, -np.ones_like(x)], -1)
    return view @ camera.world_from_view[:3, :3].T


def test_points_rebuilt_from_depth_shadow_themselves(renderer: gh.Renderer, context: "Context") -> None:
    """The control: the test above would see it."""
    shaders = Shaders(context, extra=(HERE,))
    image = context.gl.texture((48, 36), 1, dtype="f4")
    try:
        for bits in (24, 32):
            lit = shadowed = 0
            for k in range(8):
                corners, offset, camera, sun = tilted(1.0, 0.0, k)
                scene = sunlit(square(corners, offset, False), sun)
                renderer.render(scene, camera, (48, 36), EXACT, ("distance",))
                staged = renderer.stage(scene, EXACT, (48, 36), ("distance",))
                program = shaders.compute("depth_shadow", staged.features, folder="probes")
                far = {"depth_far": 1000.0, "depth_levels": 2.0**24 if bits == 24 else 0.0}
                ids = staged.targets.get("gbuffer_id")
                staged.constants.put(near=0.01)
                staged.set(jitter_px=(0, 0))
                program.dispatch(
                    {**staged.upload.resources, "gbuffer_id": ids, "out_visibility": image, **far}, (48, 36)
                )
                seen = np.frombuffer(image.read(), np.float32)
                lit, shadowed = lit + int((seen == 1).sum()), shadowed + int((seen == 0).sum())
            ray.say(f"rebuilt from {bits}-bit depth: {shadowed / (lit + shadowed):.1%} false shadows")
            assert lit + shadowed > 1000
            assert shadowed > 0.1 * (lit + shadowed), bits
    finally:
        image.release()
        shaders.release()


def yard(size: float = 1.0, offset: Any = (0, 0, 0)) -> tuple[Scene, Camera]:
    """Posts, a thin wall, a mirror ball and a torus on a glossy floor, with a low sun."""
    rng = np.random.default_rng(9)
    floor, post, wall = box(size=(24, 0.2, 24)), box(size=(0.3, 1.2, 0.3)), box(size=(6, 1.5, 0.02))
    materials = (
        Material(base_color=(0.5, 0.45, 0.4, 1), roughness=0.3),
        Material(base_color=(0.8, 0.3, 0.2, 1)),
        Material(metallic=1, roughness=0.0),
        Material(base_color=(0.2, 0.4, 0.8, 1), double_sided=True, roughness=0.6),
    )
    shapes = (floor, post, Sphere(0.8), torus(radius=0.7, tube=0.2, segments=48, sides=24), wall)
    places = [(0, (0, -0.1, 0)), (2, (1.2, 0.8, 1.0)), (3, (-1.5, 0.2, 2)), (4, (0, 0.75, -3))]
    places += [(1, (x, 0.6, z)) for x, z in rng.uniform(-5, 5, (12, 2))]
    slot = {0: 0, 1: 1, 2: 2, 3: 3, 4: 3}
    scene = scene_of(*shapes, materials=materials)
    instances = tuple(
        gh.scene.Instance(m, moved(np.array(offset) + size * np.array(p), np.eye(3) * size), materials=(slot[m],))
        for m, p in places
    )
    sky = Environment(np.full((1, 1, 3), 0.3, np.float32))
    scene = sunlit(scene.replace(instances=instances, environment=sky), (0.6, 0.4, 0.5))
    eye, target = np.array(offset) + size * np.array([6.0, 3.0, 8.0]), np.array(offset) + size * np.array([0, 0.3, 0])
    return scene, Camera.look_at(tuple(eye), tuple(target), fov_y=0.7, near=0.01 * size)


def changed(a: Any, b: Any) -> float:
    """Share of pixels whose colour differs by more than one step of 255."""
    return float((np.abs(a.rgb.astype(int) - b.rgb).max(-1) > 1).mean())


@pytest.mark.parametrize("levels", [1, 2])
def test_the_picture_does_not_depend_on_where_the_scene_lies(
    renderer: gh.Renderer, context: "Context", levels: int
) -> None:
    size = (320, 240)
    home = renderer.render(*yard(), size, settings(levels))
    assert np.ptp(home.rgb) > 100
    for place, bar in ((1e3, 1e-4), (1e5, 1e-3)):
        away = renderer.render(*yard(offset=np.array([place, -0.3 * place, 0.7 * place])), size, settings(levels))
        ray.say(f"levels {levels}: {changed(home, away):.4%} of pixels change {place:g} m away")
        assert changed(home, away) <= bar, (place, changed(home, away))


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_the_picture_does_not_depend_on_scale(
    renderer: gh.Renderer, context: "Context", size: float, levels: int
) -> None:
    home = renderer.render(*yard(), (320, 240), settings(levels))
    scaled = renderer.render(*yard(size), (320, 240), settings(levels))
    ray.say(f"levels {levels}: {changed(home, scaled):.4%} of pixels change at scale {size:g}")
    assert changed(home, scaled) <= 1e-4, changed(home, scaled)
