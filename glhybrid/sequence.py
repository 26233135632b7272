"""Pictures in a row: which frames, at what times, seen from where, and files that survive an interrupted run.

A frame is finished when its file has its name: files are written beside it and moved, so a run that is cut off leaves
whole frames only, and the next one goes on from there. Encoding happens in a thread of its own while the next frame is
drawn. Frame N depends on N alone, its motion vectors included: where the frame before it was not drawn in this run, the
scene passes through its pose all the same.
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

from glhybrid import pose as posing
from glhybrid.deform import at_rest
from glhybrid.errors import OutputError, SettingError
from glhybrid.image import check_output
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.view import choose_camera

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer

log = logging.getLogger("glhybrid")
MOST_FRAMES = 1_000_000
IN_FLIGHT = 2  # frames being written while the next is drawn


@dataclass(frozen=True, eq=False)
class Sequence:
    """numbers: the frames. Frame n shows the clip at n / fps seconds. turntable: frames a full turn of the camera about
    the scene's vertical axis takes, 0 = it does not turn."""

    scene: Scene
    settings: Settings
    numbers: range
    fps: float
    camera: int | str | None = None
    turntable: int = 0

    def settings_at(self, number: int) -> Settings:
        """A scene without a clip stays at rest, so that nothing is prepared to move."""
        plays = posing.find_clip(self.scene, self.settings.clip) is not None
        return self.settings.replace(time=number / self.fps) if plays else self.settings

    def camera_at(self, number: int) -> int | str | Camera | None:
        """The camera where the clip has it, turned counter-clockwise as seen from above."""
        if not self.turntable:
            return self.camera
        clip = posing.find_clip(self.scene, self.settings.clip)
        bare = self.scene.replace(instances=())
        if clip is not None:
            bare = posing.place(bare, posing.evaluate(self.scene, number / self.fps, clip))
        camera = choose_camera(bare, self.camera)
        angle = 2 * np.pi * (number % self.turntable) / self.turntable
        turn = np.eye(4)
        turn[0, 0] = turn[2, 2] = np.cos(angle)
        turn[0, 2], turn[2, 0] = np.sin(angle), -np.sin(angle)
        middle = posing.translation_matrix(self._middle)
        back = posing.translation_matrix(-self._middle)
        return replace(camera, world_from_view=middle @ turn @ back @ camera.world_from_view)

    @cached_property
    def _middle(self) -> Any:
        return at_rest(self.scene).bounds().mean(0)


def make(
    scene: Scene, settings: Settings, frames: str, fps: float, camera: int | str | None = None, turntable: int = 0
) -> Sequence:
    """frames: a Python slice, "A:B", "A:B:STEP" or with either end left out: the clip, or the turn, from start to end.

    Raises SettingError for a slice that is none or holds no frame, a rate that is not within 0.001 to 10000, and where
    nothing would move.
    """
    if not (np.isfinite(fps) and 1e-3 <= fps <= 1e4):
        raise SettingError(f"--fps {fps:g}: expected a number from 0.001 to 10000")
    if turntable < 0:
        raise SettingError(f"--turntable {turntable}: expected how many frames a full turn takes, 1 or more")
    if settings.time is not None:
        raise SettingError(f"--time {settings.time:g} and --frames: a frame's time is its number / fps; give one")
    clip = posing.find_clip(scene, settings.clip)
    if clip is None and not turntable:
        raise SettingError(
            f"--frames {frames}: nothing moves, {scene.name} has no animation; --turntable 120 turns the camera once "
            "in 120 frames"
        )
    length = int(np.floor(posing.clip_span(clip)[1] * fps + 1e-6)) + 1 if clip is not None else turntable
    return Sequence(scene, settings, parse_frames(frames, max(length, turntable)), fps, camera, turntable)


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
    pattern: str,
    size: tuple[int, int],
    aovs: tuple[str, ...] = (),
    exr_float: bool = False,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """Draws and writes what is not there yet. aovs: layers of EXR and NPZ files.

    Returns the last frame's receipt with `output` (the pattern), `frames` (numbers), `written`, `kept`, `seconds` and
    `frames_per_second`. Raises OutputError before any work is done where a frame could not be written.
    """
    numbers = sequence.numbers
    data = check_output(frame_path(pattern, numbers[0]), aovs) != ".png"
    if "motion" in aovs and sequence.settings.reflections == "reference":
        raise SettingError('"motion" of a sequence is not made with reflections = reference: leave one of both out')
    settings = sequence.settings.replace(aa=sequence.settings.aa_frames(data))
    sequence = replace(sequence, settings=settings)
    layers = ("radiance", *(a for a in aovs if a != "radiance")) if data else ()
    todo = [n for n in numbers if overwrite or not frame_path(pattern, n).exists()]
    kept = len(numbers) - len(todo)
    if kept:
        log.info("%d of %d frames are there already and are kept; --overwrite makes them anew", kept, len(numbers))
    receipt: dict[str, Any] = {}
    started, drawn = time.perf_counter(), None
    with ThreadPoolExecutor(1) as writer:
        pending: list[Future[Any]] = []
        for done, number in enumerate(todo):
            if progress is not None:
                progress(f"frame {number}", done, len(todo))
            path = frame_path(pattern, number)
            _remove_leftovers(path)
            before = number - numbers.step
            if "motion" in layers and drawn != before:
                staged = renderer.stage(sequence.scene, sequence.settings_at(before), size, layers)
                staged.aim(sequence.settings_at(before), sequence.camera_at(before))
            frame = renderer.render(
                sequence.scene, sequence.camera_at(number), size, sequence.settings_at(number), layers
            )
            receipt, drawn = frame.receipt, number
            pending.append(writer.submit(frame.save, path, aovs, exr_float))
            while len(pending) > IN_FLIGHT or (pending and pending[0].done()):
                pending.pop(0).result()
        for save in pending:
            save.result()
    seconds = time.perf_counter() - started
    return receipt | {
        "output": pattern, "frames": [numbers.start, numbers.stop, numbers.step], "written": len(todo), "kept": kept,
        "seconds": seconds, "frames_per_second": len(todo) / seconds if todo else 0.0,
    }  # fmt: skip


def _remove_leftovers(path: Path) -> None:
    """Half-written files of this frame whose process was killed."""
    for part in _parts(path):
        pid = int(part.name.split(".")[-3])
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            part.unlink(missing_ok=True)
        except PermissionError:
            pass  # somebody else's, and alive


def _parts(path: Path) -> Iterator[Path]:
    name = re.compile(re.escape(f".{path.stem}.") + r"\d+\.part" + re.escape(path.suffix))
    return (p for p in path.parent.iterdir() if name.fullmatch(p.name))
