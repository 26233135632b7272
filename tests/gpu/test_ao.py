"""Ambient occlusion against closed forms: rays converge to them, horizons come near where the screen shows it all, and
fail where theory says: off the screen, and behind what is thin."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import moved, piece, say, scene_of

import glhybrid as gh
from glhybrid.image import Frame
from glhybrid.layout import CONSTANTS
from glhybrid.load.shapes import box
from glhybrid.scene import Camera, Environment, Image, Instance, Light, Material, Scene, Sphere, Texture
from glhybrid.timing import Timing

if TYPE_CHECKING:
    from glhybrid.context import Context

SIZE = (160, 120)
WHITE = Material(double_sided=True)
SKY = Environment(np.ones((1, 1, 3), np.float32))
FAR = 1e4  # m: without end


def seen(renderer: gh.Renderer, scene: Scene, camera: Camera, ao: str, **parameters: Any) -> Frame:
    aa = parameters.pop("aa", 1)
    dotted = {f"ao.{ao}.{key}": value for key, value in parameters.items()}
    chosen = gh.Settings(aa=aa, exposure=0.0, ao=ao, shadows="none", reflections="none", parameters=dotted)
    names = ("occlusion", "position", "instance_id", "normal_geometric")
    return renderer.render(scene, camera, SIZE, chosen, names)


def by_the_wall(height: float = 1.0) -> tuple[Scene, Camera]:
    """A long wall on a floor; the camera looks down at the floor beside it."""
    scene = scene_of(box(size=(40, 0.2, 40)), box(size=(0.2, height, 40)), materials=(WHITE,), environment=SKY)
    poses = [moved((0, -0.1, 0)), moved((-0.1, height / 2, 0))]
    scene = scene.replace(instances=tuple(Instance(k, p) for k, p in enumerate(poses)))
    return scene, Camera.look_at((1.6, 2.2, 0.5), (1.0, 0, 0), fov_y=0.9)


def beside_wall(x: Any, height: float = 1.0) -> Any:
    """Open share of the floor at x m from an endless wall: half of 1 + sin of the angle to its edge, from the zenith."""
    return 0.5 * (1 + x / np.hypot(x, height))


def floor_of(frame: Frame) -> Any:
    return (frame["instance_id"] == 0) & (np.abs(frame["position"][..., 1]) < 1e-4)


def test_rays_converge_to_the_wall(renderer: gh.Renderer, context: "Context") -> None:
    """Stratified: the error falls faster than as 1 / sqrt(n); binomial at 64 is 0.036 at the most."""
    scene, camera = by_the_wall()
    errors = {}
    for samples in (4, 64):
        frame = seen(renderer, scene, camera, "ray", radius=FAR, samples=samples, denoise=False)
        floor = floor_of(frame)
        off = frame["occlusion"][floor] - beside_wall(frame["position"][floor][:, 0])
        errors[samples] = float(np.abs(off).mean())
        say(f"{samples} rays: mae {errors[samples]:.4f}, bias {off.mean():.5f}")
        assert floor.sum() > 5000 and abs(off.mean()) < 0.002
    assert errors[64] < 0.015 and errors[64] < errors[4] / 5


def test_frames_continue_the_sequence(renderer: gh.Renderer, context: "Context") -> None:
    """Antialiased pictures draw other rays each time: radiance of a white Lambert floor is its open share."""
    scene, camera = by_the_wall()
    flat = scene.replace(materials=(Material(double_sided=True, specular=0.0),))
    errors = []
    for aa in (1, 16):
        frame = seen(renderer, flat, camera, "ray", radius=FAR, samples=4, aa=aa, denoise=False)
        floor = floor_of(frame)
        floor[:, 1:-1] &= floor[:, 2:] & floor[:, :-2]  # pixels at the wall's foot show both
        off = frame["radiance"][floor][:, 0] - beside_wall(frame["position"][floor][:, 0])
        errors.append(float(np.abs(off).mean()))
    say(f"4 rays, 1 and 16 frames: {errors}")
    assert errors[1] < errors[0] / 5


def test_the_filter_leaves_less_error(renderer: gh.Renderer, context: "Context") -> None:
    """Beside the wall, where the truth is known: a tenth of the error of few rays, a quarter of that of many, no bias
    but that of a single ray: it cannot tell what is rarely hidden from what never is."""
    scene, camera = by_the_wall()
    for samples, share, bias in ((1, 0.07, 0.01), (4, 0.08, 0.001), (64, 0.25, 0.001)):
        errors = []
        for denoise in (False, True):
            frame = seen(renderer, scene, camera, "ray", radius=FAR, samples=samples, denoise=denoise)
            floor = floor_of(frame)
            off = frame["occlusion"][floor] - beside_wall(frame["position"][floor][:, 0])
            errors.append(float(np.abs(off).mean()))
        say(f"{samples} rays: mae {errors[0]:.4f}, filtered {errors[1]:.4f}, bias {off.mean():.5f}")
        assert errors[1] < share * errors[0] and abs(off.mean()) < bias
        foot = floor & (frame["position"][..., 0] < 0.1)
        near = frame["occlusion"][foot] - beside_wall(frame["position"][foot][:, 0])
        assert foot.sum() > 200 and abs(near.mean()) < 0.015, near.mean()  # the truth rises by 0.05 over these 10 cm


def streets() -> tuple[Scene, Camera]:
    """Boxes of all sizes, close together, and a ball."""
    rng = np.random.default_rng(2)
    meshes: list[Any] = [box(size=(8, 0.2, 8)), Sphere(0.35)]
    poses = [moved((0, -0.1, 0)), moved((0.2, 0.36, 1.2))]
    for _ in range(14):
        x, z, half, height = *rng.uniform(-1.2, 1.2, 2), rng.uniform(0.05, 0.3), rng.uniform(0.1, 0.8)
        meshes.append(box(size=(2 * half, height, 2 * half)))
        poses.append(moved((x, height / 2, z)))
    scene = scene_of(*meshes, poses=poses, materials=(WHITE,), environment=SKY)
    return scene, Camera.look_at((1.6, 1.8, 2.6), (0, 0.2, 0), fov_y=0.8)


def test_the_filter_among_edges_and_over_frames(renderer: gh.Renderer, context: "Context") -> None:
    """Corners and contacts everywhere: error falls to a fifth, further with the frames of a still view, and stays so when
    the camera moves; what has converged is left alone."""
    scene, camera = streets()
    truth = seen(renderer, scene, camera, "ray", samples=256, denoise=False)["occlusion"].astype(np.float64)

    def error(frame: Frame) -> float:
        return float(np.abs(frame["occlusion"] - truth).mean())

    for samples, share in ((1, 0.13), (4, 0.22), (16, 0.4)):
        raw, got = (error(seen(renderer, scene, camera, "ray", samples=samples, denoise=k)) for k in (False, True))
        say(f"{samples} rays: mae {raw:.4f}, filtered {got:.4f}")
        assert got < share * raw
    assert error(seen(renderer, scene, camera, "ray", samples=256)) < 0.005  # of which 0.003 is in `truth`
    settings = gh.Settings(aa=1, exposure=0.0, ao="ray", shadows="none", reflections="none")

    def film(world: Scene, shown: Camera, count: int) -> list[Any]:
        staged = renderer.stage(world, settings, SIZE)
        staged.aim(settings, shown)
        staged.set(jitter_px=(0, 0), accumulate=0)
        made = []
        for _ in range(count):
            staged.frame(Timing(context.gl.finish, enabled=False))
            made.append(np.array(staged.targets.read("occlusion_rays")[..., 0], np.float64))
        return made

    staged = renderer.stage(scene, settings, SIZE)
    staged.cut()
    errors = [float(np.abs(f - truth).mean()) for f in film(scene, camera, 12)]
    say(f"frames: {[round(e, 4) for e in errors]}")
    assert errors[1] < errors[0] and errors[11] < 0.6 * errors[0]
    # A step aside, and the view of before: history is moved, not smeared.
    aside = Camera.look_at((1.65, 1.8, 2.6), (0.05, 0.2, 0), fov_y=0.8)
    wanted = seen(renderer, scene, aside, "ray", samples=256, denoise=False)["occlusion"]
    moved_on = film(scene, aside, 1)[0]
    assert np.abs(moved_on - wanted).mean() < 1.2 * errors[0]


def test_a_disc_and_a_sphere_overhead(renderer: gh.Renderer, context: "Context") -> None:
    """A sphere of radius r at height h hides (r / h)^2 of the cosine-weighted sky right under it."""
    radius, height = 0.4, 1.0
    scene = scene_of(box(size=(8, 0.2, 8)), Sphere(radius), materials=(WHITE,), environment=SKY)
    poses = [moved((0, -0.1, 0)), moved((0, height, 0))]
    scene = scene.replace(instances=tuple(Instance(k, p) for k, p in enumerate(poses)))
    camera = Camera.look_at((0.9, 0.5, 0.9), (0, 0, 0), fov_y=0.5)
    frame = seen(renderer, scene, camera, "ray", radius=FAR, samples=256)
    d = np.hypot(frame["position"][..., 0], frame["position"][..., 2])
    under = floor_of(frame) & (d < 0.15)
    # A sphere seen at an angle from the zenith, above the horizon: (r / distance)^2 cos.
    distance = np.hypot(d, height)
    want = 1 - (radius / distance) ** 2 * height / distance
    off = (frame["occlusion"] - want)[under]
    say(f"under a sphere: mae {np.abs(off).mean():.4f}, bias {off.mean():.5f}")
    assert under.sum() > 500 and np.abs(off).mean() < 0.01 and abs(off.mean()) < 0.001


def test_rays_end_at_the_radius(renderer: gh.Renderer, context: "Context") -> None:
    """A ceiling just out of reach at the zenith; one in reach hides the cone up to where rays are too short."""
    for height, radius in ((1.0, 0.99), (0.5, 1.0)):
        scene = scene_of(box(size=(40, 0.2, 40)), box(size=(40, 0.2, 40)), materials=(WHITE,), environment=SKY)
        poses = [moved((0, -0.1, 0)), moved((0, height + 0.1, 0))]
        scene = scene.replace(instances=tuple(Instance(k, p) for k, p in enumerate(poses)))
        camera = Camera.look_at((0, 0.4, 0), (0.3, 0, 0))
        frame = seen(renderer, scene, camera, "ray", radius=radius, samples=64)
        floor = floor_of(frame)
        want = 1 - max(0.0, 1 - (height / radius) ** 2)  # sin^2 of the angle at which a ray is just as long
        assert floor.sum() > 1000 and abs(frame["occlusion"][floor].mean() - want) < 0.002


def test_horizons_come_near_the_wall(renderer: gh.Renderer, context: "Context") -> None:
    """Where the whole wall is on the screen, within what slices and steps resolve; the filter leaves little noise."""
    scene, _ = by_the_wall(0.5)
    camera = Camera.look_at((1.5, 3.0, 0), (0.6, 0, 0), fov_y=1.0)
    for parameters, bar in (({}, 0.06), ({"slices": 8, "steps": 32}, 0.045)):
        frame = seen(renderer, scene, camera, "ssao", radius=4.0, **parameters)
        floor = floor_of(frame) & (np.abs(frame["position"][..., 2]) < 0.4) & (frame["position"][..., 0] > 0.05)
        off = (frame["occlusion"] - beside_wall(frame["position"][..., 0], 0.5))[floor]
        say(f"ssao {parameters}: mae {np.abs(off).mean():.4f}, bias {off.mean():.4f}")
        assert floor.sum() > 1000 and np.abs(off).mean() < bar, off.mean()


def test_an_open_plane_is_open(renderer: gh.Renderer, context: "Context") -> None:
    """No false occlusion: seen straight on and at a grazing angle, perspective and orthographic, near and far away."""
    scene = scene_of(box(size=(200, 0.2, 200)), materials=(WHITE,), poses=[moved((0, -0.1, 0))], environment=SKY)
    cameras = [Camera.look_at((0, 2, 0.01), (0, 0, 0)), Camera.look_at((0, 0.4, 9), (0, 0, 0))]
    slanted = Camera.look_at((0, 3, 6), (0, 0, 0)).world_from_view
    cameras.append(Camera("parallel", slanted, fov_y=0.0, ymag=2.0))
    for camera in cameras:
        for ao, least in (("ray", 1 - 1e-6), ("ssao", 0.995)):  # a filter's weights sum to 1 but for rounding
            frame = seen(renderer, scene, camera, ao)
            floor = floor_of(frame) & (np.abs(frame["position"]).max(-1) < 20)
            assert floor.sum() > 1000 and frame["occlusion"][floor].min() >= least, (
                ao,
                frame["occlusion"][floor].min(),
            )


def test_a_closed_box_is_dark(renderer: gh.Renderer, context: "Context") -> None:
    """Not one ray gets out: anything above 0 would be a crack."""
    scene = scene_of(box(size=(2, 2, 2)), materials=(WHITE,), environment=SKY)
    frame = seen(renderer, scene, Camera.look_at((0.3, 0.2, 0.9), (0, 0, 0), fov_y=1.4), "ray", radius=FAR, samples=64)
    assert (frame["instance_id"] == 0).all() and frame["occlusion"].max() == 0


def test_horizons_fail_off_the_screen_and_behind_thin_things(renderer: gh.Renderer, context: "Context") -> None:
    """A wall that is not on the screen occludes nothing; a thin rod before the floor occludes as if it were a wall."""
    scene, _ = by_the_wall()
    off_screen = Camera.look_at((1.0, 2.0, 0), (1.0, 0, 0), up=(0, 0, -1), fov_y=0.5)
    errors = {}
    for ao, more in (("ray", {"samples": 32}), ("ssao", {"slices": 8, "steps": 16})):
        frame = seen(renderer, scene, off_screen, ao, radius=2.0, **more)
        floor = floor_of(frame)
        assert floor.all()
        truth = seen(renderer, scene, off_screen, "ray", radius=2.0, samples=128)["occlusion"]
        errors[f"{ao}, off-screen"] = float(np.abs(frame["occlusion"] - truth)[floor].mean())
    rods = scene_of(box(size=(8, 0.2, 8)), box(size=(0.01, 0.01, 6)), materials=(WHITE,), environment=SKY)
    poses = [moved((0, -0.1, 0)), *(moved((x, 0.4, 0)) for x in np.linspace(-1, 1, 9))]
    rods = rods.replace(instances=tuple(Instance(min(k, 1), p) for k, p in enumerate(poses)))
    above = Camera.look_at((0, 2.2, 0.01), (0, 0, 0), fov_y=0.9)
    for ao, more in (("ray", {"samples": 32}), ("ssao", {"slices": 8, "steps": 16})):
        frame = seen(renderer, rods, above, ao, **more)
        floor = floor_of(frame) & (np.abs(frame["position"]).max(-1) < 1)
        truth = seen(renderer, rods, above, "ray", samples=128)["occlusion"]
        errors[f"{ao}, thin"] = float(np.abs(frame["occlusion"] - truth)[floor].mean())
    say(f"mean error: {errors}")
    assert errors["ssao, off-screen"] > 0.1 and errors["ssao, thin"] > 0.1, errors
    assert errors["ray, off-screen"] < 0.03 and errors["ray, thin"] < 0.04, errors


def test_what_horizons_do_not_know_is_said(renderer: gh.Renderer, context: "Context") -> None:
    """Walks that leave the picture before their radius ends, so near its sides; and radii under a pixel."""
    scene, camera = by_the_wall()
    reasons = {}
    for radius in (0.1, 1e-4):
        chosen = gh.Settings(aa=1, shadows="none", reflections="none", ao="ssao", parameters={"ao.ssao.radius": radius})
        reasons[radius] = renderer.render(scene, camera, (160, 120), chosen, ("reason_ao", "depth"))
    near, tiny = (reasons[r]["reason_ao"] for r in (0.1, 1e-4))
    off = near == CONSTANTS["REASON_OFF_SCREEN"]
    assert off[[0, -1]].mean() > 0.9 and off[:, [0, -1]].mean() > 0.9
    assert not off[30:-30, 40:-40].any() and ((near == 0) | off).all()
    seen_there = np.isfinite(reasons[1e-4]["depth"])
    assert (tiny[seen_there] == CONSTANTS["REASON_SMALL"]).all() and not tiny[~seen_there].any()
    rays = gh.Settings(aa=1, shadows="none", reflections="none", ao="ray")
    assert not renderer.render(scene, camera, (32, 24), rays, ("reason_ao",))["reason_ao"].any()


@pytest.mark.parametrize("primary", ["raster", "trace"])
@pytest.mark.parametrize("levels", [1, 2])
def test_trees_instances_and_cut_outs(renderer: gh.Renderer, context: "Context", primary: str, levels: int) -> None:
    """A sheet whose holes let half the sky through, over a floor, mirrored too; equal however surfaces are found."""
    alpha = np.where(np.indices((8, 8)).sum(0) % 2 == 0, 255, 0)
    texels = np.dstack([np.full((8, 8, 3), 255), alpha]).astype(np.uint8)
    tiled = Texture(Image(texels), nearest=True, uv_transform=np.array([[40.0, 0, 0], [0, 40.0, 0]]))
    holes = Material(alpha_mode="MASK", double_sided=True, textures={"base_color": tiled})
    corners = [[-20, 0, 20], [20, 0, 20], [20, 0, -20], [-20, 0, -20]]
    sheet = piece(corners, [[0, 1, 2], [0, 2, 3]], uv=[(0, 1), (1, 1), (1, 0), (0, 0)])
    scene = scene_of(box(size=(20, 0.2, 20)), sheet, materials=(WHITE, holes), environment=SKY)
    over = moved((0, 2, 0), np.diag([-1.0, 1.0, 1.0]))
    scene = scene.replace(instances=(Instance(0, moved((0, -0.1, 0))), Instance(1, over, materials=(1,))))
    camera = Camera.look_at((0, 1.5, 1), (0, 0, 0))
    settings = gh.Settings(
        aa=1, exposure=0.0, ao="ray", reflections="none", levels=levels, primary=primary,
        parameters={"ao.ray.radius": FAR, "ao.ray.samples": 16},
    )  # fmt: skip
    frame = renderer.render(scene, camera, SIZE, settings, ("occlusion", "instance_id"))
    assert abs(frame["occlusion"][frame["instance_id"] == 0].mean() - 0.5) < 0.01


def test_it_dims_the_diffuse_sky_alone(renderer: gh.Renderer, context: "Context") -> None:
    """Lamps, emission and reflections stay as they are; the occlusion texture's factor is multiplied."""
    scene, camera = by_the_wall()
    lamp = (Light("directional", direction=(-0.3, -0.9, -0.2)),)
    bare = scene.replace(materials=(Material(double_sided=True, emissive=(0.1, 0.2, 0.3)),), lights=lamp)
    for world in (bare, bare.replace(environment=None)):
        pictures = {}
        for ao in ("none", "ray"):
            settings = gh.Settings(aa=1, exposure=0.0, ao=ao, reflections="env")
            pictures[ao] = renderer.render(world, camera, SIZE, settings, ("occlusion", "instance_id"))
        with_sky = world.environment is not None
        dimmed = pictures["none"]["radiance"] - pictures["ray"]["radiance"]
        want = (1 - pictures["ray"]["occlusion"]) * float(with_sky)  # white: c_diff 1, irradiance over pi 1
        hit = pictures["ray"]["instance_id"] != gh.image.NO_ID
        assert np.abs(dimmed - want[..., None])[hit].max() < 2e-6 and (pictures["none"]["occlusion"] == 1).all()
        assert (want[hit].max() > 0.2) == with_sky
        names = {p["name"] for p in pictures["ray"].receipt["passes"]}
        assert ("ray_ao" in names) == with_sky
        skipped = pictures["ray" if not with_sky else "none"].receipt["plan"]["skipped"]
        assert any(line.startswith("ambient occlusion") for line in skipped)


def test_none_costs_nothing(context: "Context") -> None:
    scene, camera = by_the_wall()
    with gh.Renderer(context=context) as fresh:
        frame = fresh.render(scene, camera, (32, 24), gh.Settings(aa=1))
        assert not any("ao" in p.split()[0] or "OCCLUSION" in p for p in frame.receipt["plan"]["programs"])
        assert not {"ssao", "ray_ao"} & set(frame.receipt["plan"]["passes"])
        staged = fresh.stage(scene, gh.Settings(aa=1), (32, 24))
        assert not {"occlusion", "occlusion_rays", "occlusion_raw"} & set(staged.targets._images)
