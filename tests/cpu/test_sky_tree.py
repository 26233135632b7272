"""The quadtree of an environment's light: nothing lost, whatever the size of the map."""

import numpy as np
import pytest

from glhybrid.sky_tree import LEVELS, sky_nodes


def flux(radiance: np.ndarray) -> np.ndarray:
    """Integral over the sphere of texels that are constant over their cell, (3,)."""
    height, width = radiance.shape[:2]
    edge = np.cos(np.arange(height + 1) / height * np.pi)
    return (radiance.astype(np.float64) * ((edge[:-1] - edge[1:]) * 2 * np.pi / width)[:, None, None]).sum((0, 1))


@pytest.mark.parametrize("shape", [(256, 512), (300, 600), (512, 1024), (333, 777)])
def test_every_level_holds_all_light(shape: tuple[int, int]) -> None:
    """Maps as fine as the tree or finer, of sizes that do not divide, with a sun of one texel."""
    radiance = np.random.default_rng(1).uniform(0, 1, (*shape, 3)).astype(np.float32) ** 8
    radiance[shape[0] // 3, shape[1] // 5] = 1e6
    nodes, first = sky_nodes(radiance), 0
    for level in range(LEVELS):
        rows = nodes[first : first + (32 << 2 * level)].astype(np.float64)
        first += len(rows)
        assert np.isclose(rows[:, 3].sum(), 4 * np.pi, rtol=1e-6)
        assert np.allclose((rows[:, :3] * rows[:, 3:4]).sum(0), flux(radiance), rtol=1e-5)
    assert first == len(nodes) and np.isfinite(nodes).all()


def test_centres_follow_the_light() -> None:
    """Unit directions; in an even sky those of light and of area are one, under a sun the first is the sun's."""
    even = sky_nodes(np.full((16, 32, 3), 0.5, np.float32))
    assert np.abs(even[:, 4:7] - even[:, 8:11]).max() < 1e-6 and np.allclose(even[:, :3], 0.5)
    assert np.allclose(np.linalg.norm(even[:, 4:7], axis=1), 1, atol=1e-6)
    sunny = np.full((256, 512, 3), 1e-3, np.float32)
    sunny[40, 256] = 1e6  # just right of the middle: towards -Z
    theta, phi = 40.5 / 256 * np.pi, 0.5 / 512 * 2 * np.pi
    sun = np.array([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)])
    root = sky_nodes(sunny)[:32]
    assert np.allclose(root[root[:, 0].argmax(), 4:7], sun, atol=1e-3)


def test_black_and_tiny_skies() -> None:
    for radiance in (np.zeros((4, 8, 3), np.float32), np.full((1, 1, 3), 2.0, np.float32)):
        nodes = sky_nodes(radiance)
        assert np.isfinite(nodes).all() and np.allclose(nodes[:, :3], radiance[0, 0])
