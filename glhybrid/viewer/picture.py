"""One technique's picture as it refines, sample by sample, on a renderer that it shares with others."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any

import moderngl
import numpy as np

from glhybrid.pace import Interrupted
from glhybrid.renderer import Renderer
from glhybrid.scene import F32, U8, Camera, Scene
from glhybrid.settings import Settings
from glhybrid.staged import Staged
from glhybrid.timing import Progress, Timing
from glhybrid.view import View, make_view

PROBE = 3  # pixels: powers of two, such as 1, llvmpipe compiles every program anew for
WINDOW = 120  # samples that medians and graphs are of


class Picture:
    """done of total samples. ms: milliseconds by pass, the last WINDOW samples at full size."""

    def __init__(self, renderer: Renderer, retire: Callable[[Staged], None], progress: Progress | None = None) -> None:
        """retire: told of a staging that this picture uses no more. progress: of preparations."""
        self._renderer, self._retire, self._progress = renderer, retire, progress
        self._pace = renderer.shaders.pace
        self._timing = Timing(renderer.context.raw.glFinish, clock=self._pace.clock)
        self.staged: Staged | None = None
        self.view: View | None = None
        self.done = self.total = 0
        self.size = (0, 0)
        self.ms: dict[str, deque[float]] = {}
        self.last_ms = 0.0
        self._wanted: tuple[Scene, Settings, Camera | int | None, tuple[int, int], tuple[str, ...]] | None = None
        self._samples: Iterator[tuple[int, int, Any]] | None = None
        self._radiance: Any = None
        self._into: Any = None  # the images that it is in
        self._shown: tuple[Any, ...] | None = None
        self._warm = False
        self._times: dict[str, float] = {}  # of the sample that is being drawn

    def begin(
        self, scene: Scene, settings: Settings, camera: Camera | int | None, size: tuple[int, int],
        aovs: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        """Another picture; nothing is drawn yet. What is shown stays until step() has drawn."""
        self._wanted = scene, settings, camera, size, aovs
        self._samples = None
        self.done = 0

    @property
    def finished(self) -> bool:
        """Whether no further sample is wanted."""
        return self._wanted is None or (self.done > 0 and self.done >= self.total)

    @property
    def share(self) -> float:
        """Of the samples, 0 to 1."""
        return self.done / self.total if self.total else 0.0

    def _staging(self) -> tuple[Scene, Settings, tuple[int, int], tuple[str, ...]]:
        assert self._wanted is not None
        scene, settings, _, size, aovs = self._wanted
        return scene, settings, size, aovs

    def _ready(self) -> Staged:
        """The staging, current, at the size and under the light that is wanted. Raises as Renderer.stage does."""
        assert self._wanted is not None
        scene, settings, camera, size, aovs = self._wanted
        staged = self._renderer.stage(scene, settings, size, aovs, self._progress)
        if staged is not self.staged or self._samples is None:
            self.view = staged.aim(settings, camera)
            if staged.outgrown:
                staged = self._renderer.stage(scene, settings, size, aovs, self._progress)
                self.view = staged.aim(settings, camera)
            old, self.staged, self.size, self.done = self.staged, staged, size, 0
            if staged is not old:
                self.ms, self._warm, self._radiance = {}, False, None
                if old is not None:
                    self._retire(old)
            self._timing.take()
            self._times = {}
            self._samples = staged.refine(self._timing)
        return staged

    def step(self, full: bool = True, turn: Callable[[], None] | None = None) -> float:
        """One more sample, or of a long one a part; returns its milliseconds, 0 until it is whole.

        full: at full size, so that the time counts in `ms`. turn: called now and then, in a sample too; where it raises
        Interrupted the picture begins anew with the next step.
        """
        staged = self._ready()
        assert self._samples is not None
        with self._turns(turn):
            done, self.total, radiance = next(self._samples)
        for name, value in self._timing.take().items():
            self._times[name] = self._times.get(name, 0.0) + value
        if done == self.done:
            return 0.0
        self.done, self._radiance, self._into = done, radiance, staged.targets
        times, self._times = (staged.mover.ms if staged.mover is not None and done == 1 else {}) | self._times, {}
        self.last_ms = sum(times.values())
        if full and self._warm:
            for name, value in times.items():
                self.ms.setdefault(name, deque(maxlen=WINDOW)).append(value)
        self._warm = True  # the first one also compiles
        return self.last_ms

    @contextmanager
    def _turns(self, turn: Callable[[], None] | None) -> Iterator[None]:
        """Gives turns in what is drawn; where that is given up, what is shown stays until there is another sample."""
        try:
            with self._pace.turns(turn):
                yield
        except Interrupted:
            self._samples, self.done = None, 0
            raise

    def medians(self) -> dict[str, float]:
        """Milliseconds of a sample by pass, over the last WINDOW at full size."""
        return {name: median(values) for name, values in self.ms.items() if values}

    def show(self, exposure_ev: float | None = None) -> Any:
        """The picture as far as it is, exposed and encoded: a texture, row 0 at the bottom. None before any sample.

        exposure_ev: instead of the settings' own, which makes two pictures comparable.
        """
        if self.staged is None or self._radiance is None or not self.staged.holds(self._into):
            return None
        if self._into is not self.staged.targets or not self.done:  # another is begun: what was shown last stays
            return self.display
        staged, settings = self.staged, self._wanted[1] if self._wanted else self.staged.settings
        key = self._into, self.done, settings.exposure, settings.tone, exposure_ev
        if self._shown is None or self._shown[:-1] != key:
            staged.constants.under(staged.scene, settings)
            if exposure_ev is not None:
                staged.constants.exposure_ev = exposure_ev
            staged.set()
            image = staged.display.image(staged.targets, self._radiance)
            self._shown = *key, image
        return self._shown[-1]

    def exposure_ev(self) -> float:
        """EV that show() used last."""
        return self.staged.display.exposure_ev() if self.staged is not None else 0.0

    def redisplay(self, settings: Settings) -> None:
        """Other exposure and tone map for the same samples."""
        if self._wanted is not None:
            scene, _, camera, size, aovs = self._wanted
            self._wanted = scene, settings, camera, size, aovs

    @property
    def display(self) -> Any:
        """The image that show() gave last, None before and where it was freed since."""
        there = self._shown is not None and self.staged is not None and self.staged.holds(self._shown[0])
        return self._shown[-1] if self._shown is not None and there else None

    @property
    def image(self) -> Any:
        """The image of linear radiance so far."""
        return self._radiance

    def pixels(self) -> U8:
        """(H, W, 4) uint8 of what show() gave, row 0 at the bottom."""
        image = self.display
        return np.frombuffer(image.read(), np.uint8).reshape(image.height, image.width, 4)

    def rgb(self) -> np.ndarray:
        """(H, W, 3) uint8 of what show() gave."""
        if self.display is None:
            self.show()
        return self.pixels()[::-1, :, :3]

    def radiance(self) -> F32:
        """(H, W, 3) float32 linear radiance so far."""
        image = self._radiance
        return np.frombuffer(image.read(), np.float32).reshape(image.height, image.width, 4)[::-1, :, :3]

    def array(self, name: str, turn: Callable[[], None] | None = None) -> np.ndarray:
        """An AOV, or an image of a pass by its channel's name; (H, W, ...), row 0 at the top. turn: as of step()."""
        staged = self._ready()
        self._disturb(staged)
        with self._turns(turn):
            return self._array(staged, name, turn)

    def _disturb(self, staged: Staged) -> None:
        """Something else is drawn between two samples: a picture whose random sequence that breaks begins anew."""
        if staged.stochastic and not self.finished:
            self._samples, self.done = None, 0

    def _array(self, staged: Staged, name: str, turn: Callable[[], None] | None) -> np.ndarray:
        assert self.view is not None
        if name == "radiance":
            while self._radiance is None or self.done == 0:
                self.step(turn=turn)
            return self.radiance()
        from glhybrid.image import AOVS

        if name in AOVS:
            return staged.aov(name, self.view)
        if name not in staged.targets.names:
            staged.aov("depth", self.view)
        if name not in staged.targets.names:
            return np.zeros((self.size[1], self.size[0], 1), np.float32)
        return staged.targets.read(name)

    def probe(self, camera: Camera, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """AOVs (1, 1, ...) of the middle pixel of a camera's PROBE by PROBE, without a trace in the picture."""
        scene, settings, size, aovs = self._staging()
        spot = PROBE, PROBE
        staged = self._renderer.stage(scene, settings, spot, aovs)
        self._disturb(staged)
        view = make_view(camera, spot, staged.drawn, self._renderer.context.limits.clip_control, staged.bounds)
        staged.look(view)
        try:
            middle = slice(PROBE // 2, PROBE // 2 + 1)
            return {name: staged.aov(name, view)[middle, middle] for name in names}
        finally:
            self._renderer.stage(scene, settings, size, aovs)
            if self.view is not None:
                staged.look(self.view)

    def channels(self) -> tuple[str, ...]:
        """Images of passes that array() reads besides the AOVs."""
        return self.staged.targets.names if self.staged is not None else ()

    def filter(self, exact: bool) -> None:
        """How the picture is drawn: texel by pixel, or smoothly where it is enlarged."""
        image, kind = self.display, moderngl.NEAREST if exact else moderngl.LINEAR
        if image is not None and image.filter != (kind, kind):
            image.filter = (kind, kind)

    def drop(self) -> None:
        """Frees the staging."""
        if self.staged is not None:
            self._renderer.forget(self.staged)
        self.staged = self._samples = self._radiance = self._shown = self._wanted = None
        self.done = self.total = 0
