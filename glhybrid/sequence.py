"""Pictures in a row: which frames, at what times, seen from where, and files that survive an interrupted run.

Files are written beside their final name and moved there when they are whole, so a run that is cut off leaves whole
frames only; the next one keeps those that it would make the same (resume.py) and goes on from there. A movie, one file
for all frames, is there when it is whole. Encoding happens in other threads while the next frame is drawn. Frame N
depends on N alone, its motion vectors included: where the frame before it was not drawn in this run, the scene passes
through its pose all the same.
"""

import logging
import os
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glhybrid import movie
from glhybrid import pose as posing
from glhybrid.camera_path import CameraMove, Turntable
from glhybrid.deform import at_rest
from glhybrid.errors import OutputError, SettingError
from glhybrid.image import MOVIE_SUFFIXES, Frame, check_folder, check_output
from glhybrid.resume import fingerprint, fingerprint_of, remove_leftovers, scene_digest
from glhybrid.scene import Animation, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.stream import Shot
from glhybrid.view import choose_camera

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer

log = logging.getLogger("glhybrid")
MOST_FRAMES = 1_000_000
IN_FLIGHT = 2  # frames drawn but not read back yet


@dataclass(frozen=True, eq=False)
class Sequence:
    """numbers: the frames. Frame n shows the clip at n / fps seconds.

    camera: one of the scene's, which a clip may move. move: what moves it besides or instead: a Turntable, CameraPath
    or CameraClip.
    """

    scene: Scene
    settings: Settings
    numbers: range
    fps: float
    camera: int | str | Camera | None = None
    move: CameraMove | None = None

    @property
    def plays(self) -> bool:
        """A scene without a clip stays at rest, so that nothing is prepared to move."""
        return self._clip is not None

    def settings_at(self, number: int) -> Settings:
        """The settings of a frame: those of all, at its time if a clip plays."""
        return self.settings.replace(time=number / self.fps) if self.plays else self.settings

    def camera_at(self, number: int) -> int | str | Camera | None:
        """What the renderer is to be given: it finds a camera of the scene where the clip has it."""
        return self.camera if self.move is None else self.view_at(number)

    def view_at(self, number: int) -> Camera:
        """The camera itself."""
        bare = self._bare
        if self._player is not None and not isinstance(self.camera, Camera):
            bare = posing.place(bare, self._player.at(number / self.fps), self._player.rest)
        camera = choose_camera(bare, self.camera)
        return camera if self.move is None else self.move.at(number / self.fps, number, camera)

    @cached_property
    def _clip(self) -> Animation | None:
        return posing.find_clip(self.scene, self.settings.clip)

    @cached_property
    def _bare(self) -> Scene:
        return self.scene.replace(instances=(), lights=())

    @cached_property
    def _player(self) -> posing.Player | None:
        moving = self._clip is not None and any(c.node >= 0 for c in self.scene.cameras)
        return posing.Player(self._bare, self._clip) if moving and self._clip is not None else None


def make(
    scene: Scene,
    settings: Settings,
    frames: str = ":",
    fps: float = 24.0,
    camera: int | str | Camera | None = None,
    move: CameraMove | None = None,
) -> Sequence:
    """frames: a Python slice, "A:B", "A:B:STEP" or with either end left out: the clip, or the camera's way, from start
    to end, whichever is longer.

    Raises SettingError for a slice that is none or holds no frame, a rate that is not within 0.001 to 10000, and where
    nothing would move.
    """
    if not (np.isfinite(fps) and 1e-3 <= fps <= 1e4):
        raise SettingError(f"--fps {fps:g}: expected a number from 0.001 to 10000")
    if settings.time is not None:
        raise SettingError(f"--time {settings.time:g} and --frames: a frame's time is its number / fps; give one")
    choose_camera(scene, camera)
    clip = posing.find_clip(scene, settings.clip)
    if clip is None and move is None:
        raise SettingError(
            f"--frames {frames}: nothing moves, {scene.name} has no animation; --turntable 120 turns the camera once "
            "in 120 frames, --path FILE.toml moves it"
        )
    length = int(np.floor(posing.clip_span(clip)[1] * fps + 1e-6)) + 1 if clip is not None else 1
    length = max(length, move.length(fps) if move is not None else 1)
    return Sequence(scene, settings, parse_frames(frames, length), fps, camera, move)


def turntable(
    scene: Scene, frames: int, degrees: float = 360.0, about: tuple[float, float, float] | None = None
) -> Turntable:
    """A turntable about a point, or about the middle of the scene at rest."""
    if about is None:
        x, y, z = at_rest(scene).bounds().mean(0).tolist()
        about = x, y, z
    return Turntable(frames, about, degrees)


def parse_frames(text: str, length: int) -> range:
    """The frames of a Python slice. Negative ends count from `length`, which is also where an open one ends; an end
    past it is kept: there the clip's last keys hold."""
    match = re.fullmatch(r"\s*(-?\d+)?\s*:\s*(-?\d+)?\s*(?::\s*(-?\d+)?\s*)?", text)
    if match is None:
        raise SettingError(f'--frames "{text}": expected FIRST:END or FIRST:END:STEP as in Python, such as 0:48')
    first, end, step = (int(g) if g is not None else None for g in match.groups())
    if step is not None and step < 1:
        raise SettingError(f"--frames {text}: the step is {step}, must be 1 or more")
    start = 0 if first is None else first + length if first < 0 else first
    stop = length if end is None else end + length if end < 0 else end
    numbers = range(max(start, 0), stop, step or 1)
    if not numbers:
        raise SettingError(f"--frames {text}: holds no frame (of {length})")
    if len(numbers) > MOST_FRAMES:
        raise SettingError(f"--frames {text}: {len(numbers)} frames, the limit is {MOST_FRAMES}")
    return numbers


def frame_path(pattern: str, number: int) -> Path:
    """The file of a frame. Raises OutputError where the pattern does not tell frames apart."""
    try:
        paths = [pattern.format(frame=n) for n in (number, number + 1)]
    except (KeyError, IndexError, ValueError, AttributeError):
        raise OutputError(
            f"{pattern}: not a pattern of file names: write the frame's number as {{frame:04d}}, other braces twice"
        ) from None
    if paths[0] == paths[1]:
        raise OutputError(
            f"{pattern}: every frame would have this name: add its number, such as name_{{frame:04d}}.png"
        )
    return Path(paths[0])


def run(
    renderer: "Renderer",
    sequence: Sequence,
    output: str,
    size: tuple[int, int],
    aovs: tuple[str, ...] = (),
    exr_float: bool = False,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """Draws and writes what is not there yet. output: a pattern of file names, or a movie. aovs: layers of EXR and NPZ.

    Returns the last frame's receipt with `output`, `frames` (numbers), `written`, `kept`, `seconds` and
    `frames_per_second`. Raises OutputError before any work is done where a frame could not be written.
    """
    job = _Job(renderer, sequence, output, size, aovs, exr_float, progress)
    started = time.perf_counter()
    receipt, written, kept = job.movie() if is_movie(output) else job.pictures(overwrite)
    seconds, numbers = time.perf_counter() - started, sequence.numbers
    return receipt | {
        "output": output, "frames": [numbers.start, numbers.stop, numbers.step], "written": written, "kept": kept,
        "seconds": seconds, "frames_per_second": written / seconds if written else 0.0,
    }  # fmt: skip


def is_movie(output: str) -> bool:
    """Whether all frames go into one file."""
    return Path(output).suffix.lower() in MOVIE_SUFFIXES


def check(output: str, size: tuple[int, int], fps: float, aovs: tuple[str, ...] = ()) -> str:
    """The output's suffix, before any work is spent on it. Raises OutputError or SettingError."""
    if not is_movie(output):
        return check_output(frame_path(output, 0), aovs)
    check_folder(Path(output))
    if aovs:
        raise SettingError(f"{output}: a movie holds no AOVs ({', '.join(aovs)}): write numbered .exr or .npz")
    movie.check(output, size, fps)
    return Path(output).suffix.lower()


class _Job:
    """One run: what to draw and where to put it."""

    def __init__(
        self,
        renderer: "Renderer",
        sequence: Sequence,
        output: str,
        size: tuple[int, int],
        aovs: tuple[str, ...],
        exr_float: bool,
        progress: Callable[[str, int, int], None] | None,
    ) -> None:
        self.renderer, self.output, self.size, self.aovs, self.exr_float = renderer, output, size, aovs, exr_float
        self.progress = progress or (lambda stage, done, total: None)
        data = check(output, size, sequence.fps, aovs) in (".exr", ".npz")
        if "motion" in aovs and sequence.settings.reflections == "reference":
            raise SettingError('"motion" of a sequence is not made with reflections = reference: leave one of both out')
        self.sequence = replace(sequence, settings=sequence.settings.replace(aa=sequence.settings.aa_frames(data)))
        self.layers = ("radiance", *(a for a in aovs if a != "radiance")) if data else ()

    def movie(self) -> tuple[dict[str, Any], int, int]:
        """All frames into one file: the last receipt, frames written and kept."""
        numbers, path = self.sequence.numbers, Path(self.output)
        remove_leftovers(path)
        said = {"settings": self.sequence.settings.to_dict(), "scene": {"sha256": self.sequence.scene.sha256}}
        receipt: dict[str, Any] = {}
        with movie.Movie(path, self.sequence.fps / numbers.step, len(numbers), said) as file:
            for frame in self._draw(list(numbers)):
                file.add(frame.rgb)
                receipt = frame.receipt
        return receipt, len(numbers), 0

    def pictures(self, overwrite: bool) -> tuple[dict[str, Any], int, int]:
        """Every frame that is not there yet into a file of its own."""
        numbers, prints = self.sequence.numbers, self._fingerprints()
        found = {} if overwrite else {n: fingerprint_of(frame_path(self.output, n)) for n in numbers}
        todo = [n for n in numbers if found.get(n) != prints[n]]
        others = sum(frame_path(self.output, n).exists() for n in todo)
        if len(todo) < len(numbers):
            kept = len(numbers) - len(todo)
            log.info("%d of %d frames are there already and are kept; --overwrite makes them anew", kept, len(numbers))
        if others and not overwrite:
            log.info("%d frames that are there are of another scene, of other settings or not ours: made anew", others)
        receipt: dict[str, Any] = {}
        workers = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 8)
        with ThreadPoolExecutor(workers) as pool:
            pending: list[Future[Any]] = []
            for number, frame in zip(todo, self._draw(todo), strict=True):
                receipt = frame.receipt = frame.receipt | {"fingerprint": prints[number]}
                path = frame_path(self.output, number)
                remove_leftovers(path)
                pending.append(pool.submit(frame.save, path, self.aovs, self.exr_float))
                while len(pending) > workers or (pending and pending[0].done()):
                    pending.pop(0).result()
            for save in pending:
                save.result()
        return receipt, len(todo), len(numbers) - len(todo)

    def _draw(self, numbers: list[int]) -> Iterator[Frame]:
        sequence = self.sequence
        return self.renderer.frames(
            sequence.scene, self._shots(numbers), self.size, sequence.settings, self.layers, in_flight=IN_FLIGHT
        )

    def _shots(self, numbers: list[int]) -> Iterator[Shot]:
        """Each is asked for when the one before has been drawn."""
        sequence, drawn = self.sequence, None
        for done, number in enumerate(numbers):
            self.progress(f"frame {number}", done, len(numbers))
            before = number - sequence.numbers.step
            if "motion" in self.layers and drawn != before:
                then = sequence.settings_at(before)
                self.renderer.stage(sequence.scene, then, self.size, self.layers).aim(then, sequence.camera_at(before))
            yield Shot(sequence.settings_at(number).time, sequence.camera_at(number))
            drawn = number

    def _fingerprints(self) -> dict[int, str]:
        """By frame. Motion vectors also depend on the frame before."""
        sequence, scene = self.sequence, scene_digest(self.sequence.scene)
        layers = {"aovs": self.layers, "float": self.exr_float, "size": self.size}

        def make(number: int) -> str:
            more: dict[str, Any] = dict(layers)
            if "motion" in self.layers:
                before = number - sequence.numbers.step
                more["before"] = fingerprint(b"", sequence.settings_at(before).to_dict(), sequence.view_at(before))
            return fingerprint(scene, sequence.settings_at(number).to_dict(), sequence.view_at(number), **more)

        return {number: make(number) for number in sequence.numbers}
