"""The renderer: one frame, top to bottom. Owns every GL object; close() frees them."""

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from typing import Any, Self

import numpy as np

from glhybrid import __version__, deform, geometry, layout, motion, outputs, plan, pose, stream
from glhybrid.context import Context, open_context
from glhybrid.frame_constants import FrameConstants
from glhybrid.gpu_scene import GpuScene
from glhybrid.image import AOVS, Frame, check_aovs
from glhybrid.mover import Mover
from glhybrid.passes.aov import Aov
from glhybrid.passes.baked import Baked
from glhybrid.passes.composite import Composite
from glhybrid.passes.denoise import Denoise
from glhybrid.passes.display import Display
from glhybrid.passes.gbuffer import GBufferRaster, GBufferTrace
from glhybrid.passes.glossy import Glossy
from glhybrid.passes.probe import Probe
from glhybrid.passes.ray_ao import RayAo
from glhybrid.passes.reference import Reference
from glhybrid.passes.reflect import Reflect
from glhybrid.passes.reflect_sparse import ReflectSparse
from glhybrid.passes.shadow import Shadow
from glhybrid.passes.shadow_map import ShadowMap
from glhybrid.passes.shadow_soft import ShadowSoft
from glhybrid.passes.sky import Sky
from glhybrid.passes.ssao import Ssao
from glhybrid.passes.ssr import Ssr
from glhybrid.probe_capture import Capture
from glhybrid.readback import Reading, Ring, at_once
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders
from glhybrid.stream import Shot
from glhybrid.targets import Targets
from glhybrid.timing import Timing
from glhybrid.tuning import Tuning, tuned
from glhybrid.view import View, choose_camera, make_view

Progress = Callable[[str, int, int], None]
INTERACTIVE_STAGINGS = 4  # two techniques side by side, the reference, and one on its way in
LIVE = frozenset({"exposure", "tone", "aa", "bounces", "seed"})  # settings that change numbers of a frame only
SOFTWARE_LIGHTS = 500  # whose shadow rays, of some 100 turns each, one invocation is sure to finish
OF_SURFACES = (
    "occlusion", "reflections", "mirror_rays", "march", "glossy", "probes", "probes_blurred", "denoise",
    "denoise_shadows", "visibility", "shadow_maps", "shadow_rays", "shadow_bits", "lightmap",
)  # features that a scene without any does not need  # fmt: skip
LIT_AHEAD = {"baked", "probe"}  # techniques that hold light from when they were staged


class Renderer:
    """Renders scenes on one device.

    device: auto, gpu, software, egl:N, cuda:N or osmesa. A scene's trees, buffers and programs are kept for the next
    frame of the same scene. interactive: several settings are kept ready at once, and images of two sizes.
    Raises DeviceError where there is no usable OpenGL 4.3.
    """

    def __init__(self, device: str = "auto", context: Context | None = None, interactive: bool = False) -> None:
        self._owns_context = context is None
        self.context = context or open_context(device)
        self.shaders = Shaders(self.context)
        self._most = INTERACTIVE_STAGINGS if interactive else 1
        self._stagings: list[Staged] = []  # the last one was used last
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

        size in pixels. `radiance` is always there. Pictures average settings.aa jittered frames (4 if not said);
        data AOVs are of the exact pixel centres. Raises SettingError, GeometryError or ShaderError.
        """
        started = time.perf_counter()
        settings, names = settings or Settings(), check_aovs(aovs)
        timing = Timing(self.context.gl.finish)
        staged, view, radiance, display = self.draw(scene, camera, size, settings, names, timing, progress)
        rgb = at_once(outputs.rgb(display))
        first_image_ms = (time.perf_counter() - started) * 1e3
        arrays = {n: at_once(staged.reading(n, view, radiance)) for n in dict.fromkeys(("radiance", *names))}
        return Frame(rgb, arrays, staged.receipt(view, timing, first_image_ms))

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
        Rendering something else in between is allowed; motion vectors are then those since that.
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
    ) -> tuple["Staged", View, Any, Any]:
        """One picture that stays on the GPU: the staging, the view, and the images of radiance and display."""
        choose_camera(scene, camera)  # refuses an unknown one before any work is done
        staged = self.stage(scene, settings, size, aovs, progress)
        view = staged.aim(settings, camera, timing.enabled)
        if staged.outgrown:
            staged = self.stage(scene, settings, size, aovs, progress)
            view = staged.aim(settings, camera, timing.enabled)
        radiance = staged.accumulate(timing, progress)
        return staged, view, radiance, timing.run("display", lambda: staged.display.run(staged.targets, radiance))

    def stage(
        self,
        scene: Scene,
        settings: Settings,
        size: tuple[int, int],
        aovs: tuple[str, ...] = (),
        progress: Progress | None = None,
    ) -> "Staged":
        """Everything a scene needs on the GPU under these settings; kept until one of them changes.

        Another size changes images alone. So do other lights and another turn of the environment change only numbers:
        a scene that differs from a staged one in these (Scene.replace) is not staged anew.
        """
        for staged in reversed(self._stagings):
            if staged.fits(scene, settings, aovs):
                self._stagings.remove(staged)
                self._stagings.append(staged)
                staged.resume(scene, settings, size, spare=self._most > 1)
                return staged
        shared = next((s for s in reversed(self._stagings) if s.shares_upload(scene, settings)), None)
        self._drop(self._most - 1, shared.upload if shared else None)
        kept = (shared.upload, shared.mover) if shared else None
        staged = Staged(self.context, self.shaders, scene, settings, size, aovs, kept, self.tuning, progress)
        self._stagings.append(staged)
        return staged

    @cached_property
    def tuning(self) -> Tuning:
        """What this device is good at: measured at the first use of a device, kept on disk."""
        return tuned(self.context)

    @property
    def _staged(self) -> "Staged | None":
        return self._stagings[-1] if self._stagings else None

    def forget(self, staged: "Staged") -> None:
        """Frees one staging at once."""
        if staged in self._stagings:
            self._stagings.remove(staged)
            self._stagings.insert(0, staged)
            self._drop(len(self._stagings) - 1)

    def _drop(self, most: int, wanted: GpuScene | None = None) -> None:
        """Frees the stagings that were not used for longest, and uploads that no other one uses or is to use."""
        while len(self._stagings) > most:
            old = self._stagings.pop(0)
            old.release(keep_upload=old.upload is wanted or any(s.upload is old.upload for s in self._stagings))

    def reload_shaders(self) -> int:
        """Compiles programs anew whose files have changed; returns how many. What is on the GPU of scenes stays.

        Raises ShaderError where one does not compile; then all programs are as they were.
        """
        compiled = self.shaders.recompile()
        for staged in self._stagings if compiled else ():
            staged.stale = True
        self.shaders.replace(compiled)
        return len(compiled)

    def close(self) -> None:
        """Frees everything. Twice is harmless."""
        while self.rings:
            self.rings.pop().release()
        self._drop(0)
        self.shaders.release()
        if self._owns_context:
            self.context.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Staged:
    """A scene made ready for one device, one set of settings and one size. The frame is here."""

    def __init__(
        self,
        context: Context,
        shaders: Shaders,
        scene: Scene,
        settings: Settings,
        size: tuple[int, int],
        aovs: tuple[str, ...],
        kept: tuple[GpuScene, Mover | None] | None = None,
        tuning: Tuning | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.context, self.shaders, self.scene, self.settings, self.aovs = context, shaders, scene, settings, aovs
        self.mover: Mover | None
        upload, self.mover = kept or (None, None)
        moving = self.mover.motion if self.mover is not None else motion.wanted(scene, settings)
        self.drawn = scene = moving.start if moving is not None else deform.at_time(scene, settings.time, settings.clip)
        self.plan = plan.make(
            scene, settings, software=context.device.software, clip_control=context.limits.clip_control, motion=moving,
            tuning=tuning, size=size,
        )  # fmt: skip
        features = self.plan.features
        if upload is None:
            data = geometry.build(
                scene, self.plan.levels, tangents=features.tangents, attributes=features.extra_attributes,
                deforming=moving.deforming if moving is not None else frozenset(),
            )  # fmt: skip
            upload = GpuScene(context, scene, data, features, moving, settings.rebuild)
        self.upload = upload
        others = dict(upload.resources)
        if moving is not None and self.mover is None:
            self.mover = Mover(context, shaders, upload, moving, features, settings.rebuild)
        self.bounds = moving.bounds if moving is not None else scene.bounds()
        self._motion_aov = "motion" in aovs
        if moving is not None and (self._motion_aov or features.denoise or features.denoise_shadows):
            upload.keep_previous(vertices=bool(moving.deformers))
            features = features.replace(moving=True, deforming=bool(moving.deformers))
        empty = not len(upload.geometry.meshes)
        features = features.replace(
            bvh_stack=max(upload.stack_entries, upload.stack_needed()),
            reason="reason" in aovs,
            exact_distance="reflection_hit" in aovs,
        )
        if empty:
            features = features.replace(**dict.fromkeys(OF_SURFACES, False))
        self.features, self.empty = features, empty
        self.constants = FrameConstants(context, scene, settings)
        self.sky = Sky(context, shaders, scene.environment, features)
        upload.resources.update(self.sky.resources, Frame=self.constants.buffer)
        self.targets = Targets(context, size)
        self._flipped = upload.flipped
        self.gbuffer = self._make_gbuffer()
        self.shadow: Shadow | ShadowMap | ShadowSoft | Baked | None = None
        if features.shadow_maps:
            self.shadow = ShadowMap(context, shaders, upload, features, settings)
            upload.resources.update(self.shadow.resources)
        elif features.lightmap:
            upload.relight(scene.lights)
            self.shadow = Baked(context, shaders, upload, features, settings, progress)
            upload.resources.update(self.shadow.resources)
        elif features.visibility and features.light_discs:
            self.shadow = ShadowSoft(shaders, upload, features, settings)
            upload.resources.update(self.shadow.resources)
        elif features.visibility:
            self.shadow = Shadow(shaders, upload, features)
        self.occlusion: Ssao | RayAo | None = None
        if features.occlusion:
            self.occlusion = (Ssao if settings.ao == "ssao" else RayAo)(shaders, upload, features, settings)
        self.reflect: Reflect | ReflectSparse | Ssr | Glossy | None = None
        if features.march:
            self.reflect = Ssr(shaders, upload, features, settings)
        elif features.glossy:
            self.reflect = Glossy(shaders, upload, features, settings)
        elif features.reflections and features.reflect_grid:
            self.reflect = ReflectSparse(context, shaders, upload, features, settings)
        elif features.reflections:
            self.reflect = Reflect(shaders, upload, features, self.plan.split)
        self.probe = Probe(context, shaders, upload, features, settings) if features.probes else None
        self._capture: Capture | None = None
        filtered = features.denoise or features.denoise_shadows
        self.denoise = Denoise(shaders, upload, features, settings) if filtered else None
        self._stochastic = features.glossy or features.light_discs or features.occlusion
        self._number, self._looks = 0, 0  # frames since the history began, looks since the last one
        reference = settings.reflections == "reference" and not empty  # without a tree there is only the background
        self.reference = Reference(context, shaders, upload, features) if reference else None
        self.composite = Composite(shaders, upload, features) if not reference else None
        self.display = Display(context, shaders, self.constants.buffer)
        self._aov = Aov(shaders, upload, features)
        self._ids: Any = None
        self._spare: Targets | None = None
        self._own = {name: given for name, given in upload.resources.items() if others.get(name) is not given}
        self._staged_lights = (self.mover.motion.scene if self.mover is not None else self.scene).lights
        self.stale = False  # shaders were changed
        self._relight()

    def fits(self, scene: Scene, settings: Settings, aovs: tuple[str, ...]) -> bool:
        if self.stale:
            return False
        if settings is not self.settings:
            ours, theirs = (self._timeless(s) for s in (self.settings, settings))
            if any(ours[name] != theirs.get(name) for name in ours if name not in LIVE) or ours.keys() != theirs.keys():
                return False
        if scene is not self.scene and ({settings.shadows, settings.reflections} & LIT_AHEAD or not self._like(scene)):
            return False
        if self.mover is not None and ("motion" in aovs) != self._motion_aov:
            return False
        told = ("reason" in aovs, "reflection_hit" in aovs)
        return told == (self.features.reason, self.features.exact_distance) and not self.outgrown

    def shares_upload(self, scene: Scene, settings: Settings) -> bool:
        """Whether trees, buffers and what moves them serve these settings too."""
        names = ("time", "clip", "levels", "rebuild")
        ours, theirs = ([self._timeless(s)[name] for name in names] for s in (self.settings, settings))
        return self._like(scene) and ours == theirs

    def _like(self, scene: Scene) -> bool:
        """Whether a scene differs at most in numbers of its lights and of its environment."""
        return scene is self.scene or differs_in_numbers(scene, self.scene)

    def resume(self, scene: Scene, settings: Settings, size: tuple[int, int], spare: bool = False) -> None:
        """Readies this staging again after others that share its upload were used. spare: keep images of two sizes."""
        self.upload.resources.update(self._own)
        self.scene, self.settings = scene, settings
        self.constants.under(scene, settings)
        self._relight()
        if size == self.targets.size:
            return
        other, self._spare, self._ids = self._spare, self.targets, None
        self.cut()
        if other is None or other.size != size:
            if other is not None:
                other.release()
            other = Targets(self.context, size)
        self.targets = other
        if not spare:
            self._spare.release()
            self._spare = None

    def holds(self, targets: Targets) -> bool:
        """Whether these images, current or spare, are not freed yet."""
        return targets is self.targets or targets is self._spare

    def _relight(self) -> None:
        """Lights that differ from those that were staged, on the GPU with the next look."""
        pairs = zip(self.scene.lights, self._staged_lights, self.drawn.lights, strict=True)
        self.upload.relight(tuple(now if now is not then else drawn for now, then, drawn in pairs))

    def _timeless(self, settings: Settings) -> dict[str, Any]:
        """The settings by name, but for the time where any time of the clip is as good."""
        live = self.mover is not None and motion.animated(settings)
        return settings.to_dict() | ({"time": None, "clip": settings.clip or ""} if live else {})

    @property
    def outgrown(self) -> bool:
        """Whether trees have become too deep for the programs."""
        return self.upload.stack_needed() > self.features.bvh_stack

    def _make_gbuffer(self) -> GBufferRaster | GBufferTrace:
        if self.plan.primary == "trace" and not self.empty:
            return GBufferTrace(self.shaders, self.upload, self.features)
        return GBufferRaster(self.context, self.shaders, self.upload, self.features)

    def aim(self, settings: Settings, camera: int | str | Camera | None, timed: bool = True) -> View:
        """Everything to the time of the settings, and the view of a camera there. timed: wait for the parts of it."""
        scene = self.drawn
        if self.mover is not None:
            scene = self.drawn = self.mover.show(settings.time or 0.0, timed)
            self._relight()
            if self.probe is not None:
                self.probe.stale = True
            if not np.array_equal(self._flipped, self.upload.flipped):  # the raster's states say who is mirrored
                self.gbuffer.release()
                self._flipped, self.gbuffer = self.upload.flipped, self._make_gbuffer()
        clip_control = self.context.limits.clip_control
        view = make_view(choose_camera(scene, camera), self.targets.size, scene, clip_control, self.bounds)
        self.look(view)
        return view

    def look(self, view: View) -> None:
        """Points the next frames through a view."""
        self._ids = None
        self._looks += 1
        if self.probe is not None:
            if self.probe.stale:
                self._capture_probes(self.probe)
            self.probe.look(view.origin)
        self.upload.rebase(view.origin)
        if isinstance(self.shadow, ShadowMap):
            self.shadow.look(view, self.bounds if self.mover is not None else None)
        self.constants.look(view, len(self.upload.lights))
        grid_min, grid_step = self.upload.top_grid(view.origin)
        self.constants.put(top_root=self.upload.top_root, top_grid_min=grid_min, top_grid_step=grid_step)

    def _capture_probes(self, probe: Probe) -> None:
        """Probes as things are now. What renders them is kept where things move."""
        self._capture = self._capture or Capture(self, probe)
        probe.timed(self._capture.run)
        if self.mover is None:
            self._capture.release()
            self._capture = None
        self._own |= probe.resources
        self.upload.resources.update(self._own)
        self._relight()

    def set(self, **values: Any) -> None:
        """Changes frame constants and uploads them."""
        self.constants.put(**values)
        self.constants.upload()

    def cut(self) -> None:
        """The next frame starts anew: nothing of those before is mixed in, and random sequences begin again."""
        self._number = 0

    def _follow(self) -> None:
        """Tells shaders which frame this is, and what of the one before filters may use."""
        if not self._stochastic:
            return
        kind = "NONE" if self._number == 0 or self._looks > 1 else "BEFORE" if self._looks else "SAME_VIEW"
        self.set(number=self._number, history=layout.CONSTANTS[f"HISTORY_{kind}"])
        self._number, self._looks = self._number + 1, 0

    def frame(self, timing: Timing) -> Any:
        """Kim's frame: what is seen, what light reaches it, what it reflects, together. Returns linear radiance.

        Frames drawn in a row are taken for a movie: filters go on from the one before, unless cut() was called.
        """
        targets, run = self.targets, timing.run
        timing.frame()
        assert self.composite is not None
        self._follow()
        ids = run("gbuffer", lambda: self.gbuffer.run(targets))
        visibility, indirect = self._light(run, ids)
        return run("composite", lambda: self.composite.run(targets, ids, visibility, indirect))  # type: ignore[union-attr]

    def _light(self, run: Callable[[str, Callable[[], Any]], Any], ids: Any) -> tuple[Any, dict[str, Any]]:
        """The images of what light arrives directly, and of what arrives by other ways."""
        shadow, denoise, targets, visibility = self.shadow, self.denoise, self.targets, None
        if denoise is not None:
            run(denoise.name, lambda: denoise.begin(targets, ids))
        if shadow is not None:
            visibility = run(shadow.name, lambda: shadow.run(targets, ids, self._set_lights))
            if denoise is not None:
                run(denoise.name, lambda: denoise.visibility(targets, visibility))
        indirect = self._indirect(run, ids, visibility)
        if denoise is not None:
            run(denoise.name, lambda: denoise.reflections(targets, indirect))
        return visibility, indirect

    def _indirect(self, run: Callable[[str, Callable[[], Any]], Any], ids: Any, visibility: Any) -> dict[str, Any]:
        """How open the sky is, and what specular lobes show, by the techniques in use: images by their channel."""
        occlusion, reflect, targets = self.occlusion, self.reflect, self.targets
        images = {}
        if occlusion is not None:
            images["occlusion"] = run(occlusion.name, lambda: occlusion.run(targets, ids))
        if isinstance(reflect, Ssr):
            screen = run(reflect.screen.name, lambda: reflect.screen.run(targets, ids))
            images["reflection"] = run(reflect.name, lambda: reflect.run(targets, ids, visibility, screen))
        elif reflect is not None:
            images |= run(reflect.name, lambda: reflect.run(targets, ids))
        return images

    def _set_lights(self, first: int, end: int) -> None:
        self.set(light_first=first, light_end=end)

    def accumulate(self, timing: Timing, progress: Progress | None) -> Any:
        """All samples of one picture -> radiance. The centre of the pixel comes last if data was asked for."""
        radiance = None
        name = "samples" if self.reference is not None else "frames"
        for done, total, radiance in self.refine(timing):  # noqa: B007
            if progress is not None:
                progress(name, done, total)
        return radiance

    def refine(self, timing: Timing) -> Iterator[tuple[int, int, Any]]:
        """(samples done, of how many, radiance) after each step of one picture. What is in between may be shown."""
        self._ids = None
        self.cut()  # a picture does not depend on those before it
        if self.reference is not None:
            self.set(jitter_px=(0, 0))
            self._ids = self.gbuffer.run(self.targets)
            for done, radiance in self.reference.steps(self.targets, self, timing):
                yield done, self.settings.samples, radiance
            return
        count = self.settings.aa or 4
        for i in range(count):
            self._ids = None  # the pass images are of this sample's rays from here on
            self.set(jitter_px=_jitter(i, count), accumulate=i / (i + 1))
            yield i + 1, count, self.frame(timing)

    def aov(self, name: str, view: View) -> np.ndarray:
        """One AOV at the pixel centres, (H, W, ...), row 0 at the top; of the picture just drawn."""
        return at_once(self.reading(name, view))

    def reading(self, name: str, view: View, radiance: Any = None) -> Reading[np.ndarray]:
        """The same as a reading. radiance: the picture's image, which that AOV is read from."""
        if name == "radiance":
            return outputs.texels(radiance, 0, 3)
        if self._ids is None:
            self.cut()
            self._follow()
            self.set(jitter_px=(0, 0), accumulate=0)
            self._ids = self.gbuffer.run(self.targets)
            self._light(lambda _, work: work(), self._ids)
            self.cut()
        width, height = self.targets.size
        if name == "visibility":
            if self.shadow is None:
                return outputs.constant(np.ones((height, width, len(self.upload.lights)), np.float32))
            return outputs.layers(self.targets.get(self.shadow.channel))
        if name == "occlusion":
            if self.occlusion is None:
                return outputs.constant(np.ones((height, width), np.float32))
            return outputs.texels(self.targets.get("occlusion"), 0, 1)
        if self.probe is not None and name in ("reflection", "reflection_hit", "reason"):
            self.probe.run(self.targets, self._ids)
        elif self.reflect is None and name in ("reflection", "reflection_hit", "reason"):
            shape = (height, width, 3) if name == "reflection" else (height, width)
            return outputs.constant(np.zeros(shape, AOVS[name].dtype))
        if name in ("reflection", "reflection_hit"):
            return outputs.texels(self.targets.get("reflection"), *((0, 3) if name == "reflection" else (3, 1)))
        if name == "reason":
            return outputs.texels(self.targets.get("reason"), 0, 1)
        return self._aov.run(self.targets, self._ids, name, view.origin)

    def receipt(self, view: View, timing: Timing, first_image_ms: float) -> dict[str, Any]:
        """What was drawn, how, on what, and how long it took."""
        scene = self.scene
        medians = (self.mover.ms if self.mover is not None else {}) | timing.medians()
        if self.probe is not None and self.mover is not None:
            medians["probe"] = self.probe.ms  # anew for every time
        warnings = list(scene.warnings)
        if self.settings.time is not None or self.settings.clip is not None:
            warnings += pose.notes(scene, self.settings.time, self.settings.clip)
        if dropped := self.upload.geometry.dropped:
            warnings.append(f"{dropped} triangles dropped: without area, or with a vertex that is not finite")
        rays = self.features.mirror_rays or self.features.blended
        if self.context.device.software and rays and len(scene.lights) > SOFTWARE_LIGHTS:
            warnings.append(
                f"{len(scene.lights)} lights: a software device ends the loops of a pixel at 65,535 turns: what "
                f"mirror rays and blended layers show may lack shadows of those past {SOFTWARE_LIGHTS}; a GPU does not"
            )
        drawn = [i for i in scene.instances]
        return {
            "version": __version__,
            "scene": {
                "name": scene.name, "path": str(scene.path) if scene.path else None, "sha256": scene.sha256,
                "triangles": scene.triangle_count(), "instances": len(drawn), "lights": len(scene.lights),
                "materials": len(self.upload.geometry.materials), "dropped_triangles": dropped, "warnings": warnings,
            },
            "device": self.context.device.to_dict(),
            "settings": self.settings.to_dict() | {
                "size": list(view.size), "camera": view.camera.name, "exposure_ev": self.display.exposure_ev(),
            },
            "plan": {
                "passes": list(self.plan.passes), "programs": self.shaders.names, "primary": self.plan.primary,
                "levels": self.upload.geometry.levels, "reasons": list(self.plan.reasons),
                "image_bytes": self.targets.bytes + self.sky.bytes + self.upload.image_bytes + self._map_bytes(),
                "buffer_bytes": self.upload.buffer_bytes + self.constants.buffer.size
                + (self.mover.bytes if self.mover is not None else 0),
                "skipped": list(self.plan.skipped),
            },
            "bvh": self.upload.bvh_stats(),
            "passes": [{"name": name, "ms": ms} for name, ms in medians.items()],
            "frame_ms": sum(ms for ms in medians.values()),
            "first_image_ms": first_image_ms,
        } | self._probes_receipt()  # fmt: skip

    def _probes_receipt(self) -> dict[str, Any]:
        """Where probes are and how long they took, if there are any."""
        if self.probe is None:
            return {}
        return {"probes": {"placed": [dataclasses.asdict(p) for p in self.probe.placed], "capture_ms": self.probe.ms}}

    def _map_bytes(self) -> int:
        maps = self.shadow.bytes if isinstance(self.shadow, (ShadowMap, Baked)) else 0
        return maps + (self.probe.bytes if self.probe is not None else 0)

    def release(self, keep_upload: bool = False) -> None:
        self.targets.release()
        if self._spare is not None:
            self._spare.release()
        maps = self.shadow if isinstance(self.shadow, (ShadowMap, Baked)) else None
        sparse = self.reflect if isinstance(self.reflect, ReflectSparse) else None
        for owner in (self.gbuffer, self.display, self.sky, self.reference, maps, self.probe, self._capture, sparse):
            if owner is not None:
                owner.release()
        self.constants.release()
        if not keep_upload:
            if self.mover is not None:
                self.mover.release()
            self.upload.release()


def _jitter(i: int, count: int) -> tuple[float, float]:
    """Offset from the pixel centre in pixels: a rank-1 lattice over the pixel, none for a single sample."""
    if count == 1:
        return 0.0, 0.0
    return (i + 0.5) / count - 0.5, (i * 0.61803398875 + 0.5) % 1.0 - 0.5


def differs_in_numbers(a: Scene, b: Scene) -> bool:
    """Whether two scenes are the same but for numbers of lights, and the turn and intensity of the environment."""
    for field in dataclasses.fields(Scene):
        if field.name not in ("lights", "environment") and getattr(a, field.name) is not getattr(b, field.name):
            return False
    if len(a.lights) != len(b.lights) or (a.environment is None) != (b.environment is None):
        return False
    if a.environment is not None and b.environment is not None:
        if a.environment.radiance is not b.environment.radiance:
            return False
        if (a.environment.intensity > 0) != (b.environment.intensity > 0):
            return False
    return all(
        p is q
        or (p.kind, p.node, p.radius > 0, p.angular_diameter > 0)
        == (q.kind, q.node, q.radius > 0, q.angular_diameter > 0)
        for p, q in zip(a.lights, b.lights, strict=True)
    )
