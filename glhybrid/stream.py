"""Many pictures of one scene, read back while the next ones are drawn: what Renderer.frames and arrays do."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from glhybrid import outputs, receipt
from glhybrid import pose as posing
from glhybrid.errors import DeviceError, SettingError
from glhybrid.image import Frame
from glhybrid.readback import Reading, Ring
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.timing import Timing

if TYPE_CHECKING:
    from glhybrid.renderer import Renderer
    from glhybrid.staged import Staged
    from glhybrid.view import View

T = TypeVar("T")
TIMED = 2  # pictures whose passes are timed: the first one compiles as well
MOST_IN_FLIGHT = 64


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture of many: the clip's time in seconds (None: the settings'), and a camera as Renderer.render has it."""

    time: float | None = None
    camera: int | str | Camera | None = None


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A picture that is still on the GPU."""

    staged: "Staged"
    view: "View"
    radiance: Any
    display: Any


def frames(
    renderer: "Renderer",
    scene: Scene,
    shots: Iterable[Shot],
    size: tuple[int, int],
    settings: Settings,
    aovs: tuple[str, ...],
    in_flight: int,
) -> Iterator[Frame]:
    """As Renderer.frames."""
    receipts: deque[dict[str, Any]] = deque()
    first: dict[str, Any] = {}

    def readings(drawn: _Drawn, chosen: Settings, timing: Timing | None) -> list[Reading[Any]]:
        if timing is not None:
            first.update(receipt.make(drawn.staged, drawn.view, timing, 0.0))
        said = {"time": chosen.time, "camera": drawn.view.camera.name}
        warnings = [w for w in first["scene"]["warnings"] if not w.startswith("time ")]
        if chosen.time is not None:
            warnings += posing.notes(scene, chosen.time, chosen.clip)
        receipts.append(
            first
            | {"settings": first["settings"] | said, "scene": first["scene"] | {"warnings": warnings}}
            | {"camera": receipt.camera(drawn.view)}
        )
        names = [drawn.staged.reading(name, drawn.view, drawn.radiance) for name in aovs]
        return [outputs.rgb(drawn.display), drawn.staged.display.exposure(), *names]

    for rgb, exposure, *arrays in _stream(renderer, scene, shots, size, settings, aovs, in_flight, TIMED, readings):
        told = receipts.popleft()
        told["settings"]["exposure_ev"] = exposure
        yield Frame(rgb, dict(zip(aovs, arrays, strict=True)), told)


def arrays(
    renderer: "Renderer",
    scene: Scene,
    shots: Iterable[Shot],
    size: tuple[int, int],
    settings: Settings,
    in_flight: int,
) -> Iterator[np.ndarray]:
    """As Renderer.arrays."""

    def readings(drawn: _Drawn, chosen: Settings, timing: Timing | None) -> list[Reading[Any]]:
        return [outputs.rgba(drawn.display)]

    for (rgba,) in _stream(renderer, scene, shots, size, settings, (), in_flight, 0, readings):
        yield rgba


def _stream(
    renderer: "Renderer",
    scene: Scene,
    shots: Iterable[Shot],
    size: tuple[int, int],
    settings: Settings,
    aovs: tuple[str, ...],
    in_flight: int,
    timed: int,
    readings: Callable[[_Drawn, Settings, Timing | None], list[Reading[Any]]],
) -> Iterator[list[Any]]:
    """What the readings of each shot return, in order. timed: how many pictures wait for their passes' times."""
    if not 1 <= in_flight <= MOST_IN_FLIGHT:
        raise SettingError(f"in_flight {in_flight}: expected from 1 to {MOST_IN_FLIGHT} pictures")
    ring = Ring(renderer.context, in_flight + 1)  # and the one just drawn
    renderer.rings.add(ring)
    finish = renderer.context.gl.finish
    try:
        for number, shot in enumerate(shots):
            chosen = settings if shot.time is None else settings.replace(time=shot.time)
            timing = Timing(finish, enabled=number < timed)
            drawn = _Drawn(*renderer.draw(scene, shot.camera, size, chosen, aovs, timing))
            ring.send(readings(drawn, chosen, timing if timing.enabled else None))
            if ring.full:  # whoever takes a picture may draw another: nothing is left in the images by now
                yield ring.take()
                _check_open(renderer, ring)
        while len(ring):
            yield ring.take()
            _check_open(renderer, ring)
    finally:
        if ring in renderer.rings:  # else close() has freed it
            renderer.rings.remove(ring)
            renderer.context.make_current()
            ring.release()


def _check_open(renderer: "Renderer", ring: Ring) -> None:
    if ring not in renderer.rings:
        raise DeviceError("the renderer was closed before the last picture: take them all inside its with block")
    renderer.context.make_current()  # whoever took a picture may have drawn with another renderer
