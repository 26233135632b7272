"""What the report calls things, and where links to them go."""

AXIS_NAMES = {"ao": "Ambient occlusion"}
ERROR_NAMES = {
    "flip": "HDR-FLIP of the whole picture",
    "flip_shadow": "HDR-FLIP of the direct light alone",
    "flip_reflection": "HDR-FLIP, weighted by specular share",
}


def anchor(scene: str) -> str:
    """Of the scene's part of the page."""
    return "scene-" + "".join(c if c.isalnum() else "-" for c in scene)


def axis_name(axis: str) -> str:
    """As headings have it."""
    return AXIS_NAMES.get(axis, axis.capitalize())


def clock_name(clock: str) -> str:
    """As axes of charts have it."""
    return "frame time, ms" if clock == "frame_ms" else "processor time of a frame over threads, ms"
