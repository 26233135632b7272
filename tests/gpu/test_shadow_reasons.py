"""AOV reason_shadows: where a map's share of a light is no more than a guess, and nowhere else."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from shadow_scenes import S1, half_plane, posts, seen, settings

import glhybrid as gh
from glhybrid import content_cache
from glhybrid.layout import CONSTANTS

if TYPE_CHECKING:
    from glhybrid.context import Context


@pytest.mark.parametrize(("technique", "told"), [("map", 0.95), ("pcf", 0.95), ("csm", 0.4)])
def test_a_coarse_border_of_depth_maps_is_said(
    renderer: gh.Renderer, context: "Context", technique: str, told: float
) -> None:
    """Where texels are larger than pixels nearly all that is wrong has a reason, and little else; else nothing has.

    csm: half of its few wrong pixels lie where texels are as fine as pixels.
    """
    scene, camera, _ = posts()
    right = seen(renderer, scene, camera, S1, "ray")["visibility"][..., 0] > 0.5

    def reasons(resolution: int) -> tuple[Any, Any]:
        chosen = settings(technique, resolution=resolution)
        frame = renderer.render(scene, camera, S1, chosen, ("visibility", "reason_shadows"))
        return frame["reason_shadows"], (frame["visibility"][..., 0] > 0.5) != right

    code, wrong = reasons(512)
    coarse = code == CONSTANTS["REASON_COARSE"]
    assert ((code == 0) | coarse).all() and wrong.sum() > 200
    assert coarse[wrong].mean() > told and coarse.mean() < 0.12, (coarse[wrong].mean(), coarse.mean())
    assert not reasons(4096)[0].any()
    for other in ("none", "ray"):
        frame = renderer.render(scene, camera, (64, 48), settings(other), ("reason_shadows",))
        assert not frame["reason_shadows"].any()


def test_a_cut_search_is_said(renderer: gh.Renderer, context: "Context") -> None:
    """In the penumbra alone, and only where the light is wider than what is searched."""
    scene, camera = half_plane(4.0, 0.05)
    for search, cut in ((4.0, True), (64.0, False)):
        chosen = settings("pcss", search=search, resolution=512)
        frame = renderer.render(scene, camera, (64, 16), chosen, ("visibility", "reason_shadows"))
        penumbra = (frame["visibility"][..., 0] > 0) & (frame["visibility"][..., 0] < 1)
        assert penumbra.any()
        assert ((frame["reason_shadows"] == CONSTANTS["REASON_SEARCH"]) == (penumbra & cut)).all()


def test_a_coarse_border_of_light_maps_is_said(
    renderer: gh.Renderer, context: "Context", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where texels are larger than pixels, and nowhere else."""
    monkeypatch.setattr(content_cache, "cache_dir", lambda: tmp_path)
    scene, camera, _ = posts()
    for texels, size, some in ((4, (320, 240), True), (40, (32, 24), False)):
        chosen = settings("baked", texels=float(texels))
        frame = renderer.render(scene, camera, size, chosen, ("visibility", "reason_shadows"))
        coarse, lit = frame["reason_shadows"] == CONSTANTS["REASON_COARSE"], frame["visibility"][..., 0]
        border = (lit > 0) & (lit < 1)
        assert border.any() and coarse.any() == some and not coarse[~border].any()
        assert not some or coarse[border].mean() > 0.99
