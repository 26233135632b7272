"""One technique on one scene of the failure library: what a measure (quantities/) may ask of it.

A `Case` is shared by all techniques of a scene, and keeps what they are held against: the float64 answers of oracle.py
and converged pictures of the path tracer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.image import NO_ID, Frame
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, F64, Camera, Scene, Study
from glhybrid.settings import Settings
from glhybrid.study import measure
from glhybrid.study.oracle import I64, Oracle, Seen

Picture = NDArray[np.uint8]
WRONG = np.array([255, 0, 90], np.uint8)  # pixels that a measure counts, in pictures


@dataclass(frozen=True)
class Measured:
    """value in the measure's unit. picture: (H, W, 3) as displayed, what counts against the technique marked."""

    value: float
    picture: Picture


@dataclass(eq=False)
class Case:
    """A scene of the library, its [study] table, and answers that techniques share."""

    name: str
    scene: Scene
    study: Study
    _known: dict[Any, Any] = field(default_factory=dict)

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """The result of `make`, made once a key."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    @cached_property
    def oracle(self) -> Oracle:
        """The scene in float64, made at first use."""
        return Oracle(self.scene)

    def seen(self, camera: int = 0) -> Seen:
        """What the rays of a camera meet, once computed."""
        return self.once(("seen", camera), lambda: self.oracle.seen(self.scene.cameras[camera], self.study.size))

    def visibility(self, camera: int = 0, light: int = 0) -> F64:
        """(H, W), 0 or 1: the truth about a light without size."""
        return self.once(
            ("visibility", camera, light), lambda: self.oracle.visibility(self.seen(camera), self.scene.lights[light])
        )

    def forget(self) -> None:
        """Frees what was computed."""
        self._known.clear()
        self.__dict__.pop("oracle", None)


@dataclass(eq=False)
class Subject:
    """A case under the settings of one technique."""

    renderer: Renderer
    case: Case
    settings: Settings

    def frame(self, *aovs: str, camera: int | Camera = 0, scene: Scene | None = None, **changes: Any) -> Frame:
        """A picture without jitter; changes: of the settings."""
        settings = self.settings.replace(**changes) if changes else self.settings
        return self.renderer.render(scene or self.case.scene, camera, self.case.study.size, settings, aovs)

    def visibility(self, camera: int = 0, light: int = 0) -> tuple[F64, Picture]:
        """(H, W) of one light, and the picture."""
        frame = self.frame("visibility", camera=camera)
        return frame["visibility"][..., light].astype(np.float64), frame.rgb

    def hits(self, camera: int = 0) -> tuple[I64, F64, Picture]:
        """(H, W) instances, -1 for none, and distances of the first surfaces, and the picture."""
        frame = self.frame("instance_id", "distance", camera=camera)
        ids = frame["instance_id"].astype(np.int64)
        return np.where(ids == NO_ID, -1, ids), frame["distance"].astype(np.float64), frame.rgb

    def film(self, times: Sequence[float | None], scene: Scene | None = None) -> list[F32]:
        """(H, W, 3) radiance of frames in a row, a clip's seconds each: filters go on from one to the next."""
        shown = measure.film(self.renderer, scene or self.case.scene, 0, self.case.study.size, self.settings, times)
        return list(shown)

    def reference(self, camera: int = 0, samples: int = 256, **changes: Any) -> NDArray[np.float32]:
        """(H, W, 3) radiance of the path tracer, made once a case. Without jitter, as pictures here."""

        def make() -> NDArray[np.float32]:
            settings = self.case_settings.replace(reflections="reference", samples=samples, **changes)
            return self.renderer.render(self.case.scene, camera, self.case.study.size, settings)["radiance"]

        return self.case.once(("reference", camera, samples, *sorted(changes.items())), make)

    @cached_property
    def case_settings(self) -> Settings:
        """What the case asks of every technique."""
        return base_settings(self.case.study)


def base_settings(study: Study) -> Settings:
    """What every technique of a case has in common: one sample at the pixel's centre, a fixed exposure."""
    return Settings(aa=1, exposure=0.0, tone="none").replace(**study.settings)


def marked(picture: Picture, wrong: NDArray[np.bool_]) -> Picture:
    """The picture with some pixels in the colour of what is wrong."""
    out = picture.copy()
    out[wrong] = WRONG
    return out


def developed(radiance: NDArray[Any]) -> Picture:
    """Radiance (H, W) or (H, W, 3) as a picture, without tone map; roughly sRGB."""
    if radiance.ndim == 2:
        return grey(radiance)
    return (np.clip(radiance, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)


def grey(values: NDArray[Any]) -> Picture:
    """(H, W) from 0 to 1 as a picture; roughly sRGB."""
    level = np.clip(values, 0, 1) ** (1 / 2.2) * 255
    return np.repeat(level.astype(np.uint8)[..., None], 3, -1)
