"""A steady frame, at rest or in motion: nothing is allocated, compiled or read back, and its calls are counted."""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import moderngl
import numpy as np
import pytest
from rays import moved, scene_of

import glhybrid as gh
from glhybrid import layout
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Camera, Environment, Image, Light, Material, Scene, Sphere, Texture
from glhybrid.shaders import Program
from glhybrid.timing import Timing
from glhybrid.view import make_view

if TYPE_CHECKING:
    from glhybrid.context import Context
    from glhybrid.staged import Staged

SIZE = (40, 24)
MAKERS = (
    "buffer", "texture", "texture_array", "texture3d", "texture_cube", "depth_texture", "renderbuffer", "framebuffer",
    "simple_framebuffer", "vertex_array", "simple_vertex_array", "program", "compute_shader", "query", "sampler",
)  # fmt: skip
READERS = {moderngl.Buffer: ("read", "read_into"), moderngl.Texture: ("read", "read_into"),
           moderngl.TextureArray: ("read", "read_into"), moderngl.Framebuffer: ("read", "read_into")}  # fmt: skip
SUN = Light("directional", direction=(-0.4, -0.8, -0.4))


def crowd(count: int, lights: int = 1) -> Scene:
    """Instances of three shapes, so that there are two levels of trees, each shape drawn often."""
    rng = np.random.default_rng(3)
    shapes = (box(), torus(segments=12, sides=6), Sphere(0.5))
    one = scene_of(*shapes, materials=(Material(roughness=0.2),))
    made = [one.instances[i % 3] for i in range(count)]
    poses = [moved(rng.uniform(-20, 20, 3)) for _ in range(count)]
    instances = tuple(
        type(i)(i.mesh, pose, f"{n}", i.materials) for n, (i, pose) in enumerate(zip(made, poses, strict=True))
    )
    lamps = tuple(Light("point", position=(float(k), 9.0, 0.0), intensity=50.0) for k in range(lights - 1))
    sky = Environment(np.full((1, 1, 3), 0.3, np.float32))
    return one.replace(instances=instances, lights=(SUN, *lamps), environment=sky)


def forbid(monkeypatch: pytest.MonkeyPatch, context: "Context") -> None:
    """Whatever would allocate, compile or read back fails from here on."""

    def refuse(what: str) -> Any:
        def call(*_: Any, **__: Any) -> None:
            raise AssertionError(f"a steady frame called {what}")

        return call

    for name in MAKERS:
        monkeypatch.setattr(moderngl.Context, name, refuse(name))
    for kind, names in READERS.items():
        for name in names:
            monkeypatch.setattr(kind, name, refuse(f"{kind.__name__}.{name}"))
    for name in ("glGenTextures", "glGenQueries", "glTexBuffer", "glGetInteger64v"):
        monkeypatch.setattr(context.raw, name, refuse(name))
    monkeypatch.setattr(type(context.gl), "finish", refuse("finish"))


def one_frame(staged: "Staged", camera: Camera) -> None:
    staged.look(make_view(camera, SIZE, staged.scene, staged.context.limits.clip_control, staged.bounds))
    staged.set(jitter_px=(0, 0), accumulate=0)
    radiance = staged.frame(Timing(staged.context.gl.finish, enabled=False))
    staged.display.run(staged.targets, radiance)


@pytest.fixture
def renderer(context: "Context") -> Iterator[gh.Renderer]:
    with gh.Renderer(context=context) as made:
        yield made


@pytest.mark.parametrize(
    ("objects", "lights", "primary", "shadows"),
    [(1, 1, "raster", "ray"), (500, 1, "trace", "ray"), (20, 20, "raster", "ray"), (500, 1, "raster", "csm")],
)
def test_nothing_is_made_or_read_in_a_frame(
    renderer: gh.Renderer, monkeypatch: pytest.MonkeyPatch, objects: int, lights: int, primary: str, shadows: str
) -> None:
    scene = crowd(objects, lights)
    staged = renderer.stage(scene, gh.Settings(primary=primary, shadows=shadows), SIZE)
    eyes = [(30 + 3.0 * k, 8 - k, 30) for k in range(8)]  # far enough to rebase the world several times
    cameras = [Camera.look_at(eye, (0, 0, 0)) for eye in eyes]
    one_frame(staged, cameras[0])
    calls: Counter[str] = Counter()
    dispatch = Program.dispatch

    def counted(program: Program, *given: Any, **named: Any) -> None:
        calls[program.name.split()[0]] += 1
        dispatch(program, *given, **named)

    with monkeypatch.context() as patch:
        forbid(patch, renderer.context)
        patch.setattr(Program, "dispatch", counted)
        for camera in (cameras[0], *cameras):
            one_frame(staged, camera)
    frames = len(cameras) + 1
    apart = staged.features.shadow_bits and not staged.features.mirror_shadows
    parts = ("reflect_ray", *["reflect_shadow"] * apart, "reflect_shade")
    reflect = parts if staged.plan.split else ("reflect",)
    expected = dict.fromkeys(reflect, 1) | {
        "composite": 1,
        "exposure": 1,
        "display": 1,
        "gbuffer": int(primary == "trace"),
    }
    expected |= {"shadow": -(-lights // 8)} if shadows == "ray" else {"shadow_map": 1}
    assert calls == Counter({name: count * frames for name, count in expected.items()})
    renderer.context.gl.finish()


def test_a_rebased_world_has_the_matrices_of_its_poses(renderer: gh.Renderer) -> None:
    """Only translations are computed again when the origin moves: they must be what inverting all would give."""
    scene = crowd(50)
    turn = np.array([[0.6, 0, 0.8, 3], [0, -2, 0, 4], [-0.8, 0, 0.6, 5], [0, 0, 0, 1.0]])
    scene = scene.replace(
        instances=tuple(type(i)(0, turn @ i.world_from_object, i.name, (0,)) for i in scene.instances)
    )
    staged = renderer.stage(scene, gh.Settings(), SIZE)
    for eye in ((3, 1, 2), (300, -7, 50), (3, 1, 2)):
        view = make_view(Camera.look_at(eye, (0, 0, 0)), SIZE, scene, True, staged.bounds)
        staged.look(view)
        rows = np.frombuffer(staged.upload.resources["Instances"].read(), layout.dtype("Instance"))
        poses = np.array([i.world_from_object for i in scene.instances])
        poses[:, :3, 3] -= view.origin
        inverse = np.linalg.inv(poses)
        for name, want in (("world_from_object", poses), ("object_from_world", inverse)):
            got = rows[name][:, :, :3].swapaxes(1, 2)
            assert np.allclose(got, want[:, :3], rtol=3e-7, atol=1e-6), name


def test_buffers_keep_to_themselves_on_mesa(renderer: gh.Renderer) -> None:
    """Mesa compiles a program again where a buffer's slot holds the sampler state of another program's texture.

    Slots are counted in the order of declaration: the buffers' array comes first, whole, in every program that has
    samplers at all; so no texture ever stands in a slot where another program has a buffer.
    """
    if not renderer.context.device.software:
        pytest.skip("about Mesa's software renderer only")
    from glhybrid.shaders import _SAMPLER_TYPES, BUFFERS

    rng = np.random.default_rng(0)
    checker = Texture(Image(rng.integers(0, 255, (8, 8, 4)).astype(np.uint8)))
    scene = crowd(9).replace(environment=Environment(rng.uniform(0, 1, (8, 16, 3)).astype(np.float32)))
    scene = scene.replace(materials=(Material(roughness=0.2, textures={"base_color": checker}),))
    staged = renderer.stage(scene, gh.Settings(primary="trace"), SIZE)
    one_frame(staged, Camera.look_at((9, 9, 9), (0, 0, 0)))
    seen = 0
    for program in renderer.shaders._programs.values():
        uniforms = [program.program[name] for name in program.program]
        samplers = [u for u in uniforms if getattr(u, "gl_type", None) in _SAMPLER_TYPES]
        if not samplers:
            continue
        first = min(samplers, key=lambda u: u.location)
        assert (first.name, first.array_length) == ("buffers", len(BUFFERS)), (program.name, first.name)
        seen += len(samplers) > 1
    assert seen >= 3  # shadow, reflect and composite read textures too
