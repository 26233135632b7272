"""A scene made ready for one device, one set of settings and one size: what is kept from frame to frame.

frame.py has the frame itself. Here is what surrounds it: trees and buffers, which stagings of the same scene share, the
time and the camera, the samples of a picture, and what is read back.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from glhybrid import aside, deform, geometry, layout, motion, outputs, pass_aovs, plan, probe_capture
from glhybrid.context import Context
from glhybrid.frame import Passes
from glhybrid.frame_constants import FrameConstants
from glhybrid.gpu_scene import GpuScene, check_room
from glhybrid.gpu_trees import STACK_STEP
from glhybrid.mover import Mover
from glhybrid.needs import Features
from glhybrid.passes.aov import Aov
from glhybrid.passes.display import Display
from glhybrid.passes.probe import Probe
from glhybrid.passes.reference import Reference
from glhybrid.passes.shadow_map import ShadowMap
from glhybrid.passes.sky import Sky
from glhybrid.probe_capture import Capture
from glhybrid.readback import Reading, at_once
from glhybrid.scene import Camera, Scene
from glhybrid.scene_change import only_numbers_differ
from glhybrid.settings import Settings
from glhybrid.setup import Setup
from glhybrid.shaders import Shaders
from glhybrid.targets import Targets
from glhybrid.timing import Progress, Timing
from glhybrid.tuning import Tuning
from glhybrid.view import View, choose_camera, make_view

LIVE = frozenset({"exposure", "tone", "aa", "bounces", "seed"})  # settings that change numbers of a frame only
LIT_AHEAD = {"baked", "probe"}  # techniques that hold light from when they were staged
OF_SURFACES = (
    "occlusion", "reflections", "mirror_rays", "mirror_hits", "march", "glossy", "probes", "probes_blurred", "denoise",
    "denoise_shadows", "denoise_occlusion", "visibility", "shadow_maps", "shadow_rays", "shadow_bits", "lightmap",
)  # features that a scene without any does not need  # fmt: skip


class Staged:
    """Owns what a scene needs on the device under some settings, but for the programs, which `shaders` keeps.

    kept: trees and buffers of another staging, and what moves them, to be shared with it. planned: as of resume().
    """

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
        planned: tuple[int, int] | None = None,
    ) -> None:
        self.context, self.shaders, self.scene, self.settings, self.aovs = context, shaders, scene, settings, aovs
        self.stale = False  # shaders were changed
        self._tuning, self._triangles = tuning, scene.triangle_count()

        moving = kept[1].motion if kept and kept[1] else motion.wanted(scene, settings)
        start = moving.start if moving is not None else deform.at_time(scene, settings.time, settings.clip)
        self.drawn = start  # the scene as it is at the time shown
        self.bounds = moving.bounds if moving is not None else start.bounds()
        self.plan = plan.make(
            start, settings, software=context.device.software, clip_control=context.limits.clip_control, motion=moving,
            tuning=tuning, size=planned or size,
        )  # fmt: skip
        self.upload, self.mover = kept or self._upload(moving, progress)
        try:
            self._make(moving, scene, start, size, progress)
        except BaseException:
            self.release(keep_upload=kept is not None)
            raise

    def _make(
        self, moving: motion.Motion | None, scene: Scene, start: Scene, size: tuple[int, int], progress: Progress | None
    ) -> None:
        """All but trees and buffers."""
        context, shaders, settings = self.context, self.shaders, self.settings
        if self.plan.trees and self.upload.trees is None:  # a staging that shares the upload had no use for them
            check_room(self.drawn, self.plan.levels, context)
            without, what = self.upload.geometry, f"building trees over {self._triangles:,} triangles"
            self.upload.add_trees(aside.run(lambda: geometry.grow_trees(without), progress, what))
            if self.mover is not None:
                self.mover.follow_trees()
        self.features = self._specialised(moving)
        self.constants = FrameConstants(context, start, settings)
        self.sky = Sky(context, shaders, start.environment, self.features)
        self._own: dict[str, Any] = {}
        self._add(self.sky.resources | {"Frame": self.constants.buffer})
        self._staged_lights = (self.mover.motion.scene if self.mover is not None else scene).lights
        self._lit: tuple[Any, Any, Any] | None = None  # what _relight() has seen and given
        self._relight()
        self.targets = Targets(context, size)
        self._spare: Targets | None = None  # of another size

        # What a picture is made of besides the frame: Kim's (frame.py), or the reference in its place.
        features = self.features
        self.display = Display(context, shaders, self.constants)
        setup = Setup(context, shaders, self.upload, features, settings, self.plan)
        self.passes = Passes(setup, self.constants, self.display, progress)
        self._add(self.passes.resources)
        self.probe = Probe(setup) if features.probes else None
        self._capture: Capture | None = None
        reference = self.passes.composite is None
        self.reference = Reference(context, shaders, self.upload, features) if reference else None
        self._aov = Aov(shaders, self.upload, features)
        self._view: View | None = None  # of the last picture
        self._time: float | None = None  # of the last picture, where things move
        self._ids: Any = None  # of the pixel centres, once AOVs asked for them
        self.stochastic = features.glossy or features.light_discs or features.occlusion
        self._top: tuple[Any, list[float]] | None = None  # the tree and the origin that the constants know
        self._number, self._looks = 0, 0  # frames since the history began, looks since the last one
        if self.probe is not None:
            if self.mover is not None:
                self.mover.show(0.0, False)  # places do not depend on what was shown before
            probe_capture.place(self, self.probe, progress)
            self._add(self.probe.resources)

    def _upload(self, moving: motion.Motion | None, progress: Progress | None) -> tuple[GpuScene, Mover | None]:
        """Buffers of the scene, trees if there is a use for them, and what moves them."""
        features, rebuild = self.plan.features, self.settings.rebuild
        if self.plan.trees:
            check_room(self.drawn, self.plan.levels, self.context)

        def build() -> geometry.Geometry:
            return geometry.build(
                self.drawn, self.plan.levels, tangents=features.tangents, attributes=features.extra_attributes,
                deforming=moving.deforming if moving is not None else frozenset(), trees=self.plan.trees,
            )  # fmt: skip

        what = "building trees over" if self.plan.trees else "gathering"
        data = aside.run(build, progress, f"{what} {self._triangles:,} triangles")
        if progress is not None:
            progress("uploading", 0, 0)
        upload = GpuScene(self.context, self.drawn, data, features, moving, rebuild, self.settings.builder)
        if moving is None:
            return upload, None
        return upload, Mover(self.context, self.shaders, upload, moving, features, rebuild)

    def _specialised(self, moving: motion.Motion | None) -> Features:
        """Features of the plan, with what only the AOVs asked for and the trees as they came out tell."""
        features, upload = self.plan.features, self.upload
        if not upload.geometry.meshes:
            features = features.replace(**dict.fromkeys(OF_SURFACES, False), blurred_sky=features.environment)
        if moving is not None and ("motion" in self.aovs or features.filtered):
            upload.keep_previous(vertices=bool(moving.deformers))
            features = features.replace(moving=True, deforming=bool(moving.deformers))
        unused = STACK_STEP[self.context.device.software]  # for programs that hold the code of rays and send none
        return features.replace(
            bvh_stack=max(upload.stack_entries, upload.stack_needed()) if self.plan.trees else unused,
            reason="reason" in self.aovs,
            reason_shadows="reason_shadows" in self.aovs and (features.shadow_maps or features.lightmap),
            reason_ao="reason_ao" in self.aovs and self.settings.ao == "ssao",
            exact_distance="reflection_hit" in self.aovs,
        )

    def _add(self, resources: dict[str, Any]) -> None:
        """Resources of this staging, that its programs read beside those of the scene."""
        self._own |= resources
        self.upload.resources.update(self._own)

    def fits(self, scene: Scene, settings: Settings, aovs: tuple[str, ...]) -> bool:
        """Whether it draws this scene under these settings, with these AOVs, as one staged for them would."""
        if self.stale:
            return False
        if settings is not self.settings and not self._alike(settings):
            return False
        if scene is not self.scene and ({settings.shadows, settings.reflections} & LIT_AHEAD or not self._like(scene)):
            return False
        if self.mover is not None and ("motion" in aovs) != ("motion" in self.aovs):
            return False
        told = ("reason", "reason_shadows", "reason_ao", "reflection_hit")
        return all((name in aovs) == (name in self.aovs) for name in told) and not self.outgrown

    def _alike(self, settings: Settings) -> bool:
        """Whether settings differ at most in numbers of a frame, and in a time of the same clip."""
        ours, theirs = self.settings.__dict__, settings.__dict__  # values are mostly the same objects
        other = {n for n, value in ours.items() if value is not theirs[n] and n not in LIVE and value != theirs[n]}
        if not other:
            return True
        live = self.mover is not None and motion.animated(self.settings) and motion.animated(settings)
        clips = (self.settings.clip or "") == (settings.clip or "")
        return live and clips and other <= {"time", "clip"}

    def shares_upload(self, scene: Scene, settings: Settings) -> bool:
        """Whether trees, buffers and what moves them serve these settings too."""
        names = ("time", "clip", "levels", "rebuild", "builder")
        ours, theirs = ([self._timeless(s)[name] for name in names] for s in (self.settings, settings))
        return self._like(scene) and ours == theirs

    def _like(self, scene: Scene) -> bool:
        """Whether a scene differs at most in numbers of its lights and of its environment."""
        return scene is self.scene or only_numbers_differ(scene, self.scene)

    def resume(
        self, scene: Scene, settings: Settings, size: tuple[int, int], spare: bool = False,
        planned: tuple[int, int] | None = None,
    ) -> None:  # fmt: skip
        """Readies this staging again after others that share its upload were used. spare: keep images of two sizes.

        planned: the size that decides how the camera's view is found, instead of size.
        """
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
        if settings.primary == "auto" and self._tuning is not None:
            self.plan = plan.resized(self.plan, self._tuning, self._triangles, planned or size)
            self.passes.see(self.plan.primary)

    def holds(self, targets: Targets) -> bool:
        """Whether these images, current or spare, are not freed yet."""
        return targets is self.targets or targets is self._spare

    def _relight(self) -> None:
        """Lights that differ from those that were staged, on the GPU with the next look."""
        now = self.scene.lights, self.drawn.lights
        if self._lit is not None and all(a is b for a, b in zip(self._lit, (*now, self.upload.lights), strict=True)):
            return
        pairs = zip(self.scene.lights, self._staged_lights, self.drawn.lights, strict=True)
        self.upload.relight(tuple(now if now is not then else drawn for now, then, drawn in pairs))
        self._lit = *now, self.upload.lights

    def _timeless(self, settings: Settings) -> dict[str, Any]:
        """The settings by name, but for the time where any time of the clip is as good."""
        live = self.mover is not None and motion.animated(settings)
        return settings.to_dict() | ({"time": None, "clip": settings.clip or ""} if live else {})

    @property
    def outgrown(self) -> bool:
        """Whether trees have become too deep for the programs."""
        return self.plan.trees and self.upload.stack_needed() > self.features.bvh_stack

    def aim(self, settings: Settings, camera: int | str | Camera | None, timed: bool = True) -> View:
        """Everything to the time of the settings, and the view of a camera there. timed: wait for the parts of it."""
        scene = self.drawn
        if self.mover is not None:
            then, self._time = self._time, settings.time or 0.0
            scene = self.drawn = self.mover.follow(then, self._time, timed)
            self._relight()
            if self.probe is not None:
                self.probe.captured.clear()
            self.passes.moved()
        chosen, size = choose_camera(scene, camera), self.targets.size
        if self._view is None or self._view.camera is not chosen or self._view.size != size:
            self._view = make_view(chosen, size, scene, self.context.limits.clip_control, self.bounds)
        self.look(self._view)
        return self._view

    def look(self, view: View) -> None:
        """Points the next frames through a view."""
        self._ids = None
        self._looks += 1
        if self.probe is not None:
            if missing := self.probe.missing(view):
                self._capture_probes(self.probe, missing)
            self.probe.look(view.origin)
        self.upload.rebase(view.origin)
        if isinstance(self.passes.shadow, ShadowMap):
            self.passes.shadow.look(view, self.bounds if self.mover is not None else None)
        self.constants.look(view, len(self.upload.lights))
        if self.features.two_level and not self._has_top(view):
            grid_min, grid_step = self.upload.top_grid(view.origin)
            self.constants.put(top_root=self.upload.top_root, top_grid_min=grid_min, top_grid_step=grid_step)

    def _has_top(self, view: View) -> bool:
        """Whether the constants tell the grid of the top-level tree as it is, in the world of this view."""
        before, self._top = self._top, (self.upload.top, view.origin.tolist())
        return before is not None and before[0] is self._top[0] and before[1] == self._top[1]

    def _capture_probes(self, probe: Probe, missing: list[int]) -> None:
        """These probes as things are now. What renders them is kept while more may be asked for."""
        capture = self._capture = self._capture or Capture(self, probe)
        probe.timed(lambda: capture.run(missing))
        if self.mover is None and probe.complete:
            self._capture.release()
            self._capture = None
        self._add(probe.resources)
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
        if not self.stochastic:
            return
        kind = "NONE" if self._number == 0 or self._looks > 1 else "BEFORE" if self._looks else "SAME_VIEW"
        self.set(number=self._number, history=layout.CONSTANTS[f"HISTORY_{kind}"])
        self._number, self._looks = self._number + 1, 0

    def frame(self, timing: Timing) -> Any:
        """One frame (frame.py) -> linear radiance.

        Frames drawn in a row are taken for a movie: filters go on from the one before, unless cut() was called.
        """
        timing.frame()
        self._follow()
        with self.context.bindings.keep():
            return self.passes.run(self.targets, timing.run)

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
            self._ids = self.passes.gbuffer.run(self.targets)
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
            self._ids = self.passes.gbuffer.run(self.targets)
            self.passes.light(self.targets, self._ids, lambda _, work: work())
            self.cut()
        if name in pass_aovs.NAMES:
            return pass_aovs.reading(name, self, self._ids)
        return self._aov.run(self.targets, self._ids, name, view.origin)

    def release(self, keep_upload: bool = False) -> None:
        """Also of a staging that was given up half made."""
        owned = ("_capture", "probe", "reference", "passes", "display", "sky", "_spare", "targets", "constants")
        for owner in (getattr(self, name, None) for name in owned):
            if owner is not None:
                owner.release()
        if not keep_upload:
            if self.mover is not None:
                self.mover.release()
            self.upload.release()


def _jitter(i: int, count: int) -> tuple[float, float]:
    """Offset from the pixel centre in pixels: a rank-1 lattice over the pixel, none for a single sample."""
    if count == 1:
        return 0.0, 0.0
    return (i + 0.5) / count - 0.5, (i * 0.61803398875 + 0.5) % 1.0 - 0.5
