"""The renderer: pictures of scenes on one device. Owns every GL object; close() frees them."""

import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Self

import numpy as np

from glhybrid import checks, outputs, receipt, stream
from glhybrid.context import Context, open_context
from glhybrid.errors import DeviceError
from glhybrid.flip import Flip
from glhybrid.gpu_scene import GpuScene
from glhybrid.image import Frame, check_aovs
from glhybrid.readback import Ring, at_once
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.staged import Staged
from glhybrid.stream import Shot
from glhybrid.timing import Progress, Timing
from glhybrid.tuning import Tuning, tuned
from glhybrid.view import View, choose_camera

INTERACTIVE_STAGINGS = 4  # two techniques side by side, the reference, and one on its way in


class Renderer:
    """Renders scenes on one device. Belongs to the thread and the process that open it; several take turns in one.

    device: auto, gpu, software, egl:N, cuda:N or osmesa. A scene's trees, buffers and programs are kept for the next
    frame of the same scene. interactive: several settings are kept ready at once, and images of two sizes.
    keep_programs: compiled ones, on disk too.
    Raises DeviceError where there is no usable OpenGL 4.3.
    """

    def __init__(
        self,
        device: str = "auto",
        context: Context | None = None,
        interactive: bool = False,
        keep_programs: bool = False,
    ) -> None:
        self._owns_context, self._closed = context is None, False
        self.context = context or open_context(device, keep_programs)
        self.shaders = Shaders(self.context)
        self._most = INTERACTIVE_STAGINGS if interactive else 1
        self._spare = interactive  # images of two sizes
        self.planned_size: tuple[int, int] | None = None  # decides between raster and rays in place of a picture's own
        self._stagings: list[Staged] = []  # the last one was used last
        self._seen: Camera | None = None  # was checked last
        self._view: View | None = None
        self._checked: Callable[[], Scene | None] = lambda: None
        self.rings: set[Ring] = set()  # of frames() and arrays() that are not at their end

    def render(
        self,
        scene: Scene,
        camera: int | str | Camera | None = None,
        size: tuple[int, int] = (1280, 720),
        settings: Settings | None = None,
        aovs: tuple[str, ...] = (),
        progress: Progress | None = None,
    ) -> Frame:
        """One picture, with the AOVs asked for (image.AOVS) and a receipt.

        camera: an index into Scene.cameras or a camera's name, a Camera, a text "eye=X,Y,Z;target=X,Y,Z;fov=45", or
        None for the first one. size: (width, height), pixels. progress: called with (stage, done, total), total 0 =
        unknown. `radiance` is always there. Pictures average settings.aa jittered frames (4 if not said); data AOVs
        are of the exact pixel centres. Raises SettingError, GeometryError, ShaderError, or DeviceError where the
        device lacks room.
        """
        started = time.perf_counter()
        settings, names = settings or Settings(), check_aovs(aovs)
        timing = Timing(self.context.gl.finish)
        staged, view, radiance, display = self.draw(scene, camera, size, settings, names, timing, progress)
        rgb = at_once(outputs.rgb(display))
        first_image_ms = (time.perf_counter() - started) * 1e3
        arrays = {n: at_once(staged.reading(n, view, radiance)) for n in dict.fromkeys(("radiance", *names))}
        return Frame(rgb, arrays, receipt.make(staged, view, timing, first_image_ms))

    def frames(
        self,
        scene: Scene,
        shots: Iterable[Shot],
        size: tuple[int, int] = (1280, 720),
        settings: Settings | None = None,
        aovs: tuple[str, ...] = (),
        in_flight: int = 3,
    ) -> Iterator[Frame]:
        """Pictures of one scene, one for each Shot(time, camera), as fast as they can be drawn: data sets, films.

        A picture comes out up to `in_flight` shots after it was drawn, so that reading it holds up nothing. Unlike
        render(), `radiance` is only read where `aovs` has it, and passes are timed in the first two pictures only.
        Rendering something else in between is allowed; motion vectors are then those since that. Raises as render()
        does, and SettingError for an `in_flight` that is not from 1 to 64.
        """
        return stream.frames(self, scene, shots, size, settings or Settings(), check_aovs(aovs), in_flight)

    def arrays(
        self,
        scene: Scene,
        shots: Iterable[Shot],
        size: tuple[int, int] = (1280, 720),
        settings: Settings | None = None,
        in_flight: int = 3,
    ) -> Iterator[np.ndarray]:
        """The same as bare (H, W, 4) uint8 arrays, sRGB and opaque, row 0 at the top: the fastest way to pictures."""
        return stream.arrays(self, scene, shots, size, settings or Settings(), in_flight)

    def draw(
        self,
        scene: Scene,
        camera: int | str | Camera | None,
        size: tuple[int, int],
        settings: Settings,
        aovs: tuple[str, ...],
        timing: Timing,
        progress: Progress | None = None,
    ) -> tuple[Staged, View, Any, Any]:
        """One picture that stays on the GPU: the staging, the view, and the images of radiance and display."""
        checks.check_kinds(scene, settings)
        chosen = choose_camera(scene, camera)
        if chosen is not self._seen:
            checks.check_camera(chosen)  # before any work is done
            self._seen = chosen
        staged = self.stage(scene, settings, size, aovs, progress)
        view = staged.aim(settings, camera, timing.enabled)
        if staged.outgrown:
            staged = self.stage(scene, settings, size, aovs, progress)
            view = staged.aim(settings, camera, timing.enabled)
        if view is not self._view:
            checks.check_view(view, staged.bounds)
            self._view = view
        radiance = staged.accumulate(timing, progress)
        return staged, view, radiance, timing.run("display", lambda: staged.display.image(staged.targets, radiance))

    def stage(
        self,
        scene: Scene,
        settings: Settings,
        size: tuple[int, int],
        aovs: tuple[str, ...] = (),
        progress: Progress | None = None,
    ) -> Staged:
        """Everything a scene needs on the GPU under these settings; kept until one of them changes.

        Another size changes images alone. So do other lights and another turn of the environment change only numbers:
        a scene that differs from a staged one in these (Scene.replace) is not staged anew.
        """
        if self._closed:
            raise DeviceError("this Renderer is closed: draw within its `with` block, or before close()")
        self.context.make_current()  # the process may have others
        checks.check_size(size)
        if scene is not self._checked():
            checks.check_scene(scene)
            self._checked = weakref.ref(scene)
        for staged in reversed(self._stagings):
            if staged.fits(scene, settings, aovs):
                self._stagings.remove(staged)
                self._stagings.append(staged)
                staged.resume(scene, settings, size, self._spare, self.planned_size)
                return staged
        shared = next((s for s in reversed(self._stagings) if s.shares_upload(scene, settings)), None)
        self._drop(self._most - 1, shared.upload if shared else None)
        kept = (shared.upload, shared.mover) if shared else None
        if progress is not None and "tuning" not in self.__dict__:
            progress("measuring this device, once", 0, 0)
        staged = Staged(
            self.context, self.shaders, scene, settings, size, aovs, kept, self.tuning, progress, self.planned_size
        )
        self._stagings.append(staged)
        return staged

    @property
    def keeps_programs(self) -> bool:
        """Whether what is compiled is found by the next process, too."""
        return self.context.programs is not None and self.context.programs.kept

    @cached_property
    def tuning(self) -> Tuning:
        """What this device is good at: measured at the first use of a device, kept on disk."""
        return tuned(self.context)

    @property
    def _staged(self) -> Staged | None:
        return self._stagings[-1] if self._stagings else None

    def forget(self, staged: Staged) -> None:
        """Frees one staging at once."""
        self.context.make_current()
        if staged in self._stagings:
            self._stagings.remove(staged)
            self._stagings.insert(0, staged)
            self._drop(len(self._stagings) - 1)

    def _drop(self, most: int, wanted: GpuScene | None = None) -> None:
        """Frees the stagings that were not used for longest, and uploads that no other one uses or is to use."""
        while len(self._stagings) > most:
            old = self._stagings.pop(0)
            old.release(keep_upload=old.upload is wanted or any(s.upload is old.upload for s in self._stagings))

    @contextmanager
    def keeping(self, stagings: int) -> Iterator[None]:
        """Within, so many are kept ready: for who goes to and fro between scenes."""
        before, self._most = self._most, max(stagings, self._most)
        try:
            yield
        finally:
            self._most = before
            self.context.make_current()
            self._drop(before)

    def reload_shaders(self) -> int:
        """Compiles programs anew whose files have changed; returns how many. What is on the GPU of scenes stays.

        Raises ShaderError where one does not compile; then all programs are as they were.
        """
        self.context.make_current()
        compiled = self.shaders.recompile()
        for staged in self._stagings if compiled else ():
            staged.stale = True
        self.shaders.replace(compiled)
        return len(compiled)

    @cached_property
    def flip(self) -> Flip:
        """Holds pictures against each other on this device; costs nothing where it is not asked for."""
        return Flip(self.context, self.shaders)

    def close(self) -> None:
        """Frees everything; what is drawn after it raises DeviceError. Twice is harmless."""
        if self._closed:
            return
        self._closed = True
        try:
            self.context.make_current()
        except DeviceError:  # it lives in another thread, or before a fork: its objects go when it goes
            if self._owns_context:
                self.context.close()
            return
        while self.rings:
            self.rings.pop().release()
        self._drop(0)
        if "flip" in self.__dict__:
            self.flip.release()
        self.shaders.release()
        if self._owns_context:
            self.context.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
