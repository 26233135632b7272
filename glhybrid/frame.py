"""The frame, on one page: the passes that a scene and its settings call for, and what each hands to the next.

What is not called for is None and costs nothing: no program, no image, no dispatch.
"""

from collections.abc import Callable
from typing import Any

from glhybrid.frame_constants import FrameConstants
from glhybrid.passes.baked import Baked
from glhybrid.passes.composite import Composite
from glhybrid.passes.denoise import Denoise
from glhybrid.passes.display import Display
from glhybrid.passes.gbuffer import GBufferRaster, GBufferTrace
from glhybrid.passes.glossy import Glossy
from glhybrid.passes.ray_ao import RayAo
from glhybrid.passes.rays import Rays
from glhybrid.passes.reflect import Reflect
from glhybrid.passes.reflect_sparse import ReflectSparse
from glhybrid.passes.screen_depth import ScreenDepth
from glhybrid.passes.shadow import Shadow
from glhybrid.passes.shadow_map import ShadowMap
from glhybrid.passes.shadow_soft import ShadowSoft
from glhybrid.passes.ssao import Ssao
from glhybrid.passes.ssr import Ssr
from glhybrid.setup import Setup
from glhybrid.targets import Targets
from glhybrid.timing import Progress

Timed = Callable[[str, Callable[[], Any]], Any]  # runs the work of a pass under its name, and returns its result


class Passes:
    """Kim's frame: what is seen, what light reaches it, what it reflects, together. Made and run in that order."""

    def __init__(
        self, setup: Setup, constants: FrameConstants, display: Display, progress: Progress | None = None
    ) -> None:
        self._setup, self._constants = setup, constants
        features, settings = setup.features, setup.settings
        self._basics = setup.shaders, setup.scene, features  # all that most passes are made from
        self.shadow: Shadow | ShadowMap | ShadowSoft | Baked | None = None
        if features.shadow_maps:
            self.shadow = ShadowMap(setup)
        elif features.lightmap:
            self.shadow = Baked(setup, progress)
        elif features.visibility and features.light_discs:
            self.shadow = ShadowSoft(setup)
        elif features.visibility:
            self.shadow = Shadow(*self._basics)

        self._gbuffers: dict[bool, GBufferRaster | GBufferTrace] = {}  # after light maps, which may be given up
        self.rays: Rays | None = None
        self.see(setup.plan.primary)

        self.occlusion: Ssao | RayAo | None = None
        if features.occlusion:
            self.occlusion = Ssao(setup) if settings.ao == "ssao" else RayAo(setup)

        self.screen_depth = ScreenDepth(*self._basics) if features.march else None
        self.reflect: Reflect | ReflectSparse | Ssr | Glossy | None = None
        if features.march:
            self.reflect = Ssr(setup)
        elif features.glossy:
            self.reflect = Glossy(setup)
            constants.put(emissive_weight=self.reflect.emissive_weight)
        elif features.reflections and features.reflect_grid:
            self.reflect = ReflectSparse(setup)
        elif features.reflections:
            self.reflect = Reflect(*self._basics, setup.plan.split)

        self.denoise = Denoise(setup) if features.filtered else None
        composed = settings.reflections != "reference" or not len(setup.scene.geometry.meshes)
        self.composite = Composite(*self._basics, display) if composed else None

    def run(self, targets: Targets, timed: Timed) -> Any:
        """One frame -> the image of linear radiance."""
        composite = self.composite
        assert composite is not None
        rays, visibility = self.rays, None
        if rays is not None:
            ids, visibility = timed(rays.name, lambda: rays.run(targets))
        else:
            ids = timed(self.gbuffer.name, lambda: self.gbuffer.run(targets))
        visibility, indirect = self.light(targets, ids, timed, visibility, shade=not self._setup.features.mirror_hits)
        return timed(composite.name, lambda: composite.run(targets, ids, visibility, indirect))

    def light(
        self, targets: Targets, ids: Any, timed: Timed, visibility: Any = None, shade: bool = True
    ) -> tuple[Any, dict[str, Any]]:
        """The image of what light arrives directly, and by their channels those of what arrives by other ways.

        visibility: if that image is made already. Not shade: what mirror rays met, in place of what comes along them.
        """
        shadow, occlusion, screen_depth, reflect = self.shadow, self.occlusion, self.screen_depth, self.reflect
        denoise = self.denoise
        indirect: dict[str, Any] = {}
        if denoise is not None:
            timed(denoise.name, lambda: denoise.begin(targets, ids, self._constants.sky))
        if isinstance(reflect, ReflectSparse):
            sparse = reflect
            timed(reflect.name, lambda: sparse.begin(targets, ids))
        if shadow is not None and visibility is None:
            choose, wait = self._constants.choose_lights, {}
            if (
                isinstance(shadow, Shadow)
                and isinstance(reflect, Reflect | ReflectSparse)
                and not (denoise or occlusion)
            ):
                wait = {"wait": False}  # a GPU goes on with mirror rays while the last of these are on their way
            visibility = timed(shadow.name, lambda: shadow.run(targets, ids, choose, **wait))
            if denoise is not None:
                timed(denoise.name, lambda: denoise.visibility(targets, visibility))
        if occlusion is not None:
            indirect["occlusion"] = timed(occlusion.name, lambda: occlusion.run(targets, ids))
        if isinstance(reflect, Ssr):
            assert screen_depth is not None
            screen = timed(screen_depth.name, lambda: screen_depth.run(targets, ids))
            indirect |= timed(reflect.name, lambda: reflect.run(targets, ids, visibility, screen))
        elif isinstance(reflect, Reflect):
            indirect |= timed(reflect.name, lambda: reflect.run(targets, ids, shade))
        elif isinstance(reflect, ReflectSparse):
            indirect |= timed(reflect.name, reflect.finish)
        elif reflect is not None:
            indirect |= timed(reflect.name, lambda: reflect.run(targets, ids))
        if denoise is not None:
            timed(denoise.name, lambda: denoise.indirect(targets, indirect))
        return visibility, indirect

    @property
    def resources(self) -> dict[str, Any]:
        """What programs of other passes read of the shadow pass: maps, and numbers."""
        return {} if self.shadow is None or isinstance(self.shadow, Shadow) else self.shadow.resources

    @property
    def maps(self) -> ShadowMap | Baked | None:
        """The shadow pass, if it has images that others look into."""
        return self.shadow if isinstance(self.shadow, (ShadowMap, Baked)) else None

    def moved(self) -> None:
        """To be called when instances have moved: the raster's states say which of them are mirrored."""
        raster = self._gbuffers.get(False)
        if isinstance(raster, GBufferRaster) and raster.outdated:
            self._gbuffers.pop(False).release()
            if self.gbuffer is raster:
                self.see("raster")

    def see(self, primary: str) -> None:
        """From now on what the camera sees is found by `raster` or `trace`. Both are kept once made."""
        setup = self._setup
        traced = primary == "trace" and len(setup.scene.geometry.meshes) > 0
        if traced not in self._gbuffers:
            self._gbuffers[traced] = (
                GBufferTrace(*self._basics) if traced else GBufferRaster(setup.context, *self._basics)
            )
        self.gbuffer = self._gbuffers[traced]
        self.rays = Rays(*self._basics) if traced and setup.plan.joined else None

    def release(self) -> None:
        """Frees what passes own; images belong to Targets."""
        reflect = self.reflect if isinstance(self.reflect, (ReflectSparse, Glossy)) else None
        for owner in (*self._gbuffers.values(), self.maps, reflect):
            if owner is not None:
                owner.release()
