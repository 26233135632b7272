"""What is shown and how: scene, camera, light, techniques, time. Plain state, no OpenGL and no widgets.

`moves` counts what changes the picture at once and often (camera, light, time), `edits` all the rest that needs a new
picture. Whoever draws compares the counters with those it has drawn.
"""

import shlex
import time as clock
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from glhybrid import relight
from glhybrid.camera_text import Pose, pose_of
from glhybrid.scene import F64, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.view import choose_camera
from glhybrid.viewer.transport import Transport
from glhybrid.viewer.views import PICTURE

Mode = Literal["single", "split", "difference", "flip"]
MODES: tuple[Mode, ...] = ("single", "split", "difference", "flip")
Against = Literal["reference", "b"]
SAID_S = 6.0
OF_BOTH = ("exposure", "tone", "aa", "samples", "bounces", "seed")  # settings that are the same on both sides
FLAGS = ("shadows", "reflections", "samples", "bounces", "time", "clip", "aa")


@dataclass
class Said:
    """A message to the user."""

    text: str
    error: bool
    until: float


@dataclass(frozen=True)
class Picked:
    """What is under a pixel. instance, material, triangle: indices, -1 if nothing is there. Metres, world."""

    pixel: tuple[int, int]
    instance: int = -1
    material: int = -1
    triangle: int = -1
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance: float = float("inf")
    depth: float = float("inf")
    steps: int = 0
    visibility: tuple[float, ...] = ()


@dataclass
class Session:
    """scene: as loaded. a, b: settings of the two sides. pose: of a camera moved by hand, None = the scene's own."""

    scene: Scene
    source: str
    loading: tuple[str, ...] = ()  # flags of the command line that say how it is read
    a: Settings = field(default_factory=Settings)
    b: Settings = field(default_factory=lambda: Settings(shadows="pcf", reflections="env"))
    mode: Mode = "single"
    against: Against = "reference"
    show: str = PICTURE
    light_shown: int = -1
    divider: float = 0.5
    flipped: bool = False
    reference: bool = False
    gain: float = 4.0
    camera_index: int = 0
    pose: Pose | None = None
    light_angles: dict[int, tuple[float, float]] = field(default_factory=dict)
    environment_deg: float | None = None
    transport: Transport = field(default_factory=Transport)
    picked: Picked | None = None
    panel: bool = True
    help: bool = False
    said: list[Said] = field(default_factory=list)
    moves: int = 0
    edits: int = 0
    _lit: tuple[Any, Scene] | None = None

    def say(self, text: str, error: bool = False) -> None:
        """A message for some seconds, three times as many for an error; the same again counts anew."""
        now = clock.monotonic()
        self.said = [s for s in self.said if s.until > now and s.text != text][-4:]
        self.said.append(Said(text, error, now + SAID_S * (3 if error else 1)))

    def moved(self) -> None:
        """Something of the picture has changed: it is drawn anew."""
        self.moves += 1

    def edited(self) -> None:
        """Something else has changed that needs a new frame."""
        self.edits += 1

    def lit_scene(self) -> Scene:
        """The scene under the light of now; the same object while nothing changes."""
        key = (id(self.scene), tuple(sorted(self.light_angles.items())), self.environment_deg)
        if self._lit is None or self._lit[0] != key:
            self._lit = key, relight.apply(self.scene, self.light_words(), self.environment_deg)
        return self._lit[1]

    def light_words(self) -> tuple[str, ...]:
        """The turned lights as the command line takes them."""
        return tuple(f"{i}:{a:.6g},{e:.6g}" for i, (a, e) in sorted(self.light_angles.items()))

    def turn_light(self, index: int, azimuth: float, elevation: float) -> None:
        """Where a light comes from instead, degrees; elevation is held to 90 either way."""
        self.light_angles[index] = ((azimuth + 180) % 360 - 180, min(max(elevation, -90.0), 90.0))
        self.moved()

    def turn_environment(self, degrees: float) -> None:
        """The environment's turn about +Y instead, degrees."""
        self.environment_deg = float(f"{(degrees + 180) % 360 - 180:.6g}")
        self.moved()

    @property
    def environment_angle(self) -> float:
        """Degrees."""
        if self.environment_deg is not None:
            return self.environment_deg
        sky = self.scene.environment
        return float(np.rad2deg(sky.rotation)) if sky is not None else 0.0

    def light_angle(self, index: int) -> tuple[float, float]:
        """(azimuth, elevation) in degrees."""
        return self.light_angles.get(index) or relight.angles(self.scene.lights[index])

    def sun(self) -> int:
        """The light that is dragged: the brightest directional one, else the brightest spot; -1 = none."""
        rows = [
            (p.kind == "directional", p.intensity * max(p.color), -i)
            for i, p in enumerate(self.scene.lights)
            if p.kind != "point"
        ]
        return -max(rows)[2] if rows else -1

    def camera(self) -> Camera | int:
        """The camera of now, as Staged.aim takes it: an index is of a camera that may be animated."""
        return self.camera_index if self.pose is None else self.pose.camera()

    def plain_camera(self, posed: Scene | None = None) -> Camera:
        """The camera itself; posed: the scene at the time of now."""
        if self.pose is not None:
            return self.pose.camera()
        return choose_camera(posed or self.scene, self.camera_index)

    def start_moving(self, distance: float, posed: Scene | None = None) -> Pose:
        """The pose to move on from. distance: metres to what the view turns about, if it is a scene's camera yet."""
        if self.pose is None:
            self.pose = pose_of(self.plain_camera(posed), distance).rounded()
        return self.pose

    def move_to(self, pose: Pose) -> None:
        """Looks from there instead of through the scene's camera."""
        self.pose = pose.rounded()
        self.moved()

    def use_camera(self, index: int) -> None:
        """Looks through a camera of the scene again."""
        self.camera_index, self.pose = index, None
        self.moved()

    def bounds(self) -> F64:
        """(2, 3) of what is selected, else of the scene."""
        if self.picked is not None and self.picked.instance >= 0:
            box: F64 = self.scene.instance_bounds[self.picked.instance]
            if np.isfinite(box).all():
                return box
        return self.scene.bounds()

    def extent(self) -> float:
        """The length of the scene's diagonal, metres; 1 for an empty one."""
        low, high = self.scene.bounds()
        return float(np.linalg.norm(high - low)) or 1.0

    def settings(self, side: Literal["a", "b", "reference"]) -> Settings:
        """Of one picture, with the time of now."""
        chosen = self.b if side == "b" else self.a
        time = round(self.transport.time, 4) if self.transport.clip >= 0 else None
        return _settings(chosen, side == "reference", time, self.transport.clip)

    def set(self, side: Literal["a", "b"], **changes: Any) -> None:
        """Other settings of one side. Those of display and time are of both. Raises SettingError."""
        both = {k: v for k, v in changes.items() if k in OF_BOTH}
        for name in ("a", "b"):
            given = changes if name == side else both
            if given:
                setattr(self, name, getattr(self, name).replace(**given))
        self.edited()

    def swap_scene(self, scene: Scene) -> None:
        """The same file read anew: everything stays that still makes sense."""
        self.scene, self._lit, self.picked = scene, None, None
        if self.camera_index >= len(scene.cameras):
            self.camera_index, self.pose = 0, None
        self.light_angles = {
            i: v for i, v in self.light_angles.items() if i < len(scene.lights) and scene.lights[i].kind != "point"
        }
        if scene.environment is None:
            self.environment_deg = None
        if self.transport.clip >= len(scene.animations):
            self.transport = Transport()
        elif self.transport.clip >= 0:
            kept = self.transport
            self.transport = replace(kept)
            self.transport.choose(scene, kept.clip)
            self.transport.seek(kept.time)
            self.transport.playing = kept.playing
        self.edited()

    def command(self, size: tuple[int, int], side: Literal["a", "b"] = "a", output: str = "") -> str:
        """The `glhybrid render` line that makes this picture."""
        settings, plain = self.settings(side), Settings().to_dict()
        words = ["glhybrid", "render", self.source, "--size", f"{size[0]}x{size[1]}"]
        if self.pose is not None:
            words += ["--camera", self.pose.write()]
        elif self.camera_index:
            words += ["--camera", str(self.camera_index)]
        values = settings.to_dict()
        words += ["--shadows", settings.shadows, "--reflections", settings.reflections]
        for name, value in values.items():
            if name in ("shadows", "reflections") or value == plain.get(name, ...) or value is None:
                continue
            text = str(value).lower() if isinstance(value, bool) else str(value)
            words += [f"--{name}", text] if name in FLAGS else ["--set", f"{name}={text}"]
        for word in self.light_words():
            words += ["--light", word]
        if self.environment_deg is not None:
            words += ["--environment-rotation", f"{self.environment_deg:.6g}"]
        return shlex.join([*words, *self.loading, "-o", output or "picture.png"])


@lru_cache(256)
def _settings(chosen: Settings, reference: bool, time: float | None, clip: int) -> Settings:
    """Checked anew only when something changes: every frame asks several times."""
    if reference:
        chosen = chosen.replace(reflections="reference")
    return chosen if time is None else chosen.replace(time=time, clip=str(clip))
