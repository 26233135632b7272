"""Flags of every verb that takes a scene, and what they mean."""

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from glhybrid.errors import SettingError

if TYPE_CHECKING:
    from glhybrid.scene import Scene
    from glhybrid.settings import Settings

MAX_SIDE = 32768  # of a picture, pixels

SceneName = Annotated[
    str, Parameter(help="glTF, GLB, OBJ, PLY, STL or OFF file, a scene TOML, or a built-in scene's name (see scenes).")
]


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Flags of every verb that takes a scene."""

    device: Annotated[
        str,
        Parameter(help="auto, gpu, software, egl:N, cuda:N or osmesa. auto, the default, takes a GPU if there is one."),
    ] = "auto"
    size: Annotated[str, Parameter(help="Pixels, WxH; 1280x720.")] = "1280x720"
    camera: Annotated[
        str | None,
        Parameter(
            help="Name or index of a camera of the scene, its first one by default; or eye=X,Y,Z;target=X,Y,Z;fov=45."
        ),
    ] = None
    shadows: Annotated[
        str | None, Parameter(help="none, map, pcf, pcss, csm, baked, ray (the default) or ray-soft.")
    ] = None
    reflections: Annotated[
        str | None,
        Parameter(help="none, env, probe, ssr, ssr-ray, ray-lerp (the default), ray-glossy or reference (all of it)."),
    ] = None
    ao: Annotated[str | None, Parameter(help="Ambient occlusion of the sky: none (the default), ssao or ray.")] = None
    samples: Annotated[int | None, Parameter(help="Paths per pixel of reference; 64.")] = None
    bounces: Annotated[int | None, Parameter(help="Bounces after the first hit in reference; 8.")] = None
    time: Annotated[
        float | None, Parameter(help="Seconds into the clip, held at its ends; without it nothing is animated.")
    ] = None
    clip: Annotated[
        str | None,
        Parameter(
            help="Name or number of the animation, or all at once; the first by default. Alone, it is shown at 0 s."
        ),
    ] = None
    aa: Annotated[int | None, Parameter(help="Jittered frames averaged; 4 for PNG, 1 for EXR and NPZ.")] = None
    light: Annotated[
        tuple[str, ...],
        Parameter(
            help="INDEX:AZIMUTH,ELEVATION, degrees, of where a light comes from instead; may be repeated.",
            consume_multiple=False,
        ),
    ] = ()
    environment_rotation: Annotated[
        float | None, Parameter(help="Degrees about +Y instead of the scene's own.", allow_leading_hyphen=True)
    ] = None
    set: Annotated[
        tuple[str, ...],
        Parameter(name="--set", help="key=value of any setting; may be repeated.", consume_multiple=False),
    ] = ()
    config: Annotated[str | None, Parameter(help="TOML file of settings; flags and --set win over it.")] = None
    smooth: Annotated[bool, Parameter(help="Smooth normals where a file has none: scans, STL.")] = False
    strict: Annotated[bool, Parameter(help="Anything of the file that cannot be drawn is an error.")] = False
    allow_outside: Annotated[bool, Parameter(help="Let a scene use files outside its folder.")] = False
    json: Annotated[bool, Parameter(help="Print the result as one JSON object.")] = False
    quiet: Annotated[bool, Parameter(help="No messages but errors.")] = False

    def settings(self) -> "Settings":
        """Defaults, then --config, then flags, then --set."""
        from glhybrid.settings import Settings

        settings = Settings().with_toml(self.config) if self.config is not None else Settings()
        flags = {
            name: getattr(self, name)
            for name in ("shadows", "reflections", "ao", "samples", "bounces", "aa", "time", "clip")
        }
        settings = settings.replace(**{name: value for name, value in flags.items() if value is not None})
        return settings.with_overrides(self.set)

    def pixels(self) -> tuple[int, int]:
        """(width, height) of --size. Raises SettingError."""
        match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", self.size.strip())
        if match is None:
            raise SettingError(f'--size "{self.size}": expected WIDTHxHEIGHT in pixels, such as 1280x720')
        width, height = int(match[1]), int(match[2])
        if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
            raise SettingError(f"--size {self.size}: each side must be from 1 to {MAX_SIDE} pixels")
        return width, height

    def camera_key(self) -> int | str | None:
        """--camera as Renderer.render takes it."""
        text = self.camera
        return int(text) if text is not None and text.isdecimal() else text

    def loading(self) -> tuple[str, ...]:
        """The flags that say how files are read, for who writes a command that makes the same picture."""
        given = {"--smooth": self.smooth, "--allow-outside": self.allow_outside}
        return tuple(flag for flag, wanted in given.items() if wanted)

    def load(self, scene: str) -> "Scene":
        """The scene, under the lights asked for. Raises LoadError or SettingError."""
        import glhybrid

        loaded = glhybrid.load(scene, strict=self.strict, allow_outside=self.allow_outside, smooth=self.smooth)
        if self.light or self.environment_rotation is not None:
            from glhybrid import relight

            loaded = relight.apply(loaded, self.light, self.environment_rotation)
        return loaded


NONE = Common()
