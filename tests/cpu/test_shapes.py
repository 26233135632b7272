"""Shapes: closed where they should be, outside out, with unit normals, and tangents that follow the UVs."""

import numpy as np
import pytest

from glhybrid.errors import LoadError
from glhybrid.load import patterns, shapes
from glhybrid.scene import Sphere, Triangles

CLOSED = {
    "box": ({}, 1.0, 1e-6),
    "box bevel": ({"size": (1, 2, 3), "bevel": 0.1}, 5.9487, 1e-3),
    "box round": ({"bevel": 0.5, "segments": 16}, np.pi / 6, 2e-3),
    "sphere": ({"radius": 2.0, "segments": 128}, 4 / 3 * np.pi * 8, 1e-1),
    "ellipsoid": ({"radii": (1, 2, 3)}, 4 / 3 * np.pi * 6, 0.15),
    "cylinder": ({"segments": 256}, np.pi / 4, 1e-3),
    "cylinder bevel": ({"bevel": 0.5, "segments": 128}, np.pi / 6, 1e-2),
    "torus": ({}, 2 * np.pi**2 * 0.5 * 0.15**2, 1e-2),
    "knot": ({"turns": 3, "loops": 7, "tube": 0.02}, None, None),
    "revolve": ({"segments": 256}, np.pi * 0.25 / 3, 1e-3),
    "arch": ({"segments": 128}, 4 * 5 * 0.6 - 0.6 * (2.4 * 2.8 + np.pi * 1.2**2 / 2), 1e-3),
    "arch low": ({"opening": (2.4, 1.2)}, None, None),
}
OPEN = {
    "plane": {},
    "grid": {"height": "flat"},
    "grid waves": {"height": "waves"},
    "grid hills": {"height": "hills"},
    "grid steps": {"height": "steps"},
    "column": {},
    "column plain": {"flutes": 0},
    "arch moulding": {"moulding": 0.2},
    "cloth": {},
    "facade": {},
    "facade mullions": {"mullions": 3, "bays": (2, 5)},
}


def make(case: str, **given: object) -> Triangles:
    made = shapes.shape(case.split()[0], **given)
    assert isinstance(made, Triangles)
    return made


def every_case() -> list[object]:
    return [pytest.param(c, p, id=c) for c, p in [(c, v[0]) for c, v in CLOSED.items()] + list(OPEN.items())]


@pytest.mark.parametrize("case", CLOSED)
def test_closed_bodies_have_every_edge_twice_and_the_right_volume(case: str) -> None:
    given, volume, tolerance = CLOSED[case]
    body = make(case, **given)
    place = np.unique(body.position, axis=0, return_inverse=True)[1].ravel()[body.index].astype(np.int64)
    edges = np.concatenate([place[:, [0, 1]], place[:, [1, 2]], place[:, [2, 0]]])
    there = edges[:, 0] * (place.max() + 1) + edges[:, 1]
    back = edges[:, 1] * (place.max() + 1) + edges[:, 0]
    assert len(np.unique(there)) == len(there), "an edge runs twice the same way"
    assert np.array_equal(np.sort(there), np.sort(back)), "an edge has no partner: the body is open"
    p = body.position[body.index].astype(np.float64)
    found = np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6
    assert found > 0
    if volume is not None:
        assert found == pytest.approx(volume, abs=tolerance)


@pytest.mark.parametrize(("case", "given"), every_case())
def test_frames(case: str, given: dict[str, object]) -> None:
    body = make(case, **given)
    assert body.uv0 is not None and body.tangent is not None
    assert body.position.dtype == body.normal.dtype == body.uv0.dtype == body.tangent.dtype == np.float32
    assert body.index.dtype == np.uint32 and body.index.max() < len(body.position)
    assert all(np.isfinite(a).all() for a in (body.position, body.normal, body.uv0, body.tangent))
    assert np.abs(np.linalg.norm(body.normal, axis=1) - 1).max() < 1e-5
    assert np.abs(np.linalg.norm(body.tangent[:, :3], axis=1) - 1).max() < 1e-5
    assert np.abs((body.normal * body.tangent[:, :3]).sum(1)).max() < 1e-5
    assert (body.tangent[:, 3] == 1).all()
    p, uv = body.position[body.index].astype(float), body.uv0[body.index].astype(float)
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    area = np.linalg.norm(face, axis=1)
    assert area.min() > 0, "a triangle without area"
    facing = np.einsum("ij,ikj->ik", face / area[:, None], body.normal[body.index])
    assert facing.min() > 0.3, "a normal on the wrong side of its triangle"
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    turn = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    usable = np.abs(turn) > 1e-9
    assert (turn[usable] < 0).all(), "UVs mirrored: v must run down as seen from the front"
    along_u = ((p[:, 1] - p[:, 0]) * b[:, 1:] - (p[:, 2] - p[:, 0]) * a[:, 1:])[usable] / turn[usable, None]
    along_u /= np.linalg.norm(along_u, axis=1, keepdims=True)
    tangent = body.tangent[body.index][usable][..., :3].mean(1)
    assert np.median((along_u * tangent).sum(1)) > 0.9
    assert case == "column" or (body.uv0.min() > -1e-6 and body.uv0.max() < 1 + 1e-6)


def test_analytic_sphere_and_exact_normals() -> None:
    assert shapes.shape("sphere", radius=2.0).radius == 2.0  # type: ignore[union-attr]
    assert isinstance(shapes.shape("sphere"), Sphere)
    ball = make("sphere", radius=2.0, segments=32)
    assert np.abs(ball.position / 2 - ball.normal).max() < 1e-6


def test_sizes() -> None:
    for name, given, size in (
        ("box", {"size": (1, 2, 3)}, (1, 2, 3)),
        ("plane", {"size": (4, 6)}, (4, 0, 6)),
        ("cylinder", {"radius": 2, "height": 5, "segments": 64}, (4, 5, 4)),
        ("torus", {"radius": 2, "tube": 0.5}, (5, 1, 5)),
        ("grid", {"size": (3, 5), "height": "waves", "amplitude": 0.25}, (3, None, 5)),
        ("facade", {"size": (10, 20, 30)}, (10, 20, 30)),
        ("column", {"height": 7}, (None, 7, None)),
    ):
        made = make(name, **given)
        for axis, length in enumerate(size):
            if length is not None:
                assert np.ptp(made.position[:, axis]) == pytest.approx(length, rel=1e-4), (name, axis)


def test_blades_are_a_fan_from_the_origin() -> None:
    """Each `ratio` times the one before, as large as seen from the origin, and none over another's middle."""
    p = make("blades").position.reshape(-1, 3, 3).astype(np.float64)
    assert len(p) == 240 and np.allclose(p[1:, :, 1] / p[:-1, :, 1], 1.224) and 1e-11 < p[0, 0, 1] < 1e-10
    rim = p[:, 1:].mean(1) / p[:, :1, 1]
    turn = np.sort(np.arctan2(rim[:, 2], rim[:, 0]))
    assert np.diff(turn).min() > 0.01 and np.diff(turn).max() < 0.06
    assert np.isfinite(make("blades").normal).all()


def test_debris_is_nothing_that_can_be_seen() -> None:
    from glhybrid.pieces import solid

    made = make("debris", number=400, size=2.0)
    corners = made.position.reshape(-1, 3, 3)
    assert np.isnan(corners).any((1, 2)).sum() == 100 and np.isinf(corners).any((1, 2)).sum() == 100
    assert not solid(made.position, made.index).any() and np.isfinite(made.normal).all()


def test_grid_heights() -> None:
    waves = make("grid", height="waves", amplitude=0.25)
    assert 0.2 < np.abs(waves.position[:, 1]).max() <= 0.2501
    hills = make("grid", height="hills", amplitude=2.0)
    assert hills.position[:, 1].min() >= 0 and hills.position[:, 1].max() == pytest.approx(2, abs=1e-5)
    stair = make("grid", height="steps", amplitude=0.2, wavelength=2.0, size=(4, 10))
    levels = np.unique(stair.position[:, 1])
    assert np.allclose(levels, 0.2 * np.arange(5), atol=1e-6)
    assert np.abs(np.abs(stair.normal).max(1) - 1).max() < 1e-6  # flat treads and risers
    assert not np.array_equal(waves.position, make("grid", height="waves", amplitude=0.25, seed=2).position)
    assert np.array_equal(waves.position, make("grid", height="waves", amplitude=0.25).position)


@pytest.mark.parametrize(
    ("name", "given", "says"),
    [
        ("sphere", {"radius": -1.0}, "radius = -1: must be greater than 0"),
        ("box", {"size": (1, 0, 1)}, "size = [1, 0, 1]: must be greater than 0"),
        ("box", {"bevel": 0.6}, "half the smallest side (0.5)"),
        ("cylinder", {"segments": 2}, "must be between 3 and 4096"),
        ("torus", {"tube": 0.6}, "must not be greater than radius (0.5)"),
        ("knot", {"turns": 2, "loops": 4}, "no divisor in common"),
        ("grid", {"cells": (0, 4)}, "cells"),
        ("grid", {"cells": (4000, 4000)}, "4,000,000"),
        ("grid", {"height": "wave"}, 'did you mean "waves"?'),
        ("grid", {"height": "steps", "wavelength": 1e-4}, "must be at least"),
        ("arch", {"opening": (4.0, 4.5)}, "its width must be less than the wall's"),
        ("arch", {"opening": (2.0, 0.5)}, "its height must be between"),
        ("column", {"height": 1.0}, "at least 6 times the radius"),
        ("facade", {"frame": 2.0}, "less than half a window"),
        ("blades", {"ratio": 1.0}, "must be greater than 1"),
        ("blades", {"number": 400, "ratio": 2.0}, "would span 1e-60 to 1e60 m; at most 1e11"),
        ("debris", {"size": 0.0}, "must be greater than 0"),
        ("revolve", {"profile": [[1, 2, 3]]}, "pairs [radius, y]"),
        ("revolve", {"profile": [[1, 2], "x"]}, "pairs [radius, y]"),
        ("revolve", {"profile": [[-1, 2], [1, 0]]}, "must not be negative"),
        ("bax", {}, 'did you mean "box"?'),
        ("box", {"sise": 1}, 'did you mean "size"?'),
    ],
)
def test_refusals(name: str, given: dict[str, object], says: str) -> None:
    with pytest.raises(LoadError, match=r".") as caught:
        shapes.shape(name, **given)
    assert says in str(caught.value)


@pytest.mark.parametrize("name", patterns.PATTERNS)
def test_patterns_repeat_without_a_seam(name: str) -> None:
    image = patterns.pattern(name, "roughness", texels=(512, 512)).texels
    assert image.shape == (512, 512, 4) and image.dtype == np.uint8
    grey = image[..., 1].astype(float)
    assert grey.std() > 3, "nothing to see"
    for axis in (0, 1):
        inside = np.abs(np.diff(grey, axis=axis)).mean((0, 1))
        seam = np.abs(np.take(grey, 0, axis) - np.take(grey, -1, axis)).mean()
        assert seam <= inside * 4 + 12 or name in ("checker", "tiles", "lattice")  # those end at an edge of theirs


def test_pattern_colours_and_normals() -> None:
    half = {"low": (0.5, 0.5, 0.5, 0.25), "high": (0.5, 0.5, 0.5, 0.25)}
    assert (patterns.pattern("checker", "base_color", **half).texels == (188, 188, 188, 64)).all()  # sRGB of 0.5
    assert (patterns.pattern("checker", "metallic_roughness", **half).texels[..., :3] == 128).all()
    normal = patterns.pattern("noise", "normal").texels[..., :3] / 127.5 - 1
    assert np.abs(np.linalg.norm(normal, axis=-1) - 1).max() < 0.02 and (normal[..., 2] > 0).all()
    with pytest.raises(LoadError, match="texels"):
        patterns.pattern("noise", texels=(0, 5))
    with pytest.raises(LoadError, match="half the texels"):
        patterns.pattern("checker", cells=(40, 8), texels=(64, 64))
    with pytest.raises(LoadError, match="must be between 0 and 1"):
        patterns.pattern("noise", low=(2.0, 0, 0, 1))
