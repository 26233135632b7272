"""`glhybrid view`: its flags, and what they start."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from glhybrid.errors import SettingError, unknown

if TYPE_CHECKING:
    from glhybrid.scene import Scene
    from glhybrid.settings import Settings
    from glhybrid.viewer.session import Session


@Parameter(name="*")
@dataclass(frozen=True)
class View:
    """Flags of the viewer."""

    mode: Annotated[str | None, Parameter(help="single, split, difference or flip.")] = None
    against: Annotated[
        str | None,
        Parameter(help="Side B, to compare with: shadows=pcf,reflections=env and other settings; or reference."),
    ] = None
    show: Annotated[str | None, Parameter(help="picture, or an AOV to look at: normal, bvh_steps, ...")] = None
    pick: Annotated[str | None, Parameter(help="X,Y of a pixel to pick at the start.")] = None
    reference: Annotated[bool, Parameter(help="Converge to the reference and measure errors from the start.")] = False
    divider: Annotated[float | None, Parameter(help="Of the split view, 0 to 1; 0.5.")] = None
    web: Annotated[int | None, Parameter(help="Serve the viewer to a browser at this port instead; 0 = any.")] = None
    host: Annotated[str, Parameter(help="Address for --web; 127.0.0.1 is this machine alone.")] = "127.0.0.1"
    screenshot: Annotated[
        str | None, Parameter(help="Write the whole viewer to this PNG once its pictures are finished, and end.")
    ] = None
    fresh: Annotated[bool, Parameter(help="Start without the settings of the last run.")] = False

    def refuse(self) -> None:
        """Raises SettingError for flags that are wrong whatever the scene."""
        from glhybrid.image import AOVS, check_output
        from glhybrid.viewer.session import MODES
        from glhybrid.viewer.views import PICTURE

        if self.mode is not None and self.mode not in MODES:
            raise SettingError(unknown("mode", self.mode, MODES))
        if self.show is not None and self.show not in (PICTURE, *AOVS):
            raise SettingError(unknown("view", self.show, (PICTURE, *AOVS)))
        if self.divider is not None and not 0 <= self.divider <= 1:
            raise SettingError(f"--divider {self.divider:g}: expected a number from 0 to 1")
        if self.web is not None and not 0 <= self.web <= 65535:
            raise SettingError(f"--web {self.web}: expected a port from 0 to 65535")
        if self.web is not None and self.screenshot is not None:
            raise SettingError("--web and --screenshot: give one")
        if self.screenshot is not None and check_output(self.screenshot) != ".png":
            raise SettingError(f"--screenshot {self.screenshot}: expected a .png")
        self.pixel()

    def pixel(self) -> tuple[int, int] | None:
        """--pick, (column, row) from the top left; None if it was not given. Raises SettingError."""
        if self.pick is None:
            return None
        match = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", self.pick)
        if match is None:
            raise SettingError(f'--pick "{self.pick}": expected X,Y in pixels, such as 320,180')
        return int(match[1]), int(match[2])

    def apply(self, session: "Session") -> None:
        """Puts the flags that were given into a session."""
        for name in ("mode", "show", "divider"):
            if (value := getattr(self, name)) is not None:
                setattr(session, name, value)
        session.reference = session.reference or self.reference
        if self.against == "reference":
            session.against = "reference"
        elif self.against is not None:
            words = [w for w in self.against.split(",") if w.strip()]
            session.b = session.a.with_overrides(words)
            session.against = "b"


NONE = View()


def run(
    source: str, scene: "Scene", settings: "Settings", given: bool, flags: View, device: str, size: tuple[int, int],
    camera: int | str | None, lights: tuple[str, ...], environment: float | None, load: Callable[[str], "Scene"],
    loading: tuple[str, ...] = (), quiet: bool = False,
) -> None:  # fmt: skip
    """Opens the viewer and returns when it is closed. given: the settings were asked for, not left at their defaults.

    loading: flags that `load` stands for. size: of the picture; the panel stands beside it.
    Raises DeviceError where there is no display or library.
    """
    from glhybrid.viewer import store
    from glhybrid.viewer.app import Viewer
    from glhybrid.viewer.panels import WIDTH
    from glhybrid.viewer.session import OF_BOTH, Session

    session = Session(scene, source, loading)
    saved = {} if flags.fresh or flags.screenshot else store.read()
    store.restore(session, saved)
    if given or not saved:
        session.a = settings.replace(time=None, clip=None)
        session.b = session.b.replace(**{name: getattr(settings, name) for name in OF_BOTH})
    flags.apply(session)
    start(session, settings, camera, lights, environment)
    window = size[0] + WIDTH, size[1]
    surface: Any
    if flags.screenshot is not None:
        from glhybrid.context import open_context
        from glhybrid.viewer.surface import Memory

        surface = Memory(open_context(device), window)
    elif flags.web is not None:
        from glhybrid.viewer.web import Web

        surface = Web(device, window, flags.host, flags.web)
        print(f"open {surface.url}", flush=True)
    else:
        from glhybrid.viewer.window import Window

        surface = Window(window, device)
    try:
        viewer = Viewer(surface, session, load, saved=saved, watch=flags.screenshot is None)
        try:
            if flags.screenshot is not None:
                _shoot(viewer, flags, Path(flags.screenshot))
            else:
                if (pixel := flags.pixel()) is not None:
                    viewer.tick()
                    viewer.act("pick", pixel)
                if not saved:
                    session.say("H shows keys and pointer")
                viewer.run()
                viewer.remember()
        finally:
            viewer.close()
    finally:
        surface.close()
        surface.context.close()


def start(
    session: "Session", settings: "Settings", camera: int | str | None, lights: tuple[str, ...],
    environment: float | None,
) -> None:  # fmt: skip
    """Camera, light and time as the command line has them. Raises SettingError."""
    from glhybrid import camera_text, relight
    from glhybrid.pose import find_clip
    from glhybrid.view import choose_camera

    scene = session.scene
    if isinstance(camera, str) and camera_text.is_pose(camera):
        session.pose = camera_text.read(camera)
    else:
        chosen = choose_camera(scene, camera)
        session.camera_index = next(i for i, c in enumerate(scene.cameras) if c is chosen)
    relit = relight.apply(scene, lights, environment)
    for i, (now, then) in enumerate(zip(relit.lights, scene.lights, strict=True)):
        if now is not then:
            session.light_angles[i] = relight.angles(now)
    session.environment_deg = environment
    if settings.time is not None or settings.clip is not None:
        clip = find_clip(scene, settings.clip)
        if clip is not None:
            session.transport.choose(scene, next(i for i, a in enumerate(scene.animations) if a is clip))
            session.transport.seek(settings.time or 0.0)


def _shoot(viewer: Any, flags: View, path: Path) -> None:
    viewer.settle()
    if (pixel := flags.pixel()) is not None:
        viewer.act("pick", pixel)
        viewer.settle()
    if viewer.session.said and any(s.error for s in viewer.session.said):
        raise SettingError(next(s.text for s in viewer.session.said if s.error))
    viewer.screenshot(path)
