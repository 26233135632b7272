"""A steady frame, at rest or in motion: nothing is allocated, compiled or read back, and its calls are counted."""

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import moderngl
import numpy as np
import pytest
from rays import moved, scene_of

import glhybrid as gh
from glhybrid import layout
from glhybrid.load.shapes import box, torus
from glhybrid.scene import Animation, Camera, Channel, Environment, Image, Light, Material, Node, Scene, Sphere, Texture
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
    staged.display.image(staged.targets, radiance)


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
    parts = ("reflect_ray", *["reflect_shadow"] * apart, *["reflect_shade"] * (not staged.features.mirror_hits))
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


class Calls:
    """What Python calls in some work: its own functions, and those of C, which are all of OpenGL's and NumPy's."""

    def __init__(self, work: Callable[[], None]) -> None:
        self.python = 0
        self.c: Counter[str] = Counter()
        self.bound: Counter[tuple[str, int]] = Counter()  # (kind of binding, object)

        def note(frame: Any, event: str, argument: Any) -> None:
            if event == "call":
                self.python += 1
            elif event == "c_call":
                name = getattr(argument, "__qualname__", str(argument))
                self.c[name] += 1
                if name.endswith((".bind_to_storage_buffer", ".use", ".bind")):
                    self.bound[name, id(argument.__self__)] += 1

        before = sys.getprofile()
        sys.setprofile(note)
        try:
            work()
        finally:
            sys.setprofile(before)


@pytest.mark.parametrize("objects", [1, 500])
@pytest.mark.parametrize(
    ("kernels", "dispatches", "images", "python", "c"),
    [("fused", 4, 8, 66, 80), ("split", 6, 12, 78, 102), ("joined", 4, 11, 74, 84)],
)
def test_what_a_steady_frame_calls(
    renderer: gh.Renderer, objects: int, kernels: str, dispatches: int, images: int, python: int, c: int
) -> None:
    """As many calls for 500 objects as for one, nothing bound twice, one upload of what has changed. Counts are what it takes, and a tenth:
    Python's own differ a little by version."""
    settings = gh.Settings(primary="trace", levels=2, exposure=0.0, kernels=kernels)
    staged = renderer.stage(crowd(objects), settings, SIZE)
    camera = Camera.look_at((30, 8, 30), (0, 0, 0))
    view = make_view(camera, SIZE, staged.scene, True, staged.bounds)
    off = Timing(renderer.context.gl.finish, enabled=False)

    def at_rest() -> None:
        staged.look(view)
        staged.set(jitter_px=(0, 0), accumulate=0)
        staged.frame(off)

    for _ in range(3):
        at_rest()
    calls = Calls(at_rest)
    assert calls.c["Program.run"] == dispatches and calls.c["Context.memory_barrier"] <= dispatches
    assert calls.c["Buffer.write"] == 0  # the constants are those of the frame before
    blocks = {key: count for key, count in calls.bound.items() if "storage" in key[0]}
    # Where tables are read by texels, programs have no blocks of them.
    wanted = 3 if renderer.context.device.software else 6
    assert len(blocks) == wanted + (kernels == "joined") and sum(blocks.values()) == len(blocks), blocks
    assert sum(calls.bound.values()) - sum(blocks.values()) <= images, calls.bound
    assert calls.python <= 1.1 * python and sum(calls.c.values()) <= 1.1 * c, (calls.python, calls.c)

    one_frame(staged, camera)
    calls = Calls(lambda: one_frame(staged, camera))  # its view made anew, and shown
    assert calls.c["Buffer.write"] == 1
    assert calls.python <= 1.1 * (python + 26) and sum(calls.c.values()) <= 1.1 * (c + 32), (calls.python, calls.c)


@pytest.mark.parametrize("objects", [1, 500])
def test_what_a_frame_in_which_one_moves_calls(renderer: gh.Renderer, objects: int) -> None:
    """As much for 500 objects as for one, within what a tree of more levels takes; its time comes from the settings."""
    scene = crowd(objects)
    way = np.array([[0, 0, 0], [0, 9, 0]], np.float32)
    up = Animation("up", (Channel(0, "translation", "LINEAR", np.array([0, 1], np.float32), way),))
    moving = (replace(scene.instances[0], node=0, world_from_object=np.eye(4)), *scene.instances[1:])
    scene = scene.replace(instances=moving, nodes=(Node("lift", -1),), animations=(up,))
    settings = gh.Settings(primary="trace", levels=2, exposure=0.0, kernels="joined", aa=1, time=0.0)
    off, camera = Timing(renderer.context.gl.finish, enabled=False), Camera.look_at((30, 8, 30), (0, 0, 0))

    def draw(time: float) -> None:
        renderer.draw(scene, camera, SIZE, settings.replace(time=time), (), off)

    for k in (0, 1, 3, 5):
        draw(0.1 * k)
    calls = Calls(lambda: draw(0.41))
    assert calls.c["Buffer.write"] <= 5, calls.c  # a row of instances, and nodes above it
    assert calls.python <= 1.1 * 183 and sum(calls.c.values()) <= 1.1 * 166, (calls.python, calls.c)
    rest = Calls(lambda: draw(0.41))
    assert rest.c["Buffer.write"] == 0, rest.c


def test_others_may_bind_between_frames(renderer: gh.Renderer) -> None:
    """What was bound before a frame is not believed, nor in the turns that a long dispatch gives: windows draw there."""
    context = renderer.context
    staged = renderer.stage(crowd(20), gh.Settings(exposure=0.0, kernels="split"), SIZE)
    camera = Camera.look_at((9, 4, 9), (0, 0, 0))
    junk, spoilt, turns = context.gl.buffer(reserve=1 << 16), context.gl.texture((4, 4), 4, dtype="f4"), 0

    def disturb() -> None:
        nonlocal turns
        turns += 1
        for k in range(8):
            junk.bind_to_storage_buffer(k)
            spoilt.use(k)
            spoilt.bind_to_image(k)

    one_frame(staged, camera)
    want = staged.targets.read("radiance")
    assert np.ptp(want) > 0
    disturb()
    one_frame(staged, camera)
    assert np.array_equal(staged.targets.read("radiance"), want)
    with renderer.shaders.pace.turns(disturb):
        one_frame(staged, camera)
    assert turns > 4 and np.array_equal(staged.targets.read("radiance"), want)
    spoilt.release()
    junk.release()


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
