"""`glhybrid render` of many pictures: the flags of animations and camera moves, and what they run."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from glhybrid.errors import SettingError

if TYPE_CHECKING:
    from glhybrid.camera_path import CameraMove
    from glhybrid.scene import Scene
    from glhybrid.settings import Settings
    from glhybrid.timing import Progress


@Parameter(name="*")
@dataclass(frozen=True)
class Frames:
    """Flags of animations."""

    frames: Annotated[
        str | None,
        Parameter(
            help="Frames of an animation, A:B as in Python; : is all of it. OUT holds {frame:04d}, or is a movie: "
            ".mp4, .webp, .gif or .apng.",
            allow_leading_hyphen=True,
        ),
    ] = None
    fps: Annotated[float, Parameter(help="Frames a second of the animation; 24.")] = 24.0
    turntable: Annotated[
        int | None, Parameter(help="Turn the camera about the scene once in so many frames.", allow_leading_hyphen=True)
    ] = None
    turn: Annotated[
        float | None,
        Parameter(help="Degrees that the turntable turns instead of 360; < 0: clockwise.", allow_leading_hyphen=True),
    ] = None
    about: Annotated[
        str | None,
        Parameter(help="X,Y,Z that it turns about, m; the middle of the scene.", allow_leading_hyphen=True),
    ] = None
    path: Annotated[
        str | None,
        Parameter(help="Camera path: a TOML of [[key]] time, eye, target; or a glTF whose camera moves."),
    ] = None
    overwrite: Annotated[bool, Parameter(help="Make frames anew that are there already.")] = False

    def asked(self) -> bool:
        """Whether many pictures are wanted, not one. Raises SettingError for flags that then mean nothing."""
        if self.turntable is None and (self.turn is not None or self.about is not None):
            flag = "--turn" if self.turn is not None else "--about"
            raise SettingError(f"{flag} is for turntables: give --turntable FRAMES too")
        if self.turntable is not None and self.path is not None:
            raise SettingError("--turntable and --path both move the camera: give one")
        many = self.frames is not None or self.turntable is not None or self.path is not None
        if self.overwrite and not many:
            raise SettingError("--overwrite is for animations: give --frames A:B too")
        return many

    def point(self) -> tuple[float, float, float] | None:
        """--about, world, metres; None if it was not given. Raises SettingError."""
        if self.about is None:
            return None
        try:
            x, y, z = (float(word) for word in self.about.split(","))
        except ValueError:
            raise SettingError(f'--about "{self.about}": expected X,Y,Z in metres, such as 0,1.5,0') from None
        return x, y, z

    def run(
        self,
        scene: "Scene",
        settings: "Settings",
        camera: int | str | None,
        output: str,
        size: tuple[int, int],
        aovs: tuple[str, ...],
        exr_float: bool,
        device: str,
        progress: "Progress",
    ) -> dict[str, Any]:
        """Draws and writes; returns the receipt of sequence.run."""
        from glhybrid import sequence

        made = sequence.make(scene, settings, self.frames or ":", self.fps, camera, self._move(scene))
        from glhybrid.renderer import Renderer

        with Renderer(device=device) as renderer:
            return sequence.run(renderer, made, output, size, aovs, exr_float, self.overwrite, progress)

    def _move(self, scene: "Scene") -> "CameraMove | None":
        from glhybrid import camera_path, sequence

        if self.path is not None:
            return camera_path.read(self.path)
        if self.turntable is not None:
            degrees = 360.0 if self.turn is None else self.turn
            return sequence.turntable(scene, self.turntable, degrees, self.point())
        return None


def summary(receipt: dict[str, Any]) -> str:
    """One line for people."""
    rate = f", {receipt['frames_per_second']:.2f} frames/s" if receipt["written"] else ""
    return f"{receipt['output']}: {receipt['written']} frames written, {receipt['kept']} kept{rate}"


NONE = Frames()
