"""The interactive viewer: a client of glhybrid.renderer, so that its pixels are `render`'s pixels.

    surface, window, web     where pictures go and input comes from: memory, a window, a browser
    app                      the loop: input -> state -> pictures -> panels -> surface
    state, store             what is shown and how; kept between runs
    camera_control, transport, budget     pure logic: cameras, playing clips, how large a picture may be
    picture, compare, views  a technique's picture as it refines, its error, and arrays as colours
    gui, panels, overlay     Dear ImGui on moderngl, and what it shows

glfw and imgui-bundle are the optional extra `viewer`, aiohttp is the extra `web`.
"""

import importlib
from types import ModuleType

from glhybrid.errors import DeviceError


def need(module: str, extra: str) -> ModuleType:
    """An optional library. Raises DeviceError with the line that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise DeviceError(f"the viewer needs {module} ({error}): pip install 'glhybrid[{extra}]'") from None
