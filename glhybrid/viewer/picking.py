"""What is under a pixel: the AOVs of a picture of few, through a camera that looks along its ray: the middle one's."""

from dataclasses import replace

import numpy as np

from glhybrid.image import NO_ID
from glhybrid.scene import Camera
from glhybrid.view import View
from glhybrid.viewer.picture import PROBE, Picture
from glhybrid.viewer.session import Picked

PROBED = (
    "instance_id", "material_id", "triangle_id", "position", "normal", "distance", "bvh_steps", "visibility",
)  # fmt: skip


def pixel_camera(view: View, pixel: tuple[float, float]) -> Camera:
    """A camera whose middle pixel of PROBE is that of a view at (x, y), from the top left: the same ray and size."""
    width, height = view.size
    ndc = 2 * (pixel[0] + 0.5) / width - 1, 1 - 2 * (pixel[1] + 0.5) / height
    camera, eye = view.camera, view.origin + view.eye
    pose = camera.world_from_view.copy()
    if view.orthographic:
        pose[:3, 3] = eye + ndc[0] * view.right + ndc[1] * view.up
        half, wide = (PROBE * float(np.linalg.norm(a)) / n for a, n in ((view.up, height), (view.right, width)))
        return replace(camera, world_from_view=pose, ymag=half, xmag=wide)
    forward = view.forward + ndc[0] * view.right + ndc[1] * view.up
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, pose[:3, 1])
    right = right / np.linalg.norm(right)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(right, forward), -forward
    near = camera.near / float(forward @ view.forward)
    fov = 2 * float(np.arctan(PROBE * view.pixel_angle / 2))
    return replace(camera, world_from_view=pose, fov_y=fov, fov_short=False, near=near)


def pick(picture: Picture, pixel: tuple[int, int]) -> Picked | None:
    """What a picture shows at a pixel of it; None before it was drawn. Leaves the picture as it was."""
    view = picture.view
    if picture.staged is None or view is None:
        return None
    spot = picture.probe(pixel_camera(view, pixel), PROBED)
    instance, material, triangle = (int(spot[n].item()) for n in ("instance_id", "material_id", "triangle_id"))
    if instance == NO_ID:
        return Picked(pixel)
    point, normal = _point(spot["position"]), _point(spot["normal"])
    depth = float((np.asarray(point) - view.origin - view.eye) @ view.forward)
    visibility = tuple(float(v) for v in spot["visibility"].reshape(-1))
    return Picked(
        pixel, instance, material, triangle, point, normal, float(spot["distance"].item()), depth,
        int(spot["bvh_steps"].item()), visibility,
    )  # fmt: skip


def focus(picture: Picture) -> float:
    """Metres along the view's axis to what its centre shows; inf if nothing is there."""
    view = picture.view
    if picture.staged is None or view is None:
        return float("inf")
    centre = (view.size[0] - 1) / 2, (view.size[1] - 1) / 2
    return float(picture.probe(pixel_camera(view, centre), ("depth",))["depth"].item())


def _point(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values.reshape(3))
    return x, y, z
