"""What moves that should not: the same world points seen again a pixel further on, and light that stays when its cause
is gone.

The pan is of an orthographic camera by whole pixels, so pixel x of one frame is pixel x + 1 of the one before: nothing
is resampled, and what a technique changes is its own doing.
"""

from dataclasses import dataclass

import numpy as np

from glhybrid.renderer import Renderer
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study.picture import LUMINANCE

AOVS = ("visibility", "triangle_id", "instance_id")


@dataclass(frozen=True)
class Pan:
    """flicker: mean |L(t) - L(t-1)| of the same world points over mean luminance; p99: of single points;
    flip_rate_percent: of points whose shadow changes sides of one half from a frame to the next."""

    flicker: float
    flicker_p99: float
    flip_rate_percent: float


def orthographic(camera: Camera, depth: float) -> Camera:
    """The camera that sees without perspective what `camera` sees at a depth in metres."""
    if camera.fov_y <= 0:
        return camera
    half = depth * float(np.tan(camera.fov_y / 2))
    return Camera("pan", camera.world_from_view, fov_y=0.0, near=camera.near, ymag=half)


def typical_depth(renderer: Renderer, scene: Scene, camera: Camera) -> float:
    """Median depth of what a camera sees, metres; the scene's size where it sees nothing."""
    plain = Settings(shadows="none", reflections="none", aa=1)
    depth = renderer.render(scene, camera, (64, 48), plain, aovs=("depth",))["depth"]
    seen = depth[np.isfinite(depth)]
    if len(seen):
        return float(np.median(seen))
    return float(np.linalg.norm(np.diff(scene.bounds(), axis=0))) or 1.0


def pan(
    renderer: Renderer, scene: Scene, camera: Camera, size: tuple[int, int], settings: Settings, steps: int = 4
) -> Pan:
    """`steps` frames, each a pixel to the right of the last. camera: orthographic."""
    assert camera.fov_y <= 0 and steps > 0
    pixel = 2 * camera.ymag / size[1]
    if camera.xmag:
        pixel = 2 * camera.xmag / size[0]
    before = None
    changes, flips, points, luminance = [], 0, 0, []
    for k in range(steps + 1):
        pose = camera.world_from_view.copy()
        pose[:3, 3] += k * pixel * pose[:3, 0]
        moved = Camera("pan", pose, fov_y=0.0, near=camera.near, xmag=camera.xmag, ymag=camera.ymag)
        shown = renderer.render(scene, moved, size, settings, aovs=AOVS)
        frame = {name: shown[name] for name in AOVS}
        frame["luminance"] = np.einsum("hwc,c->hw", shown["radiance"], LUMINANCE)  # no threads of BLAS
        if before is not None:
            same = np.ones((size[1], size[0] - 1), bool)
            for name in ("triangle_id", "instance_id"):
                same &= before[name][:, 1:] == frame[name][:, :-1]
            old, new = before["luminance"][:, 1:], frame["luminance"][:, :-1]
            changes.append(np.abs(new - old)[same])
            luminance.append(new[same])
            sides = (before["visibility"][:, 1:] > 0.5) != (frame["visibility"][:, :-1] > 0.5)
            lit = same[..., None] & (before["instance_id"][:, 1:, None] != 0xFFFFFFFF)
            flips += int((sides & lit).sum())
            points += int(lit.sum()) * sides.shape[-1]
        before = frame
    change, mean = np.concatenate(changes), float(np.concatenate(luminance).mean() or 1.0)
    if not len(change):
        return Pan(0.0, 0.0, 0.0)
    return Pan(
        float(change.mean()) / mean, float(np.percentile(change, 99)) / mean, 100.0 * flips / points if points else 0.0
    )


def half_life(residual: list[float], left: float = 0.05) -> int | None:
    """Frames until at most `left` of the energy is left, from the first frame after its cause is gone; None: never."""
    return next((k for k, share in enumerate(residual) if share <= left), None)
