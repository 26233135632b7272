"""The shadow terminator: facets of a smooth ball shadow what its vertex normals promise is lit, unless mended."""

import numpy as np
import pytest

import glhybrid as gh
from glhybrid.context import Context
from glhybrid.load.shapes import shape

SUN = np.array([-1.0, -0.3, 0.0]) / np.linalg.norm([1.0, 0.3, 0.0])  # low: along most of the visible limb


def falsely_dark(context: Context, segments: int, terminator: bool) -> float:
    """Share of pixels that face the sun by their normal and are shadowed all the same; on a ball none should be."""
    ball = gh.Mesh(name="ball", primitives=(shape("sphere", radius=1.0, segments=segments),))
    scene = gh.Scene(
        name="terminator",
        meshes=(ball,),
        instances=(gh.Instance(mesh=0, world_from_object=np.eye(4)),),
        lights=(gh.Light(kind="directional", intensity=3.0, direction=tuple(SUN)),),
        cameras=(gh.Camera.look_at((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)),),
    )
    with gh.Renderer(context=context) as renderer:
        settings = gh.Settings(aa=1, terminator=terminator, reflections="none")
        frame = renderer.render(scene, size=(320, 240), settings=settings, aovs=("normal", "visibility"))
    lit = frame["normal"] @ -SUN > 0.0
    return float((frame["visibility"][lit] == 0).mean())


# Expected without the fix: about the height of a facet, so a quarter of it for twice the segments.
@pytest.mark.parametrize(("segments", "low", "high"), [(16, 0.02, 0.12), (32, 0.005, 0.05)])
def test_facets_shadow_the_terminator_unless_it_is_mended(
    context: Context, segments: int, low: float, high: float
) -> None:
    plain, mended = falsely_dark(context, segments, False), falsely_dark(context, segments, True)
    print(f"{segments} segments: {plain:.2%} falsely dark, mended {mended:.2%}")
    assert low < plain < high
    assert mended <= 0.0005
