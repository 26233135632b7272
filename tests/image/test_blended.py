"""What blended, cut-out and transmitting surfaces let through, to the eye and of a sun's light."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from analytic import draw
from scene_kit import constant_sky, floor, matte, metal, plastic, quad, scene, sun

from glhybrid.scene import Camera, Material

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer


def unlit(color: Any, alpha: float = 1.0, **more: Any) -> Material:
    r, g, b = color
    mode = {"alpha_mode": "BLEND"} if alpha < 1 else {}
    return Material("unlit", (r, g, b, alpha), unlit=True, double_sided=True, **(mode | more))


def card(z: float, half: float = 1.0) -> Any:
    return quad([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)])


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
@pytest.mark.parametrize("through", ["camera", "mirror", "reference"])
def test_layers_are_in_order(renderer: "Renderer", order: tuple[int, ...], through: str) -> None:
    """Three blended cards before a wall: the nearest first, in whatever order the file has them."""
    colors = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    alphas = (0.5, 0.25, 0.6)
    layers = [(card(z), unlit(colors[i], alphas[i])) for i, z in enumerate((1.0, 0.5, 0.0))]
    parts = [*(layers[i] for i in order), (card(-1.0, 9), unlit((1.0, 1.0, 1.0)))]
    camera = Camera.look_at((0, 0, 4), (0, 0, 0), fov_y=0.2)
    if through == "mirror":
        parts.append((card(6.0, 9), metal(1.0, 0.0)))
        camera = Camera.look_at((0, 0, 4), (0, 0, 6), fov_y=0.05)
    settings = {"reflections": "reference", "samples": 4096} if through == "reference" else {}
    got = draw(renderer, scene(parts, camera), size=(8, 8), **settings)["radiance"].astype(np.float64)
    want, left = np.zeros(3), 1.0
    for color, alpha in zip(colors, alphas, strict=True):
        want, left = want + left * alpha * np.array(color), left * (1 - alpha)
    want += left
    if through == "reference":  # coverage is drawn at random: 64 pixels of 4096 paths
        assert np.abs(got.mean((0, 1)) - want).max() < 0.005
    else:
        assert np.allclose(got, want, atol=1e-5), (got[4, 4], want)


PANES: dict[str, Any] = {
    "a third there": (matte((1.0, 0.5, 0.2), alpha=0.4, alpha_mode="BLEND"), 0.6),
    "opaque": (matte((1.0, 0.5, 0.2)), 0.0),
    "cut out": (matte((1.0, 0.5, 0.2), alpha=0.4, alpha_mode="MASK"), 1.0),
    "stained": (matte((1.0, 0.5, 0.2), transmission=0.8), np.array([0.8, 0.4, 0.16])),
    "glass": (plastic((1.0, 0.9, 0.8), 0.0, transmission=1.0), np.array([1.0, 0.9, 0.8]) * 0.96),
    "metal": (metal((1.0, 0.9, 0.8), 0.3, transmission=1.0), 0.0),
    "coated glass": (plastic((1.0, 0.9, 0.8), 0.0, transmission=1.0, clearcoat=0.5), np.array([1.0, 0.9, 0.8]) * 0.96 * 0.98),
    "half glass": (plastic((1.0, 0.9, 0.8), 0.0, transmission=1.0, alpha=0.5, alpha_mode="BLEND"),
                   0.5 + 0.5 * 0.96 * np.array([1.0, 0.9, 0.8])),
}  # fmt: skip


@pytest.mark.parametrize("name", PANES)
@pytest.mark.parametrize("reflections", ["none", "reference"])
def test_shadows_of_panes(renderer: "Renderer", name: str, reflections: str) -> None:
    """What a pane lets through of the sun, once and twice: coverage, tint, Fresnel; the same in hybrid and reference."""
    pane, tint = PANES[name]
    for count in (1, 2):
        panes = [(floor(0.8, 1.0 + 0.1 * k), pane) for k in range(count)]
        # The camera looks in under the panes.
        camera = Camera.look_at((0, 0.5, 3), (0, 0, 0), fov_y=0.3)
        world = scene([(floor(), matte(0.8)), *panes], camera, lights=[sun((0, -1, 0), np.pi)])
        frame = draw(renderer, world, "position", reflections=reflections, samples=1, bounces=0, size=(32, 24))
        p = frame["position"]
        bottom = p.any(-1) & (np.abs(p[..., 1]) < 0.01)
        under = (np.abs(p[..., 0]) < 0.78) & (np.abs(p[..., 2]) < 0.78) & bottom
        away = ((np.abs(p[..., 0]) > 0.82) | (np.abs(p[..., 2]) > 0.82)) & bottom
        assert under.sum() > 50 and away.sum() > 50
        want = 0.8 * np.broadcast_to(tint, 3) ** count
        assert np.allclose(frame["radiance"][under], want, atol=1e-3), (count, frame["radiance"][under][0], want)
        assert np.allclose(frame["radiance"][away], 0.8, atol=1e-5)


@pytest.mark.parametrize("mu", [1.0, 0.5, 0.2])
def test_glass_neither_takes_nor_gives(renderer: "Renderer", mu: float) -> None:
    """A white pane in a sky of 1, smooth and thin: what it reflects and what it lets through add up to 1 at any angle."""
    glass = plastic((1.0, 1.0, 1.0), 0.0, transmission=1.0, ior=1.8)
    toward = np.array([0, mu, np.sqrt(1 - mu**2)])
    pose = Camera.look_at(tuple(5 * toward), (0, 0, 0), (0, 0, -1)).world_from_view
    world = scene([(floor(9.0), glass)], Camera("ortho", pose, fov_y=0, ymag=0.5), environment=constant_sky(1.0))
    assert np.abs(draw(renderer, world, size=(8, 8))["radiance"] - 1).max() < 1e-5
    exact = draw(renderer, world, size=(16, 16), reflections="reference", samples=256)["radiance"]
    assert np.abs(exact - 1).max() < 1e-5, "each path ends in the same sky, whichever way it went"
