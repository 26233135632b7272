"""What could only be drawn wrong is refused, by the thing, its value and the limit; what shows nothing is said."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rays import scene_of
from shadow_scenes import WHITE

import glhybrid as gh
from glhybrid.errors import DeviceError, SettingError
from glhybrid.load.shapes import box
from glhybrid.scene import Camera, Environment, Instance, Light, Mesh, Node, Probe, Scene, Skin, Sphere

if TYPE_CHECKING:
    from glhybrid.context import Context

NAN, INF = float("nan"), float("inf")
SIZE = (32, 24)
SETTINGS = gh.Settings(shadows="none", reflections="none", aa=1)


def made() -> Scene:
    sky = Environment(np.full((4, 8, 3), 0.5, np.float32))
    scene = scene_of(box(size=(1, 1, 1)), materials=(WHITE,)).replace(environment=sky)
    return scene.replace(lights=(Light("point", position=(0, 3, 0)),), cameras=(Camera.look_at((2, 2, 3), (0, 0, 0)),))


def refused(renderer: gh.Renderer, scene: Scene, camera: Any, *says: str) -> None:
    with pytest.raises(SettingError) as error:
        renderer.render(scene, camera, SIZE, SETTINGS)
    for word in says:
        assert word in str(error.value), str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("camera", "word"),
    [
        ("eye=1e30,0,0;target=0,0,0", "at most 1e+12"), ("eye=1e8,0,0;target=0,0,0", "go nearer than"),
        ("eye=2,2,3;target=0,0,0;fov=1e-9", "at least"), ("eye=2,2,3;target=0,0,0;fov=179.9999", "at most 179"),
        ("eye=2,2,3;target=0,0,0;height=1e-30", "take more"), ("eye=2,2,3;target=0,0,0;height=1e30", "half extents"),
    ],
)  # fmt: skip
def test_cameras_beyond_what_rays_bear(context: "Context", renderer: gh.Renderer, camera: str, word: str) -> None:
    refused(renderer, made(), camera, "camera", word)


@pytest.mark.parametrize(
    "changes",
    [
        {"world_from_view": np.full((4, 4), NAN)}, {"world_from_view": np.zeros((4, 4))}, {"world_from_view": np.eye(3)},
        {"world_from_view": np.diag([2.0, 2, 2, 1])}, {"fov_y": NAN}, {"fov_y": 4.0}, {"near": 0.0}, {"near": NAN},
        {"far": 0.001}, {"fov_y": 0.0, "ymag": 0.0}, {"fov_y": 0.0, "ymag": NAN},
    ],
)  # fmt: skip
def test_cameras_that_are_none(context: "Context", renderer: gh.Renderer, changes: dict[str, Any]) -> None:
    scene = made()
    refused(renderer, scene, replace(scene.cameras[0], **changes), 'camera "main"')


@pytest.mark.parametrize(
    ("camera", "word"),
    [
        ("eye=1e5,0,0;target=0,0,0", "smaller than a pixel"),
        ("eye=2,2,3;target=0,0,0;near=1e9", "behind the whole scene"),
    ],
)
def test_pictures_of_nothing_are_said(context: "Context", renderer: gh.Renderer, camera: str, word: str) -> None:
    said = renderer.render(made(), camera, SIZE, SETTINGS).receipt["scene"]["warnings"]
    assert any(word in sentence for sentence in said), said
    assert renderer.render(made(), 0, SIZE, SETTINGS).receipt["scene"]["warnings"] == []


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("light", {"kind": "banana"}), ("light", {"intensity": 1e38}), ("light", {"intensity": NAN}),
        ("light", {"intensity": -1.0}), ("light", {"color": (INF, 0, 0)}), ("light", {"position": (1e30, 0, 0)}),
        ("light", {"radius": -1.0}), ("light", {"range": NAN}), ("light", {"kind": "directional", "direction": (0, 0, 0)}),
        ("light", {"angular_diameter": 7.0}), ("material", {"roughness": -1.0}), ("material", {"roughness": 7.0}),
        ("material", {"metallic": NAN}), ("material", {"base_color": (NAN, 0, 0, 1)}), ("material", {"emissive": (1e38, 0, 0)}),
        ("material", {"alpha_mode": "FOO"}), ("material", {"ior": 0.5}), ("material", {"clearcoat": 50.0}),
        ("material", {"transmission": NAN}), ("environment", {"intensity": 1e38}), ("environment", {"rotation": NAN}),
        ("environment", {"radiance": np.full((4, 8, 3), NAN, np.float32)}),
        ("environment", {"radiance": np.full((1, 1, 3), -1, np.float32)}), ("environment", {"radiance": np.ones((4, 8))}),
        ("environment", {"radiance": np.ones((0, 0, 3))}), ("instance", {"mesh": 9}), ("instance", {"mesh": -1}),
        ("instance", {"materials": (9,)}), ("instance", {"materials": (0, 0)}), ("instance", {"world_from_object": np.eye(3)}),
    ],
)  # fmt: skip
def test_numbers_that_are_none(context: "Context", renderer: gh.Renderer, what: str, changes: dict[str, Any]) -> None:
    scene = made()
    if what == "environment":
        assert scene.environment is not None
        bad = scene.replace(environment=replace(scene.environment, **changes))
    else:
        bad = scene.replace(**{f"{what}s": (replace(getattr(scene, f"{what}s")[0], **changes),)})
    refused(renderer, bad, 0, what, list(changes)[-1].replace("radiance", ""))


AFAR, SHEARED = np.eye(4), np.eye(4)
AFAR[:3, 3], SHEARED[3] = (0, 1e20, 0), (0, 0, 0.5, 1)
MOVED = np.eye(4)
MOVED[:3, 3] = 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"instances": (Instance(0, AFAR, "far"),)}, ('instance 0 "far"', "1e+20", "at most 1e+12 m")),
        ({"instances": (Instance(0, np.eye(4)), Instance(0, AFAR, "far"))}, ('instance 1 "far"', "at most 1e+12 m")),
        ({"instances": (Instance(0, SHEARED, "odd"),)}, ('instance 0 "odd"', "last row is [0.0, 0.0, 0.5, 1.0]")),
        ({"instances": (Instance(0, np.diag([1.0, 1, 1, 2]), "odd"),)}, ("last row", "must be [0, 0, 0, 1]")),
        ({"instances": (Instance(0, MOVED.T, "odd"),)}, ('instance 0 "odd"', "it is transposed")),
        ({"nodes": (Node("root", -1, matrix=SHEARED),)}, ('node "root": matrix', "last row")),
        ({"nodes": (Node("root", -1, matrix=np.eye(3)),)}, ('node "root"', "not (4, 4)")),
        ({"nodes": (Node("root", -1),), "skins": (Skin((0,), SHEARED[None], "s"),)}, ('skin 0 "s": inverse_bind[0]', "last row")),
        ({"nodes": (Node("root", -1),), "skins": (Skin((0,), np.eye(4), "s"),)}, ('skin 0 "s"', "not (1, 4, 4)")),
    ],
)  # fmt: skip
def test_matrices(context: "Context", renderer: gh.Renderer, changes: dict[str, Any], words: tuple[str, ...]) -> None:
    refused(renderer, made().replace(**changes), 0, *words)


@pytest.mark.parametrize("size", [(3.5, 2), ("a", 2), (5,), None, "64x48", (1, 2, 3)])
def test_sizes(renderer: gh.Renderer, size: Any) -> None:
    with pytest.raises(SettingError, match="two whole numbers"):
        renderer.render(made(), 0, size, SETTINGS)


def test_shapes_and_probes(context: "Context", renderer: gh.Renderer) -> None:
    scene = made()
    refused(renderer, scene.replace(meshes=(Mesh("ball", (Sphere(-1.0),)),)), 0, '"ball"', "radius")
    refused(renderer, scene.replace(probes=(Probe((0, 2, 0), (1, 1, 1), (-1, -1, -1)),)), 0, "probe 0", "in the box")


def test_a_closed_renderer_says_so(context: "Context") -> None:
    with gh.Renderer(context=context) as renderer:
        renderer.render(made(), 0, SIZE, SETTINGS)
        shots = renderer.frames(made(), [gh.Shot(), gh.Shot()], SIZE, SETTINGS)
    for use in (lambda: renderer.render(made(), 0, SIZE, SETTINGS), lambda: next(shots)):
        with pytest.raises(DeviceError, match="this Renderer is closed"):
            use()
    renderer.close()
