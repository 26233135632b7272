"""glhybrid: OpenGL rasterises, compute shaders trace shadows and reflections, on any OpenGL 4.3.

    import glhybrid as gh
    scene = gh.load("scene.glb")
    with gh.Renderer(device="auto") as renderer:
        frame = renderer.render(scene, size=(1280, 720), settings=gh.Settings(shadows="ray"))
    frame.save("out.png")

Names are imported when they are first used, so `import glhybrid` costs next to nothing.
"""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from glhybrid.context import Context, open_context
    from glhybrid.errors import (
        DeviceError,
        GeometryError,
        GlhybridError,
        LoadError,
        OutputError,
        SettingError,
        ShaderError,
    )
    from glhybrid.image import AOVS, Frame
    from glhybrid.load import load, with_defaults
    from glhybrid.load.arrays import mesh
    from glhybrid.renderer import Renderer
    from glhybrid.scene import Camera, Environment, Instance, Light, Material, Mesh, Scene, Sphere, Triangles
    from glhybrid.settings import Settings
    from glhybrid.stream import Shot

_HOME = {
    "context": ("Context", "open_context"),
    "errors": (
        "DeviceError", "GeometryError", "GlhybridError", "LoadError", "OutputError", "SettingError", "ShaderError",
    ),
    "image": ("AOVS", "Frame"),
    "load": ("load", "with_defaults"),
    "load.arrays": ("mesh",),
    "renderer": ("Renderer",),
    "scene": ("Camera", "Environment", "Instance", "Light", "Material", "Mesh", "Scene", "Sphere", "Triangles"),
    "settings": ("Settings",),
    "stream": ("Shot",),
}  # fmt: skip
_WHERE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "AOVS",
    "Camera",
    "Context",
    "DeviceError",
    "Environment",
    "Frame",
    "GeometryError",
    "GlhybridError",
    "Instance",
    "Light",
    "LoadError",
    "Material",
    "Mesh",
    "OutputError",
    "Renderer",
    "Scene",
    "SettingError",
    "Settings",
    "ShaderError",
    "Shot",
    "Sphere",
    "Triangles",
    "__version__",
    "load",
    "mesh",
    "open_context",
    "with_defaults",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_WHERE[name]}")
    value = module if name == "load" else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _CallableModule(ModuleType):
    """glhybrid.load is a package and also a function; Python would let only the first one keep the name."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self.load(*args, **options)


class _Package(ModuleType):
    def __setattr__(self, name: str, value: Any) -> None:
        if name == "load" and isinstance(value, ModuleType):
            value.__class__ = _CallableModule
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
